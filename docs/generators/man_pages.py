"""Manual pages: ``python docs/generators/man_pages.py FOLDER`` writes ``tofmix.1`` and one page for each command.

The pages are roff with the macros of man(7). `man -l FOLDER/tofmix-estimate.1` shows one.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from commands import PROGRAM, DescribedCommand, described_commands, described_program

from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS
from tofmix.version import __version__


def man_pages() -> dict[str, str]:
    """Return the pages by the name of their file; each ends in one newline."""
    program, commands = described_program(main), list(described_commands(main))
    pages = {f"{PROGRAM}.1": _page(program, [*_list_of(commands), *_exit_codes()])}
    return pages | {f"{_name(c)}.1": _page(c, _see_also()) for c in commands}


def _page(command: DescribedCommand, last: list[str]) -> str:
    name = _name(command)
    lines = [
        f'.TH {name.upper()} 1 "" "{PROGRAM} {__version__}" "{PROGRAM} manual"',
        ".SH NAME",
        f"{_text(name)} \\- {_text(command.summary.rstrip('.'))}",
        ".SH SYNOPSIS",
        f".B {_text(command.usage)}",
        ".SH DESCRIPTION",
        *_paragraphs(command),
        ".SH OPTIONS",
        *_options(command),
        *_examples(command),
        *last,
    ]
    return "\n".join(lines) + "\n"


def _paragraphs(command: DescribedCommand) -> Iterator[str]:
    for paragraph in command.paragraphs:
        yield ".PP"
        yield _text(paragraph)


def _options(command: DescribedCommand) -> Iterator[str]:
    for option in command.options:
        names = ", ".join(f"\\fB{_text(name)}\\fR" for name in option.names)
        yield ".TP"
        yield f"{names} \\fI{_text(option.value)}\\fR" if option.value else names
        default = f" Default: {option.default.removesuffix('.')}." if option.default else ""
        yield _text(option.text + default)


def _examples(command: DescribedCommand) -> Iterator[str]:
    yield ".SH EXAMPLES"
    for heading, lines in command.examples:
        yield from (".PP", _text(heading), ".PP", ".nf", ".RS 4")
        yield from (_text(line) for line in lines.splitlines())
        yield from (".RE", ".fi")


def _list_of(commands: list[DescribedCommand]) -> list[str]:
    lines = [".SH COMMANDS"]
    for command in commands:
        lines += [".TP", f"\\fB{_text(_name(command))}\\fR(1)", _text(command.summary)]
    return lines


def _exit_codes() -> list[str]:
    lines = [".SH EXIT STATUS"]
    for code, text in EXIT_CODE_MEANINGS.items():
        lines += [".TP", f"\\fB{int(code)}\\fR", _text(text)]
    return lines


def _see_also() -> list[str]:
    return [".SH SEE ALSO", f"\\fB{PROGRAM}\\fR(1), which lists the exit status."]


def _name(command: DescribedCommand) -> str:
    return command.path.replace(" ", "-")


def _text(text: str) -> str:
    """Return a text that roff prints as it is."""
    shown = " ".join(text.split("\n")).replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{shown}" if shown.startswith((".", "'")) else shown


def _write(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, page in man_pages().items():
        (folder / name).write_text(page, encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:  # noqa: PLR2004  the program and its argument
        sys.exit("usage: python docs/generators/man_pages.py FOLDER")
    _write(Path(sys.argv[1]))
