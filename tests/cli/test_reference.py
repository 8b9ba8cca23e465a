import os
import subprocess
import sys
from pathlib import Path

import cli_page
import click
import pytest

from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "reference/cli.md"
OPTIONS = [
    (name, option)
    for name, command in main.commands.items()
    for option in command.params
    if isinstance(option, click.Option)
]


def printed(**environment: str) -> bytes:
    """What the command of the page prints."""
    command: list[str | Path] = [sys.executable, DOCS / "generators/cli_page.py"]
    return subprocess.run(command, capture_output=True, check=True, env=os.environ | environment).stdout


def test_page_in_docs_equals_the_output_of_the_command() -> None:
    if PAGE.read_bytes() != printed():
        pytest.fail(f"docs/reference/cli.md is not what the commands say; write it anew: {cli_page.COMMAND}")


def test_page_of_exit_codes_equals_the_output_of_the_command() -> None:
    page = PAGE.with_name("exit-codes.md").read_text(encoding="utf-8")
    assert page == cli_page.exit_codes(), f"run: {cli_page.EXIT_CODES_COMMAND}"
    assert all(f"| {int(code)} | " in page for code in EXIT_CODE_MEANINGS)


def test_the_page_depends_on_neither_the_terminal_nor_the_environment() -> None:
    narrow = printed(COLUMNS="40", TERM="dumb", TOFMIX_ESTIMATE_MAX_LAYERS="9", FORCE_COLOR="1", LC_ALL="C")
    assert narrow == printed()


def _misprinted(command: str, option: click.Option) -> bool:
    """Whether the row of an option is not what its help and its default say."""
    section = cli_page.reference().split(f"\n## tofmix {command}\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if f"`{option.opts[-1]}`" in line and line.startswith("| `-")]
    # A default that is no constant stands at the end of the help and has its own column on the page.
    text, _, default = (option.help or "").removesuffix("]").partition("  [default: ")
    shown = str(option.default) if option.show_default else default
    return not (text and rows and rows[0].endswith(f"| {text} |") and f"| {shown} |" in rows[0])


def test_every_option_has_a_row_with_its_help_and_default() -> None:
    assert len(OPTIONS) > 50
    offenders = [f"{command} {option.opts[-1]}" for command, option in OPTIONS if _misprinted(command, option)]
    assert not offenders, "\n".join(offenders)


def test_the_rule_for_environment_variables_holds() -> None:
    for _, option in OPTIONS:
        if not option.is_flag:
            assert option.name == option.opts[-1].removeprefix("--").replace("-", "_")


def test_bounds_choices_and_defaults_are_in_words() -> None:
    page = cli_page.reference()
    assert "| `--window` | integer, at least 1 | all | Frames of one estimate. |" in page
    assert "| `--sigma` | tied\\|prior\\|free | prior |" in page
    assert "| `--memory` | SIZE | 1GB |" in page


def test_page_has_examples_and_exit_codes() -> None:
    page = cli_page.reference()
    for command in main.commands.values():
        assert command.epilog
        for line in command.epilog.splitlines()[2:]:
            assert f"\n{line.strip()}\n" in page
    for code, text in EXIT_CODE_MEANINGS.items():
        assert f"| {int(code)} | {text} |" in page
