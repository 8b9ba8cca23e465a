"""The one kind of picture of a page, in both themes, with its words.

It is a figure with axes of its own (`figure_picture`), or an image of the pixels, around which the page draws axes,
colour bar, legend and hatching (``macros.html``): of ranges, of signed differences, or of a few kinds of pixels.

An image has one picture element a pixel: small, sharp at any size, and of one colour scale.
"""

import base64
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from tofmix.arrays import BoolArray, ByteArray, FloatArray
from tofmix.report.theme import COUNT_MAP, DARK, GAP_MAP, LIGHT, RANGE_MAP, Theme, drawn
from tofmix.wording import counted, number

MANY = 6
"""Counts of surfaces from here on share one colour."""

BELOW, ABOVE = "#000a1f", "#fff7b8"
"""Colours of ranges beyond the scale: darker and lighter than the ends of the colour map, so such values are
visible."""

_WIDTH_REM = 26.0
"""Width of an image in a card of the page, about, in the page's unit of text."""

MARK = "#d55e00"
"""Colour of marked places in an image of ranges."""

CLIPPED_PERCENT = (0.1, 99.9)
"""Percentiles of the values between which the colours run."""

_SHADES = 253  # colours of ranges; the other 3 of a byte mean no surface, below and above
_NO_DATA, _BELOW_INDEX, _ABOVE_INDEX = 0, 1, 2  # then the shades


@dataclass(frozen=True, slots=True)
class Plane:
    """Rows and columns of an image, and round numbers along them."""

    rows: int
    cols: int

    @property
    def col_ticks(self) -> list[tuple[float, int]]:
        """Place in per cent of the width, and column."""
        return pixel_ticks(self.cols, most=_room(34.0 * self.cols / self.rows, each=2.6))

    @property
    def row_ticks(self) -> list[tuple[float, int]]:
        """Place in per cent of the height, and row."""
        return pixel_ticks(self.rows, most=_room(_WIDTH_REM * self.rows / self.cols, each=1.5))


def _room(length_rem: float, *, each: float) -> int:
    """Steps between numbers of a size along an image that is so long, or as long as the page's style lets it be."""
    return int(np.clip(min(_WIDTH_REM, max(3.0, length_rem)) / each, 1, 6))


def pixel_ticks(count: int, *, most: int = 6) -> list[tuple[float, int]]:
    """Round numbers along `count` pixels, in `most` steps: each's middle in per cent of the whole, and the number."""
    places = MaxNLocator(nbins=most, integer=True, steps=[1, 2, 2.5, 5, 10]).tick_values(0, count - 1)
    return [(round(100 * (n + 0.5) / count, 2), int(n)) for n in places if 0 <= n < count and n == int(n)]


def range_shades() -> list[str]:
    """Colours of the range scale, near to far, ``#rrggbb``."""
    return [to_hex(colour) for colour in colormaps[RANGE_MAP](np.linspace(0.0, 1.0, _SHADES))]


def colour_scale(values: FloatArray, *, default: tuple[float, float]) -> tuple[float, float]:
    """Limits of a colour scale: nearly all finite values, or `default` (mm) without one.

    A few stray values would else leave one colour for all others.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return default
    low, high = (float(v) for v in np.percentile(finite, CLIPPED_PERCENT))
    margin = max(1.0, 0.02 * (high - low))
    return low - margin, high + margin


def bar_labels(scale: tuple[float, float]) -> tuple[str, ...]:
    """Labels of the colour bar in mm: its ends, and three between."""
    return tuple(f"{mm:.0f}" for mm in np.linspace(*scale, 5))


def range_uri(range_mm: FloatArray, *, scale: tuple[float, float], marked: NDArray[np.bool_] | None = None) -> str:
    """Draw ranges as a ``data:`` URI of a PNG.

    Parameters
    ----------
    range_mm : (row, col) float
        Ranges in mm; NaN is transparent.
    scale : (float, float)
        Limits of the colours, mm; the same for all that are compared.
    marked : (row, col) bool, optional
        Places that are drawn in `MARK`; ranges past the scale then have the colours of its ends.
    """
    low, high = scale
    finite = np.isfinite(range_mm)
    known = np.where(finite, range_mm, low)
    shade = np.clip((known - low) / (high - low) * _SHADES, 0, _SHADES - 1).astype(np.uint8)
    index = np.where(known < low, _BELOW_INDEX, np.where(known > high, _ABOVE_INDEX, shade + _ABOVE_INDEX + 1))
    if marked is not None:
        index = np.where(marked, _ABOVE_INDEX, np.where(finite, shade + _ABOVE_INDEX + 1, _NO_DATA))
        return _png_uri(index.astype(np.uint8), ["#000000", BELOW, MARK, *range_shades()])
    return _png_uri(np.where(finite, index, _NO_DATA).astype(np.uint8), ["#000000", BELOW, ABOVE, *range_shades()])


def difference_uri(values: FloatArray, *, most: float) -> str:
    """Draw signed values (row, col), zero in the middle of the colours, which end at -+`most`; NaN is transparent."""
    finite = np.isfinite(values)
    shade = np.clip((np.where(finite, values, 0.0) / most + 1.0) / 2.0 * _SHADES, 0, _SHADES - 1)
    return _png_uri(np.where(finite, shade + 1, _NO_DATA).astype(np.uint8), ["#000000", *difference_shades()])


def difference_shades() -> list[str]:
    """Colours of signed values, from negative to positive, ``#rrggbb``."""
    return [to_hex(colour) for colour in colormaps[GAP_MAP](np.linspace(0.0, 1.0, _SHADES))]


def kinds_uri(kinds: NDArray[np.uint8], colours: list[str]) -> str:
    """Draw one of a few kinds (row, col), each in its colour, ``#rrggbb``; transparent past the last."""
    index = np.where(kinds < len(colours), kinds.astype(np.int64) + 1, _NO_DATA).astype(np.uint8)
    return _png_uri(index, ["#000000", *colours])


def count_colours(most: int, theme: Theme) -> list[str]:
    """Colours of the counts 0 to `most`, at most `MANY`: the ground for none, then from dark to light, far apart."""
    steps = colormaps[COUNT_MAP](np.linspace(0.15, 1.0, max(3, min(MANY, most))))
    return [theme.no_surface, *(to_hex(step) for step in steps)]


def count_label(count: int) -> str:
    """``no surface``, ``1 surface``, ``2 surfaces``, ..., ``6 or more``."""
    if count >= MANY:
        return f"{MANY} or more"
    return "no surface" if count == 0 else counted(count, "surface")


def _png_uri(index: NDArray[np.uint8], palette: list[str]) -> str:
    """Encode palette indices (row, col), index 0 transparent; the same image gives the same text."""
    image = Image.fromarray(index)
    image.putpalette(b"".join(bytes.fromhex(colour[1:]) for colour in palette))
    buffer = io.BytesIO()
    image.save(buffer, format="png", transparency=_NO_DATA)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def style_colours() -> dict[str, object]:
    """Colours that the page's style sheet takes from here: both themes, and stops of the range scale."""
    return {"light": LIGHT, "dark": DARK, "shades": range_shades()[::21]}


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
