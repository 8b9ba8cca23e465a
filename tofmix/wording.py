"""Numbers and cells in texts: a count with its noun, numbers that are never ``-0``, shares, cells of Markdown."""

import math
from typing import Any


def counted(count: int, noun: str, form: str = "") -> str:
    """A count and its noun, in the plural but for 1.

    Parameters
    ----------
    count : int
        How many.
    noun : str
        One of them; its plural ends in s.
    form : str
        Format of the count, such as ``,``.

    Returns
    -------
    str
        Such as ``1 frame`` or ``2 frames``.
    """
    return f"{count:{form}} {noun}{'' if count == 1 else 's'}"


def number(value: float | None, form: str = "", *, missing: str = "-") -> str:
    """Format a number; a number that rounds to zero has no sign.

    Parameters
    ----------
    value : float or None
        The number.
    form : str
        Format, such as ``.2f`` or ``+.3g``.
    missing : str
        Text of a number that is None.

    Returns
    -------
    str
        Such as ``0.00`` for -0.001 and ``.2f``.
    """
    if value is None:
        return missing
    text = f"{value:{form}}"
    if not math.isfinite(value) or any(digit in text for digit in "123456789"):
        return text
    return f"{0 * abs(value):{form.replace('+', '')}}" if form else text.replace("-", "")


def finite_or_none(value: object) -> Any:  # noqa: ANN401  a value of any type, for JSON
    """The value, or None for a float that is NaN or infinite, which JSON has not."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def rounded(value: float, digits: int = 6) -> float:
    """A number with so many significant digits; never -0."""
    return float(f"{value:.{digits}g}") + 0.0


def percent_of(count: int, total: int) -> str:
    """A count as a share of a total, such as ``12.5 %``; 0 of 0 is 0."""
    return f"{100 * count / max(1, total):.1f} %"


def readable(text: str) -> str:
    """The text with a replacement character for each byte of a file name that is no UTF-8.

    Python keeps such bytes as lone surrogates, which no file format of text takes.
    """
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def left_out_words(count: int) -> str:
    """Say that suspect layers were left out, for the end of a line; nothing if there were none."""
    return f"; {counted(count, 'suspect layer', ',')} left out (--suspect takes them)" if count else ""
