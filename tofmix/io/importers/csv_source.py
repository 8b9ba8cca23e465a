"""CSV: a frame a line (wide), or a sample a line (long), told by the header.

Wide: `--shape ROWSxCOLS` says how the values of a line lie, row by row; a header is passed over, but for a column
`time` (s) and a column `frame`. Read line by line. Long: the header names `frame`, `row`, `col` and `range`, and
perhaps `target`, `amplitude` and `time` (s), in any order and beside others; the lines may be in any order. Read whole.
An empty cell and nan are no sample; so is what a long file leaves out.
"""

import csv
import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.importers.base import Frame, FrameSource, Request, foreign
from tofmix.io.importers.units import UNITS_MM
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE, MOST_TARGETS

SUFFIXES = (".csv", ".tsv", ".txt")

_ALSO = {"column": "col", "distance": "range"}
_WHOLE = ("frame", "row", "col")
_MOST_LONG_BYTES = 4 << 30
"""A long file is read whole: its numbers take about as much memory as their text."""

_FLOAT = np.dtype(np.float64)


@contextmanager
def open_csv(path: Path, request: Request) -> Iterator[FrameSource]:
    """Open a text file of numbers.

    Raises
    ------
    BadInputError
        If it holds something else, lines differ in length, or its layout cannot be told.
    """
    with foreign(path):
        head, delimiter = _head(path)
    if not head:
        raise BadInputError(f"{path}: empty")
    names = None if all(_is_number(cell) for cell in head) else [_name(cell) for cell in head]
    if names is not None and {"row", "col"} & set(names):
        yield _long(path, names, delimiter, request)
    elif request.shape is None:
        raise BadInputError(
            f"{path}: if a line is a frame, give --shape ROWSxCOLS; if it is a sample, a header must name"
            " frame,row,col,range"
        )
    else:
        yield _wide(path, names, delimiter, len(head), request.shape)


def _head(path: Path) -> tuple[list[str], str | None]:
    """Cells of the first line that has any, and what parts them: None for blanks."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        for line in file:
            if text := line.strip().lstrip("#").strip():
                delimiter = next((mark for mark in (",", ";", "\t") if mark in text), None)
                return _cells(text, delimiter), delimiter
    return [], None


def _cells(line: str, delimiter: str | None) -> list[str]:
    return (
        line.split() if delimiter is None else [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _name(cell: str) -> str:
    name = cell.strip().lower()
    return _ALSO.get(name, name)


def _value(cell: str) -> float:
    return float(cell) if cell.strip() else math.nan


def _lines(path: Path, *, skip: bool) -> Iterator[tuple[int, str]]:
    """Lines with numbers, and where they stand, counted from 1; `skip` the first one."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        for number, line in enumerate(file, 1):
            text = line.strip()
            if not text or (text.startswith("#") and not skip):
                continue
            if skip:
                skip = False
                continue
            yield number, text


def _wide(
    path: Path, names: list[str] | None, delimiter: str | None, width: int, shape: tuple[int, int]
) -> FrameSource:
    names = names or []
    beside = [k for k, name in enumerate(names) if name in ("frame", "time")]
    time_at = names.index("time") if "time" in names else None
    pixels = shape[0] * shape[1]
    if width - len(beside) != pixels:
        raise BadInputError(
            f"{path}: {width - len(beside)} values in the first line, --shape {shape[0]}x{shape[1]} has {pixels}"
        )
    with foreign(path):
        frames = sum(1 for _ in _lines(path, skip=bool(names)))
    if not frames:
        raise BadInputError(f"{path}: no frame below its header")
    keep = [k for k in range(width) if k not in beside]

    def images() -> Iterator[Frame]:
        lines = _lines(path, skip=bool(names))
        while True:
            with foreign(path):
                number, text = next(lines, (0, ""))
            if not number:
                return
            with foreign(f"{path}: line {number}"):
                cells = _cells(text, delimiter)
                if len(cells) != width:
                    raise BadInputError(f"{path}: line {number}: {len(cells)} values, the first line has {width}")
                values = np.array([_value(cells[k]) for k in keep])
                time_s = None if time_at is None else float(cells[time_at])
            yield Frame(depth=values.reshape(shape), time_s=time_s)

    return FrameSource(
        kind="CSV, a frame a line",
        shape=(frames, *shape),
        dtype=_FLOAT,
        frames=images(),
        has_time=time_at is not None,
    )


def _long(path: Path, names: list[str], delimiter: str | None, request: Request) -> FrameSource:
    column, unit_mm = _range_column(path, names)
    wanted = [*_WHOLE, *(name for name in ("target", "amplitude", "time") if name in names)]
    if lacking := [name for name in _WHOLE if name not in names]:
        raise BadInputError(f"{path}: its header names no {', '.join(lacking)}; it names: {', '.join(names)}")
    if path.stat().st_size > _MOST_LONG_BYTES:
        raise BadInputError(
            f"{path}: longer than {_MOST_LONG_BYTES >> 30} GB, and a sample a line is read whole;"
            " write a frame a line, or an .npy"
        )
    table = _table(path, [names.index(name) for name in wanted] + [column], delimiter)
    held = dict(zip([*wanted, "range"], table.T, strict=True))
    return _Samples(path, held, request.shape).source(unit_mm)


