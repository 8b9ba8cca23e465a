"""The command line as a Markdown page: ``python docs/generators/cli_page.py > docs/reference/cli.md``.

With the argument ``exit-codes`` it is the page of exit codes, with a remedy for each.
"""

import sys
from collections.abc import Iterator

import click
from commands import PROGRAM, DescribedCommand, described_commands, described_program, table_cell

from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS, EXIT_CODE_REMEDIES

COMMAND = "python docs/generators/cli_page.py > docs/reference/cli.md"

_HEAD = f"""\
# Command line

Made by `{COMMAND}`; change the commands, not this page.

Every command shows its own part of it with `-h` or `--help`. An option that takes a value can also be set by an
environment variable: `TOFMIX_ESTIMATE_MAX_LAYERS=4` stands for `{PROGRAM} estimate --max-layers 4`. The option on the
command line wins.
"""
EXIT_CODES_COMMAND = "python docs/generators/cli_page.py exit-codes > docs/reference/exit-codes.md"
_EXIT_CODES_HEAD = f"""\
# Exit codes

Made by `{EXIT_CODES_COMMAND}`; change `tofmix/errors.py`, not this page.

An error is one line on stderr. It names the file, the dataset or option, and the reason:

    tofmix: boards.layers.h5 exists; pass --overwrite to replace it

| code | meaning | remedy or remark |
|---|---|---|
"""
_TABLE_HEAD = "| option | value | default | |\n|---|---|---|---|"


def reference() -> str:
    """Return the page, ending in one newline."""
    parts = [_HEAD, *_program()]
    for command in described_commands(main):
        parts += _command(command)
    parts += _exit_codes()
    return "\n".join(parts)


def exit_codes() -> str:
    """Return the page of exit codes, ending in one newline."""
    rows = ((int(c), table_cell(EXIT_CODE_MEANINGS[c]), table_cell(EXIT_CODE_REMEDIES[c])) for c in EXIT_CODE_MEANINGS)
    return _EXIT_CODES_HEAD + "".join(f"| {code} | {text} | {remedy} |\n" for code, text, remedy in rows)


def _program() -> Iterator[str]:
    program = described_program(main)
    yield f"## {program.path}\n"
    yield _fenced(program.usage)
    yield _paragraphs(program)
    yield "| command | |\n|---|---|"
    for command in described_commands(main):
        anchor = command.path.replace(" ", "-")
        yield f"| [`{command.path}`](#{anchor}) | {table_cell(command.summary)} |"
    yield ""
    yield from _options(program)
    yield from _examples(program)


def _command(command: DescribedCommand) -> Iterator[str]:
    yield f"## {command.path}\n"
    yield _fenced(command.usage)
    yield _paragraphs(command)
    yield from _options(command)
    yield from _examples(command)


def _options(command: DescribedCommand) -> Iterator[str]:
    yield _TABLE_HEAD
    for option in command.options:
        names = ", ".join(f"`{name}`" for name in option.names)
        yield f"| {names} | {table_cell(option.value)} | {table_cell(option.default)} | {table_cell(option.text)} |"
    yield ""


def _examples(command: DescribedCommand) -> Iterator[str]:
    for heading, lines in command.examples:
        yield f"{heading}\n"
        yield _fenced(lines)


def _exit_codes() -> Iterator[str]:
    yield "## Exit codes\n"
    yield "| code | |\n|---|---|"
    for code, text in EXIT_CODE_MEANINGS.items():
        yield f"| {int(code)} | {table_cell(text)} |"
    yield ""


def _paragraphs(command: DescribedCommand) -> str:
    return "".join(f"{paragraph}\n\n" for paragraph in command.paragraphs).removesuffix("\n")


def _fenced(text: str) -> str:
    return f"```sh\n{text}\n```\n"


if __name__ == "__main__":
    click.echo(exit_codes() if sys.argv[1:] == ["exit-codes"] else reference(), nl=False)
