"""Commands as their help describes them."""

import click
from commands import described_commands, described_program


@click.group()
@click.version_option("1")
def program() -> None:
    """A program.

    It does
    much.
    """


@program.command(epilog="\b\nExamples:\n  tofmix go here\n\n\b\nExit codes:\n  0  done")
@click.argument("place", metavar="PLACE")
@click.option("-n", "--number", type=click.IntRange(1, 5), default=2, show_default=True, help="How often.")
@click.option("--way", type=click.Choice(["left", "right"]), help="Where.  [default: the last]")
@click.option("--fast", is_flag=True, help="Hurry.")
def go(place: str, number: int, way: str, *, fast: bool) -> None:
    """Go to PLACE."""


def test_program_has_its_paragraphs_in_one_line_each() -> None:
    found = described_program(program)
    assert found.paragraphs == ("A program.", "It does much.")
    assert [o.names for o in found.options] == [("--version",)]


def test_command_has_usage_options_and_examples_without_exit_codes() -> None:
    (found,) = described_commands(program)
    assert (found.path, found.usage, found.summary) == ("tofmix go", "tofmix go [OPTIONS] PLACE", "Go to PLACE.")
    assert [(o.names, o.value, o.default, o.text) for o in found.options] == [
        (("-n", "--number"), "integer, at least 1, at most 5", "2", "How often."),
        (("--way",), "left|right", "the last", "Where."),
        (("--fast",), "", "", "Hurry."),
    ]
    assert found.examples == (("Examples:", "tofmix go here"),)
