"""The command line as a Markdown page: ``python -m tofmix.cli.reference > docs/reference/cli.md``.

Made from click's own objects, so that the page says what ``--help`` says. It takes
names, types, defaults and texts from them, never a formatted help: neither the
terminal, nor the environment, nor the layout of a click version changes a byte.
"""

import inspect
import re
from collections.abc import Iterator

import click

from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS

PROGRAM = "tofmix"
COMMAND = "python -m tofmix.cli.reference > docs/reference/cli.md"

_HEAD = f"""\
# Command line

Made by `{COMMAND}`; change the commands, not this page.

Every command shows its own part of it with `-h` or `--help`. An option that takes a value can also be set by an
environment variable: `TOFMIX_ESTIMATE_MAX_LAYERS=4` stands for `{PROGRAM} estimate --max-layers 4`. The option on the
command line wins.
"""
_TABLE_HEAD = "| option | value | default | |\n|---|---|---|---|"
_DEFAULT_IN_HELP = re.compile(r"\s*\[default: (.*)\]$")
_EXIT_CODES_HEADING = "Exit codes:"


def reference() -> str:
    """Return the page, ending in one newline."""
    parts = [_HEAD, *_program(main)]
    for name, command in main.commands.items():
        parts += _command(f"{PROGRAM} {name}", command)
    parts += _exit_codes()
    return "\n".join(parts)


def _program(group: click.Group) -> Iterator[str]:
    yield f"## {PROGRAM}\n"
    yield _fenced(f"{PROGRAM} [OPTIONS] COMMAND [ARGS]...")
    yield _paragraphs(group.help or "")
    yield "| command | |\n|---|---|"
    for name, command in group.commands.items():
        yield f"| [`{PROGRAM} {name}`](#{PROGRAM}-{name}) | {_cell(command.short_help or '')} |"
    yield ""
    yield from _options(group)
    yield from _epilog(group)


def _command(path: str, command: click.Command) -> Iterator[str]:
    arguments = [parameter.human_readable_name for parameter in command.params if isinstance(parameter, click.Argument)]
    yield f"## {path}\n"
    yield _fenced(" ".join([path, "[OPTIONS]", *arguments]))
    yield _paragraphs(command.help or "")
    yield from _options(command)
    yield from _epilog(command)


def _options(command: click.Command) -> Iterator[str]:
    yield _TABLE_HEAD
    for option in command.params:
        if isinstance(option, click.Option):
            text, default = _text_and_default(option)
            names = ", ".join(f"`{name}`" for name in option.opts)
            yield f"| {names} | {_cell(_value(option))} | {_cell(default)} | {_cell(text)} |"
    yield ""


def _text_and_default(option: click.Option) -> tuple[str, str]:
    """Help text and default; the default is said by click or, where it is no constant, at the end of the text."""
    text = option.help or ""
    if option.show_default:
        return text, str(option.default)
    if said := _DEFAULT_IN_HELP.search(text):
        return text[: said.start()], said[1]
    return text, ""


def _value(option: click.Option) -> str:
    """Say what the option takes, in words."""
    kind = option.type
    if option.is_flag:
        return ""
    if option.metavar is not None:
        return option.metavar
    if isinstance(kind, click.Choice):
        return "|".join(str(choice) for choice in kind.choices)
    if isinstance(kind, click.IntRange | click.FloatRange):
        return f"{_number_name(kind)}{_bounds(kind)}"
    if isinstance(kind, type(click.INT) | type(click.FLOAT)):
        return _number_name(kind)
    return "path" if isinstance(kind, click.Path) else "text"


def _number_name(kind: object) -> str:
    return "integer" if isinstance(kind, type(click.INT)) else "number"


def _bounds(kind: click.IntRange | click.FloatRange) -> str:
    low = "" if kind.min is None else f", {'above' if kind.min_open else 'at least'} {kind.min:g}"
    high = "" if kind.max is None else f", {'below' if kind.max_open else 'at most'} {kind.max:g}"
    return low + high


def _epilog(command: click.Command) -> Iterator[str]:
    """Yield the epilog's blocks as they are written: a heading and the lines below it."""
    for block in (command.epilog or "").split("\n\n"):
        heading, _, lines = block.removeprefix("\b\n").partition("\n")
        if lines and heading != _EXIT_CODES_HEADING:
            yield f"{heading}\n"
            yield _fenced(inspect.cleandoc(lines))


def _exit_codes() -> Iterator[str]:
    yield "## Exit codes\n"
    yield "| code | |\n|---|---|"
    for code, text in EXIT_CODE_MEANINGS.items():
        yield f"| {int(code)} | {_cell(text)} |"
    yield ""


def _paragraphs(text: str) -> str:
    """Return a help text with one line a paragraph."""
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "".join(f"{' '.join(paragraph.split())}\n\n" for paragraph in paragraphs).removesuffix("\n")


def _fenced(text: str) -> str:
    return f"```sh\n{text}\n```\n"


def _cell(text: str) -> str:
    """Return a text that a table's cell shows as it is."""
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    click.echo(reference(), nl=False)
