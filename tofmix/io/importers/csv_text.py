"""How a text file of numbers is written: its encoding, its separators, its decimal mark, and its first line.

Each guess is a note.
"""

import codecs
import csv
import datetime as dt
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import IO

from tofmix.io.importers.base import foreign
from tofmix.io.importers.conversion import set_of

_NUMBER = re.compile(r"[+-]?\d+(?:[.,]\d+)?(?:e[+-]?\d+)?", re.IGNORECASE)
_NUMBER_WITH_COMMA = re.compile(r"[+-]?\d*,\d+(?:e[+-]?\d+)?", re.IGNORECASE)
_MARKS = (";", "\t", ",")
_MISSING = {""} | set_of(
    "- -- --- ? * n/a #n/a na <na> #na nat null none nil missing invalid nan(ind) -nan(ind) 1.#qnan -1.#ind"
)
"""Words for a sample that is missing, lower case."""

_DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+|$)")
_YEAR_FIRST = re.compile(r"(\d{4})/(\d{1,2})/(\d{1,2})(?:[ T]+|$)")
_OF_DAY = re.compile(r"(?:(\d+) days? +)?(\d+):(\d\d):(\d\d(?:[.,]\d+)?)")


_PIECE_BYTES = 1 << 20
"""Bytes that are read together where the encoding is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout of a file."""

    encoding: str  # its encoding
    delimiter: str | None  # separator of cells; None for blanks
    decimal_comma: bool  # whether numbers have a comma for a point
    head: list[str]  # cells of the first line that has any; empty where there is none
    has_header: bool  # whether this line is a header
    below: tuple[list[str], ...]  # cells of some lines below it
    notes: tuple[str, ...]  # the guesses

    def open(self, path: Path) -> IO[str]:
        """Open the file as text."""
        return path.open(encoding=self.encoding, newline="")

    def cells(self, line: str) -> list[str]:
        """Cells of a line."""
        return _cells(line, self.delimiter)

    def number(self, cell: str) -> float:
        """Number of a cell; NaN of an empty one, and of a word for a missing sample such as ``N/A``."""
        text = cell.strip()
        if text.lower() in _MISSING:
            return math.nan
        return float(text.replace(",", ".") if self.decimal_comma else text)

    def moment(self, cell: str) -> float:
        """Number of a cell of times; s since 1970 of a date, s since midnight of a time of day."""
        try:
            return self.number(cell)
        except ValueError:
            return _moment_s(cell)

    def is_moment(self, cell: str) -> bool:
        """Whether a cell is a date or a time of day."""
        try:
            _moment_s(cell)
        except ValueError:
            return False
        return _number_of(self, cell) is None


def layout_of(path: Path) -> Layout:
    """Look at a file: at its bytes, at its first lines, and for commas within numbers."""
    with foreign(path):
        encoding, named = _encoding(path)
    notes = [f"{path}: read as {named}"] if named else []
    with foreign(path), path.open(encoding=encoding, newline="") as file:
        sample_lines = 20  # lines below the first that are looked at
        first, *others = [*islice(_filled(file), 1 + sample_lines)] or [""]
    second = others[0] if others else ""
    delimiter = _delimiter(second) or _delimiter(first)
    with foreign(path):
        decimal_comma = _has_decimal_comma(path, encoding, delimiter)
        head = _cells(first, delimiter) if first else []
        below = tuple(_cells(line, delimiter) for line in others)
    if decimal_comma:
        notes.append(f"{path}: commas in its numbers are decimal commas")
    layout = Layout(
        encoding=encoding,
        delimiter=delimiter,
        decimal_comma=decimal_comma,
        head=head,
        has_header=False,
        below=below,
        notes=(),
    )
    has_header, guessed = _is_header(layout)
    if guessed:
        notes.append(f"{path}: its first line, {head[0] or head[-1]} to {head[-1]}, is taken as a header")
    return replace(layout, has_header=has_header, notes=tuple(notes))


