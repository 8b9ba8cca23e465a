"""Pictures over the image plane of where two results differ, and the colour scale of ranges.

Each is a separate figure, with axes and legend. Images of ranges and counts are in `tofmix.report.figures.rasters`.
"""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.report.theme import GAP_MAP, Theme, mark_no_data, no_data_patch

WIDTH_INCH = 5.0  # of a picture
_LEAST_HEIGHT, _MOST_HEIGHT = 0.8, 6.0  # of the image itself, inch
_LEFT_INCH, _RIGHT_INCH, _BELOW_INCH, _ABOVE_INCH = 0.6, 1.05, 0.85, 0.1  # margins
_BAR_GAP_INCH, _BAR_INCH = 0.1, 0.14  # from the image to the colour bar, and the bar's width
_CLIPPED_PERCENT = (0.1, 99.9)  # percentiles of the values between which the colours run


def colour_scale(values: FloatArray, *, default: tuple[float, float]) -> tuple[float, float]:
    """Limits of a colour scale: nearly all finite values, or `default` (mm) without one.

    A few stray values would else leave one colour for all others.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return default
    low, high = (float(v) for v in np.percentile(finite, _CLIPPED_PERCENT))
    margin = max(1.0, 0.02 * (high - low))
    return low - margin, high + margin


def category_image(categories: NDArray[np.uint8], *, names: tuple[str, ...], theme: Theme) -> Figure:
    """Draw one of a few categories a pixel.

    Parameters
    ----------
    categories : (row, col) uint8
        Index into `names`; 0 is the ground.
    names : tuple of str
        For the legend, up to four; those that occur are in it.
    theme : Theme
        Colours.
    """
    figure, axes = _image_axes(categories.shape)
    colours = [theme.no_surface, theme.layers[2], theme.layers[0], theme.accent][: len(names)]
    norm = Normalize(-0.5, len(colours) - 0.5)
    axes.imshow(categories, cmap=ListedColormap(colours), norm=norm, interpolation="nearest", aspect="auto")
    present = np.unique(categories).tolist()
    entries = [Patch(facecolor=colours[n], edgecolor=theme.ink, linewidth=0.6, label=names[n]) for n in present]
    _legend_below(figure, entries)
    return figure


def gap_image(gap_mm: FloatArray, *, no_data: str, theme: Theme, least_gap_mm: float = 0.1) -> Figure:
    """Draw signed differences over the image plane, zero in the middle of the colours.

    Parameters
    ----------
    gap_mm : (row, col) float
        Differences, mm; NaN: hatched.
    no_data : str
        Meaning of a hatched pixel, for the legend.
    theme : Theme
        Colours.
    least_gap_mm : float
        Least half-width of the scale, mm.
    """
    figure, axes = _image_axes(gap_mm.shape)
    mark_no_data(axes, theme)
    finite = gap_mm[np.isfinite(gap_mm)]
    most = max(least_gap_mm, float(np.percentile(np.abs(finite), _CLIPPED_PERCENT[1])) if finite.size else 0.0)
    norm = Normalize(-most, most)
    cmap = colormaps[GAP_MAP]
    axes.imshow(np.ma.masked_invalid(gap_mm), cmap=cmap, norm=norm, interpolation="nearest", aspect="auto")
    bar = figure.colorbar(
        ScalarMappable(norm=norm, cmap=cmap),
        cax=_bar_axes(figure, axes),
        extend=_extend(finite, (-most, most)),
        label="difference (mm)",
    )
    bar.outline.set_visible(False)
    if finite.size < gap_mm.size:
        _legend_below(figure, [no_data_patch(theme, no_data)])
    return figure


def _image_axes(shape: tuple[int, ...]) -> tuple[Figure, Axes]:
    """Make a figure with square pixels; a very narrow image is stretched so that it is visible.

    The axes have one position for any labels around them, so images side by side are aligned.
    """
    rows, cols = shape
    width = WIDTH_INCH - _LEFT_INCH - _RIGHT_INCH
    height = float(np.clip(width * rows / cols, _LEAST_HEIGHT, _MOST_HEIGHT))
    width = min(width, max(height * cols / rows, _LEAST_HEIGHT))
    total = _BELOW_INCH + height + _ABOVE_INCH
    figure = Figure(figsize=(WIDTH_INCH, total))
    left, bottom = _LEFT_INCH / WIDTH_INCH, _BELOW_INCH / total
    axes = figure.add_axes((left, bottom, width / WIDTH_INCH, height / total))
    axes.set(xlabel="column (pixels)", ylabel="row (pixels)")
    axes.spines[["top", "right"]].set_visible(True)  # a white image would else have no edge
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, nbins=6))
    return figure, axes


def _bar_axes(figure: Figure, axes: Axes) -> Axes:
    """Make room for a colour bar right of the image, of its height."""
    place = axes.get_position()
    return figure.add_axes((place.x1 + _BAR_GAP_INCH / WIDTH_INCH, place.y0, _BAR_INCH / WIDTH_INCH, place.height))


def _extend(finite: FloatArray, scale: tuple[float, float]) -> str:
    below, above = bool((finite < scale[0]).any()), bool((finite > scale[1]).any())
    return {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[below, above]


def _legend_below(figure: Figure, entries: list[Patch]) -> None:
    ncols = min(4, len(entries))
    figure.legend(handles=entries, loc="lower left", ncols=ncols, handlelength=1.8, handleheight=1.1)
