"""What sources state of their numbers: packing, fill values, status, streams, units and order of times."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
import xarray
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from scipy.io import netcdf_file, savemat
from support import naive_png
from support.commandline import succeed
from support.reading import depths, read_source

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError, UsageError
from tofmix.io.importers.conversion import depths_among, stream_of
from tofmix.io.importers.times import settled, time_unit_s, times_of_array, unit_of_stamps

WALL = np.rint(np.random.default_rng(7).normal(2100.0, 6.0, (9, 4, 5)))


def imported_mm(path: Path, *options: str) -> NDArray[np.float64]:
    succeed("import", path, "-o", path.with_name("out.h5"), "--overwrite", "--depth-axis", "ray", *options)
    with h5py.File(path.with_name("out.h5")) as root:
        ranges = root["range"][...].astype(np.float64)
    return np.where(ranges == 0, np.nan, ranges)


@pytest.mark.parametrize("units", ["mm", "m", "cm"])
def test_packed_netcdf_is_unpacked_and_its_fill_value_is_no_sample(tmp_path: Path, units: str) -> None:
    factor = {"mm": 1.0, "m": 1000.0, "cm": 10.0}[units]
    values = WALL / factor
    values[3, 1, 2] = np.nan
    packing = {"dtype": "int16", "scale_factor": 0.25 / factor, "add_offset": 1800.0 / factor, "_FillValue": -9999}
    table = xarray.Dataset({"range": (("frame", "row", "col"), values, {"units": units})})
    table.to_netcdf(tmp_path / "a.nc", engine="h5netcdf", encoding={"range": packing})
    expected = WALL.copy()
    expected[3, 1, 2] = np.nan
    np.testing.assert_allclose(imported_mm(tmp_path / "a.nc"), expected, atol=0.13)


def write_hdf5(path: Path, values: NDArray[Any], **attributes: object) -> Path:
    with h5py.File(path, "w") as root:
        root["range"] = values
        root["range"].attrs.update(attributes)
    return path


@pytest.mark.parametrize(
    ("attributes", "bad"),
    [
        ({"missing_value": np.array([7777, 8888], "u2")}, 8888),
        ({"valid_max": 4000}, 4001),
        ({"valid_min": 500}, 499),
        ({"valid_range": np.array([500, 4000])}, 300),
        ({"_FillValue": np.uint16(4242)}, 4242),
    ],
)
def test_values_that_attributes_call_invalid_are_no_samples(
    tmp_path: Path, attributes: dict[str, object], bad: int
) -> None:
    values = WALL.astype("u2")
    values[:4, 2, 3] = bad
    found = imported_mm(write_hdf5(tmp_path / "a.h5", values, units="mm", **attributes))
    assert np.argwhere(np.isnan(found)).tolist() == [[k, 2, 3] for k in range(4)]


def test_frames_that_were_never_written_have_the_fill_value_of_their_dataset(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        data = root.create_dataset("range", shape=WALL.shape, dtype="u2", fillvalue=1234, chunks=(1, 4, 5))
        data[:6] = WALL[:6]
    assert np.isnan(imported_mm(tmp_path / "a.h5"))[:, 0, 0].tolist() == [False] * 6 + [True] * 3


@pytest.mark.parametrize("images", [False, True])
def test_whole_numbers_that_are_marked_as_unsigned_are_read_so(tmp_path: Path, *, images: bool) -> None:
    # netCDF-3 has no unsigned numbers: 2100 mm in steps of 0.05 mm are 42,000, stored as -23,536.
    counts = np.rint(WALL / 0.05).astype(np.uint16)
    counts[2, 1, 1], counts[3, 0, 2] = 65000, 60000  # the fill value, and above the largest valid number
    expected = np.where(counts >= 60000, np.nan, counts * 0.05)
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as root:
        for number, stored in enumerate(counts.view(np.int16) if images else [counts.view(np.int16)]):
            dataset = root.create_dataset(f"frame_{number}/depth" if images else "range", data=stored)
            dataset.attrs.update(
                {
                    "_Unsigned": "true",
                    "scale_factor": 0.05,
                    "units": "mm",
                    "_FillValue": np.int16(65000 - 65536),
                    "valid_max": np.int16(59999 - 65536),
                }
            )
    np.testing.assert_allclose(imported_mm(path), expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("units", "stored"),
    [("ms", np.arange(9) * 40), ("seconds since 2024-01-01", np.arange(9) * 0.04), ("us", np.arange(9) * 40000)],
)
def test_times_are_read_in_their_units(tmp_path: Path, units: str, stored: NDArray[Any]) -> None:
    path = write_hdf5(tmp_path / "a.h5", WALL)
    with h5py.File(path, "a") as root:
        root["time"] = stored
        root["time"].attrs["units"] = units
    source, frames = read_source(path)
    np.testing.assert_allclose([frame.time_s or 0.0 for frame in frames], np.arange(9) * 0.04)
    assert source.notes == ()
    with h5py.File(path, "a") as root:
        root["time"].attrs["units"] = "ticks"
    source, _ = read_source(path)
    assert not source.has_time
    assert "time in 'ticks', no known unit of time (--time-unit gives it)" in source.notes[0]


def test_axes_are_told_by_the_names_of_dimensions_with_a_note(tmp_path: Path) -> None:
    table = xarray.Dataset({"depth": (("y", "x", "time"), np.moveaxis(WALL, 0, -1))}, coords={"time": np.arange(9.0)})
    table.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    np.testing.assert_array_equal(depths(tmp_path / "a.nc"), WALL)
    assert "the dimensions y,x,time are taken as --axes row,col,frame" in read_source(tmp_path / "a.nc")[0].notes[0]


def write_arrays(folder: Path, kind: str, **arrays: NDArray[Any]) -> Path:
    path = folder / f"a.{kind}"
    if kind == "npz":
        np.savez(path, allow_pickle=False, **arrays)
    elif kind == "mat":
        savemat(path, arrays)
    else:
        with h5py.File(path, "w") as root:
            for name, values in arrays.items():
                root[name] = values
    return path


@pytest.mark.parametrize("kind", ["npz", "mat", "h5"])
def test_depths_are_told_from_other_streams_by_name_and_status_codes_are_used(tmp_path: Path, kind: str) -> None:
    status = np.where(WALL > 2100, 5, 4)
    path = write_arrays(tmp_path, kind, depth=WALL, infrared=WALL + 1, status=status)
    axes = {"axes": "frame,row,col"} if kind == "mat" else {}
    source, frames = read_source(path, **axes)
    np.testing.assert_array_equal(np.stack([frame.depth for frame in frames]), WALL)
    assert any("not used: array status (--valid-status status=5,9" in note for note in source.notes)
    assert any("not used: array infrared" in note for note in source.notes)
    source, frames = read_source(path, valid_status=("status", (5,)), **axes)
    assert source.status_valid == (5,)
    np.testing.assert_array_equal([frame.status for frame in frames], status)
    assert not any("status" in note for note in source.notes)
    with pytest.raises(BadInputError, match=r"--valid-status: no array 'state'"):
        read_source(path, valid_status=("state", (5,)), **axes)


def test_zones_with_targets_are_arranged_by_the_shape(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(500, 900, (7, 20, 3))
    np.save(tmp_path / "a.npy", values)
    expected = np.moveaxis(values.reshape(7, 4, 5, 3), -1, 1)
    np.save(tmp_path / "b.npy", np.moveaxis(values, 1, 2))
    for name, request in (("a.npy", {}), ("b.npy", {"axes": "frame,target,zone"})):
        _, frames = read_source(tmp_path / name, shape=(4, 5), **request)
        np.testing.assert_array_equal([frame.depth for frame in frames], expected)


def write_png(path: Path, image: NDArray[Any], text: str = "") -> None:
    info = PngInfo()
    if text:
        info.add_text("Description", text)
    Image.fromarray(image.astype("u2")).save(path, pnginfo=info)


def test_scale_in_the_text_of_an_image_is_used(tmp_path: Path) -> None:
    text = "layer 1; radial range, 1 count = 0.125 mm, 0 = no layer"
    (tmp_path / "png").mkdir()
    write_png(tmp_path / "png/0.png", WALL[0] * 8, text)
    tifffile.imwrite(tmp_path / "a.tif", (WALL[:1] * 8).astype("u2"), description=text, metadata=None)
    for path in (tmp_path / "png", tmp_path / "a.tif"):
        source, frames = read_source(path)
        assert (source.unit_mm, source.depth_axis) == (0.125, "ray")
        np.testing.assert_array_equal(frames[0].depth, WALL[0] * 8)


@pytest.mark.parametrize(
    ("lines", "unit_mm", "factor", "offset"),
    [
        ("cf=0\nc0=100.0\nc1=0.25\nvunit=mm\n", 1.0, 0.25, 100.0),
        ("cf=0\nc0=0.0\nc1=0.001\nvunit=m\n", 1000.0, 0.001, 0.0),
        ("vunit=mm\n", 1.0, 1.0, 0.0),
        ("cf=20\nc0=1.0\nc1=2.0\nvunit=Gray Value\n", None, 1.0, 0.0),
    ],
)
def test_calibration_of_imagej_is_used(
    tmp_path: Path, lines: str, unit_mm: float | None, factor: float, offset: float
) -> None:
    path = tmp_path / "a.tif"
    text = f"ImageJ=1.54f\nimages={len(WALL)}\nframes={len(WALL)}\n{lines}"
    with tifffile.TiffWriter(path) as file:
        for number, image in enumerate(WALL):
            file.write(image.astype("u2"), description=text if number == 0 else None, metadata=None)
    source, frames = read_source(path)
    assert (source.unit_mm, source.scale_factor, source.add_offset) == (unit_mm, factor, offset)
    np.testing.assert_array_equal([frame.depth for frame in frames], WALL)


@pytest.mark.parametrize(
    ("channel", "annotation", "unit_mm"),
    [
        ("Depth [cm]", "", 10.0),
        ("depth_m", "mm", 1000.0),
        ("Depth", "mm", 1.0),
        ("Depth", "", None),
        ("Depth", "V", None),
    ],
)
def test_unit_of_an_ome_tiff_is_that_of_its_channel_or_of_an_annotation(
    tmp_path: Path, channel: str, annotation: str, unit_mm: float | None
) -> None:
    metadata = {
        "axes": "TYX",
        "Channel": {"Name": channel},
        "PhysicalSizeX": 3.0,
        "PhysicalSizeXUnit": "m",
        **({"MapAnnotation": {"Unit": annotation}} if annotation else {}),
    }
    tifffile.imwrite(tmp_path / "a.ome.tif", WALL.astype("f4"), metadata=metadata, ome=True)
    assert read_source(tmp_path / "a.ome.tif")[0].unit_mm == unit_mm


def test_images_of_another_stream_in_a_folder_are_not_frames(tmp_path: Path) -> None:
    for k in range(9):
        write_png(tmp_path / f"depth_{k}.png", WALL[k])
        write_png(tmp_path / f"ir_{k}.png", WALL[k] + 100)
    np.testing.assert_array_equal(depths(tmp_path), WALL)
    assert read_source(tmp_path)[0].notes == (f"{tmp_path}: not used: images ir_# (9)",)
    for k in range(9):
        (tmp_path / f"depth_{k}.png").rename(tmp_path / f"left_depth_{k}.png")
        write_png(tmp_path / f"right_depth_{k}.png", WALL[k])
    with pytest.raises(BadInputError, match="several sequences of images: 9 of ir_#, 9 of left_depth_#, 9 of "):
        read_source(tmp_path)


@pytest.mark.parametrize(
    ("names", "chosen"), [(("Depth", "Amplitude"), 0), (("IR", "range"), 1), (("one", "two"), None)]
)
def test_channel_of_an_ome_tiff_is_told_by_its_name(tmp_path: Path, names: tuple[str, str], chosen: int | None) -> None:
    stack = np.stack([WALL, WALL + 500], axis=1).astype("u2")
    metadata = {"axes": "TCYX", "Channel": {"Name": list(names)}}
    tifffile.imwrite(tmp_path / "a.ome.tif", stack, metadata=metadata, ome=True)
    if chosen is None:
        with pytest.raises(BadInputError, match=r"2 channels \(one, two\), not one sequence of depths"):
            read_source(tmp_path / "a.ome.tif")
        return
    np.testing.assert_array_equal(depths(tmp_path / "a.ome.tif"), stack[:, chosen])
    assert f"not used: channels {names[1 - chosen]}" in read_source(tmp_path / "a.ome.tif")[0].notes[0]


@pytest.mark.parametrize(
    ("name", "stream"),
    [
        ("/camera/depth/image_raw", "depth"),
        ("/camera/aligned_depth_to_color/image_raw", "depth"),
        ("/depth_to_rgb/image_raw", "depth"),
        ("/rgb_to_depth/image_raw", "other"),
        ("/camera/infra1/image_rect_raw", "other"),
        ("/depth/confidence/image", "other"),
        ("AmplitudeImage", "other"),
        ("zDepth_mm", "depth"),
        ("/device_0/sensor_0/Depth_0/image/data", "depth"),
        ("/points", "unknown"),
        # The last part that says something decides.
        ("/sensor/noise_filtered/depth", "depth"),
        ("/color_camera/depth/image", "depth"),
        ("/tof/depth_valid", "depth"),
        ("/valid", "other"),
        ("/depth/valid_mask", "other"),
        ("/depth_cam/ir/image_raw", "other"),
        ("ir_depth", "depth"),
        ("depth_ir", "other"),
        ("sigma_z", "other"),
        ("IRImage", "other"),
    ],
)
def test_streams_are_told_by_the_words_of_their_names(name: str, stream: str) -> None:
    assert stream_of(name) == stream


@pytest.mark.parametrize("kind", ["npz", "mat", "h5"])
def test_array_of_8_bits_beside_a_wider_one_is_no_depth_where_names_say_nothing(tmp_path: Path, kind: str) -> None:
    path = write_arrays(tmp_path, kind, a=np.full(WALL.shape, 255, dtype="u1"), b=WALL)
    source, frames = read_source(path, axes="frame,row,col")
    np.testing.assert_array_equal([frame.depth for frame in frames], WALL)
    assert source.notes == (f"{path}: not used: array a",)


@pytest.mark.parametrize(
    "texts",
    [
        ("radial range, 1 count = 0.25 mm", "radial range, 1 count = 0.125 mm"),
        ("radial range, 1 count = 0.25 mm", "1 count = 0.25 mm"),
        ("1 count = 2 mm", ""),
    ],
)
@pytest.mark.parametrize("kind", ["png", "tif"])
def test_images_of_different_scales_are_no_sequence(tmp_path: Path, kind: str, texts: tuple[str, str]) -> None:
    for k, text in enumerate(texts):
        if kind == "png":
            write_png(tmp_path / f"{k}.png", WALL[0], text)
        else:
            tifffile.imwrite(tmp_path / f"{k}.tif", WALL[0].astype("u2"), description=text, metadata=None)
    with pytest.raises(BadInputError, match=r"1\.\w+: its text states .*, that of .*0\.\w+"):
        read_source(tmp_path)


@pytest.mark.parametrize("attributes", [{"scale_factor": 0.25}, {"units": "cm"}, {"_FillValue": 17}, {"units": None}])
def test_datasets_of_frames_that_state_different_numbers_are_refused(
    tmp_path: Path, attributes: dict[str, object]
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        for k in range(3):
            dataset = root.create_dataset(f"f{k}/depth", data=WALL[k].astype("u2"))
            stated = {"units": "mm", **(attributes if k == 2 else {})}
            dataset.attrs.update({key: value for key, value in stated.items() if value is not None})
    with pytest.raises(BadInputError, match=r"f2/depth: scale_factor .*, f0/depth has scale_factor 1"):
        read_source(tmp_path / "a.h5")


def test_datasets_beside_those_of_frames_are_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        for k in range(3):
            root[f"f{k}/depth"], root[f"f{k}/ir"], root[f"f{k}/stamp"] = WALL[k], WALL[k], 0.5 * k
    notes = read_source(tmp_path / "a.h5")[0].notes
    assert f"{tmp_path / 'a.h5'}: not used: datasets f#/ir (3), f#/stamp (3)" in notes
    np.testing.assert_array_equal(depths(tmp_path / "a.h5", topic="f#/ir"), WALL[:3])


@pytest.mark.parametrize(
    "limits",
    [
        {"valid_range": np.array([1.95, 2.2])},
        {"valid_min": np.float64(1.95), "valid_max": np.float64(2.2)},
        {"valid_range": np.array([1.95, 2.2], "f4")},
        {"valid_range": np.array([150, 400], "i2")},
    ],
)
def test_limits_of_the_unpacked_type_are_values(tmp_path: Path, limits: dict[str, object]) -> None:
    # Stored numbers count mm above 1.8 m: 1.95 m is 150.
    stored = WALL.astype("i2") - 1800
    stored[0, 0, :4] = 149, 150, 400, 401
    path = write_hdf5(tmp_path / "a.nc", stored, units="m", scale_factor=0.001, add_offset=1.8, **limits)
    assert np.isnan(imported_mm(path)[0, 0, :4]).tolist() == [True, False, False, True]


def test_classic_netcdf_is_refused_with_the_command_that_converts_it(tmp_path: Path) -> None:
    with netcdf_file(tmp_path / "a b.nc", "w") as root:
        root.createDimension("time", 2)
        root.createVariable("depth", "f4", ("time",))[:] = [1.5, 1.6]
    with pytest.raises(
        BadInputError, match=r"a b\.nc: classic netCDF, not netCDF-4: nccopy -k nc4 '.*a b\.nc' '.*a b_nc4"
    ):
        read_source(tmp_path / "a b.nc")


STACK = np.random.default_rng(4).integers(900, 1900, (5, 3, 4)).astype("u2")


def folder_of(path: Path, *kinds: str) -> Path:
    """A folder of images named ``KIND0.png`` and so on; each kind has other values."""
    path.mkdir(exist_ok=True)
    for offset, kind in enumerate(kinds):
        for number, image in enumerate(STACK + offset):
            (path / f"{kind}{number}.png").write_bytes(naive_png.encode(image))
    return path


def source_of(folder: Path, kind: str, name: str) -> tuple[Path, str]:
    """A source whose only stream has a name, and the name that ``--dataset`` takes for it."""
    if kind == "folder":
        return folder_of(folder / "images", f"{name}_"), f"{name}_#"
    if kind == "folder name":
        return folder_of(folder / name, ""), name
    if kind in ("npy", "tif", "csv"):
        path = folder / f"{name}.{kind}"
        if kind == "npy":
            np.save(path, STACK)
        elif kind == "tif":
            tifffile.imwrite(path, STACK, photometric="minisblack")
        else:
            np.savetxt(path, STACK.reshape(5, -1), fmt="%d", delimiter=",")
        return path, name
    path = folder / f"recorded.{kind}"
    if kind == "ome.tif":
        metadata = {"axes": "TYX", "Channel": {"Name": [name]}}
        tifffile.imwrite(path, STACK, metadata=metadata, ome=True, photometric="minisblack")
        return path, name
    return write_arrays(folder, kind, **{name: STACK}), name


ONE_STREAM = ["folder", "folder name", "npy", "tif", "csv", "npz", "mat", "h5", "ome.tif"]


@pytest.mark.parametrize("kind", ONE_STREAM)
@pytest.mark.parametrize("name", ["infrared", "confidence_image"])
def test_the_only_stream_is_refused_if_its_name_says_other_and_read_if_it_is_asked_for(
    tmp_path: Path, kind: str, name: str
) -> None:
    path, asked = source_of(tmp_path, kind, name)
    options: dict[str, Any] = {"axes": "frame,row,col"} if kind == "mat" else {}
    options |= {"shape": (3, 4)} if kind == "csv" else {}
    with pytest.raises(BadInputError, match=rf"{name}\S* holds no depths by its name, .* --dataset '?{asked}'? -o"):
        read_source(path, **options)
    _, frames = read_source(path, topic=asked, **options)
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK)


@pytest.mark.parametrize("kind", [kind for kind in ONE_STREAM if kind not in ("mat", "csv")])  # these need options
@pytest.mark.parametrize("name", ["depth_ir", "wall"])
def test_amplitudes_may_be_named_so(tmp_path: Path, kind: str, name: str) -> None:
    np.save(tmp_path / "plain.npy", STACK + 7)
    path, _ = source_of(tmp_path, kind, name)
    _, frames = read_source(tmp_path / "plain.npy", amplitude=str(path))
    np.testing.assert_array_equal([frame.amplitude for frame in frames], STACK)


def test_two_kinds_of_images_are_listed_and_one_is_chosen(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "pair", "near_", "far_")
    with pytest.raises(BadInputError, match=r"5 of far_#, 5 of near_#; choose one: tofmix import .*--dataset 'far_#'"):
        read_source(path)
    source, frames = read_source(path, topic="far_#")
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK + 1)
    assert source.notes == (f"{path}: not used: images near_# (5)",)
    with pytest.raises(UsageError, match=r"--dataset does not apply to .*: 5 of far_#"):
        read_source(path, topic="middle")


def test_amplitudes_of_a_folder_with_depths_are_its_other_images(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "both", "depth_", "ir_")
    _, frames = read_source(path, amplitude=str(path))
    np.testing.assert_array_equal([frame.amplitude for frame in frames], STACK + 1)
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK)


@pytest.mark.parametrize("axes", ["TCYX", "CTYX", "", "ZTYX"])
def test_two_sequences_in_the_pages_of_tifffile_are_listed_and_one_is_chosen(tmp_path: Path, axes: str) -> None:
    both = np.stack([STACK, STACK + 1], axis=0 if axes == "CTYX" else 1)
    metadata = {"axes": axes} if axes else {}
    tifffile.imwrite(tmp_path / "a.tif", both, metadata=metadata, photometric="minisblack")
    with pytest.raises(BadInputError, match=r"2 channels \(channel 0, channel 1\), not one sequence"):
        read_source(tmp_path / "a.tif")
    _, frames = read_source(tmp_path / "a.tif", topic="channel 1")
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK + 1)
    with pytest.raises(UsageError, match="--dataset does not apply"):
        read_source(tmp_path / "a.tif", topic="channel 2")


@pytest.mark.parametrize(
    "names",
    [
        [f"rig3.{k}" for k in range(1, 13)],
        [f"shot.2.{k}.x" for k in range(8, 12)],
        ["1.8", "1.9", "1.10", "1.80"],
        ["img_9007199254740993", "img_9007199254740994"],
        ["1700000000.05", "1700000000.1", "1700000000.25", "1700000001"],
        ["d_1700000000.125", "d_1700000000.5"],
        ["0.033", "0.1", "0.2"],
    ],
)
def test_numbers_in_names_are_counters_unless_each_name_is_one_time_stamp(tmp_path: Path, names: list[str]) -> None:
    for name, image in zip(names, np.arange(len(names), dtype="u2")[:, None, None] + STACK[0], strict=True):
        (tmp_path / f"{name}.png").write_bytes(naive_png.encode(image))
    firsts = [int(frame.depth[0, 0]) for frame in read_source(tmp_path)[1]]
    assert firsts == [int(STACK[0, 0, 0]) + k for k in range(len(names))]


@pytest.mark.parametrize(
    "option",
    [{"valid_status": ("status", (5,))}, {"columns": {"y": "row"}}, {"time_unit_s": 1e-3}],
)
@pytest.mark.parametrize("kind", ["npy", "tif", "csv", "folder", "npz", "h5"])
def test_options_without_use_are_refused(tmp_path: Path, kind: str, option: dict[str, Any]) -> None:
    path, _ = source_of(tmp_path, kind, "wall")
    shape: dict[str, Any] = {"shape": (3, 4)} if kind == "csv" else {}
    with pytest.raises((UsageError, BadInputError), match=r"--(valid-status|columns|time-unit)"):
        read_source(path, **option, **shape)


@pytest.mark.parametrize("kind", ["npz", "mat", "h5"])
def test_amplitudes_beside_depths_are_named_with_the_option_that_uses_them(tmp_path: Path, kind: str) -> None:
    path = write_arrays(tmp_path, kind, depth=STACK, amplitude=STACK + 3)
    source, _ = read_source(path, axes="frame,row,col")
    assert source.notes == (f"{path}: not used: array amplitude (--amplitude amplitude uses it)",)
    assert read_source(path, axes="frame,row,col", amplitude="amplitude")[0].notes == ()


def test_codes_of_the_camera_are_used_for_a_status_of_the_same_shape_alone(tmp_path: Path) -> None:
    codes: dict[str, Any] = {"status_codes": (5, 9)}
    used = read_source(write_arrays(tmp_path, "npz", depth=STACK, status=np.full(STACK.shape, 5)), **codes)[0]
    assert (used.status_valid, used.notes) == ((5, 9), ())
    path = write_arrays(tmp_path, "npz", depth=STACK, status=np.full(5, 1))
    other = read_source(path, **codes)[0]
    assert (other.status_valid, other.notes) == ((), (f"{path}: not used: array status",))


def test_mat_of_a_struct_names_it_and_the_commands_that_save_its_part(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"rec": {"depth": STACK}})
    with pytest.raises(BadInputError, match=r"but rec \(struct\).*depth = rec\.depth; save\('a_depth\.mat', 'depth'\)"):
        read_source(tmp_path / "a.mat")


def distinct(count: int) -> np.ndarray:
    return np.zeros(count, dtype=np.bool_)


@pytest.mark.parametrize(
    ("text", "unit_s"),
    [
        ("s", 1.0),
        ("ms", 1e-3),
        ("Seconds", 1.0),
        ("milliseconds since 2021-05-01 00:00:00", 1e-3),
        ("µs", 1e-6),
        ("ns", 1e-9),
        ("days since 1970-01-01", 86400.0),
        ("fortnight", None),
        ("", None),
    ],
)
def test_units_of_time_are_read_as_cf_and_people_write_them(text: str, unit_s: float | None) -> None:
    assert time_unit_s(text) == unit_s


@given(seed=st.integers(0, 500), count=st.integers(2, 60), rate=st.sampled_from([0.2, 5.0, 30.0]))
def test_frames_of_a_regular_clock_in_any_order_are_sorted(seed: int, count: int, rate: float) -> None:
    rng = np.random.default_rng(seed)
    times = np.arange(count) / rate + rng.uniform(0, 0.2 / rate, count)
    place = rng.permutation(count)
    assume((np.diff(place) < 0).sum() >= (count - 1) / 3)  # rarer steps back may be those of a clock that is set
    found = settled(times[place], distinct(count))
    np.testing.assert_array_equal(place[found.order], np.arange(count))
    np.testing.assert_allclose(found.time_s, times - times[0], atol=1e-9)


@given(
    stamps=st.lists(
        st.one_of(
            st.floats(-1e4, 1e4), st.just(float("nan")), st.sampled_from([0.0, 1.0]), st.floats(-9e9, 9e9), st.floats()
        ),
        min_size=1,
    ),
    seed=st.integers(0, 9),
)
def test_times_ascend_from_0_whatever_the_stamps_are(stamps: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    same = rng.uniform(size=len(stamps)) < 0.2
    same[0] = False
    found = settled(np.array(stamps), same, np.flatnonzero(rng.uniform(size=len(stamps)) < 0.1))
    assert found.time_s[0] == 0.0
    assert np.isfinite(found.time_s).all()
    assert (np.diff(found.time_s) > 0).all()
    np.testing.assert_array_equal(np.sort(found.order), np.flatnonzero(~same))


def test_equal_frame_of_the_same_time_goes_and_another_one_lies_between() -> None:
    stamps = np.array([0.0, 0.1, 0.1, 0.2, 0.2, 0.3])
    found = settled(stamps, np.array([False, False, True, False, False, False]))
    np.testing.assert_array_equal(found.order, [0, 1, 3, 4, 5])
    np.testing.assert_allclose(found.time_s, [0.0, 0.1, 0.2, 0.25, 0.3])
    assert found.remarks == (
        "1 frame equal to another of the same time left out",
        "1 frame of a time that another has; their times are put between",
    )


def runs(*first_and_count: tuple[float, int], step: float = 0.1) -> FloatArray:
    return np.concatenate([first + step * np.arange(count, dtype=np.float64) for first, count in first_and_count])


@pytest.mark.parametrize(
    ("stamps", "starts"),
    [
        (runs((0.0, 80), (0.04, 80)), "frame 80"),  # between the first run's frames
        (runs((7.0, 60), (0.07, 40), (0.02, 70)), "frames 60, 100"),
        (runs((30.0, 90), (12.0, 90)), "frame 90"),  # wholly before the first run
        (runs((0.0, 6), (0.2, 6), (0.1, 5), (0.3, 7), step=0.4), "frames 6, 12, 17"),
        (np.delete(runs((0.0, 100), (0.05, 100)), [3, 40, 41, 77, 130]), "frame 96"),  # with frames lost
    ],
)
def test_clock_that_is_set_back_is_a_new_start_at_any_phase(stamps: np.ndarray, starts: str) -> None:
    found = settled(stamps, distinct(stamps.size))
    np.testing.assert_array_equal(found.order, np.arange(stamps.size))
    assert found.remarks == (f"the clock is set back at {starts}; its frames follow one interval later",)
    steps = np.diff(found.time_s)
    assert steps.min() > 0.9 * np.median(steps)


@pytest.mark.parametrize("step", [0.05, 2.0])
@pytest.mark.parametrize(
    "place",
    [
        sorted(range(120), key=str),  # names of files, as text
        [*range(30), 45, *range(30, 45), *range(46, 90)],  # one message 15 frames too early
        [*range(20), *range(50, 70), *range(20, 50), *range(70, 90)],  # a part too early
    ],
)
def test_frames_of_one_clock_in_few_parts_are_sorted(step: float, place: list[int]) -> None:
    found = settled(step * np.array(place), distinct(len(place)))
    assert found.order.tolist() == list(np.argsort(place))
    np.testing.assert_allclose(found.time_s, step * np.arange(len(place)), atol=1e-9)


def test_clock_goes_on_where_the_source_counts_anew() -> None:
    stamps = runs((0.0, 25), (0.03, 25), (0.01, 25), step=0.02)  # by less than a second
    found = settled(stamps, distinct(stamps.size), np.array([25, 50]))
    np.testing.assert_array_equal(found.order, np.arange(75))
    np.testing.assert_allclose(found.time_s, 0.02 * np.arange(75), atol=1e-9)
    assert found.remarks == (
        "the clock starts again with the count of frames at frames 25, 50; its frames follow one interval later",
    )
    found = settled(np.array([0.0, 0.1, 0.1, 0.3, 0.4]), distinct(5), np.array([3]))
    np.testing.assert_allclose(found.time_s, [0.0, 0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("stamp", [0.0, 1.6e9, 3.0e18, 1e300, -1e12])
def test_one_damaged_stamp_is_missing_and_its_frame_stays_in_place(stamp: float) -> None:
    stamps = 50.0 + 0.1 * np.arange(30, dtype=np.float64)
    stamps[17] = stamp
    found = settled(stamps, distinct(30))
    np.testing.assert_array_equal(found.order, np.arange(30))
    np.testing.assert_allclose(found.time_s, 0.1 * np.arange(30), atol=1e-9)
    assert len(found.remarks) == 2


@pytest.mark.parametrize(
    ("step", "offset", "unit_s"),
    [(0.04, 0.0, 1.0), (0.04, 1.65e9, 1.0), (40, 1_650_000_000_000, 1e-3), (4 * 10**7, 165 * 10**16, 1e-9)],
)
def test_unit_of_stamps_is_told_by_their_size(step: float, offset: float, unit_s: float) -> None:
    stored = (offset + step * np.arange(20)).astype(np.float64)
    found, notes = unit_of_stamps(stored, "a: time")
    assert found == unit_s
    assert len(notes) == (unit_s != 1.0)
    times, said = times_of_array(stored, 20, "a: time")
    np.testing.assert_allclose(times - times[0], 0.04 * np.arange(20), atol=1e-6)
    assert said == notes


@pytest.mark.parametrize(
    ("step", "offset", "text"), [(40, 0, "--time-unit ms"), (40_000, 7, "--time-unit us"), (4e7, 1e9, "--time-unit ns")]
)
def test_unit_of_stamps_that_would_be_far_apart_is_asked_for(step: float, offset: float, text: str) -> None:
    with pytest.raises(BadInputError, match=f"a: time: no unit, and frames would be .* s apart; give {text}"):
        times_of_array(offset + step * np.arange(20), 20, "a: time")
    times, _ = times_of_array(step * np.arange(3), 3, "a: time", 1e-3)
    np.testing.assert_allclose(times, step * 1e-3 * np.arange(3))


@pytest.mark.parametrize("kind", ["ms", "us", "ns"])
def test_dates_and_durations_of_numpy_are_times(kind: str) -> None:
    steps = (np.arange(6) * 50).astype("m8[ms]").astype(f"m8[{kind}]")
    for stored in (steps, np.datetime64("2023-11-05T23:59:59", "s") + steps):
        times, notes = times_of_array(stored, 6, "a: time")
        np.testing.assert_allclose(times, 0.05 * np.arange(6), atol=1e-12)
        assert notes == ()
    stored[2] = "NaT"
    assert np.isnan(times_of_array(stored, 6, "a: time")[0]).tolist() == [False, False, True, False, False, False]


def test_names_of_depth_come_first_and_those_that_say_nothing_where_there_is_none() -> None:
    assert depths_among(["a", "b", "infrared"]) == ["a", "b"]
    assert depths_among(["a", "my_range"]) == ["my_range"]
    assert depths_among(["depth_valid", "depth"]) == ["depth"]
    assert depths_among(["/rgb/depth/image", "/ir/image"]) == ["/rgb/depth/image"]
