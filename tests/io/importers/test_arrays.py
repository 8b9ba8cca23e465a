"""Arrays of NumPy and MATLAB, folders of images and stacks: exact values, axes, order, and every refusal."""

import resource
import sys
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy.io import savemat
from support import naive_png
from support.naive import beam_directions
from support.reading import depths, read_source

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.io.importers import open_source
from tofmix.io.importers.base import SourceRequest
from tofmix.io.importers.conversion import Conversion
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import beam_directions_of, ray_over_depth

SHAPE = (6, 4, 5)
ROWS_FIRST = "row,col,frame"
FRAMES_FIRST: Literal["frame,row,col"] = "frame,row,col"


def samples(dtype: str = "u2", seed: int = 2) -> NDArray[Any]:
    return np.random.default_rng(seed).integers(1, 60000, SHAPE).astype(dtype)


def matlab_73(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays as MATLAB 7.3 does: its header, and HDF5 with the axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as root:
        for name, array in arrays.items():
            root.create_dataset(name, data=array.T).attrs["MATLAB_class"] = np.bytes_("uint16")
        root.create_group("#refs#")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def save(path: Path, version: str, **arrays: NDArray[Any]) -> Path:
    if version == "7.3":
        matlab_73(path, **arrays)
    else:
        savemat(path, arrays, do_compression=version == "7", format="5")
    return path


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2", "i4", "f4", "f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_and_npz_are_read_exactly(tmp_path: Path, dtype: str, order: Literal["C", "F"]) -> None:
    array = np.asarray(samples(dtype), order=order)
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", depth=array)
    np.savez_compressed(tmp_path / "b.npz", depth=array, exposure=np.ones(3))
    for name in ("a.npy", "a.npz", "b.npz"):
        np.testing.assert_array_equal(depths(tmp_path / name), array)


def test_npz_and_mat_carry_amplitude_and_time(tmp_path: Path) -> None:
    time_s = np.arange(6) / 30.0
    np.savez(tmp_path / "a.npz", range=samples(), amplitude=samples("f4", 9), time=time_s)
    held = {"range": samples(), "amplitude": samples("f4", 9), "time": time_s[:, None]}
    save(tmp_path / "a.mat", "5", **held)
    save(tmp_path / "b.mat", "7.3", **held)
    for name in ("a.npz", "a.mat", "b.mat"):
        source, frames = read_source(tmp_path / name, amplitude="amplitude", axes=FRAMES_FIRST)
        assert source.has_amplitude
        assert source.has_time
        np.testing.assert_array_equal([frame.depth for frame in frames], samples())
        np.testing.assert_array_equal([frame.amplitude for frame in frames], samples("f4", 9))
        assert [frame.time_s for frame in frames] == time_s.tolist()


@pytest.mark.parametrize("version", [pytest.param("5", marks=pytest.mark.slow), "7.3"])
def test_mat_is_read_in_either_order_of_axes(tmp_path: Path, version: str) -> None:
    own = save(tmp_path / "own.mat", version, d=np.moveaxis(samples(), 0, -1))
    ours = save(tmp_path / "ours.mat", version, d=samples())
    np.testing.assert_array_equal(depths(own, axes=ROWS_FIRST), samples())
    np.testing.assert_array_equal(depths(ours, axes=FRAMES_FIRST), samples())
    for path in (own, ours):  # told by the sensor's image
        np.testing.assert_array_equal(depths(path, image=(4, 5)), samples())
        with pytest.raises(BadInputError, match=r"the order of its axes does not follow from .*; choose --axes"):
            read_source(path, image=(144, 176))
    single = save(tmp_path / "single.mat", version, d=samples()[0])
    np.testing.assert_array_equal(depths(single), samples()[:1])


@pytest.mark.parametrize("kind", ["npz", pytest.param("5", marks=pytest.mark.slow), "7.3"])
def test_the_array_is_chosen_or_the_candidates_are_listed(tmp_path: Path, kind: str) -> None:
    held: dict[str, Any] = {"a": samples(), "b": samples(seed=4)}
    path = tmp_path / ("a.npz" if kind == "npz" else "a.mat")
    np.savez(path, **held) if kind == "npz" else save(path, kind, **held)
    np.testing.assert_array_equal(depths(path, topic="b", axes=FRAMES_FIRST), samples(seed=4))
    with pytest.raises(BadInputError, match=r"--dataset: a \(6, 4, 5\), b \(6, 4, 5\)"):
        read_source(path, axes=FRAMES_FIRST)
    with pytest.raises(BadInputError, match=r"no array 'c'; it holds: a"):
        read_source(path, topic="c", axes=FRAMES_FIRST)


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (pytest.fail, ("unpickled",))

    array = np.array([[[Trap()]]], dtype=object)
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    np.savez(tmp_path / "a.npz", a=array)
    np.savez(tmp_path / "t.npz", a=samples(), time=np.array([Trap()] * 6, dtype=object))
    for name in ("a.npy", "a.npz", "t.npz"):
        with pytest.raises(BadInputError):
            read_source(tmp_path / name)


@pytest.mark.parametrize(
    "array",
    [np.zeros((0, 4, 5)), np.zeros(7), np.zeros((2, 2, 2, 2)), np.zeros((2, 3, 4), complex), np.array([["a", "b"]])],
)
def test_arrays_of_other_dimensions_are_refused(tmp_path: Path, array: NDArray[Any]) -> None:
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", a=array)
    for name in ("a.npy", "a.npz"):
        with pytest.raises(BadInputError, match=name):
            read_source(tmp_path / name, **({"topic": "a"} if name == "a.npz" else {}))


@pytest.mark.parametrize(
    ("share", "kind"),
    [
        pytest.param(share, kind, marks=[pytest.mark.slow] if kind == "5" and share != 0.5 else [])  # one process each
        for share in (0.0, 0.02, 0.5, 0.98)
        for kind in ("npy", "npz", "npz compressed", "5", "7.3")
    ],
)
def test_cut_files_are_refused_in_one_line(tmp_path: Path, kind: str, share: float) -> None:
    array = np.random.default_rng(1).integers(0, 60000, (20, 30, 40)).astype("u2")
    path = tmp_path / f"a.{kind[:3] if kind[0] == 'n' else 'mat'}"
    if kind == "npy":
        np.save(path, array)
    elif kind.startswith("npz"):
        (np.savez if kind == "npz" else np.savez_compressed)(path, a=array)
    else:
        save(path, kind, a=array)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(BadInputError) as refused:
        read_source(path, axes=FRAMES_FIRST)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_mat_that_crashes_its_reader_is_refused(tmp_path: Path) -> None:
    # SciPy 1.17 trusts the type of the array's name and ends in a segmentation fault.
    path = save(tmp_path / "a.mat", "5", a=samples())
    data = bytearray(path.read_bytes())
    data[184] = 100
    path.write_bytes(data)
    with pytest.raises(BadInputError) as refused:
        read_source(path, axes=FRAMES_FIRST)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_mismatched_arrays_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", range=samples(), amplitude=samples()[:3])
    np.savez(tmp_path / "t.npz", range=samples(), time=np.zeros(3))
    save(tmp_path / "a.mat", "5", range=samples(), amplitude=samples()[:3])
    save(tmp_path / "b.mat", "7.3", range=samples(), amplitude=samples()[:3])
    for name in ("a.npz", "a.mat", "b.mat"):
        with pytest.raises(BadInputError, match=r"shape \(3, 4, 5\) differs"):
            read_source(tmp_path / name, amplitude="amplitude", axes=FRAMES_FIRST)
    with pytest.raises(BadInputError, match="time: expected 6 numbers"):
        read_source(tmp_path / "t.npz")


def test_a_full_disk_while_a_mat_is_unpacked_is_no_fault_of_the_file(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mat", "5", a=samples())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))  # the child inherits it
    try:
        with (
            pytest.raises(StorageError, match=r"a\.mat is unpacked in this folder"),
            open_source(path, SourceRequest(axes=FRAMES_FIRST)),
        ):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def images(dtype: str = "u2", frames: int = 12, rows: int = 5, cols: int = 7) -> NDArray[Any]:
    return np.random.default_rng(3).integers(0, 65536, (frames, rows, cols)).astype(dtype)


def folder_of(path: Path, frames: NDArray[Any], suffix: str, name: str = "frame{}") -> Path:
    path.mkdir()
    for number, frame in enumerate(frames):
        file = path / (name.format(number) + suffix)
        if suffix == ".png":
            file.write_bytes(naive_png.encode(frame))
        else:
            tifffile.imwrite(file, frame)
    (path / "readme.txt").write_text("not an image")
    return path


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
@pytest.mark.parametrize("name", ["frame{}", "{:06d}", "a{}_depth"])
def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path, suffix: str, name: str) -> None:
    np.testing.assert_array_equal(depths(folder_of(tmp_path / "f", images(), suffix, name)), images())


@pytest.mark.parametrize("dtype", ["u1", "u2", "i4", "f4", "f8"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_stack_of_pages_is_read_as_frames(
    tmp_path: Path, dtype: str, order: Literal["<", ">"], compression: str | None
) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, images(dtype), byteorder=order, compression=compression, photometric="minisblack")
    read = depths(path)
    np.testing.assert_array_equal(read, images(dtype))
    assert read.dtype == np.dtype(dtype)


def test_amplitudes_are_another_source(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "depth", images(), ".png")
    tifffile.imwrite(tmp_path / "amplitude.tif", images("f4")[::-1], photometric="minisblack")
    source, frames = read_source(folder, amplitude=str(tmp_path / "amplitude.tif"))
    assert source.has_amplitude
    np.testing.assert_array_equal([frame.amplitude for frame in frames], images("f4")[::-1])
    tifffile.imwrite(tmp_path / "short.tif", images("f4")[:3], photometric="minisblack")
    with pytest.raises(BadInputError, match="amplitudes 3 x 5 x 7, depths 12 x 5 x 7"):
        read_source(folder, amplitude=str(tmp_path / "short.tif"))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_mixed_sizes_are_refused_by_name(tmp_path: Path, suffix: str) -> None:
    folder = folder_of(tmp_path / "f", images(), suffix)
    file = folder / f"frame7{suffix}"
    file.unlink()
    folder_of(tmp_path / "other", images(rows=4), suffix)
    (tmp_path / "other" / f"frame7{suffix}").rename(file)
    with pytest.raises(BadInputError, match=f"frame7{suffix}: 4 x 7 pixels, the first frame has 5 x 7"):
        read_source(folder)


def test_mixed_sizes_and_types_of_pages_are_refused(tmp_path: Path) -> None:
    for other, reason in ((images(rows=4)[0], "page 1: 4 x 7 pixels"), (images("f4")[0], "page 1: type float32")):
        with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
            writer.write(images()[0], photometric="minisblack")
            writer.write(other, photometric="minisblack")
        with pytest.raises(BadInputError, match=reason):
            read_source(tmp_path / "a.tif")


@pytest.mark.parametrize(("mode", "reason"), [("L", "got L"), ("RGB", "got RGB"), ("P", "got P"), ("1", "got 1")])
def test_png_that_is_no_16_bit_grey_is_refused(tmp_path: Path, mode: str, reason: str) -> None:
    (tmp_path / "f").mkdir()
    Image.new(mode, (7, 5)).save(tmp_path / "f" / "a.png")
    with pytest.raises(BadInputError, match=f"expected 16-bit grey, {reason}"):
        read_source(tmp_path / "f")


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9])
def test_a_cut_image_is_refused_by_name(tmp_path: Path, suffix: str, share: float) -> None:
    folder = folder_of(tmp_path / "f", images(rows=50, cols=70, frames=3), suffix)
    file = folder / f"frame1{suffix}"
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(BadInputError) as refused:
        read_source(folder)
    assert f"frame1{suffix}" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.5, 0.8, 0.95, 0.999])
