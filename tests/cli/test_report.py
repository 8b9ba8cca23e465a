"""`tofmix report`: table, JSON and page."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.commandline import Estimated, Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    return estimated(boards(40), window=20)


def test_the_table_counts_pixels(tofmix: Tofmix, layers: Path) -> None:
    shown = tofmix("report", layers)
    assert shown.code == 0
    assert "ok" in shown.out
    assert shown.err == ""


def test_report_json_counts_pixels(tofmix: Tofmix, layers: Path) -> None:
    summary = json.loads(tofmix("report", layers, "--json").out)
    assert summary["pixels"] == 2 * 24
    assert sum(summary["pixels_by_surfaces"]) == 48


def test_html_page_is_written_with_the_table(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    page = tmp_path / "a.html"
    shown = tofmix("report", layers, "--recording", tmp_path / "a.h5", "--html", page, "--window", 1)
    assert shown.code == 0, shown.err
    assert shown.out.endswith(f"page: {page}\n")
    assert page.read_text().startswith("<!DOCTYPE html>")
    with_json = tofmix("report", layers, "--json", "--html", page, "--overwrite")
    json.loads(with_json.out)
    assert with_json.err == f"page: {page}\n"


def test_another_recording_is_refused(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    other = write_recording(tmp_path / "other.h5", boards(40) + np.uint16(1))
    shown = tofmix("report", layers, "--recording", other, "--html", tmp_path / "wrong.html")
    assert shown.code == ExitCode.BAD_INPUT
    assert "other.h5 is not the recording that" in shown.err
    assert f"tofmix estimate {other}" in shown.err
    assert not (tmp_path / "wrong.html").exists()
    small = write_recording(tmp_path / "small.h5", boards(40, 2, 2))
    assert tofmix("report", layers, "--recording", small).code == ExitCode.BAD_INPUT


def test_report_refuses_options_and_files_with_their_exit_code(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    (tmp_path / "old.html").write_text("old")
    for arguments, code in (
        ((tmp_path / "none.h5",), ExitCode.BAD_INPUT),
        ((tmp_path / "a.h5",), ExitCode.BAD_INPUT),
        ((layers, "--recording", layers), ExitCode.BAD_INPUT),
        ((layers, "--html", tmp_path / "old.html"), ExitCode.USAGE),
        ((layers, "--html", layers, "--overwrite"), ExitCode.USAGE),
        ((layers, "--html", tmp_path / "b.html", "--window", 2), ExitCode.USAGE),
        ((layers, "--html", tmp_path / "none" / "b.html"), ExitCode.STORAGE),
    ):
        outcome = tofmix("report", *arguments)
        assert outcome.code == code, arguments
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    assert (tmp_path / "old.html").read_text() == "old"
    assert not (tmp_path / "b.html").exists()
