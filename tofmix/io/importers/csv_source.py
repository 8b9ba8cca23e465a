"""CSV: a frame a line (wide), or a sample a line (long); the header decides.

Wide: `--shape ROWSxCOLS` gives the image of a line, row by row. A header is skipped, except for a column `time` (s) and
a column `frame`. Read line by line. Long: see `csv_long`. An empty cell and nan are invalid samples. So are samples
that a long file leaves out.
"""

import csv
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tofmix.errors import BadInputError
from tofmix.io.importers.base import Frame, FrameSource, Request, foreign
from tofmix.io.importers.csv_long import open_long
from tofmix.wording import counted

SUFFIXES = (".csv", ".tsv", ".txt")

_ALSO = {"column": "col", "distance": "range"}
_FLOAT = np.dtype(np.float64)


@contextmanager
def open_csv(path: Path, request: Request) -> Iterator[FrameSource]:
    """Open a text file of numbers.

    Raises
    ------
    BadInputError
        If it has other content, lines differ in length, or its layout is not determined.
    """
    with foreign(path):
        head, delimiter = _head(path)
    if not head:
        raise BadInputError(f"{path}: empty")
    names = None if all(_is_number(cell) for cell in head) else [_name(cell) for cell in head]
    if names is not None and {"row", "col"} & set(names):
        yield open_long(path, names, delimiter, request.shape, unit_mm=request.unit_mm)
    elif request.shape is None:
        raise BadInputError(
            f"{path}: if a line is a frame, give --shape ROWSxCOLS; if it is a sample, a header must name"
            " frame,row,col,range"
        )
    else:
        yield _wide(path, names, delimiter, len(head), request.shape)


def _head(path: Path) -> tuple[list[str], str | None]:
    """Cells of the first line that has any, and their separator: None for blanks."""
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
    """Lines with numbers, and their line numbers from 1; `skip` the first one."""
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
    labels = [k for k, name in enumerate(names) if name in ("frame", "time")]
    time_at = names.index("time") if "time" in names else None
    pixels = shape[0] * shape[1]
    if width - len(labels) != pixels:
        raise BadInputError(
            f"{path}: {counted(width - len(labels), 'value')} in the first line,"
            f" --shape {shape[0]}x{shape[1]} has {pixels}"
        )
    with foreign(path):
        frames = sum(1 for _ in _lines(path, skip=bool(names)))
    if not frames:
        raise BadInputError(f"{path}: no frame below its header")
    keep = [k for k in range(width) if k not in labels]

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
                    raise BadInputError(
                        f"{path}: line {number}: {counted(len(cells), 'value')}, the first line has {width}"
                    )
                values = np.array([_value(cells[k]) for k in keep])
                time_s = None if time_at is None else float(cells[time_at])
            yield Frame(depth=values.reshape(shape), time_s=time_s)

    return FrameSource(
        kind="CSV, one frame a line",
        shape=(frames, *shape),
        dtype=_FLOAT,
        frames=images(),
        has_time=time_at is not None,
    )
