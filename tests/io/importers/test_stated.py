"""What sources state of their numbers: CF packing, fill values, status, streams, sequences, and the text of images."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
import xarray
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from scipy.io import netcdf_file, savemat
from support.commandline import succeed

from tofmix.errors import BadInputError
from tofmix.io.importers import open_source
from tofmix.io.importers.base import Frame, FrameSource, SourceRequest
from tofmix.io.importers.streams import depths_among, stream_of

WALL = np.rint(np.random.default_rng(7).normal(2100.0, 6.0, (9, 4, 5)))


def opened(path: Path, **request: Any) -> tuple[FrameSource, list[Frame]]:  # noqa: ANN401  fields of a request
    with open_source(path, SourceRequest(**request)) as source:
        return source, list(source.frames)


def depths(path: Path, **request: Any) -> NDArray[Any]:  # noqa: ANN401  likewise
    return np.stack([frame.depth for frame in opened(path, **request)[1]])


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


def test_default_fill_value_counts_in_netcdf_alone(tmp_path: Path) -> None:
    values = WALL.astype("u1")
    values[0, 0, 0] = 77
    for name, dtype, fill in (("a.nc", "i4", -2147483647), ("b.nc", "f4", 9.96921e36)):
        stored = WALL.astype(dtype)
        stored[0, 0, 0] = fill
        found = imported_mm(write_hdf5(tmp_path / name, stored, units="mm"))
        assert np.isnan(found).sum() == 1


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


def test_damaged_packing_is_refused(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a.h5", WALL, scale_factor="half")
    with pytest.raises(BadInputError, match="scale_factor: expected a number"):
        opened(path)


@pytest.mark.parametrize(
    ("units", "stored"),
    [("ms", np.arange(9) * 40), ("seconds since 2024-01-01", np.arange(9) * 0.04), ("us", np.arange(9) * 40000)],
)
def test_times_are_read_in_their_units(tmp_path: Path, units: str, stored: NDArray[Any]) -> None:
    path = write_hdf5(tmp_path / "a.h5", WALL)
    with h5py.File(path, "a") as root:
        root["time"] = stored
        root["time"].attrs["units"] = units
    source, frames = opened(path)
    np.testing.assert_allclose([frame.time_s or 0.0 for frame in frames], np.arange(9) * 0.04)
    assert source.notes == ()
    with h5py.File(path, "a") as root:
        root["time"].attrs["units"] = "ticks"
    source, _ = opened(path)
    assert not source.has_time
    assert "time in 'ticks', no known unit of time (--time-unit gives it)" in source.notes[0]


def test_axes_are_told_by_the_names_of_dimensions_with_a_note(tmp_path: Path) -> None:
    table = xarray.Dataset({"depth": (("y", "x", "time"), np.moveaxis(WALL, 0, -1))}, coords={"time": np.arange(9.0)})
    table.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    np.testing.assert_array_equal(depths(tmp_path / "a.nc"), WALL)
    assert "the dimensions y,x,time are taken as --axes row,col,frame" in opened(tmp_path / "a.nc")[0].notes[0]


def test_a_dataset_a_frame_is_a_sequence_in_natural_order(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        for k in range(9):
            root[f"shot_{k + 3}/depth"], root[f"shot_{k + 3}/infrared"] = WALL[k], WALL[k] * 2
    np.testing.assert_array_equal(depths(tmp_path / "a.h5"), WALL)


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
    source, frames = opened(path, **axes)
    np.testing.assert_array_equal(np.stack([frame.depth for frame in frames]), WALL)
    assert any("not used: array status (--valid-status status=5,9" in note for note in source.notes)
    assert any("not used: array infrared" in note for note in source.notes)
    source, frames = opened(path, valid_status=("status", (5,)), **axes)
    assert source.status_valid == (5,)
    np.testing.assert_array_equal([frame.status for frame in frames], status)
    assert not any("status" in note for note in source.notes)
    with pytest.raises(BadInputError, match=r"--valid-status: no array 'state'"):
        opened(path, valid_status=("state", (5,)), **axes)


def test_zones_with_targets_are_arranged_by_the_shape(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(500, 900, (7, 20, 3))
    np.save(tmp_path / "a.npy", values)
    expected = np.moveaxis(values.reshape(7, 4, 5, 3), -1, 1)
    np.testing.assert_array_equal(depths(tmp_path / "a.npy", shape=(4, 5)), expected)
    np.save(tmp_path / "b.npy", np.moveaxis(values, 1, 2))
    np.testing.assert_array_equal(depths(tmp_path / "b.npy", shape=(4, 5), axes="frame,target,zone"), expected)


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
        source, frames = opened(path)
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
    source, frames = opened(path)
    assert (source.unit_mm, source.scale_factor, source.add_offset) == (unit_mm, factor, offset)
    np.testing.assert_array_equal([frame.depth for frame in frames], WALL)


def test_channels_of_imagej_have_no_names_and_are_refused(tmp_path: Path) -> None:
    stack = np.stack([WALL, WALL + 500], axis=1).astype("u2")
    tifffile.imwrite(tmp_path / "a.tif", stack, imagej=True, metadata={"axes": "TCYX"})
    with pytest.raises(BadInputError, match=r"2 channels .* not one sequence of depths"):
        opened(tmp_path / "a.tif")


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
    assert opened(tmp_path / "a.ome.tif")[0].unit_mm == unit_mm


@pytest.mark.parametrize("kind", ["npz", "mat", "h5"])
def test_unit_in_the_name_of_an_array_is_used(tmp_path: Path, kind: str) -> None:
    path, metres = tmp_path / f"a.{kind}", WALL / 1000
    if kind == "npz":
        np.savez(path, depth_m=metres)
    elif kind == "mat":
        savemat(path, {"depth_m": metres})
    else:
        with h5py.File(path, "w") as root:
            root["depth_m"] = metres
    options = ("--axes", "frame,row,col") if kind == "mat" else ()
    np.testing.assert_allclose(imported_mm(path, *options), WALL, rtol=1e-6)
    np.testing.assert_allclose(imported_mm(path, *options, "--units", "cm"), WALL / 100, rtol=1e-6)


def test_images_of_another_stream_in_a_folder_are_not_frames(tmp_path: Path) -> None:
    for k in range(9):
        write_png(tmp_path / f"depth_{k}.png", WALL[k])
        write_png(tmp_path / f"ir_{k}.png", WALL[k] + 100)
    np.testing.assert_array_equal(depths(tmp_path), WALL)
    assert opened(tmp_path)[0].notes == (f"{tmp_path}: not used: images ir_# (9)",)
    for k in range(9):
        (tmp_path / f"depth_{k}.png").rename(tmp_path / f"left_depth_{k}.png")
        write_png(tmp_path / f"right_depth_{k}.png", WALL[k])
    with pytest.raises(BadInputError, match="several sequences of images: 9 of ir_#, 9 of left_depth_#, 9 of "):
        opened(tmp_path)


def test_names_that_are_time_stamps_are_sorted_as_decimal_numbers(tmp_path: Path) -> None:
    for name, image in zip(("1700000000.125", "1700000000.5", "1700000001.0"), WALL[:3], strict=True):
        write_png(tmp_path / f"{name}.png", image)
    np.testing.assert_array_equal(depths(tmp_path), WALL[:3])


@pytest.mark.parametrize(
    ("names", "chosen"), [(("Depth", "Amplitude"), 0), (("IR", "range"), 1), (("one", "two"), None)]
)
def test_channel_of_an_ome_tiff_is_told_by_its_name(tmp_path: Path, names: tuple[str, str], chosen: int | None) -> None:
    stack = np.stack([WALL, WALL + 500], axis=1).astype("u2")
    metadata = {"axes": "TCYX", "Channel": {"Name": list(names)}}
    tifffile.imwrite(tmp_path / "a.ome.tif", stack, metadata=metadata, ome=True)
    if chosen is None:
        with pytest.raises(BadInputError, match=r"2 channels \(one, two\), not one sequence of depths"):
            opened(tmp_path / "a.ome.tif")
        return
    np.testing.assert_array_equal(depths(tmp_path / "a.ome.tif"), stack[:, chosen])
    assert f"not used: channels {names[1 - chosen]}" in opened(tmp_path / "a.ome.tif")[0].notes[0]


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
    ],
)
def test_streams_are_told_by_the_words_of_their_names(name: str, stream: str) -> None:
    assert stream_of(name) == stream


@pytest.mark.parametrize("kind", ["npz", "mat", "h5"])
def test_array_of_8_bits_beside_a_wider_one_is_no_depth_where_names_say_nothing(tmp_path: Path, kind: str) -> None:
    path, arrays = tmp_path / f"a.{kind}", {"a": np.full(WALL.shape, 255, dtype="u1"), "b": WALL}
    if kind == "npz":
        np.savez(path, **arrays)  # type: ignore[arg-type]
    elif kind == "mat":
        savemat(path, arrays)
    else:
        with h5py.File(path, "w") as root:
            for name, values in arrays.items():
                root[name] = values
    source, frames = opened(path, axes="frame,row,col")
    np.testing.assert_array_equal([frame.depth for frame in frames], WALL)
    assert source.notes == (f"{path}: not used: array a",)


def test_names_that_say_nothing_are_taken_where_none_says_depth() -> None:
    assert depths_among(["a", "b", "infrared"]) == ["a", "b"]
    assert depths_among(["a", "my_range"]) == ["my_range"]


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
        opened(tmp_path)


def test_given_unit_takes_the_place_of_different_scales(tmp_path: Path) -> None:
    for k, scale in enumerate((0.25, 0.5)):
        write_png(tmp_path / f"{k}.png", WALL[0], f"radial range, 1 count = {scale} mm")
    np.testing.assert_array_equal(depths(tmp_path, unit_mm=1.0), WALL[[0, 0]])


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
        opened(tmp_path / "a.h5")


def test_datasets_beside_those_of_frames_are_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        for k in range(3):
            root[f"f{k}/depth"], root[f"f{k}/ir"], root[f"f{k}/stamp"] = WALL[k], WALL[k], 0.5 * k
    notes = opened(tmp_path / "a.h5")[0].notes
    assert f"{tmp_path / 'a.h5'}: not used: datasets f#/ir (3), f#/stamp (3)" in notes
    np.testing.assert_array_equal(depths(tmp_path / "a.h5", topic="f#/ir"), WALL[:3])


@pytest.mark.parametrize("key", ["unit", "Units", "UNIT", "units"])
def test_attribute_of_the_unit_is_read_in_any_case(tmp_path: Path, key: str) -> None:
    np.testing.assert_allclose(imported_mm(write_hdf5(tmp_path / "a.h5", WALL / 10, **{key: "cm"})), WALL, rtol=1e-6)


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
        opened(tmp_path / "a b.nc")
