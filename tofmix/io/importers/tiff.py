"""TIFF by tifffile: a stack of pages, one a frame, read page by page."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

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
)

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
        yield FrameSource(
            kind="multi-page TIFF",
            shape=(count, first.shape[0], first.shape[1]),
            dtype=first.dtype,
            depth_axis="z",
            frames=_frames(pages, count, first, path),
        )


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


def _frames(pages: Any, count: int, first: NDArray[Any], path: Path) -> Iterator[Frame]:  # noqa: ANN401  tifffile's own
    for number in range(count):
        page = _page(pages, number, path)
        yield Frame(depth=check_frame(page, first.shape, first.dtype, f"{path}: page {number}"))
