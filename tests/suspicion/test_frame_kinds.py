"""Frames that are displaced together: their layers are marked, and one warning says it."""

import json
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.cameras import camera_of

import tofmix
from tofmix.arrays import BoolArray, FloatArray
from tofmix.cli.main import main
from tofmix.errors import DoubtWarning

FRAMES, SHAPE, SIGMA_MM = 100, (8, 12), 8.0
SENSOR = camera_of([1000.0], [SIGMA_MM], reach_mm=(100.0, 7000.0), fov_deg=(40.0, 30.0))
CODE = "frames_of_two_kinds"


def board(seed: int = 1, *, frames: int = FRAMES, mixed: bool = True) -> FloatArray:
    """Samples of a board at 1.5 m before a wall at 2.5 m; one row of pixels sees both."""
    rng = np.random.default_rng(seed)
    range_mm = np.full((frames, *SHAPE), 2500.0)
    range_mm[:, 3:, 4:9] = 1500.0
    if mixed:
        range_mm[:, 3, 4:9] = np.where(rng.random((frames, 5)) < 0.4, 2500.0, 1500.0)
    return range_mm + rng.normal(0.0, SIGMA_MM, range_mm.shape)


def every_fourth() -> BoolArray:
    return np.asarray(np.arange(FRAMES) % 4 == 3)


def a_fifth() -> BoolArray:
    chosen = np.zeros(FRAMES, bool)
    chosen[np.random.default_rng(2).choice(FRAMES, FRAMES // 5, replace=False)] = True
    return chosen


def second_half() -> BoolArray:
    return np.asarray(np.arange(FRAMES) >= FRAMES // 2)


def estimated(range_mm: FloatArray, window: int | None = None) -> tuple[tofmix.Estimate, list[str]]:
    recording = tofmix.from_array(range_mm, units="mm", sensor=SENSOR)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DoubtWarning)
        found = tofmix.estimate(recording, noise="file", window=window, workers=1)
    return found, [str(one.message) for one in caught]


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        (every_fourth(), "every 4th frame, from frame 3 on"),
        (a_fifth(), "frames "),
        (second_half(), "frames 50 to 99"),
        ((np.arange(FRAMES) >= 40) & (np.arange(FRAMES) < 48), "frames 40 to 47"),
    ],
    ids=["every fourth", "a fifth", "second half", "a few"],
)
@pytest.mark.parametrize("by_mm", [60.0, -60.0])
def test_layers_of_frames_that_move_together_are_marked_and_said_once(
    moved: BoolArray, words: str, by_mm: float
) -> None:
    found, said = estimated(board() + by_mm * moved[:, None, None])
    assert found.suspect is not None
    assert found.suspect_frames is not None
    present = np.isfinite(found.range)
    marked = found.suspect == 4
    # One of each surface's two layers; a surface may be split by chance.
    assert (marked.sum(axis=-1) * 2 == found.n_modes).mean() > 0.97
    truth = np.array([1500.0, 2500.0])
    for layers, middle in ((present & ~marked, truth), (marked, truth + by_mm)):
        assert np.abs(found.range[layers][:, None] - middle).min(axis=1).max() < 15.0
    ends = np.flatnonzero(moved)[[0, -1]]
    assert (found.suspect_frames[marked] == ends).mean() > 0.97
    assert not found.suspect_frames[~marked].any()
    lines = [line for line in said if "kinds" in line]
    assert len(lines) == 1
    assert lines[0].startswith(f"In {moved.sum()} of 100 frames nearly all pixels read ")
    assert f"mm {'farther' if by_mm > 0 else 'nearer'} than in the others ({words}" in lines[0]
    assert abs(float(lines[0].split(" read ")[1].split()[0]) - abs(by_mm)) < 1.0


def test_three_kinds_of_frames_are_told_apart() -> None:
    found, said = estimated(board() + np.array([0.0, 60.0, 120.0])[np.arange(FRAMES) % 3][:, None, None])
    assert found.suspect is not None
    assert (found.suspect[found.n_modes == 3] == [0, 4, 4, 0, 0, 0]).all()
    (line,) = (line for line in said if "kinds" in line)
    assert "(every 3rd frame, from frame 1 on); in 33 of 100" in line
    assert "(every 3rd frame, from frame 2 on): frames of several kinds" in line


def test_kinds_are_found_where_every_pixel_has_two_surfaces() -> None:
    rng = np.random.default_rng(4)
    range_mm = board(mixed=False)
    net = rng.random(range_mm.shape) < 0.5
    range_mm = np.where(net, rng.normal(1000.0, SIGMA_MM, range_mm.shape), range_mm)
    assert estimated(range_mm)[0].suspect is None
    found, said = estimated(range_mm + 60.0 * every_fourth()[:, None, None])
    assert found.suspect is not None
    assert np.median((found.suspect == 4).sum(axis=-1)) == 2
    assert any("every 4th frame, from frame 3 on" in line for line in said)


