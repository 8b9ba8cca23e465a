"""TIFF by tifffile: a stack of pages, one a frame, read page by page."""

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.extras import need
from tofmix.io.importers.axes import IMAGE_DIMENSIONS
from tofmix.io.importers.base import (
    Frame,
    FrameSource,
    Request,
    check_frame,
    check_numbers,
    complaints_are_errors,
    foreign,
    unused,
)
from tofmix.io.importers.image_text import imagej_keys, ome_root, stated_in, tag
from tofmix.io.importers.streams import depths_among

_LOGGER = "tifffile"


@contextmanager
def open_pages(path: Path, _: Request) -> Iterator[FrameSource]:
    """Open a TIFF of one page a frame.

    Raises
    ------
    BadInputError
        If it is damaged or cut short, or a page is not grey or differs from the first one.
    """
    with _opened(path) as pages:
        first = _page(pages, 0, path)
        check_numbers(first.dtype, path)
        with complaints_are_errors(_LOGGER, path), foreign(path):
            count = len(pages)
        with complaints_are_errors(_LOGGER, path), foreign(path):
            text = str(pages[0].description or "")
        channels = _channels(text)
        chosen, notes = _depth_pages(channels, count, path)
        stated = stated_in(text, channels.names[chosen[0] // channels.stride % len(channels.names)])
        yield FrameSource(
            kind="multi-page TIFF",
            shape=(len(chosen), first.shape[0], first.shape[1]),
            dtype=first.dtype,
            unit_mm=stated.unit_mm,
            scale_factor=stated.scale_factor,
            add_offset=stated.add_offset,
            depth_axis=stated.depth_axis,
            frames=_frames(pages, chosen, first, path),
            notes=notes,
        )


class _Channels(NamedTuple):
    """Names of the channels, and the number of pages from one of them to the next."""

    names: list[str]
    stride: int


def _channels(text: str) -> _Channels:
    """Channels of an OME-TIFF or of ImageJ's, which has no names; one without a name where the text has none."""
    one = _Channels([""], 1)
    if text.startswith("ImageJ="):
        count = imagej_keys(text).get("channels", "1")
        return _Channels([""] * int(count), 1) if count.isdecimal() and int(count) > 1 else one
    root = ome_root(text)
    pixels = None if root is None else next((item for item in root.iter() if tag(item) == "Pixels"), None)
    if pixels is None:
        return one
    sizes = {axis: int(size) if (size := pixels.get(f"Size{axis}", "1")).isdecimal() else 1 for axis in "ZCT"}
    order = pixels.get("DimensionOrder", "XYCZT")[2:]  # the fastest axis first
    names = [item.get("Name", "") for item in pixels if tag(item) == "Channel"]
    before = order[: order.find("C")] if "C" in order else ""
    names = [*names, *[""] * max(0, sizes["C"] - len(names))][: max(1, sizes["C"])]
    return _Channels(names, max(1, math.prod(sizes.get(axis, 1) for axis in before)))


def _depth_pages(channels: _Channels, count: int, path: Path) -> tuple[list[int], tuple[str, ...]]:
    """Pages of the depths, and a note on other channels.

    Raises
    ------
    BadInputError
        If there are several channels, and their names do not tell which is of depths.
    """
    names = channels.names
    if len(names) <= 1:
        return list(range(count)), ()
    shown = [name or f"channel {k}" for k, name in enumerate(names)]
    depths = depths_among([name for name in names if name])
    if len(depths) != 1 or count % len(names):
        raise BadInputError(
            f"{path}: {len(names)} channels ({', '.join(shown)}), not one sequence of depths;"
            " write the depths to a TIFF of their own"
        )
    channel = names.index(depths[0])
    pages = [page for page in range(count) if page // channels.stride % len(names) == channel]
    return pages, (unused(path, "channels", [name for k, name in enumerate(shown) if k != channel]),)


def single_text(path: Path) -> str | None:
    """The ``ImageDescription`` of a TIFF.

    Raises
    ------
    BadInputError
        If it is damaged.
    """
    with _opened(path) as pages, complaints_are_errors(_LOGGER, path), foreign(path):
        return str(pages[0].description or "")


def read_single(path: Path) -> NDArray[Any]:
    """Read a TIFF of one page, (row, col).

    Raises
    ------
    BadInputError
        If it is damaged, is not grey, or has several pages.
    """
    with _opened(path) as pages:
        with complaints_are_errors(_LOGGER, path), foreign(path):
            count = len(pages)
        if count != 1:
            raise BadInputError(f"{path}: {count} pages, expected one in a folder of frames")
        return _page(pages, 0, path)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    tifffile = need("tifffile", extra="images", what="TIFF")
    with ExitStack() as stack:
        with complaints_are_errors(_LOGGER, path), foreign(path):
            file = stack.enter_context(tifffile.TiffFile(path))
        yield file.pages


def _page(pages: Any, number: int, path: Path) -> NDArray[Any]:  # noqa: ANN401  tifffile's own
    what = f"{path}: page {number}"
    with complaints_are_errors(_LOGGER, what), foreign(what):
        page = np.asarray(pages[number].asarray())
    if page.ndim != IMAGE_DIMENSIONS:
        raise BadInputError(f"{what}: expected grey (row, col), got shape {page.shape}")
    return page


def _frames(pages: Any, numbers: list[int], first: NDArray[Any], path: Path) -> Iterator[Frame]:  # noqa: ANN401  tifffile's own
    for number in numbers:
        page = _page(pages, number, path)
        yield Frame(depth=check_frame(page, first.shape, first.dtype, f"{path}: page {number}"))
