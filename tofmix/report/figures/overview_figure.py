"""One figure of a whole window: the nearest range and the number of surfaces of each pixel."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.points import MM_A_METRE
from tofmix.report.figures.rasters import colour_scale
from tofmix.report.theme import COUNT_MAP, RANGE_MAP, Theme, mark_no_data, new_figure


def overview_figure(layers: Layers, *, name: str, theme: Theme, height_inch: float = 3.6) -> Figure:
    """Draw the nearest range and the number of surfaces of each pixel (row, col), side by side.

    It is hatched where a pixel has no surface, or too few samples.
    """
    figure = new_figure(height_inch)
    left, right = figure.subplots(1, 2)
    nearest = np.where(layers.n_modes > 0, layers.range[..., 0], np.nan).astype(np.float64)
    low, high = colour_scale(nearest, default=(0.0, MM_A_METRE))
    figure.suptitle(name, x=0.01, ha="left", fontweight="bold")
    _style(left, "nearest range", theme)
    shown = left.imshow(
        np.ma.masked_invalid(nearest) / MM_A_METRE,
        cmap=colormaps[RANGE_MAP],
        norm=Normalize(low / MM_A_METRE, high / MM_A_METRE),
        interpolation="nearest",
    )
    figure.colorbar(shown, ax=left, label="range (m)", shrink=0.8)
    _style(right, "number of surfaces", theme)
    most = max(1, int(layers.n_modes.max()))
    counts = np.ma.masked_where(layers.status == int(Status.TOO_FEW_SAMPLES), layers.n_modes)
    colours = [theme.no_surface, *colormaps[COUNT_MAP](np.linspace(0.15, 1.0, most))]
    counted = right.imshow(
        counts, cmap=ListedColormap(colours), norm=Normalize(-0.5, most + 0.5), interpolation="nearest"
    )
    figure.colorbar(counted, ax=right, ticks=range(most + 1), label="surfaces", shrink=0.8)
    return figure


def _style(axes: Axes, title: str, theme: Theme) -> None:
    mark_no_data(axes, theme)
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set(xlabel="column (pixels)", ylabel="row (pixels)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, nbins=6))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, nbins=6))