def test_a_cut_stack_is_refused_and_never_shorter(
    tmp_path: Path, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, images(rows=50, cols=70), photometric="minisblack", metadata=None)
    with tifffile.TiffWriter(path) as writer:  # page by page, as a camera writes: each page's header beside it
        for image in images(rows=50, cols=70):
            writer.write(image, photometric="minisblack", contiguous=False, metadata=None)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(BadInputError) as refused:
        read_source(path)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr().err == ""  # what the library logs is the error


def test_empty_and_mixed_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "f").mkdir()
    with pytest.raises(BadInputError, match=r"no \.png, \.tif, \.tiff in this folder"):
        read_source(tmp_path / "f")
    (tmp_path / "f" / "a.png").write_bytes(naive_png.encode(images()[0]))
    tifffile.imwrite(tmp_path / "f" / "b.tif", images()[0])
    with pytest.raises(BadInputError, match="keep one kind"):
        read_source(tmp_path / "f")
    (tmp_path / "f" / "a.png").unlink()
    tifffile.imwrite(tmp_path / "f" / "b.tif", images(), photometric="minisblack")
    with pytest.raises(BadInputError, match="12 pages, expected one"):
        read_source(tmp_path / "f")


def test_unknown_kinds_and_unfit_options_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("")
    with pytest.raises(UsageError, match=r"not a known source; .*\.mcap"):
        read_source(tmp_path / "a.xyz")
    with pytest.raises(BadInputError, match="No such file"):
        read_source(tmp_path / "none.tif")
    folder = folder_of(tmp_path / "f", images(), ".png")
    for option, name in (("topic", "dataset"), ("camera_info", "camera-info"), ("axes", "axes"), ("shape", "shape")):
        with pytest.raises(UsageError, match=f"--{name} does not apply to"):
            read_source(folder, **{option: "frame,row,col"})


