"""CSV with a sample a line: the header names `frame`, `row`, `col` and `range`.

`zone` may take the place of `row` and `col`, and a time that of `frame`. Optional columns are `target`, `amplitude`, a
time, and status codes. Columns may be in any order, with others. Rows, columns and targets count from 0; from 1 if no 0
occurs (in neither rows nor columns). Where the frames ascend, the file is read twice in pieces: once for its sizes,
once for its samples. Where they do not, it is read whole, and sorted.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.io.importers.base import Frame, FrameSource, SourceRequest, foreign, unused
from tofmix.io.importers.conversion import codes_of, is_status_name
from tofmix.io.importers.csv_text import Layout
from tofmix.io.importers.times import unit_of_stamps
from tofmix.io.recording.range_check import TIME_UNITS_S, UNITS_MM
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE, MOST_TARGETS

PIECE_LINES = 1 << 17
"""Lines that are read together: their numbers take some 10 MB."""

MOST_WHOLE_BYTES = 4 << 30
"""A file that is read whole: its numbers take about as much memory as their text."""

_PLACE = ("row", "col")
_INDICES = ("frame", *_PLACE, "target")
_WHOLE = (*_INDICES, "zone")
_FLOAT = np.dtype(np.float64)
TIME_NAMES = frozenset(
    f"{stem}{unit}"
    for stem in ("time", "timestamp", "stamp", "datetime", "t")
    for unit in ("", "_s", "_ms", "_us", "_ns")
)
"""Names of a column of times; what follows the last _ is its unit."""

INDEX_NAMES = ("", "index", "unnamed: 0")
"""Names of a column that numbers the lines, as tables of pandas have it."""

_OTHER = "other "
"""Before the name of a column whose meaning another one has by ``--columns``."""


def named_columns(names: list[str], request: SourceRequest, path: Path) -> list[str]:
    """Names of columns with the meanings that ``--columns`` gives them; a unit at the end of a name stays."""
    if lacking := [name for name in request.columns if name not in names]:
        raise BadInputError(f"{path}: --columns: no column {', '.join(lacking)}; its header names: {', '.join(names)}")

    taken = set(request.columns.values())

    def meaning(name: str) -> str:
        if name not in request.columns:
            return f"{_OTHER}{name}" if _plain_meaning(name) in taken else name
        ours, unit = request.columns[name], name.rpartition("_")[2]
        known = (ours == "range" and unit in UNITS_MM) or (ours == "time" and unit in TIME_UNITS_S)
        return f"{ours}_{unit}" if known and "_" in name else ours

    return [meaning(name) for name in names]


def _plain_meaning(name: str) -> str:
    """Meaning that a column has by its own name; the name itself where it has none of ours."""
    if _is_range(name):
        return "range"
    if name in TIME_NAMES:
        return "time"
    return "status" if is_status_name(name) else name


def _is_range(name: str) -> bool:
    stem, _, unit = name.rpartition("_")
    return name == "range" or (stem in ("range", "distance") and unit in UNITS_MM)


def time_unit_of(name: str, first: list[float], request: SourceRequest, path: Path) -> tuple[float, list[str]]:
    """Unit of a column of times, s, and a note where it is told by the size of the numbers.

    A given unit comes first, then that of the column's name; `first` are the numbers in the first frames.
    """
    if request.time_unit_s is not None:
        return request.time_unit_s, []
    unit = name.rpartition("_")[2] if "_" in name else ""
    if unit in TIME_UNITS_S:
        return TIME_UNITS_S[unit], []
    unit_s, notes = unit_of_stamps(np.array(first), f"{path}: {name}")
    return unit_s, list(notes)


def open_long(path: Path, names: list[str], layout: Layout, request: SourceRequest) -> FrameSource:
    """Open a file with a sample a line; `names` are the meanings of its columns, by `named_columns`."""
    column, named_mm = _range_column(path, names)
    if request.unit_mm is not None and named_mm is not None and request.unit_mm != named_mm:
        raise BadInputError(
            f"{path}: the column is {names[column]}, but --units or --scale says {request.unit_mm:g} mm a unit; leave"
            f" the option out, or rename the column to {names[column].rpartition('_')[0]}"
        )
    time = next((name for name in names if name in TIME_NAMES), None)
    place = ("zone",) if "zone" in names and not set(_PLACE) & set(names) else _PLACE
    needed = [*(("frame",) if time is None else ()), *place]
    if lacking := [name for name in needed if name not in names]:
        raise BadInputError(
            f"{path}: its header names no {', '.join(lacking)}; it names: {', '.join(names)};"
            f" {_remedy(names, lacking[0], layout)}"
        )
    if place == ("zone",) and request.shape is None:
        raise BadInputError(f"{path}: a column zone without row and col: give their image: --shape ROWSxCOLS")
    status, codes, notes = _status(path, names, request)
    wanted = {name: names.index(name) for name in ("frame", *place, "target", "amplitude") if name in names}
    wanted |= {"range": column} | ({} if time is None else {"time": names.index(time)})
    wanted |= {} if status is None else {"status": status}
    notes += _not_used(path, names, wanted, layout)
    _refuse_dates(path, wanted, layout)
    samples = _Samples(_Table(path, wanted, layout, request.shape), request.shape)
    unit_s, said = (1.0, []) if time is None else time_unit_of(time, samples.first_times(), request, path)
    return samples.source(named_mm, unit_s, codes, (*layout.notes, *notes, *said))


def _remedy(names: list[str], lacking: str, layout: Layout) -> str:
    """Option that names a column; where frames have no number, a column of dates tells them."""
    dates = [name for name, cell in zip(names, _first_below(layout), strict=False) if layout.is_moment(cell)]
    if lacking == "frame" and dates:
        return f"--columns {dates[0]}=time has the frames told by their times"
    or_time = ", or THEIRS=time," if lacking == "frame" else ""
    return f"--columns THEIRS={lacking}{or_time} says which column it is"


def _first_below(layout: Layout) -> list[str]:
    return layout.below[0] if layout.below else []


def _refuse_dates(path: Path, wanted: dict[str, int], layout: Layout) -> None:
    """Refuse dates where whole or real numbers are expected."""
    cells = _first_below(layout)
    for name, column in wanted.items():
        if name != "time" and column < len(cells) and layout.is_moment(cells[column]):
            theirs = layout.head[column]
            raise BadInputError(
                f"{path}: {theirs}: {cells[column]} is a time, no {name}; --columns {theirs.lower()}=time says so"
            )


def _range_column(path: Path, names: list[str]) -> tuple[int, float | None]:
    """Column of the ranges, and mm of their unit if the header names it, as in ``range_mm``."""
    for k, name in enumerate(names):
        if _is_range(name):
            return k, UNITS_MM.get(name.rpartition("_")[2])
    raise BadInputError(
        f"{path}: its header names no range; it names: {', '.join(names)}; --columns THEIRS=range says which it is"
    )


def _status(path: Path, names: list[str], request: SourceRequest) -> tuple[int | None, tuple[int, ...], list[str]]:
    """Column of the status codes, the valid ones, and a note on a column of codes that is not used."""
    for k, name in enumerate(names):
        if not name.startswith(_OTHER) and (codes := codes_of(name, request)):
            return k, codes, []
    if request.valid_status is not None:
        raise BadInputError(
            f"{path}: --valid-status: no column {request.valid_status[0]!r}; its header names: {', '.join(names)}"
        )
    left = [name for name in names if is_status_name(name) and not name.startswith(_OTHER)]
    remedy = f"--valid-status {left[0]}=5,9 says which codes are valid" if left else ""
    return None, (), [unused(path, "column", left, remedy)] if left else []


def _not_used(path: Path, names: list[str], wanted: dict[str, int], layout: Layout) -> list[str]:
    """Note on columns of numbers that are not used; remarks in words may stand beside them."""
    first = _first_cells(path, layout)
    left = [
        name.removeprefix(_OTHER)
        for k, name in enumerate(names)
        if k not in wanted.values()
        and (
            name.startswith(_OTHER)
            or (
                not is_status_name(name)
                and name not in INDEX_NAMES
                and (len(first) <= k or _is_number(first[k], layout))
            )
        )
    ]
    return [unused(path, "column", left)] if left else []


def _first_cells(path: Path, layout: Layout) -> list[str]:
    """Cells of the first sample."""
    with foreign(path), layout.open(path) as file:
        lines = (line for line in file if line.strip())
        next(lines, None)
        first = next((line for line in lines if not line.lstrip().startswith("#")), "")
        return layout.cells(first.strip(" \r\n"))


def _is_number(cell: str, layout: Layout) -> bool:
    """Whether a cell holds a number or a date, or nothing."""
    try:
        layout.moment(cell)
    except ValueError:
        return False
    return True


Piece = dict[str, "np.ndarray[Any, Any]"]
"""Columns of some lines: `frame`, `row`, `col`, `target` (line,) whole numbers; the others float64."""


def _taken(piece: Piece, lines: IntArray | slice) -> Piece:
    return {name: values[lines] for name, values in piece.items()}


def _joined(pieces: list[Piece]) -> Piece:
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


class _Table:
    """The lines of a file, in pieces."""

    def __init__(self, path: Path, columns: dict[str, int], layout: Layout, image: tuple[int, int] | None) -> None:
        self.path, self._columns, self._layout, self._image = path, columns, layout, image

    @property
    def names(self) -> list[str]:
        """The columns that are read."""
        return list(self._columns)

    def pieces(self) -> Iterator[Piece]:
        """Read the file once."""
        converters: dict[int | str, Callable[[str], float]] = {
            column: self._layout.moment if name == "time" else self._layout.number
            for name, column in self._columns.items()
        }
        with foreign(self.path):
            file = self._layout.open(self.path)
        with file:
            lines = (line for line in file if line.strip())
            with foreign(self.path):
                next(lines, None)  # the header, which may begin with #
            samples = (line for line in lines if not line.lstrip().startswith("#"))
            before, last = 0, _LastTime()
            while True:
                with foreign(self.path):
                    text = list(islice(samples, PIECE_LINES))
                if not text:
                    return
                with foreign(f"{self.path}: after {before} samples" if before else self.path):
                    found = np.loadtxt(
                        text,
                        delimiter=self._layout.delimiter,
                        usecols=list(self._columns.values()),
                        converters=converters,
                        ndmin=2,
                        comments="#",
                        quotechar='"',
                    )
                before += len(found)
                yield self._piece(dict(zip(self._columns, np.asarray(found, dtype=np.float64).T, strict=True)), last)

    def _piece(self, held: dict[str, FloatArray], last: "_LastTime") -> Piece:
        frame = self._index("frame", held["frame"], None) if "frame" in held else last.frames(held["time"])
        if "zone" in held and self._image is not None:
            zone = self._index("zone", held["zone"], MOST_PIXELS_A_SIDE**2)
            row, col = zone // self._image[1], zone % self._image[1]
        else:
            row, col = (self._index(name, held[name], MOST_PIXELS_A_SIDE) for name in _PLACE)
        target = self._index("target", held["target"], MOST_TARGETS) if "target" in held else np.zeros_like(row)
        values = {name: held[name] for name in held if name not in _WHOLE}
        return {"frame": frame, "row": row, "col": col, "target": target, **values}

    def _index(self, name: str, values: FloatArray, most: int | None) -> IntArray:
        bad = ~(np.isfinite(values) & (values == np.floor(values)) & (values >= 0) & (values < 2**53))
        if bad.any():
            raise BadInputError(f"{self.path}: {name}: {values[np.argmax(bad)]:g} is not a whole number of at least 0")
        if most is not None and values.max() > most:
            raise BadInputError(f"{self.path}: {name}: {values.max():g}; no more than {most}")
        return values.astype(np.int64)


class _LastTime:
    """Numbers frames where only their times are known: a new time is a new frame."""

    def __init__(self) -> None:
        self._time, self._frame = math.nan, -1

    def frames(self, time: FloatArray) -> IntArray:
        """Numbers of the frames of these lines (line,) int64; a missing time belongs to the frame before."""
        new = np.diff(time, prepend=self._time) != 0
        new &= ~np.isnan(time)
        numbers = np.maximum(self._frame + np.cumsum(new), 0)
        self._time, self._frame = float(time[-1]), int(numbers[-1])
        return np.asarray(numbers, dtype=np.int64)


class _Ends(NamedTuple):
    """Number of frames; the least and the largest `frame`, `row`, `col` and `target`."""

    frames: int
    least: dict[str, int]
    most: dict[str, int]


def _ends(pieces: Iterable[Piece]) -> _Ends | None:
    """Read the pieces once; None if a frame comes after a later one, or there is no line."""
    found: _Ends | None = None
    for piece in pieces:
        if (np.diff(piece["frame"]) < 0).any():
            return None
        frames = len(np.unique(piece["frame"]))
        least, most = ({name: int(end(piece[name])) for name in _INDICES} for end in (np.min, np.max))
        if found is not None:
            if least["frame"] < found.most["frame"]:
                return None
            # A frame whose lines lie in both pieces counts once.
            frames += found.frames - int(least["frame"] == found.most["frame"])
            least = {name: min(value, found.least[name]) for name, value in least.items()}
            most = {name: max(value, found.most[name]) for name, value in most.items()}
        found = _Ends(frames, least, most)
    return found


class _Samples:
    """Samples of a file with a sample a line, frame by frame."""

    def __init__(self, table: _Table, shape: tuple[int, int] | None) -> None:
        self._table, self._path, self.restarted = table, table.path, ""
        self._time_unit_s = 1.0
        self._new_starts: frozenset[int] = frozenset()
        self._pieces: Callable[[], Iterable[Piece]] = table.pieces
        ends = _ends(table.pieces())
        if ends is None:
            whole = self._sorted()
            self._pieces = lambda: [whole]
            ends = _ends([whole])
        if ends is None:
            raise BadInputError(f"{self._path}: no sample below its header")
        self.notes: list[str] = []
        rows, cols = ends.most["row"], ends.most["col"]
        counts_from_1 = min(ends.least["row"], ends.least["col"]) >= 1
        self._first = int(counts_from_1 and (shape is None or rows >= shape[0] or cols >= shape[1]))
        if self._first:
            self.notes.append(f"{self._path}: rows and columns are taken to start at 1, because none is 0")
        self._pixels = shape or (rows - self._first + 1, cols - self._first + 1)
        if rows - self._first >= self._pixels[0] or cols - self._first >= self._pixels[1]:
            raise BadInputError(
                f"{self._path}: row {rows - self._first}, column {cols - self._first} are outside of --shape"
                f" {self._pixels[0]}x{self._pixels[1]}"
            )
        self._first_target = int(ends.least["target"] >= 1)
        self._targets = ends.most["target"] - self._first_target + 1 if "target" in table.names else 0
        if ends.frames > MOST_FRAMES:
            raise BadInputError(f"{self._path}: {ends.frames} frames; no more than {MOST_FRAMES}")
        if missing := ends.most["frame"] - ends.least["frame"] + 1 - ends.frames:
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
        whole = self._counted_on(_joined(pieces))
        return _taken(whole, np.argsort(whole["frame"], kind="stable"))

    def _counted_on(self, whole: Piece) -> Piece:
        """Lines whose frames count on where the counter starts again, which shows by samples that occur twice."""
        keys = np.stack([whole[name] for name in _INDICES])
        if np.unique(keys, axis=1).shape[1] == keys.shape[1]:
            return whole
        starts = np.flatnonzero(np.diff(whole["frame"]) < 0) + 1
        run = np.zeros(whole["frame"].size, dtype=np.int64)
        run[starts] = 1
        run = np.cumsum(run)
        if np.unique(np.vstack([run, keys]), axis=1).shape[1] < keys.shape[1]:
            return whole  # twins within a run are refused with their place
        ends = np.maximum.reduceat(whole["frame"], np.r_[0, starts]) + 1
        first = np.r_[0, np.cumsum(ends)[:-1]]
        times = "once" if starts.size == 1 else f"{starts.size} times"
        self.restarted = f"{self._path}: its frame counter starts again {times}; the frames are counted on"
        frame = whole["frame"] + first[run]
        self._new_starts = frozenset(np.minimum.reduceat(frame, starts).tolist())
        return whole | {"frame": frame}

    def first_times(self, *, frames: int = 20) -> list[float]:
        """Times of the first frames, in the file's unit."""
        with foreign(self._path):
            piece = next(iter(self._pieces()))
        _, first = np.unique(piece["frame"], return_index=True)
        return [float(time) for time in piece["time"][np.sort(first)[:frames]]]

    def source(
        self, unit_mm: float | None, time_unit_s: float, status_valid: tuple[int, ...], notes: tuple[str, ...]
    ) -> FrameSource:
        """The file as a source."""
        self._time_unit_s = time_unit_s
        return FrameSource(
            kind="CSV, one sample a line",
            shape=(self._frames, *self._pixels),
            targets=self._targets,
            dtype=_FLOAT,
            frames=self._images(),
            unit_mm=unit_mm,
            has_amplitude="amplitude" in self._table.names,
            has_time="time" in self._table.names,
            status_valid=status_valid,
            notes=(*notes, *self.notes, *((self.restarted,) if self.restarted else ())),
        )

    def _images(self) -> Iterator[Frame]:
        """Frames in order; the lines of a frame may lie in several pieces."""
        waiting: list[Piece] = []
        for piece in self._pieces():
            starts = np.flatnonzero(np.diff(piece["frame"])) + 1
            for first, stop in zip([0, *starts], [*starts, len(piece["frame"])], strict=True):
                if waiting and waiting[0]["frame"][0] != piece["frame"][first]:
                    yield self._frame(_joined(waiting))
                    waiting = []
                waiting.append(_taken(piece, slice(first, stop)))
        if waiting:
            yield self._frame(_joined(waiting))

    def _frame(self, lines: Piece) -> Frame:
        where = lines["target"] - self._first_target, lines["row"] - self._first, lines["col"] - self._first
        place = np.ravel_multi_index(where, (max(1, self._targets), *self._pixels))
        self._refuse_twins(lines, place)
        time_s = float(lines["time"][0]) * self._time_unit_s if "time" in lines else None
        status = self._image(place, lines["status"]) if "status" in lines else None
        amplitude = self._image(place, lines["amplitude"]) if "amplitude" in lines else None
        return Frame(
            depth=self._image(place, lines["range"]),
            amplitude=amplitude,
            time_s=time_s,
            status=status,
            new_start=int(lines["frame"][0]) in self._new_starts,
        )

    def _refuse_twins(self, lines: Piece, place: IntArray) -> None:
        _, first, count = np.unique(place, return_index=True, return_counts=True)
        if (count > 1).any():
            k = int(first[np.argmax(count > 1)])
            row, col = int(lines["row"][k]) - self._first, int(lines["col"][k]) - self._first
            of = f", target {int(lines['target'][k]) - self._first_target}" if self._targets else ""
            remedy = "" if self._targets else "; several targets of a pixel need a column target"
            raise BadInputError(
                f"{self._path}: frame {int(lines['frame'][k])} has two samples of row {row}, column {col}{of}{remedy}"
            )

    def _image(self, place: IntArray, values: FloatArray) -> FloatArray:
        image = np.full(max(1, self._targets) * math.prod(self._pixels), np.nan)
        image[place] = values
        return image.reshape((self._targets, *self._pixels) if self._targets else self._pixels)
