"""`tofmix import` without `--sensor`: HDF5, CSV, units, depths along z, and what stays unknown."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from support import naive_png
from support.commandline import Tofmix

from tofmix.errors import ExitCode

SHAPE = (60, 4, 6)
"""Frames enough for a noise curve."""


def samples(shape: tuple[int, ...] = SHAPE, seed: int = 3) -> NDArray[np.float64]:
    """A wall whose pixels stand 10 mm apart, with 4 mm of noise."""
    rng = np.random.default_rng(seed)
    wall = 1500.0 + 10.0 * np.arange(np.prod(shape[-2:])).reshape(shape[-2:])
    return np.asarray(wall + rng.normal(0.0, 4.0, shape))


def read(path: Path, name: str = "range") -> NDArray[Any]:
    with h5py.File(path) as root:
        return np.asarray(root[name][...])


def test_array_without_a_sensor_has_unknown_camera_data(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples())
    out = tmp_path / "a.h5"
    done = tofmix("import", tmp_path / "a.npy", "-o", out)
    assert (done.code, done.err) == (0, "")
    assert "depths along the beam, taken as ranges (--depth-axis z if they are along z)" in done.out
    assert "not known: field of view (export, map and surfaces need it: import --fov), largest range" in done.out
    with h5py.File(out) as root:
        assert root["sensor"].attrs["name"] == "unknown"
        for key in ("range_min_mm", "range_max_mm", "fov_horizontal_deg", "fov_vertical_deg", "integration_time_ms"):
            assert np.isnan(root["sensor"].attrs[key]), key
        assert "noise_sigma" not in root["sensor"]
    told = tofmix("info", out)
    assert "No field of view" in told.out
    assert "No range_max_mm" in told.out


@pytest.mark.slow
def test_commands_name_the_missing_camera_data(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples((60, 8, 8)))
    tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    layers = tmp_path / "a.layers.h5"
    done = tofmix("estimate", tmp_path / "a.h5")
    assert done.code == 0, done.err
    assert "noise: sigma 4 mm" in done.err or "noise: sigma 3.9" in done.err
    assert "no range_max_mm" in done.err
    assert (read(layers, "n_modes") == 1).all()
    refused = tofmix("export", layers, "-o", tmp_path / "a.ply")
    assert refused.code == ExitCode.BAD_INPUT
    assert "no field of view, so points cannot be placed; give it with --fov" in refused.err
    assert tofmix("export", layers, "-o", tmp_path / "a.ply", "--fov", "60,45").code == 0
    refused = tofmix("map", layers, "-o", tmp_path / "map.yaml")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err == (
        f"tofmix: {layers}: the directions of its pixels are not known; import the recording with --fov HxV or"
        " --intrinsics, and estimate again\n"
    )
    remedy = "known; give them with --fov HxV, or import"
    assert tofmix("surfaces", layers).err == refused.err.replace("known; import", remedy)


@pytest.mark.slow
def test_fov_option_is_stored_in_the_recording(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples((60, 8, 8)))
    assert tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--fov", "70x55").code == 0
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["sensor"].attrs["fov_horizontal_deg"] == 70.0
        assert root["sensor"].attrs["fov_vertical_deg"] == 55.0
    assert tofmix("estimate", tmp_path / "a.h5").code == 0
    done = tofmix("map", tmp_path / "a.layers.h5", "-o", tmp_path / "map.yaml")
    assert done.code == 0, done.err
    assert "no range_max_mm: samples without a return mark no space as free" in done.err


@pytest.mark.parametrize(("units", "mm"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0)])
def test_units_option_takes_names(tofmix: Tofmix, tmp_path: Path, units: str, mm: float) -> None:
    np.save(tmp_path / "a.npy", samples() / mm)
    assert tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--units", units).code == 0
    np.testing.assert_allclose(read(tmp_path / "a.h5"), samples(), rtol=1e-7)


def test_real_numbers_that_look_like_metres_are_refused_and_whole_ones_are_not(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", (samples() / 1000).astype("f4"))
    refused = tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err.count("\n") == 1
    assert "give --units m, or --units mm if mm is right" in refused.err
    assert not (tmp_path / "m.h5").exists()
    np.save(tmp_path / "counts.npy", (samples() / 100).astype("u2"))
    assert tofmix("import", tmp_path / "counts.npy", "-o", tmp_path / "c.h5").code == 0


def test_metres_are_noticed_after_empty_first_frames(tofmix: Tofmix, tmp_path: Path) -> None:
    values = (samples((250, 4, 6)) / 1000).astype("f4")
    values[:120] = np.nan
    np.save(tmp_path / "m.npy", values)
    assert tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5").code == ExitCode.BAD_INPUT


@pytest.mark.parametrize("kind", ["png", "tif"])
def test_images_are_along_z_and_become_ranges_by_an_ideal_pinhole(tofmix: Tofmix, tmp_path: Path, kind: str) -> None:
    flat = np.full((3, 4, 6), 2000, dtype=np.uint16)
    source = tmp_path / ("images" if kind == "png" else "a.tif")
    if kind == "png":
        source.mkdir()
        for number, image in enumerate(flat):
            (source / f"{number}.png").write_bytes(naive_png.encode(image))
    else:
        tifffile.imwrite(source, flat, photometric="minisblack")
    done = tofmix("import", source, "-o", tmp_path / "a.h5", "--fov", "90x60")
    assert done.code == 0, done.err
    assert "depths along z converted to ranges by an ideal pinhole of 90 x 60 degrees" in done.out
    assert "--depth-axis ray if they are along the beam" in done.out
    row, col = np.mgrid[0:4, 0:6]
    x, y = (col - 2.5) / 3.0, (row - 1.5) / 2.0 * np.tan(np.radians(30))
    np.testing.assert_allclose(read(tmp_path / "a.h5"), np.tile(2000 * np.sqrt(1 + x**2 + y**2), (3, 1, 1)), rtol=1e-6)
    done = tofmix("import", source, "-o", tmp_path / "b.h5", "--depth-axis", "ray")
    assert done.code == 0, done.err
    np.testing.assert_array_equal(read(tmp_path / "b.h5"), flat)


def write_h5(path: Path, name: str, **attributes: object) -> None:
    with h5py.File(path, "w") as root:
        dataset = root.create_dataset(name, data=samples().astype("f4"), chunks=(7, 2, 6), compression="gzip")
        for key, value in attributes.items():
            dataset.attrs[key] = value
        root.create_dataset("calibration/dark", data=np.zeros((4, 6)))


def test_only_dataset_of_frames_is_found_without_its_name(tofmix: Tofmix, tmp_path: Path) -> None:
    write_h5(tmp_path / "x.h5", "entry/data")
    done = tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5")
    assert (done.code, done.err) == (0, "")
    assert "dataset entry/data of an HDF5 file" in done.out
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), samples().astype("f4"))


def test_units_and_fill_value_of_a_dataset_are_used_and_the_command_line_overrules_them(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    write_h5(tmp_path / "x.h5", "d", units="cm", _FillValue=np.float32(samples().astype("f4")[0, 0, 0]))
    assert tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5").code == 0
    found = read(tmp_path / "r.h5")
    assert np.isnan(found[0, 0, 0])
    np.testing.assert_allclose(found.ravel()[1:], 10 * samples().ravel()[1:], rtol=1e-6)
    assert tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "s.h5", "--units", "mm").code == 0
    np.testing.assert_allclose(read(tmp_path / "s.h5").ravel()[1:], samples().ravel()[1:], rtol=1e-6)
    write_h5(tmp_path / "y.h5", "d", units="counts")
    refused = tofmix("import", tmp_path / "y.h5", "-o", tmp_path / "y_.h5")
    assert refused.code == ExitCode.BAD_INPUT
    assert "units 'counts' are not a known unit of length" in refused.err
    assert tofmix("import", tmp_path / "y.h5", "-o", tmp_path / "y_.h5", "--scale", 2).code == 0


def test_one_of_several_datasets_is_chosen_by_name(tofmix: Tofmix, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as root:
        root["a/first"], root["a/second"] = samples().astype("f4"), samples(seed=9).astype("f4")
        root["a/time"] = np.arange(SHAPE[0]) / 25.0
    refused = tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5")
    assert refused.code == ExitCode.BAD_INPUT
    assert "choose one with --dataset: a/first (60, 4, 6), a/second (60, 4, 6)" in refused.err
    done = tofmix(
        "import", tmp_path / "x.h5", "-o", tmp_path / "r.h5", "--dataset", "/a/first", "--amplitude", "a/second"
    )
    assert done.code == 0, done.err
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), samples().astype("f4"))
    np.testing.assert_array_equal(read(tmp_path / "r.h5", "amplitude"), samples(seed=9).astype("f4"))
    np.testing.assert_allclose(read(tmp_path / "r.h5", "time"), np.arange(SHAPE[0]) / 25.0)


def test_a_recording_in_metres_keeps_its_camera(tofmix: Tofmix, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as root:
        root["range"], root["amplitude"] = (samples() / 1000).astype("f4"), samples().astype("f4")
        root.create_group("sensor").attrs["range_max_mm"] = 9000.0
    assert tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5").code == ExitCode.BAD_INPUT
    done = tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5", "--units", "m")
    assert done.code == 0, done.err
    np.testing.assert_allclose(read(tmp_path / "r.h5"), samples(), rtol=1e-6)
    with h5py.File(tmp_path / "r.h5") as root:
        assert root["sensor"].attrs["range_max_mm"] == 9000.0
        assert "amplitude" in root


@pytest.mark.parametrize("axes", ["row,col,frame", "col,frame,row"])
def test_hdf5_of_any_order_of_axes_is_imported(tofmix: Tofmix, tmp_path: Path, axes: str) -> None:
    order = [["frame", "row", "col"].index(name) for name in axes.split(",")]
    with h5py.File(tmp_path / "x.h5", "w") as root:
        root["d"] = np.transpose(samples().astype("f4"), order)
    assert tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5", "--axes", axes).code == 0
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), samples().astype("f4"))


@pytest.mark.parametrize(("mark", "header"), [(",", None), (";", "z0"), ("\t", None), (" ", None), (",", "time")])
def test_csv_with_a_frame_a_line_is_imported(tofmix: Tofmix, tmp_path: Path, mark: str, header: str | None) -> None:
    values = np.round(samples((20, 4, 6)), 2)
    lines = [mark.join(f"{value:g}" for value in frame.ravel()) for frame in values]
    if header is not None:
        names = [f"z{k}" for k in range(24)]
        if header == "time":
            names, lines = ["time", *names], [f"{k / 15:g}{mark}{line}" for k, line in enumerate(lines)]
        lines = [mark.join(names), *lines]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n\n")
    done = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5", "--shape", "4x6")
    assert (done.code, done.err) == (0, "")
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), values.astype("f4"))
    with h5py.File(tmp_path / "r.h5") as root:
        assert ("time" in root) == (header == "time")


def test_csv_with_a_sample_a_line_is_imported_in_any_order(tofmix: Tofmix, tmp_path: Path) -> None:
    values = np.round(samples((5, 4, 6)), 1)
    place = np.stack(np.unravel_index(np.arange(values.size), values.shape), axis=1)
    lines = [
        f"x,{c},{r},{f + 100},{values[f, r, c]:g},{10 * c}"
        for f, r, c in np.random.default_rng(1).permutation(place)
        if (f, r, c) not in ((1, 0, 0), (2, 3, 5))
    ]
    lines[7:7] = ["x,0,0,101,,3", "", "# a remark"]
    (tmp_path / "a.csv").write_text("note,col,row,frame,range,amplitude\n" + "\n".join(lines))
    done = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5")
    assert (done.code, done.err) == (0, "")
    expected = values.astype("f4")
    expected[1, 0, 0] = expected[2, 3, 5] = np.nan
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), expected)
    assert (read(tmp_path / "r.h5", "amplitude")[0, :, 5] == 50).all()


def test_a_long_csv_may_name_its_unit_and_count_from_1(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,row,col,range_m\n1,1,1,1.5\n1,1,2,1.6\n2,1,1,1.7\n2,1,2,-1\n")
    done = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5", "--invalid", -1)
    assert done.code == 0, done.err
    assert "rows and columns are taken to start at 1, because none is 0" in done.err
    expected = np.array([[[1500.0, 1600.0]], [[1700.0, np.nan]]])
    np.testing.assert_allclose(read(tmp_path / "r.h5"), expected)


@pytest.mark.parametrize(
    ("text", "options", "reason"),
    [
        ("1,2,3\n4,5,6\n", (), "give --shape ROWSxCOLS"),
        ("1,2,3\n4,5,6\n", ("--shape", "2x2"), "3 values in the first line, --shape 2x2 has 4"),
        ("1,2\n4\n", ("--shape", "1x2"), "line 2: 1 value, the first line has 2"),
        ("1,2\n4,x\n", ("--shape", "1x2"), "line 2: cannot be read"),
        ("", ("--shape", "1x2"), "empty"),
        ("a,b\n", ("--shape", "1x2"), "no frame below its header"),
        ("frame,row,range\n0,0,1000\n", (), "its header names no col"),
        ("frame,row,col,depth\n0,0,0,1000\n", (), "its header names no range"),
        ("frame,row,col,range\n", (), "no sample below its header"),
        ("frame,row,col,range\n0,0.5,0,1000\n", (), "row: 0.5 is not a whole number"),
        ("frame,row,col,range\n0,0,-1,1000\n", (), "col: -1 is not a whole number"),
        ("frame,row,col,range\n0,0,0,1000\n0,0,0,2000\n", (), "need a column target"),
        ("frame,row,col,range\n0,0,0,1000\n0,0,90000,2000\n", (), "no more than 4096"),
        ("frame,row,col,range\n0,0,0,1000\n0,9,0,2000\n", ("--shape", "4x6"), "outside of --shape 4x6"),
        ("frame,row,col,range\n0,0,0,oops\n", (), "cannot be read"),
        ("frame,row,col,target,range\n0,0,0,0,9\n0,4000,4000,60,9\n", (), "61 targets of 4001 x 4001 pixels; no more"),
    ],
)
def test_invalid_csv_is_refused_in_one_line(
    tofmix: Tofmix, tmp_path: Path, text: str, options: tuple[str, ...], reason: str
) -> None:
    (tmp_path / "a.csv").write_text(text)
    refused = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5", *options)
    assert refused.code == ExitCode.BAD_INPUT, refused.err
    assert reason in refused.err
    assert refused.err.count("\n") == 1
    assert not (tmp_path / "r.h5").exists()


def test_zones_in_one_axis_are_laid_out_by_shape(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples().reshape(60, 24))
    assert tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "r.h5", "--shape", "4x6").code == 0
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), samples().astype("f4"))


def test_a_recording_of_an_unknown_camera_passes_verify(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples())
    assert tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "r.h5").code == 0
    done = tofmix("verify", tmp_path / "r.h5")
    assert done.code == 0, done.out + done.err


def test_json_lists_the_output_and_unknown_camera_data(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((5, 3, 4), 1234.0))
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--units", "mm", "--json")
    assert done.code == 0, done.err
    made = json.loads(done.out)
    assert (made["frames"], made["rows"], made["cols"], made["targets"], made["unit_mm"]) == (5, 3, 4, 0, 1.0)
    assert made["output"] == str(tmp_path / "a.h5")
    unknown = ["field of view", "largest range", "noise curve", "times of the frames", "amplitudes"]
    unknown += ["modulation frequency"]
    assert [line.split(" (")[0] for line in made["not_known"]] == unknown