@pytest.mark.parametrize(("suffix", "module"), [(".png", "PIL.Image"), (".tif", "tifffile")])
def test_a_missing_library_is_named(tmp_path: Path, suffix: str, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = folder_of(tmp_path / "f", images(), suffix)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=r"pip install 'tofmix\[images\]'"):
        read_source(folder)


@pytest.mark.parametrize("side", ["rows", "cols"])
def test_size_that_a_page_declares_is_checked_before_it_is_read(tmp_path: Path, side: str) -> None:
    # A strip of 12 bytes that declares an image of 4 GB; reading it would take that much memory.
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 3), "u1"), photometric="minisblack", metadata=None)
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as file:
        tags: Any = file.pages.first.tags
        for name in ("ImageLength" if side == "rows" else "ImageWidth", "RowsPerStrip"):
            tags[name].overwrite(2**30)
    with pytest.raises(BadInputError, match=r"1073741824.* pixels; no more than 4096 a side"):
        read_source(tmp_path / "a.tif")


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2"])
def test_whole_millimetres_stay_as_they_are(dtype: str) -> None:
    depth = np.arange(256, dtype=dtype).reshape(16, 16)
    convert = Conversion(dtype=depth.dtype)
    assert convert.stored_dtype == "u2"
    range_mm = convert(depth).range_mm
    kept = depth != np.iinfo(depth.dtype).max  # the end of a type is a fill value
    np.testing.assert_array_equal(range_mm, np.where(kept, depth, 0))
    assert range_mm.dtype == np.uint16