def _encoding(path: Path) -> tuple[str, str]:
    """Encoding of a file, and its name where it is not UTF-8."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as raw:
        begin = raw.read(_PIECE_BYTES)
        if begin[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
            return "utf-16", "UTF-16"
        # Digits and separators in UTF-16 have one byte 0 of two.
        for encoding, zeros, others in (("utf-16-le", begin[1::2], begin[::2]), ("utf-16-be", begin[::2], begin[1::2])):
            if zeros.count(0) > len(zeros) // 2 and not others.count(0):
                return encoding, "UTF-16"
        try:
            while begin:
                decoder.decode(begin)
                begin = raw.read(_PIECE_BYTES)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "cp1252", "Windows-1252, because it is no UTF-8"
    return "utf-8-sig", ""


def _is_header(layout: Layout) -> tuple[bool, bool]:
    """Whether the first line is a header, and whether this is a guess.

    A line of names is a header. A line that counts is one, too, perhaps with names at its begin. Any other line with
    more numbers than names is a frame, of which samples may be lost.
    """
    head = layout.head
    found = [_number_of(layout, cell) for cell in head]
    names = [k for k, cell in enumerate(head) if found[k] is None and not layout.is_moment(cell)]
    begin = next((k for k, number in enumerate(found) if number is not None and not math.isnan(number)), len(head))
    counts = [number for number in found[begin:] if number is not None]
    if begin + len(counts) == len(head) and _counts(counts) and _are_labels(layout, begin, head[begin:]):
        return True, True
    numbers = sum(number is not None and not math.isnan(number) for number in found)
    has_header = bool(names) and 2 * numbers <= len(head)
    return has_header, has_header and numbers > 0


def _moment_s(cell: str) -> float:
    """Seconds since 1970 of a date, since midnight of a time of day; `ValueError` of anything else."""
    text = cell.strip()
    if of_day := _OF_DAY.fullmatch(text):
        days, hours, minutes = (int(part or 0) for part in of_day.groups()[:3])
        return ((days * 24 + hours) * 60 + minutes) * 60 + float(of_day[4].replace(",", "."))
    if day_first := _DAY_FIRST.match(text):
        day, month, year = (int(part) for part in day_first.groups())
        text = f"{year:04}-{month:02}-{day:02} {text[day_first.end() :]}".strip()
    elif year_first := _YEAR_FIRST.match(text):
        year, month, day = (int(part) for part in year_first.groups())
        text = f"{year:04}-{month:02}-{day:02} {text[year_first.end() :]}".strip()
    try:
        moment = dt.datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"{cell.strip()!r} is no time: write dates as 2024-05-01 10:00:00.5") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=dt.UTC)).timestamp()


def _filled(lines: Iterator[str]) -> Iterator[str]:
    """Lines with a cell, without a leading #."""
    for line in lines:
        if text := line.strip().lstrip("#").strip():
            yield text


def _delimiter(line: str) -> str | None:
    mark = next((mark for mark in _MARKS if mark in line), None)
    blanks = line.split()
    by_blanks = mark == "," and len(blanks) > 1 and all(_NUMBER.fullmatch(cell) for cell in blanks)
    return None if by_blanks else mark


def _has_decimal_comma(path: Path, encoding: str, delimiter: str | None) -> bool:
    """Whether a comma within a cell is a decimal comma in any line: the first ones may hold whole numbers."""
    mark = '"' if delimiter == "," else ","
    with path.open(encoding=encoding, newline="") as file:
        lines = (line for line in _filled(file) if mark in line)
        return any(_NUMBER_WITH_COMMA.fullmatch(cell) for line in lines for cell in _cells(line, delimiter))


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def _number_of(layout: Layout, cell: str) -> float | None:
    try:
        return layout.number(cell)
    except ValueError:
        return None


def _counts(numbers: list[float]) -> bool:
    """Whether a line is 0, 1, 2, ... or 1, 2, 3, ..., as a table without names has for a header."""
    return bool(numbers) and numbers[0] in (0.0, 1.0) and all(b - a == 1.0 for a, b in pairwise(numbers))


def _are_labels(layout: Layout, begin: int, labels: list[str], *, sure: int = 3) -> bool:
    """Whether cells that count are labels; fewer than three might also be samples, which the lines below are like."""
    if len(labels) >= sure:
        return True
    cells = [cell for line in layout.below for cell in line[begin:]]
    numbers = [number for cell in cells if (number := _number_of(layout, cell)) is not None and not math.isnan(number)]
    # Numbers below a line of labels 0, 1 are larger than them by this, or have decimals, where labels have none.
    label_factor = 20.0
    most = max(1.0, float(layout.number(labels[-1]))) * label_factor
    larger = all(number >= most for number in numbers)
    with_decimals = not any(cell.isdecimal() for cell in cells) and all(label.isdecimal() for label in labels)
    return bool(numbers) and (larger or with_decimals)