def _range_column(path: Path, names: list[str]) -> tuple[int, float | None]:
    """Where the ranges are, and mm of their unit if the header names it, as in ``range_mm``."""
    for k, name in enumerate(names):
        stem, _, unit = name.rpartition("_")
        if name == "range" or (_name(stem) == "range" and unit in UNITS_MM):
            return k, UNITS_MM.get(unit) if name != "range" else None
    raise BadInputError(f"{path}: its header names no range; it names: {', '.join(names)}")


def _table(path: Path, columns: list[int], delimiter: str | None) -> FloatArray:
    with foreign(path), path.open(encoding="utf-8-sig", newline="") as file:
        for line in file:  # the header
            if line.strip():
                break
        rest = (line for line in file if line.strip())
        first = next(rest, None)
        if first is None:
            raise BadInputError(f"{path}: no sample below its header")
        found = np.loadtxt(
            chain([first], rest), delimiter=delimiter, usecols=columns, converters=_value, ndmin=2, comments="#"
        )
    return np.asarray(found, dtype=np.float64)


class _Samples:
    """Samples of a long file, frame by frame.

    Rows, columns and targets count from 0; from 1 where no 0 is there (of rows and columns alike).
    """

    def __init__(self, path: Path, held: dict[str, NDArray[Any]], shape: tuple[int, int] | None) -> None:
        self._path, self._held = path, held
        self.notes: list[str] = []
        row, col = self._index("row", MOST_PIXELS_A_SIDE), self._index("col", MOST_PIXELS_A_SIDE)
        if min(row.min(), col.min()) >= 1 and (shape is None or row.max() >= shape[0] or col.max() >= shape[1]):
            row, col = row - 1, col - 1
            self.notes.append(f"{path}: no row and no column 0: they are taken to count from 1")
        self._pixels = shape or (int(row.max()) + 1, int(col.max()) + 1)
        if row.max() >= self._pixels[0] or col.max() >= self._pixels[1]:
            raise BadInputError(
                f"{path}: row {int(row.max())}, column {int(col.max())} are outside of --shape"
                f" {self._pixels[0]}x{self._pixels[1]}"
            )
        self._targets = 0
        target = np.zeros_like(row)
        if "target" in held:
            target = self._index("target", MOST_TARGETS)
            target -= int(target.min() >= 1)
            self._targets = int(target.max()) + 1
        numbers, frame = np.unique(self._index("frame", None), return_inverse=True)
        if len(numbers) > MOST_FRAMES:
            raise BadInputError(f"{path}: {len(numbers)} frames; no more than {MOST_FRAMES}")
        if missing := int(numbers[-1] - numbers[0]) + 1 - len(numbers):
            self.notes.append(f"{path}: {missing} frame numbers between the first and the last have no line")
        self._frames = len(numbers)
        layout = max(1, self._targets), *self._pixels
        self._place = np.ravel_multi_index((target, row, col), layout)
        self._order = np.lexsort((self._place, frame))
        self._starts = np.searchsorted(frame[self._order], np.arange(self._frames + 1))
        self._refuse_twins(frame, (target, row, col), numbers)

    def _index(self, name: str, most: int | None) -> NDArray[np.int64]:
        values = self._held[name]
        bad = ~(np.isfinite(values) & (values == np.floor(values)) & (values >= 0) & (values < 2**53))
        if bad.any():
            raise BadInputError(f"{self._path}: {name}: {values[np.argmax(bad)]:g} is no whole number from 0 on")
        if most is not None and values.max() > most:
            raise BadInputError(f"{self._path}: {name}: {values.max():g}; no more than {most}")
        return values.astype(np.int64)

    def _refuse_twins(
        self, frame: NDArray[np.int64], where: tuple[NDArray[np.int64], ...], numbers: NDArray[np.int64]
    ) -> None:
        first, second = self._order[:-1], self._order[1:]
        twins = (frame[first] == frame[second]) & (self._place[first] == self._place[second])
        if twins.any():
            k = int(first[np.argmax(twins)])
            target, row, col = (int(index[k]) for index in where)
            of = f", target {target}" if self._targets else ""
            remedy = "" if self._targets else "; several targets of a pixel need a column target"
            raise BadInputError(
                f"{self._path}: frame {int(numbers[frame[k]])} has two samples of row {row}, column {col}{of}{remedy}"
            )

    def source(self, unit_mm: float | None) -> FrameSource:
        """The file as a source."""
        return FrameSource(
            kind="CSV, a sample a line",
            shape=(self._frames, *self._pixels),
            targets=self._targets,
            dtype=_FLOAT,
            frames=self._images(),
            unit_mm=unit_mm,
            has_amplitude="amplitude" in self._held,
            has_time="time" in self._held,
            notes=tuple(self.notes),
        )

    def _images(self) -> Iterator[Frame]:
        for number in range(self._frames):
            part = self._order[self._starts[number] : self._starts[number + 1]]
            time_s = float(self._held["time"][part[0]]) if "time" in self._held else None
            amplitude = self._image("amplitude", part) if "amplitude" in self._held else None
            yield Frame(depth=self._image("range", part), amplitude=amplitude, time_s=time_s)

    def _image(self, name: str, part: NDArray[np.int64]) -> FloatArray:
        image = np.full(max(1, self._targets) * math.prod(self._pixels), np.nan)
        image[self._place[part]] = self._held[name][part]
        return image.reshape((self._targets, *self._pixels) if self._targets else self._pixels)
