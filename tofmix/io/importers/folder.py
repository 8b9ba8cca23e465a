"""A folder of images, one a frame, in the order of the numbers in their names: one line a kind in `IMAGE_KINDS`."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.extras import need
from tofmix.io.importers.base import Frame, FrameSource, Request, check_frame, check_numbers, foreign, unused
from tofmix.io.importers.image_text import stated_in
from tofmix.io.importers.streams import depths_among, stream_of
from tofmix.io.importers.tiff import read_single, single_text

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
        files = sorted((p for p in path.iterdir() if p.suffix.lower() in IMAGE_KINDS), key=_natural)
    kinds = sorted({_kind(file)[0] for file in files})
    if not files:
        raise BadInputError(f"{path}: no {', '.join(IMAGE_KINDS)} in this folder")
    if len(kinds) > 1:
        raise BadInputError(f"{path}: {' and '.join(kinds)} images in this folder; keep one kind")
    files, left = _one_sequence(files, path)
    first = _read(files[0])
    stated = stated_in(_text(files[0]))
    yield FrameSource(
        kind=f"folder of {kinds[0]} images",
        shape=(len(files), *first.shape),
        dtype=first.dtype,
        unit_mm=stated.unit_mm,
        scale_factor=stated.scale_factor,
        add_offset=stated.add_offset,
        depth_axis=stated.depth_axis,
        frames=_frames(files, first),
        notes=(unused(path, "images", left),) if left else (),
    )


def _one_sequence(files: list[Path], folder: Path) -> tuple[list[Path], list[str]]:
    """The images of depths, and the names of the other sequences in the folder.

    Names that differ in numbers alone are one sequence.

    Raises
    ------
    BadInputError
        If there are several sequences, and names do not tell which is of depths.
    """
    sequences: dict[str, list[Path]] = {}
    for file in files:
        sequences.setdefault(re.sub(r"[\d.]+", "#", file.stem), []).append(file)
    told = {name: stream_of(name) for name in sequences}
    if len(sequences) == 1 or not any(told.values()) or set(told.values()) == {"unknown"}:
        return files, []
    chosen = depths_among(sequences)
    if len(chosen) != 1:
        listed = ", ".join(f"{len(members)} of {name}" for name, members in sequences.items())
        raise BadInputError(
            f"{folder}: several sequences of images: {listed}; put the depths into a folder of their own"
        )
    return sequences[chosen[0]], [f"{name} ({len(sequences[name])})" for name in sequences if name != chosen[0]]


def _natural(path: Path) -> list[tuple[int, float, str]]:
    """Sort key in which 2 comes before 10, and time stamps such as 1700000000.5 are decimal numbers."""
    parts = re.split(r"(\d+(?:\.\d+)?)", path.stem)
    return [(0, float(part), "") if part[:1].isdecimal() else (1, 0.0, part) for part in parts]


def _frames(files: list[Path], first: NDArray[Any]) -> Iterator[Frame]:
    for file in files:
        yield Frame(depth=check_frame(_read(file), first.shape, first.dtype, file))


def _kind(file: Path) -> tuple[str, Callable[[Path], NDArray[Any]]]:
    return IMAGE_KINDS[file.suffix.lower()]


def _text(file: Path) -> str | None:
    """The text that an image holds of itself."""
    return TEXTS[_kind(file)[0]](file)


def _png_text(file: Path) -> str | None:
    pillow = need("PIL.Image", extra="images", what="PNG")
    with foreign(file), pillow.open(file, formats=["PNG"]) as image:
        text = image.text.get("Description") if hasattr(image, "text") else None
    return text if isinstance(text, str) else None


def _read(file: Path) -> NDArray[Any]:
    _, read = _kind(file)
    image = read(file)
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


IMAGE_KINDS: dict[str, tuple[str, Callable[[Path], NDArray[Any]]]] = {
    ".png": ("PNG", _read_png),
    ".tif": ("TIFF", read_single),
    ".tiff": ("TIFF", read_single),
}
"""Kind of each suffix, and the reader of one image, (row, col)."""

TEXTS: dict[str, Callable[[Path], str | None]] = {"PNG": _png_text, "TIFF": single_text}
"""Readers of an image's own text, by its kind."""
