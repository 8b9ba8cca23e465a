"""`tofmix compare`: exit codes, JSON, page, refusals."""

import json
from pathlib import Path

import h5py
import pytest
from support.commandline import Estimated, Tofmix
from support.files import boards

from tofmix.errors import ExitCode


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    return estimated(boards(60), window=30)


@pytest.fixture
def moved(layers: Path) -> Path:
    """The same with one range of the second window moved by 5 combined standard errors, and one count less."""
    path = layers.with_name("b.layers.h5")
    path.write_bytes(layers.read_bytes())
    with h5py.File(path, "r+") as root:
        error = root["range_stderr"][1, 0, 0, 0]
        root["range"][1, 0, 0, 0] += 5 * 2**0.5 * error
        root["n_modes"][0, 3, 2] = root["n_modes"][0, 3, 2] - 1
    return path


def test_compare_of_a_file_with_itself_finds_no_difference(tofmix: Tofmix, layers: Path) -> None:
    shown = tofmix("compare", layers, layers, "--tolerance", 0)
    assert shown.code == 0
    assert shown.out.endswith("\nequal\n")
    assert shown.err == ""


def test_differences_exit_with_6_and_list_their_pixels(tofmix: Tofmix, layers: Path, moved: Path) -> None:
    shown = tofmix("compare", layers, moved, "--json")
    assert shown.code == int(ExitCode.DIFFERENT) == 6
    found = json.loads(shown.out)
    assert not found["equal"]
    assert (found["different"], found["count_differs"], found["range_differs"]) == (2, 1, 1)
    assert found["different_by_window"] == [1, 1]
    assert found["gap_largest_errors"] == pytest.approx(5, rel=1e-4)
    places = [(p["window"], p["row"], p["col"]) for p in found["pixels_shown"]]
    assert places == [(0, 3, 2), (1, 0, 0)]
    assert tofmix("compare", layers, moved).out.endswith("\ndifferent\n")


def test_tolerance_and_allowed_share_decide_the_exit_code(tofmix: Tofmix, layers: Path, moved: Path) -> None:
    found = json.loads(tofmix("compare", layers, moved, "--tolerance", 5.1, "--json").out)
    assert (found["count_differs"], found["range_differs"]) == (1, 0)
    assert tofmix("compare", layers, moved, "--allow", 2 / 48).code == 0
    assert tofmix("compare", layers, moved, "--allow", 1.9 / 48).code == ExitCode.DIFFERENT


@pytest.mark.slow
def test_html_page_is_written_with_the_same_exit_code(
    tofmix: Tofmix, layers: Path, moved: Path, tmp_path: Path
) -> None:
    page = tmp_path / "c.html"
    shown = tofmix("compare", layers, moved, "--html", page, "--window", 1)
    assert shown.code == ExitCode.DIFFERENT
    assert shown.out.endswith(f"page: {page}\n")
    assert "a.layers.h5 against b.layers.h5" in page.read_text()
    with_json = tofmix("compare", layers, moved, "--json", "--html", page, "--overwrite")
    json.loads(with_json.out)
    assert with_json.err == f"page: {page}\n"


def test_compare_refuses_options_and_files_with_their_exit_code(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    assert tofmix("estimate", tmp_path / "a.h5", "-o", tmp_path / "one.layers.h5").code == 0
    (tmp_path / "old.html").write_text("old")
    for arguments, code, text in (
        ((layers, tmp_path / "one.layers.h5"), ExitCode.BAD_INPUT, "different sizes"),
        ((layers, tmp_path / "none.h5"), ExitCode.BAD_INPUT, "No such file"),
        ((tmp_path / "a.h5", layers), ExitCode.BAD_INPUT, "not a layers file"),
        ((layers,), ExitCode.USAGE, "'B'"),
        ((layers, layers, "--tolerance", -1), ExitCode.USAGE, "--tolerance"),
        ((layers, layers, "--window", 0), ExitCode.USAGE, "--html"),
        ((layers, layers, "--html", tmp_path / "b.html", "--window", 2), ExitCode.USAGE, "windows 0 to 1"),
        ((layers, layers, "--html", tmp_path / "old.html"), ExitCode.USAGE, "--overwrite"),
        ((layers, layers, "--html", layers, "--overwrite"), ExitCode.USAGE, "is the input"),
    ):
        outcome = tofmix("compare", *arguments)
        assert outcome.code == code, (arguments, outcome.err)
        assert text in outcome.err
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    assert (tmp_path / "old.html").read_text() == "old"
