"""What `import` and other commands say of doubtful clocks, values, lenses, and of metres read as mm."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.bags import DEPTH, INFO, KINDS, new_bag
from support.commandline import Tofmix
from support.files import boards, wall_model, write_recording

from tofmix.errors import ExitCode

SECOND = 10**9
IMAGES = np.random.default_rng(4).integers(900, 1100, (12, 3, 4)).astype("u2")


def imported(tofmix: Tofmix, source: Path, *options: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    output = source.parent / "out.h5"
    done = tofmix.done("import", source, "-o", output, "--depth-axis", "ray", "--json", *options)
    tofmix.done("verify", output)
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


RNG = np.random.default_rng(11)


def wall_mm(frames: int = 12) -> np.ndarray:
    return np.rint(RNG.normal(1700.0, 5.0, (frames, 4, 5)))


def ranges_of(path: Path) -> np.ndarray:
    with h5py.File(path) as root:
        values = root["range"][...]
    return np.where(values == 0, np.nan, values) if values.dtype.kind == "u" else values


@pytest.mark.parametrize(
    ("dtype", "bad", "said"),
    [
        ("i2", -9, "12 negative"),
        ("i4", -1, "12 negative"),
        ("u2", 65535, "12 fill value 65535"),
        ("u2", 32768, "12 fill value 32768"),
        ("i4", 2**31 - 1, "12 fill value 2147483647"),
        ("f8", 3.0e15, "12 above 1e+09 mm"),
    ],
)
def test_values_that_are_no_ranges_are_dropped_and_counted(
    tofmix: Tofmix, tmp_path: Path, dtype: str, bad: float, said: str
) -> None:
    values = wall_mm().astype(dtype)
    values[:, 1, 2] = bad
    np.save(tmp_path / "a.npy", values)
    done = tofmix.done("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--units", "mm", "--json")
    made = json.loads(done.out)
    assert f"a.npy: no samples: {said} (--keep-values keeps fill values)" in done.err
    assert made["notes"] == [done.err.removeprefix("tofmix: ").strip()]
    assert list(made["dropped"].values()) == [12]
    assert np.isnan(ranges_of(tmp_path / "a.h5")).sum() == 12
    tofmix.done("verify", tmp_path / "a.h5")


def test_keep_values_keeps_zeros_and_fill_values_but_no_negative_range(tofmix: Tofmix, tmp_path: Path) -> None:
    values = wall_mm().astype("i4")
    values[:, 0, 0], values[:, 0, 1], values[:, 0, 2] = 0, 65535, -5
    np.save(tmp_path / "a.npy", values)
    tofmix.done("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--keep-values")
    found = ranges_of(tmp_path / "a.h5")
    np.testing.assert_array_equal(found[0, 0, :3], [0.0, 65535.0, np.nan])


def test_given_invalid_values_are_counted_without_a_note(tofmix: Tofmix, tmp_path: Path) -> None:
    values = wall_mm().astype("u2")
    values[:3, 1, 2] = 4444
    np.save(tmp_path / "a.npy", values)
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--invalid", "4444")
    assert (done.code, done.err) == (0, "")
    assert "no samples: 3 value 4444\n" in done.out


def test_source_in_another_unit_is_said_with_the_command_that_sets_it_right(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", wall_mm().astype("u4") * 1000)
    done = tofmix.done("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert "no camera sees so far; check the units; if the numbers are in micrometres: tofmix import" in done.err
    estimated = tofmix.done("estimate", tmp_path / "a.h5")
    assert "a.h5: range: half of the ranges are above 17" in estimated.err
    words = done.err.split("micrometres: ")[1].split()[1:]
    again = tofmix(*words[:-1], tmp_path / "b.h5")
    assert (again.code, again.err) == (0, "")
    assert abs(np.nanmedian(ranges_of(tmp_path / "b.h5")) - 1700.0) < 3.0


@pytest.mark.parametrize("text", ["status", "status=", "=5", "status=5,x"])
def test_valid_status_that_names_no_codes_is_refused(tofmix: Tofmix, tmp_path: Path, text: str) -> None:
    np.save(tmp_path / "a.npy", wall_mm())
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--valid-status", text)
    done.refused(ExitCode.USAGE, "is not NAME=CODE,..., such as status=5,9")


@pytest.mark.parametrize("text", ["y", "y=line", "=row", "a=row,b=row", ","])
def test_columns_without_a_known_meaning_are_refused(tofmix: Tofmix, tmp_path: Path, text: str) -> None:
    np.save(tmp_path / "a.npy", wall_mm())
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--columns", text)
    done.refused(ExitCode.USAGE, "--columns")


def test_scale_is_said_to_be_multiplied_by_the_factor_of_the_source_and_quiet_hides_that(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root["depth"] = np.full((4, 2, 3), 3000, dtype="u2")
        root["depth"].attrs["scale_factor"] = 0.5
    arguments = ("import", tmp_path / "a.h5", "-o", tmp_path / "b.h5", "--overwrite", "--scale", "0.2")
    done = tofmix.done(*arguments)
    said = "one stored number is 0.1 mm: --scale 0.2 times the source's scale_factor 0.5"
    assert done.err == f"tofmix: {tmp_path / 'a.h5'}: {said}\n"
    done = tofmix(*arguments, "--quiet", "--json")
    assert done.err == ""
    assert said in json.loads(done.out)["notes"][0]
    with h5py.File(tmp_path / "b.h5") as root:
        np.testing.assert_allclose(root["range"], 300.0)


def test_quiet_hides_how_a_source_is_read_and_keeps_doubts(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "frame,row,col,range_mm,amplitude_2,ir\n" + "".join(f"{k},0,0,{4 + k},1,2\n" for k in range(4))
    )
    loud = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "a.h5")
    quiet = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "b.h5", "--quiet")
    assert "ir" in loud.err
    assert "not used" in loud.err
    assert "not used" not in quiet.err
    for done in (loud, quiet):
        assert done.code == 0, done.err
        assert "no camera sees so near" in done.err


def test_frame_rate_of_a_source_with_times_is_said_to_be_unused(tofmix: Tofmix, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", depth=wall_mm(), time=np.arange(12) * 0.25)
    done = tofmix.done("import", tmp_path / "a.npz", "-o", tmp_path / "a.h5", "--frame-rate", "30")
    assert "--frame-rate is not used: the frames have times" in done.err
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["time"][1] == 0.25


def depths(folder: Path) -> Path:
    np.save(folder / "depths.npy", np.full((3, 10, 12), 1700, dtype=np.uint16))
    return folder / "depths.npy"


@pytest.mark.parametrize(
    ("fov", "remedy"),
    [
        ("3.3x1.4", "in radians: --fov 189.1x80.21"),
        ("1.1x48", "if 1.1 is in radians: --fov 63.03x48"),
        ("62x0.9", "if 0.9 is in radians: --fov 62x51.57"),
        ("1.1x0.8", "--fov: 1.1 x 0.8 degrees is narrow; in radians: --fov 63.03x45.84"),
        ("6.4x4", ""),
        ("63x45", ""),
        ("40x2", ""),  # of 10 rows and 480 columns: in degrees the pixels are nearer to squares
    ],
)
def test_angles_that_may_be_in_radians_are_told_by_the_shape_of_a_pixel(
    tofmix: Tofmix, tmp_path: Path, fov: str, remedy: str
) -> None:
    samples = np.full((3, 10, 480) if fov == "40x2" else (3, 10, 12), 1700, dtype=np.uint16)
    np.save(tmp_path / "depths.npy", samples)
    done = tofmix.done("import", tmp_path / "depths.npy", "-o", tmp_path / "o.h5", "--fov", fov)
    assert done.err.endswith(f"{remedy}\n" if remedy else "")
    assert bool(done.err) == bool(remedy)


def test_export_and_surfaces_say_that_a_field_of_view_may_be_in_radians(tofmix: Tofmix, tmp_path: Path) -> None:
    tofmix.done("estimate", write_recording(tmp_path / "a.h5", boards(20)))
    layers = tmp_path / "a.layers.h5"
    for command in (("export", layers, "-o", tmp_path / "a.csv"), ("surfaces", layers)):
        done = tofmix.done(*command, "--fov", "0.7x0.5", "--overwrite")
        assert done.err == "tofmix: --fov: 0.7 x 0.5 degrees is narrow; in radians: --fov 40.11x28.65\n"
        assert tofmix(*command, "--fov", "40x30", "--overwrite").err == ""


def test_a_centre_far_outside_of_the_image_is_said(tofmix: Tofmix, tmp_path: Path) -> None:
    for centre, said in (("40,30", True), ("5.5,4.5", False)):
        output = tmp_path / f"{said}.h5"
        done = tofmix.done(
            "import",
            depths(tmp_path),
            "-o",
            output,
            "--units",
            "mm",
            "--depth-axis",
            "z",
            "--intrinsics",
            f"60,60,{centre}",
        )
        assert ("--intrinsics: the centre, column 40, row 30, is far outside of the image" in done.err) == said


def test_refusal_of_a_bag_without_a_lens_says_why_it_has_none(tofmix: Tofmix, tmp_path: Path) -> None:
    for topic, reason in ((INFO, f"{INFO}: not calibrated"), ("/rgb/camera_info", "--camera-info takes one of: /rgb")):
        folder = tmp_path / topic.split("/")[1]
        folder.mkdir()
        with new_bag(folder, "mcap") as (bag, path):
            bag.info(topic, (4, 6), (0.0,) * 4)
            bag.image(DEPTH, np.full((4, 6), 800, "u2"), stamp_ns=10**9)
        done = tofmix("import", path, "-o", folder / "o.h5")
        done.refused(ExitCode.BAD_INPUT, "depths along z need a lens")
        assert reason in done.err
        assert done.err.count("\n") == 1


@pytest.fixture
def metres(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "metres.h5", (boards(40) * 1e-3).astype("f4"))


@pytest.mark.parametrize(
    "line",
    [
        "estimate METRES -o OUT",
        "estimate METRES --noise auto -o OUT",
        "report LAYERS --recording METRES",
        "inspect LAYERS --pixel 1,1 --recording METRES",
        "map LAYERS --from averaged --recording METRES -o OUT.yaml",
        "reconcile MODEL METRES -o OUT",
    ],
)
def test_metres_without_units_are_refused_by_every_command(
    tofmix: Tofmix, metres: Path, tmp_path: Path, line: str
) -> None:
    model, layers = tmp_path / "model.toml", tmp_path / "a.layers.h5"
    model.write_text(wall_model(4, 6, 20))
    view = {"fov_horizontal_deg": 12.0, "fov_vertical_deg": 8.0}
    tofmix.done("estimate", write_recording(tmp_path / "a.h5", boards(40), attributes=view))
    names = {
        "METRES": metres,
        "OUT": tmp_path / "out",
        "OUT.yaml": tmp_path / "out.yaml",
        "LAYERS": layers,
        "MODEL": model,
    }
    before = sorted(tmp_path.iterdir())
    done = tofmix(*(names.get(word, word) for word in line.split()))
    done.refused(ExitCode.BAD_INPUT, f"tofmix import {metres} --units m")
    assert "attribute units to mm" in done.err
    assert done.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_zeros_that_count_as_ranges_are_noted_once(tofmix: Tofmix, tmp_path: Path) -> None:
    samples = boards(40).astype("f4")
    samples[:10] = 0
    path = write_recording(tmp_path / "a.h5", samples)
    done = tofmix.done("estimate", path)
    assert done.err.count("240 of 960 checked samples are exactly 0") == 1
    assert "range_zeros" in tofmix("info", path, "--json").out
    with h5py.File(path, "a") as root:
        root["range"].attrs["_FillValue"] = 0.0
    assert "exactly 0" not in tofmix("estimate", path, "--overwrite").err
