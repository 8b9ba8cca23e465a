"""Recordings of cameras without a known end of the working range: the same bytes in however many pieces."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording
from support.sizes import sized

import tofmix as tm
from tofmix.layers import LAYER_FIELDS

WINDOWS = ("--window", 10, "--stride", 5)
UNKNOWN = {"range_min_mm": np.nan, "range_max_mm": np.nan}


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", sized(4096, 128))
    samples = boards(200, *sized((16, 20), (2, 5)))
    samples[3, 0, 0], samples[-1, -1, -1] = 90, 21_000  # each end in another block
    return write_recording(tmp_path / "a.h5", samples, attributes=UNKNOWN, chunks=(7, 2, 5))


@pytest.fixture
def expected(tofmix: Tofmix, recording: Path, tmp_path: Path) -> bytes:
    assert tofmix("estimate", recording, "-o", tmp_path / "expected.h5", *WINDOWS).code == 0
    return (tmp_path / "expected.h5").read_bytes()


def test_extreme_samples_are_stored_and_noted(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    outcome = tofmix("estimate", recording, *WINDOWS)
    assert outcome.code == 0, outcome.err
    assert "random values spread from the smallest sample to the largest, 90 to 21000 mm" in outcome.err
    with h5py.File(tmp_path / "a.layers.h5") as root:
        attributes = root["sensor"].attrs
        assert (attributes["sample_min_mm"], attributes["sample_max_mm"]) == (90.0, 21_000.0)
    assert tofmix("verify", tmp_path / "a.layers.h5").code == 0
    assert "sample_max_mm              21000" in tofmix("info", tmp_path / "a.layers.h5").out
    assert "sample_max_mm" not in tofmix("info", recording).out


def test_layers_of_a_known_range_keep_no_extreme_samples(tofmix: Tofmix, tmp_path: Path) -> None:
    assert tofmix("estimate", write_recording(tmp_path / "b.h5", boards(20))).code == 0
    with h5py.File(tmp_path / "b.layers.h5") as root:
        assert not {"sample_min_mm", "sample_max_mm"} & set(root["sensor"].attrs)


@pytest.mark.parametrize(
    "options",
    [("--workers", 1), *(pytest.param(o, marks=pytest.mark.slow) for o in (("--workers", 3), ("--memory", "250MB")))],
)
@pytest.mark.slow
def test_bytes_depend_on_neither_workers_nor_memory(
    tofmix: Tofmix, recording: Path, expected: bytes, tmp_path: Path, options: tuple[object, ...]
) -> None:
    assert tofmix("estimate", recording, *WINDOWS, *options).code == 0
    assert (tmp_path / "a.layers.h5").read_bytes() == expected


@pytest.mark.slow
def test_shards_merged_have_the_bytes_of_one_run(
    tofmix: Tofmix, recording: Path, expected: bytes, tmp_path: Path
) -> None:
    parts = [tmp_path / f"{part}.part" for part in (1, 2, 3)]
    for number, part in enumerate(parts, 1):
        assert tofmix("estimate", recording, *WINDOWS, "--shard", f"{number}/3", "-o", part).code == 0
    assert tofmix("merge", *parts, "-o", tmp_path / "merged.h5").code == 0
    assert (tmp_path / "merged.h5").read_bytes() == expected


@pytest.mark.slow
def test_resume_keeps_a_finished_output_of_the_same_samples(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    assert tofmix("estimate", recording, *WINDOWS).code == 0
    before = (tmp_path / "a.layers.h5").stat()
    again = tofmix("estimate", recording, *WINDOWS, "--resume")
    assert again.code == 0
    assert "blocks from the interrupted run" in again.err
    assert (tmp_path / "a.layers.h5").stat().st_mtime_ns == before.st_mtime_ns


@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_python_gives_the_same_layers(recording: Path, expected: bytes, tmp_path: Path) -> None:
    found = tm.estimate(recording, window=10, stride=5)
    assert expected
    command = tm.open(tmp_path / "expected.h5")
    assert isinstance(command, tm.Estimate)
    assert found.sensor.sample_max_mm == command.sensor.sample_max_mm == 21_000.0
    for spec in LAYER_FIELDS:
        np.testing.assert_array_equal(getattr(found, spec.name), getattr(command, spec.name))
