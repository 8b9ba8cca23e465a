"""A folder of 16-bit PNG or TIFF images, one a frame, in the order of the numbers in their names."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.extras import need
from tofmix.io.importers.base import Frame, FrameSource, Request, check_frame, check_numbers, foreign
from tofmix.io.importers.tiff import read_single

_TIFF, _PNG = (".tif", ".tiff"), (".png",)
_GREY_16 = ("I;16", "I;16B", "I")
"""Modes in which Pillow, by its version, reads 16-bit grey."""


@contextmanager
def open_folder(path: Path, _: Request) -> Iterator[FrameSource]:
    """Open a folder; its images are read one by one.

    Raises
    ------
    BadInputError
        If it holds no image or two kinds, or an image is damaged or differs from the first one.
    """
    with foreign(path):
        files = sorted((p for p in path.iterdir() if p.suffix.lower() in (*_TIFF, *_PNG)), key=_natural)
    kinds = {p.suffix.lower() in _PNG for p in files}
    if not files:
        raise BadInputError(f"{path}: no .png or .tif in this folder")
    if len(kinds) > 1:
        raise BadInputError(f"{path}: both .png and .tif in this folder; keep one kind")
    first = _read(files[0])
    yield FrameSource(
        kind=f"folder of {'PNG' if True in kinds else 'TIFF'} images",
        shape=(len(files), *first.shape),
        dtype=first.dtype,
        depth_axis="z",
        frames=_frames(files, first),
    )


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort key in which 2 comes before 10."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]


def _frames(files: list[Path], first: NDArray[Any]) -> Iterator[Frame]:
    for file in files:
        yield Frame(depth=check_frame(_read(file), first.shape, first.dtype, file))


def _read(file: Path) -> NDArray[Any]:
    image = _read_png(file) if file.suffix.lower() in _PNG else read_single(file)
    check_numbers(image.dtype, file)
    return image


def _read_png(file: Path) -> NDArray[np.uint16]:
    pillow = need("PIL.Image", extra="images", what="PNG")
    with foreign(file), pillow.open(file, formats=["PNG"]) as image:
        mode = image.mode
        values = np.asarray(image) if mode in _GREY_16 else None
    if values is None:
        raise BadInputError(f"{file}: expected 16-bit grey, got {mode}")
    return values.astype(np.uint16)
