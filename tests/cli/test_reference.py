import os
import subprocess
import sys
from pathlib import Path

import click
import pytest

from tofmix.cli import reference
from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS

PAGE = Path(__file__).parents[2] / "docs" / "cli.md"
OPTIONS = [
    (name, option)
    for name, command in main.commands.items()
    for option in command.params
    if isinstance(option, click.Option)
]


def printed(**environment: str) -> bytes:
    """What ``python -m tofmix.cli.reference`` prints."""
    command = [sys.executable, "-m", "tofmix.cli.reference"]
    return subprocess.run(command, capture_output=True, check=True, env=os.environ | environment).stdout


def test_the_page_in_docs_is_what_the_command_prints() -> None:
    if PAGE.read_bytes() != printed():
        pytest.fail(f"docs/cli.md is not what the commands say; write it anew: {reference.COMMAND}")


def test_the_page_depends_on_neither_the_terminal_nor_the_environment() -> None:
    narrow = printed(COLUMNS="40", TERM="dumb", TOFMIX_ESTIMATE_MAX_LAYERS="9", FORCE_COLOR="1", LC_ALL="C")
    assert narrow == printed()


@pytest.mark.parametrize(("command", "option"), OPTIONS, ids=lambda part: getattr(part, "name", part))
def test_every_option_is_there_with_its_help(command: str, option: click.Option) -> None:
    section = reference.reference().split(f"\n## tofmix {command}\n")[1].split("\n## ")[0]
    row = next(line for line in section.splitlines() if f"`{option.opts[-1]}`" in line and line.startswith("| `-"))
    assert option.help
    # A default that is no constant stands at the end of the help and has its own column on the page.
    text, _, default = option.help.removesuffix("]").partition("  [default: ")
    assert row.endswith(f"| {text} |")
    assert f"| {str(option.default) if option.show_default else default} |" in row


def test_the_rule_for_environment_variables_holds() -> None:
    for _, option in OPTIONS:
        if not option.is_flag:
            assert option.name == option.opts[-1].removeprefix("--").replace("-", "_")


def test_bounds_choices_and_defaults_are_in_words() -> None:
    page = reference.reference()
    assert "| `--window` | integer, at least 1 | all | Frames that make one estimate. |" in page
    assert "| `--sigma` | tied\\|prior\\|free | prior |" in page
    assert "| `--memory` | SIZE | 1GB |" in page


def test_examples_and_exit_codes_are_there() -> None:
    page = reference.reference()
    for command in main.commands.values():
        assert command.epilog
        for line in command.epilog.splitlines()[2:]:
            assert f"\n{line.strip()}\n" in page
    for code, text in EXIT_CODE_MEANINGS.items():
        assert f"| {int(code)} | {text} |" in page
