"""The Python functions as a Markdown page: ``python docs/generators/python_page.py > docs/reference/python.md``.

Made from the docstrings and signatures of `tofmix.__all__`. The tables of parameters are numpydoc's.
"""

import inspect
import re
import sys
from collections.abc import Callable, Iterator

import tofmix

COMMAND = "python docs/generators/python_page.py > docs/reference/python.md"

_HEAD = f"""\
# Python reference

Made by `{COMMAND}`; change the docstrings, not this page.

Everything here is a name of `import tofmix`. [The tutorial](../tutorials/python.md) shows it at work. Ranges are radial
distances in mm unless a parameter says otherwise, and arrays are (frame, row, col) or (window, row, col, layer).
"""
_SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
_TABULAR = ("Parameters", "Returns", "Raises", "Warns")


def reference() -> str:
    """Return the page, ending in one newline."""
    named = ((name, getattr(tofmix, name)) for name in tofmix.__all__)
    entries = [(name, thing) for name, thing in named if callable(thing)]
    functions = [_entry(f"tofmix.{name}", thing) for name, thing in entries if not inspect.isclass(thing)]
    classes = [_class(name, thing) for name, thing in entries if inspect.isclass(thing)]
    return "\n".join([_HEAD, "## Functions\n", *functions, "## Classes\n", *classes])


def _class(name: str, kind: type) -> str:
    members = {key: value for key, value in vars(kind).items() if not key.startswith("_")}
    methods = [_entry(f"{name}.{key}", value, 4) for key, value in members.items() if inspect.isfunction(value)]
    properties = [
        f"#### {name}.{key}\n\n{_docstring(value)}\n" for key, value in members.items() if isinstance(value, property)
    ]
    return "\n".join([f"### {name}\n\n{_docstring(kind)}\n", *properties, *methods])


def _entry(name: str, function: Callable[..., object], level: int = 3) -> str:
    return f"{'#' * level} {name}\n\n```text\n{_call(name, function)}\n```\n\n{_docstring(function)}\n"


def _call(name: str, function: Callable[..., object]) -> str:
    """The call with its defaults; types are in the table below it, in words."""
    signature = inspect.signature(function)
    bare = [p.replace(annotation=p.empty) for key, p in signature.parameters.items() if key != "self"]
    return f"{name}{signature.replace(parameters=bare, return_annotation=signature.empty)}"


def _docstring(thing: object) -> str:
    first, *parts = _SECTION.split(inspect.getdoc(thing) or "")
    sections = zip(parts[::2], parts[1::2], strict=True)
    shown = [first.strip(), *(_section(title, body.strip("\n")) for title, body in sections)]
    return "\n\n".join(shown)


def _section(title: str, body: str) -> str:
    if title not in _TABULAR:
        return f"**{title}**\n\n{body}"
    return f"**{title}**\n\n" + "\n".join(_items(body))


def _items(body: str) -> Iterator[str]:
    """Yield one item for each name of a numpydoc section, with the text below it."""
    for item in re.split(r"\n(?=\S)", body):
        head, _, text = item.partition("\n")
        name, _, kind = head.partition(" : ")
        words = " ".join(text.split())
        yield f"- `{name}`" + (f", {kind}" if kind else "") + (f": {words}" if words else "")


if __name__ == "__main__":
    sys.stdout.write(reference())
