"""`tofmix import`: the order and the times of frames whose clocks went wrong."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.bags import DEPTH, KINDS, new_bag
from support.commandline import Tofmix

SECOND = 10**9
IMAGES = np.random.default_rng(4).integers(900, 1100, (12, 3, 4)).astype("u2")


def imported(tofmix: Tofmix, source: Path, *options: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    output = source.parent / "out.h5"
    done = tofmix("import", source, "-o", output, "--depth-axis", "ray", "--json", *options)
    assert done.code == 0, done.err
    assert tofmix("verify", output).code == 0
    with h5py.File(output) as root:
        return root["range"][...], root["time"][...], json.loads(done.out)["notes"]


@pytest.mark.parametrize("kind", KINDS)
def test_messages_that_overtook_one_another_are_sorted(tofmix: Tofmix, tmp_path: Path, kind: str) -> None:
    place = np.random.default_rng(2).permutation(12)
    with new_bag(tmp_path, kind) as (bag, path):
        for k, number in enumerate(place):
            bag.image(DEPTH, IMAGES[number], stamp_ns=int(5 * SECOND + number * SECOND // 10), bag_ns=(5 + k) * SECOND)
    ranges, times, notes = imported(tofmix, path)
    np.testing.assert_array_equal(ranges, IMAGES)
    np.testing.assert_allclose(times, np.arange(12) / 10)
    assert any("out of order sorted by time" in note for note in notes)


def test_clock_set_back_and_a_frame_stored_twice_give_an_ascending_recording(tofmix: Tofmix, tmp_path: Path) -> None:
    stamps = np.r_[100 + np.arange(8) / 10, np.arange(4) / 10]
    place = np.r_[np.arange(5), 4, np.arange(5, 12)]
    np.savez(tmp_path / "a.npz", range=IMAGES[place], time=stamps[place], amplitude=IMAGES[place] * 2)
    ranges, times, notes = imported(tofmix, tmp_path / "a.npz", "--amplitude", "amplitude")
    np.testing.assert_array_equal(ranges, IMAGES)
    np.testing.assert_allclose(times, np.arange(12) / 10, atol=1e-9)
    assert "1 frame equal to another of the same time left out" in notes[0]
    assert "the clock is set back at frame 9" in notes[1]
    with h5py.File(tmp_path / "out.h5") as root:
        np.testing.assert_array_equal(root["amplitude"][...], IMAGES * 2)


def test_times_begin_at_0(tofmix: Tofmix, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", range=IMAGES, time=1.7e12 + 40.0 * np.arange(12))
    _, times, notes = imported(tofmix, tmp_path / "a.npz", "--time-unit", "ms")
    np.testing.assert_allclose(times, np.arange(12) / 25, atol=1e-6)
    assert notes == []


def test_source_without_times_says_so(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", IMAGES)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert "times of the frames (reconcile needs them for effects in time: import --frame-rate)" in done.out
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "b.h5", "--frame-rate", "25")
    assert "times of the frames" not in done.out


def test_frame_counter_and_clock_that_restart_together_keep_the_order_of_the_lines(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    lines = [
        f"{k % 4},{k % 4 * 0.05:.2f},{r},{c},{IMAGES[k % 4, r, c]}" for k in range(8) for r in (0, 1) for c in (0, 1)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["frame,time_s,row,col,range_mm", *lines]))
    ranges, times, notes = imported(tofmix, tmp_path / "a.csv")  # the second run equals the first, times included
    np.testing.assert_array_equal(ranges, np.tile(IMAGES[:4, :2, :2], (2, 1, 1)))
    np.testing.assert_allclose(times, np.arange(8) * 0.05, atol=1e-9)
    assert any("starts again with the count of frames at frame 4" in note for note in notes)


def test_damaged_stamp_leaves_its_frame_in_place(tofmix: Tofmix, tmp_path: Path) -> None:
    stamps = np.arange(12) / 8
    stamps[5] = 2.1e18
    np.savez(tmp_path / "a.npz", range=IMAGES, time=stamps)
    ranges, times, notes = imported(tofmix, tmp_path / "a.npz")
    np.testing.assert_array_equal(ranges, IMAGES)
    np.testing.assert_allclose(times, np.arange(12) / 8)
    assert "that no clock shows (2.1e+18 s)" in notes[0]


def test_unit_of_times_is_asked_for_in_arrays_as_in_tables(tofmix: Tofmix, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", range=IMAGES, time=20 * np.arange(12))
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root["range"], root["time"] = IMAGES, 20 * np.arange(12)
    for path in (tmp_path / "a.npz", tmp_path / "a.h5"):
        done = tofmix("import", path, "-o", tmp_path / "b.h5")
        assert done.code == 3
        assert "time: no unit, and frames would be 20 s apart; give --time-unit ms" in done.err
        _, times, _ = imported(tofmix, path, "--time-unit", "ms", "--overwrite")
        np.testing.assert_allclose(times, 0.02 * np.arange(12))


def test_dates_of_numpy_are_times(tofmix: Tofmix, tmp_path: Path) -> None:
    stamps = np.datetime64("2025-02-28T23:59:59", "ms") + 50 * np.arange(12)
    np.savez(tmp_path / "a.npz", range=IMAGES, time=stamps)
    _, times, notes = imported(tofmix, tmp_path / "a.npz")
    np.testing.assert_allclose(times, 0.05 * np.arange(12))
    assert notes == []
