"""Numbers and cells in texts: a count with its noun, numbers that are never ``-0``, shares, cells of Markdown."""

import math


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


def number(value: float, form: str = "") -> str:
    """Format a number; a number that rounds to zero has no sign.

    Parameters
    ----------
    value : float
        The number.
    form : str
        Format, such as ``.2f`` or ``+.3g``.

    Returns
    -------
    str
        Such as ``0.00`` for -0.001 and ``.2f``.
    """
    text = f"{value:{form}}"
    if not math.isfinite(value) or any(digit in text for digit in "123456789"):
        return text
    return f"{0.0:{form.replace('+', '')}}" if form else text.replace("-", "")


def percent_of(count: int, total: int) -> str:
    """A count as a share of a total, such as ``12.5 %``; 0 of 0 is 0."""
    return f"{100 * count / max(1, total):.1f} %"


def table_cell(text: str) -> str:
    """A text as the cell of a Markdown table: one line, with bars escaped."""
    return " ".join(text.split()).replace("|", "\\|")


def readable(text: str) -> str:
    """The text with a replacement character for each byte of a file name that is no UTF-8.

    Python keeps such bytes as lone surrogates, which no file format of text takes.
    """
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def left_out_words(count: int) -> str:
    """Say that suspect layers were left out, for the end of a line; nothing if there were none."""
    return f"; {counted(count, 'suspect layer', ',')} left out (--suspect takes them)" if count else ""
