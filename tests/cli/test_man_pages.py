"""Manual pages: one for the program and for each command, whole, and readable to man."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from man_pages import man_pages

from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS

SCRIPT = Path(__file__).parents[2] / "docs/generators/man_pages.py"


def shown(page: Path) -> str:
    """A page as man shows it, without bold and underlined letters, and in one line."""
    groff = shutil.which("groff") or ""
    done = subprocess.run([groff, "-man", "-Tascii", "-ww", page], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return " ".join(re.sub(r"\x1b\[[\d;]*m|.\x08", "", done.stdout).split())


def test_each_command_has_a_page_with_its_options_and_examples() -> None:
    pages = man_pages()
    assert set(pages) == {"tofmix.1", *(f"tofmix-{name}.1" for name in main.commands)}
    for name, command in main.commands.items():
        page = pages[f"tofmix-{name}.1"].replace("\\-", "-")
        missing = [o for p in command.params for o in p.opts if o.startswith("-") and f"\\fB{o}\\fR" not in page]
        assert missing == []
        assert f"tofmix {name}" in page.split(".SH EXAMPLES")[1]


def test_page_of_the_program_lists_commands_and_exit_codes() -> None:
    page = man_pages()["tofmix.1"].replace("\\-", "-")
    assert all(f"\\fBtofmix-{name}\\fR(1)" in page for name in main.commands)
    assert all(f"\\fB{int(code)}\\fR\n{text}" in page for code, text in EXIT_CODE_MEANINGS.items())


def test_command_writes_the_pages_into_a_folder(tmp_path: Path) -> None:
    subprocess.run([sys.executable, SCRIPT, tmp_path / "man"], check=True)
    assert {p.name: p.read_text() for p in (tmp_path / "man").iterdir()} == man_pages()


def test_command_without_a_folder_prints_its_usage() -> None:
    done = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "usage" in done.stderr


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff here")
def test_groff_shows_backslashes_dots_and_dashes_as_they_are(tmp_path: Path) -> None:
    page = tmp_path / "tofmix.1"
    page.write_text(man_pages()["tofmix.1"])
    text = shown(page)
    assert 'eval "$(_TOFMIX_COMPLETE=bash_source tofmix)"' in text
    assert "--overwrite" in text
