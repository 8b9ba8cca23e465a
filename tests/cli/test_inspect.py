"""`tofmix inspect`: numbers, figures, refusals."""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from support.commandline import Estimated, Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    return estimated(boards(60), window=30)


def test_inspect_prints_the_numbers_of_the_files(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    shown = tofmix(
        "inspect",
        layers,
        "--pixel",
        "2,3",
        "--window",
        1,
        "--neighbours",
        2,
        "--recording",
        tmp_path / "a.h5",
        "--json",
    )
    assert shown.code == 0, shown.err
    pixels = json.loads(shown.out)["pixels"]
    assert [(p["row"], p["col"]) for p in pixels] == [(2, 2), (2, 3), (2, 4)]
    with h5py.File(layers) as root:
        for pixel in pixels:
            place = 1, 2, pixel["col"]
            assert len(pixel["layers"]) == root["n_modes"][place]
            for k, layer in enumerate(pixel["layers"]):
                for name, field in (
                    ("range_mm", "range"),
                    ("range_stderr_mm", "range_stderr"),
                    ("weight", "weight"),
                    ("weight_stderr", "weight_stderr"),
                    ("probability", "probability"),
                ):
                    assert layer[name] == pytest.approx(float(root[field][(*place, k)]))
            assert pixel["samples_mm"] == boards(60)[30:, 2, pixel["col"]].tolist()
    text = tofmix("inspect", layers, "--pixel", "2,3", "--window", 1).out
    assert text.startswith("row 2, column 3: ")
    assert "row 2, column 5" in text
    assert "peaks of the density" not in text
    assert text.endswith("\nestimate kept layers of 0.999 or more (--false-alarm 0.001)\n")
    assert tofmix("estimate", tmp_path / "a.h5", "--refine", "none", "-o", tmp_path / "peaks.h5").code == 0
    assert "--false-alarm" not in tofmix("inspect", tmp_path / "peaks.h5", "--pixel", "2,3").out


@pytest.mark.parametrize("suffix", [pytest.param("png", marks=pytest.mark.slow), "svg"])
@pytest.mark.parametrize("over_frames", [False, True])
def test_inspect_writes_figures_as_png_and_svg(
    tofmix: Tofmix, layers: Path, tmp_path: Path, suffix: str, over_frames: bool
) -> None:
    figure = tmp_path / f"f.{suffix}"
    options = ["--over-frames"] if over_frames else []
    shown = tofmix("inspect", layers, "--pixel", "1,2", "--recording", tmp_path / "a.h5", "-o", figure, *options)
    assert shown.code == 0, shown.err
    assert shown.out.endswith(f"figure: {figure}\n")
    assert ("samples  peaks" in shown.out) == over_frames
    if suffix == "png":
        with Image.open(figure) as image:
            assert image.width > 800
            assert len(np.unique(np.asarray(image.convert("L")))) > 10
    else:
        assert "<svg" in figure.read_text()


def test_over_frames_counts_modes(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    arguments = ("inspect", layers, "--pixel", "0,0", "--recording", tmp_path / "a.h5", "--over-frames", "--json")
    grown = json.loads(tofmix(*arguments).out)["over_frames"]
    assert grown["n_samples"] == list(range(1, 31))
    assert grown["modes_mm"][-1] == pytest.approx([1200], abs=15)


def test_inspect_refuses_options_and_files_with_their_exit_code(
    tofmix: Tofmix, layers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write_recording(tmp_path / "small.h5", boards(60, 2, 2))
    dark = boards(60)
    dark[:, 0, 0] = 0
    empty = write_recording(tmp_path / "dark.h5", dark)
    (tmp_path / "old.png").write_text("old")
    pixel = ("--pixel", "0,0")
    for arguments, code, text in (
        ((layers,), ExitCode.USAGE, "--pixel"),
        ((layers, "--pixel", "3"), ExitCode.USAGE, "is not ROW,COL"),
        ((layers, "--pixel", "a,b"), ExitCode.USAGE, "is not ROW,COL"),
        ((layers, "--pixel", "4,0"), ExitCode.USAGE, "rows 0 to 3 and columns 0 to 5"),
        ((layers, "--pixel", "0,-1"), ExitCode.USAGE, "columns 0 to 5"),
        ((layers, *pixel, "--window", 2), ExitCode.USAGE, "windows 0 to 1"),
        ((layers, *pixel, "--over-frames"), ExitCode.USAGE, "--recording"),
        ((layers, *pixel, "-o", tmp_path / "a.pdf"), ExitCode.USAGE, ".png, .svg"),
        ((layers, *pixel, "-o", tmp_path / "old.png"), ExitCode.USAGE, "--overwrite"),
        ((layers, *pixel, "--recording", other), ExitCode.BAD_INPUT, "does not match"),
        ((tmp_path / "a.h5", *pixel), ExitCode.BAD_INPUT, "not a layers file"),
    ):
        outcome = tofmix("inspect", *arguments)
        assert outcome.code == code, (arguments, outcome.err)
        assert text in outcome.err
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    another = tofmix("inspect", layers, *pixel, "--recording", empty)
    assert another.code == ExitCode.BAD_INPUT
    assert "dark.h5 is not the recording that" in another.err
    assert tofmix("estimate", empty).code == 0
    nothing = tofmix("inspect", tmp_path / "dark.layers.h5", *pixel, "--recording", empty, "--over-frames")
    assert nothing.code == ExitCode.BAD_INPUT
    assert nothing.err.endswith("row 0, column 0: the pixel has no valid sample\n")
    monkeypatch.setitem(sys.modules, "tofmix.report.pixels.pixel_figures", None)
    missing = tofmix("inspect", layers, *pixel, "-o", tmp_path / "a.png")
    assert missing.code == ExitCode.USAGE
    assert "pip install 'tofmix[report]'" in missing.err
    assert not (tmp_path / "a.png").exists()
    assert (tmp_path / "old.png").read_text() == "old"