def test_infinite_values_become_nan() -> None:
    depth = np.array([[np.nan, np.inf, -np.inf, 1e38, 1.0]], dtype="f4")
    out = Conversion(dtype=depth.dtype, unit_mm=1000.0)(depth).range_mm
    assert np.isnan(out).tolist() == [[True, True, True, True, False]]


@pytest.mark.parametrize(("dtype", "invalid"), [("u2", 65535.0), ("i4", -1.0), ("f4", 0.1), ("f8", 9999.5)])
def test_invalid_values_become_nan(dtype: str, invalid: float) -> None:
    depth = np.array([[0, 7, invalid]], dtype=dtype)
    out = Conversion(dtype=depth.dtype, invalid=(invalid, 12345.678))(depth).range_mm
    valid = out != 0 if out.dtype == np.uint16 else np.isfinite(out)
    assert valid.tolist() == [[False, True, False]]


def _walls() -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Range over depth by the geometry under test, and by the angle between the beam and the axis."""
    pinhole = Pinhole(fx=4.0, fy=5.0, cx=2.5, cy=1.0)
    row, col = np.mgrid[0:4, 0:6]
    beams = np.stack([(col - 2.5) / 4.0, (row - 1.0) / 5.0, np.ones((4, 6))], axis=-1)
    azimuth, elevation = np.deg2rad((col - 2.5) * 60 / 6), np.deg2rad((row - 1.5) * 40 / 4)
    return {
        "pinhole": (ray_over_depth(beam_directions_of(pinhole, (4, 6))), np.linalg.norm(beams, axis=-1)),
        "grid": (
            ray_over_depth(beam_directions(4, 6, fov_horizontal_deg=60.0, fov_vertical_deg=40.0)),
            1 / (np.cos(azimuth) * np.cos(elevation)),
        ),
    }


@pytest.mark.parametrize("geometry", ["pinhole", "grid"])
def test_a_wall_across_the_axis_has_one_depth_and_longer_ranges_off_it(geometry: str) -> None:
    factor, expected = _walls()[geometry]
    depth = np.full((4, 6), 2000, dtype=np.uint16)
    convert = Conversion(dtype=depth.dtype, ray_over_depth=factor)
    assert convert.stored_dtype == "f4"
    np.testing.assert_allclose(convert(depth).range_mm, 2000 * expected, rtol=1e-7)
