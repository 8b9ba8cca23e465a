"""The one kind of picture of a page, in both themes, with its words.

It is a figure with axes of its own (`figure_picture`), or an image of the pixels, around which the page draws axes,
colour bar and legend: of ranges, of signed differences, or of a few kinds of pixels.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np
from matplotlib.figure import Figure

from tofmix.arrays import BoolArray, ByteArray, FloatArray
from tofmix.report.figures.rasters import (
    CLIPPED_PERCENT,
    Plane,
    bar_labels,
    difference_shades,
    difference_uri,
    kinds_uri,
    range_uri,
)
from tofmix.report.theme import DARK, LIGHT, Theme, drawn
from tofmix.wording import number

NO_DATA, NO_SURFACE = "var(--hatching)", "var(--no-surface)"
"""Colours of the page's style, which has them in both themes: hatching, and a pixel without a surface."""

Legend = tuple[tuple[str, str], ...]
"""CSS colour and label of each entry."""


class Words(TypedDict, total=False):
    """Texts of a picture; see `Picture`."""

    title: str
    alt: str
    shows: str
    good: str
    bad: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture of a page."""

    title: str
    alt: str  # its content in numbers, for readers who do not see it
    light: str  # ``data:`` URI
    dark: str  # the same as `light` where no colour depends on the theme
    # What it shows, what is good in it, what is bad; a line each.
    shows: str = ""
    good: str = ""
    bad: str = ""
    # Of a figure: width and height in CSS pixels.
    width: int = 0
    height: int = 0
    # Of an image: its rows and columns, labels of the colour bar, their unit, colours other than those of ranges.
    plane: Plane | None = None
    bar: tuple[str, ...] = ()
    unit: str = "mm"
    shades: tuple[str, ...] = ()
    legend: Legend = ()


def figure_picture(draw: Callable[[Theme], Figure], **words: Unpack[Words]) -> Picture:
    """Draw a figure in both themes; `words` are the texts of `Picture`."""
    light, dark, (width, height) = drawn(draw, "svg")
    return Picture(light=light, dark=dark, width=width, height=height, **words)


def range_picture(
    range_mm: FloatArray,
    *,
    scale: tuple[float, float],
    bar: tuple[str, ...] | None = None,
    unit: str = "mm",
    legend: Legend = (),
    marked: BoolArray | None = None,
    image: tuple[int, int] | None = None,
    **words: Unpack[Words],
) -> Picture:
    """Picture of ranges, or of other values that are not signed.

    Parameters
    ----------
    range_mm : (row, col) float
        Ranges in mm, or values in another unit; NaN: hatched.
    scale : (float, float)
        Limits of the colours.
    bar, unit : tuple of str, str
        Labels of the colour bar, by default in mm; their unit.
    legend : tuple
        CSS colours and labels.
    marked : (row, col) bool, optional
        Places of another colour.
    image : (int, int), optional
        Rows and columns of the image, where `range_mm` has parts of pixels.
    **words
        Texts of `Picture`.
    """
    uri = range_uri(range_mm, scale=scale, marked=marked)
    plane = Plane(*(image or range_mm.shape))
    labels = bar_labels(scale) if bar is None else bar
    return Picture(light=uri, dark=uri, plane=plane, bar=labels, unit=unit, legend=legend, **words)


def difference_picture(values: FloatArray, *, most: float, unit: str, no_data: str, **words: Unpack[Words]) -> Picture:
    """Picture of signed values (row, col), zero in the middle of the colours.

    Parameters
    ----------
    values : (row, col) float
        NaN: hatched.
    most : float
        Value at which the colours end.
    unit : str
        Unit of the labels of the colour bar.
    no_data : str
        Meaning of a hatched pixel, for the legend.
    **words
        Texts of `Picture`.
    """
    uri, digits = difference_uri(values, most=most), max(0, 1 - math.floor(math.log10(most)))
    bar = [number(value, f".{digits}f") for value in np.linspace(-most, most, 5)]
    bar[0] = f"≤ {bar[0]}" if (values < -most).any() else bar[0]
    bar[-1] = f"≥ {bar[-1]}" if (values > most).any() else bar[-1]
    return Picture(
        light=uri,
        dark=uri,
        plane=Plane(*values.shape),
        bar=tuple(bar),
        unit=unit,
        shades=tuple(difference_shades()[::21]),
        legend=() if np.isfinite(values).all() else ((NO_DATA, no_data),),
        **words,
    )


def most_of(values: FloatArray, *, least: float) -> float:
    """Size that nearly all finite values have at most, but `least` at least: for the ends of the colours."""
    finite = np.abs(values[np.isfinite(values)])
    return max(least, float(np.percentile(finite, CLIPPED_PERCENT[1])) if finite.size else 0.0)


def kinds_picture(
    kinds: ByteArray,
    *,
    names: Sequence[str],
    colours: Sequence[str],
    no_data: str = "",
    image: tuple[int, int] | None = None,
    legend: Legend | None = None,
    **words: Unpack[Words],
) -> Picture:
    """Picture of a few kinds of pixels, each in its colour.

    Parameters
    ----------
    kinds : (row, col) uint8
        Index into `names` and `colours`; hatched past the last.
    names : sequence of str
        For the legend, which has those that occur.
    colours : sequence of str
        ``#rrggbb``, or a variable of the page's style: `NO_SURFACE`, ``var(--no-data)``, ``var(--accent)``,
        ``var(--layer-1)`` to 3.
    no_data : str
        Meaning of a hatched pixel, for the legend.
    image : (int, int), optional
        Rows and columns of the image, where `kinds` has parts of pixels.
    legend : tuple, optional
        Another legend.
    **words
        Texts of `Picture`.
    """
    light, dark = (kinds_uri(kinds, [_resolved(colour, theme) for colour in colours]) for theme in (LIGHT, DARK))
    if legend is None:
        present = [(colours[k], names[k]) for k in range(len(names)) if (kinds == k).any()]
        legend = (*present, *(((NO_DATA, no_data),) if (kinds >= len(colours)).any() else ()))
    return Picture(light=light, dark=dark, plane=Plane(*(image or kinds.shape)), legend=legend, **words)


def _resolved(colour: str, theme: Theme) -> str:
    """The colour of a theme behind a variable of the page's style."""
    of_theme = {
        NO_SURFACE: theme.no_surface,
        "var(--no-data)": theme.no_data,
        "var(--accent)": theme.accent,
        **{f"var(--layer-{number})": shade for number, shade in enumerate(theme.layers, 1)},
    }
    return of_theme.get(colour, colour)
