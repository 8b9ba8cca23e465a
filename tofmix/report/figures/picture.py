"""One picture of a page, in both themes, with its text."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from tofmix.report.theme import Format, Theme, drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """One picture in both themes, as ``data:`` URIs, and its words.

    title; alt, its content in numbers for readers who do not see it; shows, good and bad, a line each; width and height
    in CSS pixels.
    """

    title: str
    light: str
    dark: str
    alt: str
    shows: str
    good: str
    bad: str
    width: int
    height: int


def make_picture(draw: Callable[[Theme], Figure], kind: Format, **words: str) -> Picture:
    """Draw a picture in both themes; `words` are the texts of `Picture`."""
    light, dark, (width, height) = drawn(draw, kind)
    return Picture(light=light, dark=dark, width=width, height=height, **words)