def still_net() -> FloatArray:
    """A net 60 mm before everything, which each sample hits by chance."""
    range_mm = board()
    return np.where(np.random.default_rng(5).random(range_mm.shape) < 0.25, range_mm - 60.0, range_mm)


def net_at_times() -> FloatArray:
    """A net at half the distance, which all pixels see in every third frame."""
    range_mm = board(mixed=False)
    range_mm[::3] *= 0.5
    return range_mm


def person() -> FloatArray:
    """Something that passes in two thirds of the image."""
    range_mm = board(mixed=False)
    range_mm[20:32, :, 2:10] = np.random.default_rng(6).normal(1000.0, SIGMA_MM, (12, SHAPE[0], 8))
    return range_mm


def cover() -> FloatArray:
    """Something that passes before the whole image at once."""
    range_mm = board(mixed=False)
    range_mm[20:32] = np.random.default_rng(8).normal(1000.0, SIGMA_MM, (12, *SHAPE))
    return (
        range_mm
        - np.linspace(0.0, 300.0, SHAPE[1]) * ((np.arange(FRAMES) < 20) | (np.arange(FRAMES) > 31))[:, None, None]
    )


def drift() -> FloatArray:
    return board() + np.linspace(0.0, 60.0, FRAMES)[:, None, None]


def jitter() -> FloatArray:
    return board() + np.random.default_rng(7).normal(0.0, 20.0, FRAMES)[:, None, None]


@pytest.mark.parametrize("scene", [board, still_net, net_at_times, person, cover, drift, jitter])
def test_no_word_of_kinds_where_frames_are_of_one(scene: object) -> None:
    assert callable(scene)
    found, said = estimated(scene())
    assert (found.n_modes > 1).any()
    assert not any("kinds" in line for line in said)


def test_marks_do_not_depend_on_windows_and_bands() -> None:
    """The pixels that tell are those of the image, wherever its blocks end."""
    moved = 60.0 * (np.arange(2 * FRAMES) % 4 == 3)[:, None, None]
    found, said = estimated(board(frames=2 * FRAMES) + moved, window=FRAMES)
    assert found.suspect is not None
    assert ((found.suspect == 4).sum(axis=-1) * 2 == found.n_modes).mean() > 0.97
    assert found.suspect_frames is not None
    assert found.suspect_frames[1][found.suspect[1] == 4].min() == FRAMES + 3
    assert sum("So in 2 of 2 windows" in line for line in said) == 1


@pytest.mark.parametrize("moved", [every_fourth(), a_fifth(), second_half()], ids=["fourth", "fifth", "half"])
def test_command_of_the_warning_leaves_frames_of_one_kind(moved: BoolArray, tmp_path: Path) -> None:
    path = tofmix.from_array(board(mixed=False) + 60.0 * moved[:, None, None], units="mm", sensor=SENSOR).save(
        tmp_path / "two kinds.h5"
    )
    result = CliRunner().invoke(main, ["estimate", str(path), "--noise", "file", "--json"])
    assert result.exit_code == 0, result.output
    (said,) = (one for one in json.loads(result.stdout)["warnings"] if one["code"] == CODE)
    assert result.stderr.count("nearly all pixels read") == 1
    report = CliRunner().invoke(main, ["report", str(tmp_path / "two kinds.layers.h5"), "--json"])
    (alone,) = (one for one in json.loads(report.stdout)["warnings"] if one["code"] == CODE)
    first, last = np.flatnonzero(moved)[[0, -1]]
    assert f"In {moved.sum()} of 100 frames" in alone["text"]
    assert f"(from frame {first} to {last})" in alone["text"]
    export = CliRunner().invoke(main, ["export", str(tmp_path / "two kinds.layers.h5"), "-o", str(tmp_path / "a.csv")])
    assert f"{SHAPE[0] * SHAPE[1]} suspect layers left out" in export.output
    (command,) = said["commands"]
    program, *arguments = shlex.split(command)
    if program == "tofmix":
        assert CliRunner().invoke(main, [*arguments, "--noise", "file"]).exit_code == 0
        name = "two kinds.layers.h5"
    else:
        assert program == "python"
        subprocess.run([sys.executable, *arguments], check=True, cwd=tmp_path)
        name = "two kinds.others.layers.h5"
        assert CliRunner().invoke(main, ["estimate", str(tmp_path / "two kinds.others.h5")]).exit_code == 0
    with h5py.File(tmp_path / name) as file:
        assert (file["n_modes"][...] == 1).mean() > 0.97
        assert "suspect" not in file
