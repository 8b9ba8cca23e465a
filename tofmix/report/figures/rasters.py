"""Images of a page, one picture element a pixel: small, sharp at any size, and of one colour scale.

The page itself draws axes, colour bar, legend and hatching around them (``macros.html``), so nothing is laid out here.
"""

import base64
import io
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from tofmix.arrays import FloatArray
from tofmix.report.theme import COUNT_MAP, DARK, GAP_MAP, LIGHT, RANGE_MAP, Theme
from tofmix.wording import counted

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
