"""How a text file of numbers is written: its encoding, its separators, its decimal mark, and its first line.

Each guess is a note.
"""

import csv
import datetime as dt
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO

from tofmix.io.importers.base import foreign

_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_NUMBER_WITH_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)
_MARKS = (";", "\t", ",")


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout of a file.

    Parameters
    ----------
    encoding : str
        Its encoding.
    delimiter : str or None
        Separator of cells; None for blanks.
    decimal_comma : bool
        Whether numbers have a comma for a point.
    head : list of str
        Cells of the first line that has any; empty where there is none.
    has_header : bool
        Whether this line is a header.
    notes : tuple of str
        The guesses.
    """

    encoding: str
    delimiter: str | None
    decimal_comma: bool
    head: list[str]
    has_header: bool
    notes: tuple[str, ...]

    def open(self, path: Path) -> IO[str]:
        """Open the file as text."""
        return path.open(encoding=self.encoding, newline="")

    def cells(self, line: str) -> list[str]:
        """Cells of a line."""
        return _cells(line, self.delimiter)

    def number(self, cell: str) -> float:
        """Number of a cell; NaN of an empty one."""
        text = cell.strip()
        return float(text.replace(",", ".") if self.decimal_comma else text) if text else math.nan

    def moment(self, cell: str) -> float:
        """Number of a cell of times, s since 1970 of a date; NaN of an empty one."""
        try:
            return self.number(cell)
        except ValueError:
            moment = dt.datetime.fromisoformat(cell.strip())
        return (moment if moment.tzinfo else moment.replace(tzinfo=dt.UTC)).timestamp()


def layout_of(path: Path) -> Layout:
    """Look at the first two lines of a file.

    Raises
    ------
    BadInputError
        If it cannot be read.
    """
    notes = []
    with foreign(path), path.open("rb") as raw:
        encoding = "utf-16" if raw.read(2) in _UTF_16 else "utf-8-sig"
    if encoding == "utf-16":
        notes.append(f"{path}: read as UTF-16")
    with foreign(path), path.open(encoding=encoding, newline="") as file:
        first, second = (next(lines, "") for lines in [_filled(file)] * 2)
    delimiter = _delimiter(second) or _delimiter(first)
    with foreign(path):
        decimal_comma = _has_decimal_comma(second or first, delimiter)
        head = _cells(first, delimiter) if first else []
    if decimal_comma:
        notes.append(f"{path}: commas in its numbers are decimal commas")
    layout = Layout(
        encoding=encoding, delimiter=delimiter, decimal_comma=decimal_comma, head=head, has_header=False, notes=()
    )
    with foreign(path):
        numbers = _numbers(layout, head)
    counted = numbers is not None and _counts(numbers)
    if counted:
        notes.append(f"{path}: its first line, {head[0] or head[1]} to {head[-1]}, is taken as a header")
    return Layout(
        encoding=encoding, delimiter=delimiter, decimal_comma=decimal_comma, head=head,
        has_header=counted or (bool(head) and numbers is None), notes=tuple(notes),
    )  # fmt: skip


def _filled(lines: Iterator[str]) -> Iterator[str]:
    """Lines with a cell, without a leading #."""
    for line in lines:
        if text := line.strip().lstrip("#").strip():
            yield text


def _delimiter(line: str) -> str | None:
    mark = next((mark for mark in _MARKS if mark in line), None)
    by_blanks = mark == "," and all(_NUMBER_WITH_COMMA.fullmatch(cell) for cell in line.split()) and " " in line
    return None if by_blanks else mark


def _has_decimal_comma(line: str, delimiter: str | None) -> bool:
    return delimiter != "," and any(_NUMBER_WITH_COMMA.fullmatch(cell) for cell in _cells(line, delimiter))


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def _numbers(layout: Layout, cells: list[str]) -> list[float] | None:
    try:
        return [layout.number(cell) for cell in cells]
    except ValueError:
        return None


def _counts(numbers: list[float], *, least: int = 3) -> bool:
    """Whether a line is 0, 1, 2, ... or 1, 2, 3, ..., as a table without names has for a header.

    The first cell may be empty: that of an index.
    """
    counted = numbers[1:] if numbers and math.isnan(numbers[0]) else numbers
    return len(counted) >= least and counted[0] in (0.0, 1.0) and all(b - a == 1.0 for a, b in pairwise(counted))
