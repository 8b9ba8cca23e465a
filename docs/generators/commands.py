"""A command as its help describes it, apart from any layout.

Made from click's own objects: names, types, defaults and texts, never a formatted help. Neither the terminal, nor the
environment, nor the layout of a click version changes a byte. `cli_page` writes Markdown from it, and `man_pages`
manual pages.
"""

import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass

import click

PROGRAM = "tofmix"

_DEFAULT_IN_HELP = re.compile(r"\s*\[default: (.*)\]$")
_EXIT_CODES_HEADING = "Exit codes:"


def table_cell(text: str) -> str:
    """A text as the cell of a Markdown table: one line, with bars escaped."""
    return " ".join(text.split()).replace("|", "\\|")


@dataclass(frozen=True, slots=True)
class DescribedOption:
    """An option.

    Parameters
    ----------
    names : tuple of str
        As they are typed, for example ``("-o", "--output")``.
    value : str
        The value that it takes, in words; empty for a flag.
    default : str
        In words; empty if there is none.
    text : str
        Its help.
    """

    names: tuple[str, ...]
    value: str
    default: str
    text: str


@dataclass(frozen=True, slots=True)
class DescribedCommand:
    """A command, or the program itself.

    Parameters
    ----------
    path : str
        As it is typed, for example ``"tofmix estimate"``.
    summary : str
        One line.
    usage : str
        Path, and its arguments in capitals.
    paragraphs : tuple of str
        The help, one line a paragraph.
    options : tuple of DescribedOption
        In the order of the help.
    examples : tuple of (str, str)
        A heading and the lines below it, as they are written. Exit codes are left out.
    """

    path: str
    summary: str
    usage: str
    paragraphs: tuple[str, ...]
    options: tuple[DescribedOption, ...]
    examples: tuple[tuple[str, str], ...]


def described_program(group: click.Group) -> DescribedCommand:
    """Describe the program."""
    return _described(group, PROGRAM, f"{PROGRAM} [OPTIONS] COMMAND [ARGS]...")


def described_commands(group: click.Group) -> Iterator[DescribedCommand]:
    """Yield the program's commands, in their order."""
    for name, command in group.commands.items():
        path = f"{PROGRAM} {name}"
        arguments = [p.human_readable_name for p in command.params if isinstance(p, click.Argument)]
        yield _described(command, path, " ".join([path, "[OPTIONS]", *arguments]))


def _described(command: click.Command, path: str, usage: str) -> DescribedCommand:
    paragraphs = tuple(" ".join(text.split()) for text in inspect.cleandoc(command.help or "").split("\n\n"))
    return DescribedCommand(
        path=path,
        summary=command.short_help or paragraphs[0],
        usage=usage,
        paragraphs=paragraphs,
        options=tuple(_option(option) for option in command.params if isinstance(option, click.Option)),
        examples=tuple(_examples(command)),
    )


def _option(option: click.Option) -> DescribedOption:
    text, default = _text_and_default(option)
    return DescribedOption(names=tuple(option.opts), value=_value(option), default=default, text=text)


def _text_and_default(option: click.Option) -> tuple[str, str]:
    """Help text and default; click gives a constant default, and the end of the text any other."""
    text = option.help or ""
    if option.show_default:
        return text, str(option.default)
    if said := _DEFAULT_IN_HELP.search(text):
        return text[: said.start()], said[1]
    return text, ""


def _value(option: click.Option) -> str:
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


def _examples(command: click.Command) -> Iterator[tuple[str, str]]:
    for block in (command.epilog or "").split("\n\n"):
        heading, _, lines = block.removeprefix("\b\n").partition("\n")
        if lines and heading != _EXIT_CODES_HEADING:
            yield heading, inspect.cleandoc(lines)
