"""CSV with a sample a line: the header names `frame`, `row`, `col` and `range`.

Optional columns are `target`, `amplitude` and `time` (s). Columns may be in any order, with others. Rows, columns and
targets count from 0; from 1 if no 0 occurs (in neither rows nor columns). Where the frames ascend, the file is read
twice in pieces: once for its sizes, once for its samples. Where they do not, it is read whole, and sorted.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.io.importers.base import Frame, FrameSource, foreign
from tofmix.io.importers.units import UNITS_MM
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE, MOST_TARGETS

PIECE_LINES = 1 << 17
"""Lines that are read together: their numbers take some 10 MB."""

MOST_WHOLE_BYTES = 4 << 30
"""A file that is read whole: its numbers take about as much memory as their text."""

_WHOLE = ("frame", "row", "col")
_FLOAT = np.dtype(np.float64)


def open_long(
    path: Path,
    names: list[str],
    delimiter: str | None,
    shape: tuple[int, int] | None,
    *,
    unit_mm: float | None = None,
) -> FrameSource:
    """Open a file with a sample a line.

    Parameters
    ----------
    path : Path
        The file.
    names : list of str
        Names in its header, in lower case.
    delimiter : str, optional
        Separator of cells; blanks without it.
    shape : (int, int), optional
        Rows and columns; without it, from the samples.
    unit_mm : float, optional
        mm of the given unit; it must not contradict the header.

    Raises
    ------
    BadInputError
        If a column is missing, the header names another unit, a number is none or out of bounds, or the file is too
        long to be sorted.
    """
    column, named_mm = _range_column(path, names)
    if unit_mm is not None and named_mm is not None and unit_mm != named_mm:
        raise BadInputError(
            f"{path}: the column is {names[column]}, but --units or --scale says {unit_mm:g} mm a unit; leave the"
            f" option out, or rename the column to {names[column].rpartition('_')[0]}"
        )
    if lacking := [name for name in _WHOLE if name not in names]:
        raise BadInputError(f"{path}: its header names no {', '.join(lacking)}; it names: {', '.join(names)}")
    wanted = [*_WHOLE, *(name for name in ("target", "amplitude", "time") if name in names)]
    table = _Table(path, {name: names.index(name) for name in wanted} | {"range": column}, delimiter)
    return _Samples(table, shape).source(named_mm)


def _range_column(path: Path, names: list[str]) -> tuple[int, float | None]:
    """Column of the ranges, and mm of their unit if the header names it, as in ``range_mm``."""
    for k, name in enumerate(names):
        stem, _, unit = name.rpartition("_")
        if name == "range" or (stem in ("range", "distance") and unit in UNITS_MM):
            return k, UNITS_MM.get(unit) if name != "range" else None
    raise BadInputError(f"{path}: its header names no range; it names: {', '.join(names)}")


def _value(cell: str) -> float:
    return float(cell) if cell.strip() else math.nan


class Piece(NamedTuple):
    """Columns of some lines: `frame`, `row`, `col`, `target` (line,) whole numbers; the others by name, float64."""

    frame: IntArray
    row: IntArray
    col: IntArray
    target: IntArray
    values: dict[str, FloatArray]

    def taken(self, lines: IntArray | slice) -> "Piece":
        """Some of the lines."""
        values = {name: part[lines] for name, part in self.values.items()}
        return Piece(self.frame[lines], self.row[lines], self.col[lines], self.target[lines], values)


def _joined(pieces: Iterable[Piece]) -> Piece:
    parts = list(pieces)
    if len(parts) == 1:
        return parts[0]
    return Piece(
        frame=np.concatenate([part.frame for part in parts]),
        row=np.concatenate([part.row for part in parts]),
        col=np.concatenate([part.col for part in parts]),
        target=np.concatenate([part.target for part in parts]),
        values={name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values},
    )


class _Table:
    """The lines of a file, in pieces."""

    def __init__(self, path: Path, columns: dict[str, int], delimiter: str | None) -> None:
        self.path, self._columns, self._delimiter = path, columns, delimiter

    @property
    def names(self) -> list[str]:
        """The columns that are read."""
        return list(self._columns)

    def pieces(self) -> Iterator[Piece]:
        """Read the file once."""
        with foreign(self.path):
            file = self.path.open(encoding="utf-8-sig", newline="")
        with file:
            lines = (line for line in file if line.strip())
            with foreign(self.path):
                next(lines, None)  # the header, which may begin with #
            samples = (line for line in lines if not line.lstrip().startswith("#"))
            before = 0
            while True:
                with foreign(self.path):
                    text = list(islice(samples, PIECE_LINES))
                if not text:
                    return
                with foreign(f"{self.path}: after {before} samples" if before else self.path):
                    found = np.loadtxt(
                        text, delimiter=self._delimiter, usecols=list(self._columns.values()), converters=_value,
                        ndmin=2, comments="#",
                    )  # fmt: skip
                before += len(found)
                yield self._piece(dict(zip(self._columns, np.asarray(found, dtype=np.float64).T, strict=True)))

    def _piece(self, held: dict[str, FloatArray]) -> Piece:
        frame = self._index("frame", held["frame"], None)
        row, col = (self._index(name, held[name], MOST_PIXELS_A_SIDE) for name in ("row", "col"))
        target = self._index("target", held["target"], MOST_TARGETS) if "target" in held else np.zeros_like(row)
        values = {name: held[name] for name in held if name not in (*_WHOLE, "target")}
        return Piece(frame, row, col, target, values)

    def _index(self, name: str, values: FloatArray, most: int | None) -> IntArray:
        bad = ~(np.isfinite(values) & (values == np.floor(values)) & (values >= 0) & (values < 2**53))
        if bad.any():
            raise BadInputError(f"{self.path}: {name}: {values[np.argmax(bad)]:g} is not a whole number of at least 0")
        if most is not None and values.max() > most:
            raise BadInputError(f"{self.path}: {name}: {values.max():g}; no more than {most}")
        return values.astype(np.int64)


class _Ends(NamedTuple):
    """Number of frames, the first and the last; least and largest row, column and target."""

    frames: int
    frame: tuple[int, int]
    row: tuple[int, int]
    col: tuple[int, int]
    target: tuple[int, int]


def _range(values: IntArray) -> tuple[int, int]:
    return int(values.min()), int(values.max())


def _both(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    return min(one[0], other[0]), max(one[1], other[1])


def _ends(pieces: Iterable[Piece]) -> _Ends | None:
    """Read the pieces once; None if a frame comes after a later one, or there is no line."""
    found: _Ends | None = None
    for piece in pieces:
        if (np.diff(piece.frame) < 0).any():
            return None
        here = _Ends(
            len(np.unique(piece.frame)), _range(piece.frame), _range(piece.row), _range(piece.col), _range(piece.target)
        )
        if found is not None:
            if here.frame[0] < found.frame[1]:
                return None
            again = int(here.frame[0] == found.frame[1])  # a frame whose lines lie in both pieces
            here = _Ends(
                found.frames + here.frames - again, _both(found.frame, here.frame), _both(found.row, here.row),
                _both(found.col, here.col), _both(found.target, here.target),
            )  # fmt: skip
        found = here
    return found


class _Samples:
    """Samples of a file with a sample a line, frame by frame."""

    def __init__(self, table: _Table, shape: tuple[int, int] | None) -> None:
        self._table, self._path = table, table.path
        self._pieces: Callable[[], Iterable[Piece]] = table.pieces
        ends = _ends(table.pieces())
        if ends is None:
            whole = self._sorted()
            self._pieces = lambda: [whole]
            ends = _ends([whole])
        if ends is None:
            raise BadInputError(f"{self._path}: no sample below its header")
        self.notes: list[str] = []
        rows, cols = ends.row[1], ends.col[1]
        self._first = int(
            min(ends.row[0], ends.col[0]) >= 1 and (shape is None or rows >= shape[0] or cols >= shape[1])
        )
        if self._first:
            self.notes.append(f"{self._path}: rows and columns are taken to start at 1, because none is 0")
        self._pixels = shape or (rows - self._first + 1, cols - self._first + 1)
        if rows - self._first >= self._pixels[0] or cols - self._first >= self._pixels[1]:
            raise BadInputError(
                f"{self._path}: row {rows - self._first}, column {cols - self._first} are outside of --shape"
                f" {self._pixels[0]}x{self._pixels[1]}"
            )
        self._first_target = int(ends.target[0] >= 1)
        self._targets = ends.target[1] - self._first_target + 1 if "target" in table.names else 0
        if ends.frames > MOST_FRAMES:
            raise BadInputError(f"{self._path}: {ends.frames} frames; no more than {MOST_FRAMES}")
        if missing := ends.frame[1] - ends.frame[0] + 1 - ends.frames:
            self.notes.append(f"{self._path}: {missing} frame numbers between the first and the last have no line")
        self._frames = ends.frames

    def _sorted(self) -> Piece:
        """All lines, by frame."""
        if self._path.stat().st_size > MOST_WHOLE_BYTES:
            raise BadInputError(
                f"{self._path}: longer than {MOST_WHOLE_BYTES >> 30} GB, and its frames are not in order; sort its"
                " lines by frame"
            )
        pieces = list(self._table.pieces())
        if not pieces:
            raise BadInputError(f"{self._path}: no sample below its header")
        whole = _joined(pieces)
        return whole.taken(np.argsort(whole.frame, kind="stable"))

    def source(self, unit_mm: float | None) -> FrameSource:
        """The file as a source."""
        return FrameSource(
            kind="CSV, one sample a line",
            shape=(self._frames, *self._pixels),
            targets=self._targets,
            dtype=_FLOAT,
            frames=self._images(),
            unit_mm=unit_mm,
            has_amplitude="amplitude" in self._table.names,
            has_time="time" in self._table.names,
            notes=tuple(self.notes),
        )

    def _images(self) -> Iterator[Frame]:
        """Frames in order; the lines of a frame may lie in several pieces."""
        waiting: list[Piece] = []
        for piece in self._pieces():
            starts = np.flatnonzero(np.diff(piece.frame)) + 1
            for first, stop in zip([0, *starts], [*starts, len(piece.frame)], strict=True):
                if waiting and waiting[0].frame[0] != piece.frame[first]:
                    yield self._frame(_joined(waiting))
                    waiting = []
                waiting.append(piece.taken(slice(first, stop)))
        if waiting:
            yield self._frame(_joined(waiting))

    def _frame(self, lines: Piece) -> Frame:
        where = lines.target - self._first_target, lines.row - self._first, lines.col - self._first
        place = np.ravel_multi_index(where, (max(1, self._targets), *self._pixels))
        self._refuse_twins(lines, place)
        time_s = float(lines.values["time"][0]) if "time" in lines.values else None
        amplitude = self._image(place, lines.values["amplitude"]) if "amplitude" in lines.values else None
        return Frame(depth=self._image(place, lines.values["range"]), amplitude=amplitude, time_s=time_s)

    def _refuse_twins(self, lines: Piece, place: IntArray) -> None:
        _, first, count = np.unique(place, return_index=True, return_counts=True)
        if (count > 1).any():
            k = int(first[np.argmax(count > 1)])
            row, col = int(lines.row[k]) - self._first, int(lines.col[k]) - self._first
            of = f", target {int(lines.target[k]) - self._first_target}" if self._targets else ""
            remedy = "" if self._targets else "; several targets of a pixel need a column target"
            raise BadInputError(
                f"{self._path}: frame {int(lines.frame[k])} has two samples of row {row}, column {col}{of}{remedy}"
            )

    def _image(self, place: IntArray, values: FloatArray) -> FloatArray:
        image = np.full(max(1, self._targets) * math.prod(self._pixels), np.nan)
        image[place] = values
        return image.reshape((self._targets, *self._pixels) if self._targets else self._pixels)
