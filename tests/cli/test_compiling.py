"""What people see of compiling: a terminal the part and the number, a script one line, --quiet nothing."""

import time

import pytest

from tofmix.cli import reporter
from tofmix.cli.reporter import Announcement
from tofmix.compiled.kept import CANNOT_KEEP
from tofmix.compiled.watching import FIRST_RUN


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Show and say at once."""
    monkeypatch.setattr(reporter, "SHOWN_AFTER_S", 0.0)
    monkeypatch.setattr(reporter, "SAID_AFTER_S", 0.05)


def _compile(said: Announcement) -> None:
    said.expects(2)
    for kernel in ("estimation.layering._layer_block", "unmixing.seeds._fit_windows"):
        said.begins(kernel)
        time.sleep(0.6)
        said.ends(kernel)


def test_terminals_show_the_part_and_scripts_get_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    said = Announcement(is_terminal=True, is_quiet=lambda: False)
    _compile(said)
    said.close()
    shown = capsys.readouterr().err
    assert "\rtofmix: compiling for a first run: layers (1 of 2), 0 s" in shown
    assert "\rtofmix: compiling for a first run: unmixing (2 of 2), " in shown
    assert "\n" not in shown
    assert shown.endswith(" \r")  # wiped out
    said = Announcement(is_terminal=False, is_quiet=lambda: False)
    _compile(said)
    _compile(said)
    said.close()
    assert capsys.readouterr().err == f"tofmix: {FIRST_RUN}\n"


@pytest.mark.parametrize("is_terminal", [True, False])
def test_quiet_shows_nothing_but_that_no_code_is_kept(is_terminal: bool, capsys: pytest.CaptureFixture[str]) -> None:
    said = Announcement(is_terminal=is_terminal, is_quiet=lambda: True)
    _compile(said)
    said.cannot_keep(CANNOT_KEEP)
    said.close()
    assert capsys.readouterr().err == f"tofmix: {CANNOT_KEEP}\n"


def test_every_part_of_the_program_with_kernels_has_a_name() -> None:
    named = tuple(reporter._PARTS)
    from tofmix.compiled.kept import _KERNEL_FOLDERS

    assert all(any(start.split(".")[0] == folder for start in named) for folder in _KERNEL_FOLDERS[1:])
