"""A folder of images, one a frame, in the order of the numbers in their names: one line a kind in `IMAGE_KINDS`."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError, UsageError
from tofmix.io.importers.base import (
    Frame,
    FrameSource,
    SourceRequest,
    check_frame,
    check_numbers,
    check_size,
    foreign,
    unused,
)
from tofmix.io.importers.conversion import depths_among, stream_of
from tofmix.io.importers.tiff import Stated, check_stated, read_single, single_text, stated_in
from tofmix.io.next_command import import_command, need

_GREY_16 = ("I;16", "I;16B", "I")
"""Modes in which Pillow, by its version, reads 16-bit grey."""

_NUMBERS = re.compile(r"[\d.]*\d[\d.]*")
_WHOLE, _DECIMAL = re.compile(r"(\d+)", re.ASCII), re.compile(r"(\d+(?:\.\d+)?)", re.ASCII)
_STAMP = re.compile(r"(\d+(?:\.\d+)?)|\D*(\d{9,}(?:\.\d+)?)\D*", re.ASCII)


@contextmanager
def open_folder(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a folder; its images are read one by one."""
    with foreign(path):
        files = [p for p in path.iterdir() if p.suffix.lower() in IMAGE_KINDS]
    kinds = sorted({_kind(file)[0] for file in files})
    if not files:
        raise BadInputError(f"{path}: no {', '.join(IMAGE_KINDS)} in this folder")
    if len(kinds) > 1:
        raise BadInputError(f"{path}: {' and '.join(kinds)} images in this folder; keep one kind")
    stream, files, left = _one_sequence(files, path, request)
    files = in_order(files)
    first = _read(files[0])
    stated = stated_in(_text(files[0]))
    yield FrameSource(
        kind=f"folder of {kinds[0]} images",
        shape=(len(files), *first.shape),
        dtype=first.dtype,
        **stated._asdict(),
        frames=_frames(files, first, stated, request),
        stream=stream,
        notes=(unused(path, "images", left),) if left else (),
    )


def _one_sequence(files: list[Path], folder: Path, request: SourceRequest) -> tuple[str, list[Path], list[str]]:
    """Name of the sequence of depths, its images, and the names of the other sequences in the folder.

    Names that differ in numbers alone are one sequence; those without any number are one together.
    """
    sequences: dict[str, list[Path]] = {}
    for file in files:
        sequences.setdefault(_NUMBERS.sub("#", file.stem), []).append(file)
    listed = ", ".join(f"{len(members)} of {name}" for name, members in sorted(sequences.items()))
    if request.topic in sequences:
        chosen = [request.topic]
    elif request.topic is not None and (len(sequences) > 1 or request.topic != folder.resolve().name):
        raise UsageError(f"--dataset does not apply to {folder} unless it names a sequence of images there: {listed}")
    elif not any("#" in name for name in sequences) and {stream_of(name) for name in sequences} == {"unknown"}:
        return "", files, []
    elif len(sequences) == 1:
        chosen = list(sequences)
    elif request.as_amplitude:
        chosen = [name for name in sequences if stream_of(name) == "other"]
    else:
        chosen = depths_among(sequences)
    if len(chosen) != 1:
        raise BadInputError(
            f"{folder}: several sequences of images: {listed}; choose one:"
            f" {import_command(folder, '--dataset', min(chosen or sequences))}"
        )
    left = [f"{name} ({len(sequences[name])})" for name in sorted(sequences) if name != chosen[0]]
    return chosen[0], sequences[chosen[0]], left


def in_order(files: list[Path]) -> list[Path]:
    """Images in the order of the numbers in their names, in which 2 comes before 10.

    Points separate numbers, as in ``run2.10``. They are decimal points where each name is one time stamp, such as
    ``1700000000.5``, alone or with words beside a number since 1970, and no two of them are equal.
    """
    stems = [file.stem for file in files]
    stamps = [found for stem in stems if (found := _STAMP.fullmatch(stem))]
    decimal = len(stamps) == len(stems) == len({Decimal(found[1] or found[2]) for found in stamps})
    number = _DECIMAL if decimal else _WHOLE
    return [file for _, file in sorted(zip((_natural(stem, number) for stem in stems), files, strict=True))]


def _natural(stem: str, number: re.Pattern[str]) -> list[tuple[int, Decimal, str]]:
    parts = number.split(stem)
    return [(0, Decimal(part), "") if number.fullmatch(part) else (1, Decimal(0), part) for part in parts]


def _frames(files: list[Path], first: NDArray[Any], stated: Stated, request: SourceRequest) -> Iterator[Frame]:
    for file in files:
        check_stated(stated_in(_text(file)), stated, file, files[0], unit_given=request.unit_mm is not None)
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
        check_size((image.height, image.width), file)
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
