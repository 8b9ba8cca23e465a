"""Folders of PNG and TIFF, and stacks of TIFF pages: exact values, order, and every refusal."""

import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from support import naive_png
from support.reading import depths, read_source

from tofmix.errors import BadInputError, UsageError


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


def test_stack_of_another_program_is_read(tmp_path: Path) -> None:
    first, *rest = (Image.fromarray(image) for image in images())
    first.save(tmp_path / "a.tiff", save_all=True, append_images=rest)
    np.testing.assert_array_equal(depths(tmp_path / "a.tiff"), images())


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


def test_colour_tiff_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((5, 7, 3), "u2"), photometric="rgb")
    with pytest.raises(BadInputError, match=r"expected grey \(row, col\), got shape"):
        read_source(tmp_path / "a.tif")


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


def test_an_image_larger_than_a_camera_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((2, 5000), "u1"))
    with pytest.raises(BadInputError, match="2 x 5000 pixels; no more than 4096 a side"):
        read_source(tmp_path / "a.tif")


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
