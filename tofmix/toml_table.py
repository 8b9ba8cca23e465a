"""Strict reading of TOML: every refusal names the file, the table, the key, the value and the remedy.

Use it for files that people write by hand: an unknown key is a typing error
until shown otherwise, and true is not 1. Bounds are not checked here; the
dataclasses that the values go to check their own.
"""

import difflib
import json
import math
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from tofmix.arrays import Float32Array
from tofmix.errors import BadInputError
from tofmix.wording import readable

MapReader = Callable[[str, tuple[int, int] | None], Float32Array]
"""Reads the map that a file names by a relative path, of an image (rows, cols) where that is known; ValueError, with
the reason, if it cannot."""

_TYPE_NAMES = {
    bool: "a boolean",
    int: "a whole number",
    float: "a number",
    str: "a string",
    list: "a list",
    dict: "a table",
}


MOST_CHARACTERS = 1_000_000
"""Characters of a TOML file: the parser holds the whole file."""


def nearest(name: str, known: Iterable[str]) -> str:
    """``; did you mean "x"?`` and the known names, to end a refusal of `name`."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    guess = f'; did you mean "{close[0]}"? known: ' if close else "; known: "
    return guess + ", ".join(names)


def _shown(value: object) -> str:
    """A value on one line, short enough for a message."""
    kind = _TYPE_NAMES.get(type(value), "a date or time")
    if isinstance(value, dict | list):
        return kind
    try:
        text = json.dumps(value, default=str)
    except ValueError:  # an integer of more digits than Python prints
        return kind
    return f"{kind}, {text if len(text) <= 60 else text[:57] + '...'}"  # noqa: PLR2004  one line of a terminal


def toml_string(text: str) -> str:
    """A text as a basic string of TOML, on one line."""
    return json.dumps(readable(text), ensure_ascii=False).replace("\x7f", "\\u007f")


@dataclass(frozen=True, slots=True)
class TomlTable:
    """One table of a TOML file and its position.

    Parameters
    ----------
    values : dict
        The table as `tomllib` returns it.
    source : str
        The file's name, for messages.
    path : str
        The table's place as a reader of the file finds it, such as ``[sensor.noise]``; empty for the root.
    """

    values: dict[str, object]
    source: str
    path: str = ""

    def error(self, message: str, key: str = "") -> BadInputError:
        """A refusal of this table or of one key in it, ready to raise."""
        return BadInputError(": ".join(part for part in (self.source, self.path, key, message) if part))

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """Raise BadInputError if the table has a key that is not `known`."""
        names = set(known)
        for key in self.values:
            if key not in names:
                raise self.error(f"{json.dumps(key)} is not a key here{nearest(key, names)}")

    def require(self, keys: Iterable[str]) -> None:
        """Raise BadInputError, naming all, if the table lacks some of the keys."""
        if missing := [key for key in keys if key not in self.values]:
            raise self.error("missing", ", ".join(missing))

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def _value(self, key: str) -> object:
        if key not in self.values:
            raise self.error("missing", key)
        return self.values[key]

    def text(self, key: str) -> str:
        """The string at `key`; BadInputError if it is missing or something else."""
        value = self._value(key)
        if not isinstance(value, str):
            raise self.error(f"expected a string, got {_shown(value)}", key)
        return value

    def boolean(self, key: str) -> bool:
        """The boolean at `key`; BadInputError if it is missing or something else."""
        value = self._value(key)
        if not isinstance(value, bool):
            raise self.error(f"expected true or false, got {_shown(value)}", key)
        return value

    def integer(self, key: str) -> int:
        """The whole number at `key`; BadInputError if it is missing or something else, 1.0 and true included."""
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(f"expected a whole number, got {_shown(value)}", key)
        return value

    def number(self, key: str) -> float:
        """The finite number at `key`; BadInputError if it is missing or something else."""
        return self._number(self._value(key), key)

    def _number(self, value: object, key: str, position: str = "") -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"expected a number{position}, got {_shown(value)}", key)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.error(f"expected a finite number{position}, got {number}", key)
        return number

    def numbers(self, key: str, length: int | None = None) -> tuple[float, ...]:
        """The list of finite numbers at `key`, of this length if one is given; else BadInputError."""
        value = self._value(key)
        expected = f"a list of {'' if length is None else f'{length} '}numbers"
        if not isinstance(value, list):
            raise self.error(f"expected {expected}, got {_shown(value)}", key)
        if length is not None and len(value) != length:
            raise self.error(f"expected {expected}, got {len(value)}", key)
        return tuple(self._number(item, key, f" at place {k}") for k, item in enumerate(value, 1))

    def number_lists(self, key: str) -> tuple[tuple[float, ...], ...]:
        """The list of lists of finite numbers at `key`; else BadInputError."""
        value = self._value(key)
        if not isinstance(value, list) or not all(isinstance(item, list) for item in value):
            raise self.error(f"expected a list of lists of numbers, got {_shown(value)}", key)
        return tuple(
            tuple(self._number(number, key, f" at place {j} of list {k}") for j, number in enumerate(item, 1))
            for k, item in enumerate(value, 1)
        )

    def texts(self, key: str) -> tuple[str, ...]:
        """The list of strings at `key`; BadInputError if it is missing or something else."""
        value = self._value(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.error(f"expected a list of strings, got {_shown(value)}", key)
        return tuple(value)

    def table(self, key: str) -> "TomlTable":
        """The table at `key`, empty if there is none; BadInputError if it is something else."""
        value = self.values.get(key, {})
        path = f"[{self.path.strip('[]')}.{key}]" if self.path else f"[{key}]"
        if not isinstance(value, dict):
            raise self.error(f"expected one table {path}, got {_shown(value)}", key)
        return TomlTable(value, self.source, path)

    def tables(self, key: str) -> "list[TomlTable]":
        """The tables [[key]] in file order, none if there are none; BadInputError if it is something else."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(f"expected tables [[{key}]], got {_shown(value)}", key)
        return [TomlTable(item, self.source, f"[[{key}]] {k}") for k, item in enumerate(value, 1)]


def parse_toml(text: str, *, source: str) -> TomlTable:
    """Parse a TOML file's text.

    Parameters
    ----------
    text : str
        The text.
    source : str
        The file's name, for messages.

    Raises
    ------
    BadInputError
        If it is not TOML, or longer than any that a person writes; the message has the line as `tomllib` gives it.
    """
    longest = max(map(len, text.split("\n")))
    most_in_a_line = 2000  # characters of a line: the parser's memory grows with the square of a dotted key's length
    if len(text) > MOST_CHARACTERS or longest > most_in_a_line:
        raise BadInputError(
            f"{source}: {len(text)} characters, {longest} in the longest line; no more than {MOST_CHARACTERS} and"
            f" {most_in_a_line} are read; break a long list over several lines"
        )
    try:
        return TomlTable(tomllib.loads(text), source)
    except RecursionError:
        raise BadInputError(f"{source}: not a TOML file: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, and what int() and datetime() refuse
        raise BadInputError(f"{source}: not a TOML file: {' '.join(str(error).split())}") from None
