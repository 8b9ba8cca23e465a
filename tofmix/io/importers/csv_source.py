"""CSV: a frame a line (wide), or a sample a line (long); the header decides.

Wide: `--shape ROWSxCOLS` gives the image of a line, row by row. A header is skipped, except for a column of times and
a column `frame`. Read line by line. Long: see `csv_long`. An empty cell and nan are invalid samples. So are samples
that a long file leaves out.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tofmix.errors import BadInputError
from tofmix.io.importers.base import Frame, FrameSource, SourceRequest, foreign
from tofmix.io.importers.csv_long import INDEX_NAMES, TIME_NAMES, named_columns, open_long, time_unit_of
from tofmix.io.importers.csv_text import Layout, layout_of
from tofmix.io.recording.range_check import unit_mm_of
from tofmix.wording import counted

SUFFIXES = (".csv", ".tsv", ".txt")

_ALSO = {"column": "col", "distance": "range", "zone_id": "zone", "pixel": "zone"}
_UNIT_BESIDE = re.compile(r"(.+?)[ _]*[\[(]\s*(\w+)\s*[\])]")
_FLOAT = np.dtype(np.float64)


@contextmanager
def open_csv(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a text file of numbers."""
    layout = layout_of(path)
    if not layout.head:
        raise BadInputError(f"{path}: empty")
    request = _as_in_header(request)
    names = named_columns([_name(cell) for cell in layout.head], request, path) if layout.has_header else None
    if names is not None and {"row", "col", "zone"} & set(names):
        yield open_long(path, names, layout, request)
    elif request.columns:
        raise BadInputError(f"{path}: --columns is for a table with a sample a line, whose header names its columns")
    elif request.shape is None:
        raise BadInputError(
            f"{path}: if a line is a frame, give --shape ROWSxCOLS; if it is a sample, a header must name"
            " frame,row,col,range, or --columns y=row,x=col,depth=range must say which columns these are"
        )
    else:
        yield _wide(path, names, layout, request.shape, request)


def _as_in_header(request: SourceRequest) -> SourceRequest:
    """The request with its names of columns as `_name` has them; a column of codes by its meaning, if it has one."""
    columns = {_name(theirs): ours for theirs, ours in request.columns.items()}
    status = request.valid_status
    if status is not None:
        name = _name(status[0])
        status = columns.get(name, name), status[1]
    return replace(request, columns=columns, valid_status=status)


def _name(cell: str) -> str:
    """Our name of a column; a unit in brackets follows it, as in ``range_mm``."""
    name = cell.strip().lower()
    beside = _UNIT_BESIDE.fullmatch(name)
    stem, unit = (beside[1], f"_{beside[2]}") if beside else (name, "")
    return _ALSO.get(stem, stem) + unit


def _lines(path: Path, layout: Layout) -> Iterator[tuple[int, str]]:
    """Lines with numbers, and their line numbers from 1."""
    skip = layout.has_header
    with layout.open(path) as file:
        for number, line in enumerate(file, 1):
            text = line.strip(" \r\n") if layout.delimiter == "\t" else line.strip()
            if not text.strip() or (text.startswith("#") and not skip):
                continue
            if skip:
                skip = False
                continue
            yield number, text


def _wide(
    path: Path, names: list[str] | None, layout: Layout, shape: tuple[int, int], request: SourceRequest
) -> FrameSource:
    names, width, notes = names or [], len(layout.head), list(layout.notes)
    labels = [k for k, name in enumerate(names) if name == "frame" or name in TIME_NAMES]
    labels += [k for k, name in enumerate(names[:1]) if name in INDEX_NAMES]
    time_at = next((k for k, name in enumerate(names) if name in TIME_NAMES), None)
    pixels = shape[0] * shape[1]
    if width == pixels + 1 and not labels and _first_counts(path, layout):
        labels = [0]
        notes.append(f"{path}: its first column, which counts the lines, is taken as an index")
    if width - len(labels) != pixels:
        raise BadInputError(
            f"{path}: {counted(width - len(labels), 'value')} in the first line,"
            f" --shape {shape[0]}x{shape[1]} has {pixels}"
        )
    with foreign(path):
        frames = sum(1 for _ in _lines(path, layout))
    if not frames:
        raise BadInputError(f"{path}: no frame below its header")
    keep = [k for k in range(width) if k not in labels]
    unit_mm = _unit_of_header(path, layout.head, keep, request) if layout.has_header else None
    unit_s = 1.0
    if time_at is not None:
        unit_s, said = time_unit_of(names[time_at], _first_times(path, layout, time_at), request, path)
        notes += said

    def images() -> Iterator[Frame]:
        lines = _lines(path, layout)
        while True:
            with foreign(path):
                number, text = next(lines, (0, ""))
            if not number:
                return
            with foreign(f"{path}: line {number}"):
                cells = layout.cells(text)
                if len(cells) != width:
                    raise BadInputError(
                        f"{path}: line {number}: {counted(len(cells), 'value')}, the first line has {width}"
                    )
                values = np.array([layout.number(cells[k]) for k in keep])
                time_s = None if time_at is None else layout.moment(cells[time_at]) * unit_s
            yield Frame(depth=values.reshape(shape), time_s=time_s)

    return FrameSource(
        kind="CSV, one frame a line",
        shape=(frames, *shape),
        dtype=_FLOAT,
        frames=images(),
        unit_mm=unit_mm,
        has_time=time_at is not None,
        stream="",
        notes=tuple(notes),
    )


def _unit_of_header(path: Path, head: list[str], keep: list[int], request: SourceRequest) -> float | None:
    """Length of the unit that the names of all pixels state, mm, as in ``range_cm_0`` or ``z0 [cm]``."""
    units = {_unit_in_name(head[k]) for k in keep}
    if len(units) > 1 and request.unit_mm is None:
        raise BadInputError(f"{path}: its header names different units of its columns; give --units or --scale")
    return units.pop() if len(units) == 1 else None


def _unit_in_name(name: str) -> float | None:
    """Unit at the end of a name, before the number of the pixel."""
    words = [word for word in re.split(r"[\W_]+", name.strip()) if word and not word.isdecimal()]
    return unit_mm_of(words[-1].lower()) if len(words) > 1 else None


def _first_cells(path: Path, layout: Layout, column: int, count: int) -> list[str]:
    with foreign(path):
        lines = _lines(path, layout)
        texts = [text for _, (_, text) in zip(range(count), lines, strict=False)]
        return [layout.cells(text)[column] for text in texts if len(layout.cells(text)) > column]


def _first_counts(path: Path, layout: Layout, *, count: int = 3) -> bool:
    """Whether the first column counts the lines from 0 or 1."""
    with foreign(path):
        first = [layout.number(cell) for cell in _first_cells(path, layout, 0, count)]
    return len(first) > 1 and first[0] in (0.0, 1.0) and all(b - a == 1.0 for a, b in pairwise(first))


def _first_times(path: Path, layout: Layout, column: int, *, count: int = 20) -> list[float]:
    with foreign(path):
        return [layout.moment(cell) for cell in _first_cells(path, layout, column, count)]
