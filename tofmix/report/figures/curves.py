"""Pictures with two numeric axes: histograms, and sigma against range."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from tofmix.arrays import FloatArray
from tofmix.layers import Layers
from tofmix.report.summary.tables import ordinal
from tofmix.report.theme import DENSITY_MAP, LAYER_LINES, Theme
from tofmix.sensor import NoiseCurve
from tofmix.wording import counted

SHOWN_LAYERS = len(LAYER_LINES)
"""Most layers that are drawn separately; more are not distinguishable."""

_HISTOGRAM_INCH = (5.0, 3.3)  # width and height

_PLAIN_NUMBER = FuncFormatter(lambda value, _: f"{value:,.0f}")


def range_histogram(layers: Layers, *, theme: Theme, bins: int = 80) -> Figure:
    """Draw the ranges of each layer over a window, pixels on a logarithmic axis.

    `bins` are those of the axis of ranges.
    """
    finite = layers.range[np.isfinite(layers.range)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = max(1.0, 0.02 * (high - low))
    edges = np.linspace(low - margin, high + margin, bins + 1)
    figure, axes = curve_axes("range (mm)", "pixels")
    _layer_steps(axes, np.asarray(layers.range, dtype=np.float64), edges, theme)
    figure.legend(loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def weight_histogram(layers: Layers, *, theme: Theme, bins: int = 25) -> Figure:
    """Draw the shares of each layer, and of no return, over a window, pixels on a logarithmic axis.

    `bins` are those of the axis of shares.
    """
    edges = np.linspace(0.0, 1.0, bins + 1)
    figure, axes = curve_axes("share of the beam (1)", "pixels")
    # A share of 1 + rounding belongs into the last bin.
    _layer_steps(axes, np.clip(np.asarray(layers.weight, dtype=np.float64), 0.0, 1.0), edges, theme)
    no_return = np.clip(layers.weight_no_return[np.isfinite(layers.weight_no_return)], 0.0, 1.0)
    axes.stairs(
        np.histogram(no_return, edges)[0],
        edges,
        baseline=None,
        color=theme.ink,
        linewidth=1.2,
        linestyle="-.",
        label="no return",
    )
    axes.set(xlim=(-0.02, 1.02), xticks=np.linspace(0.0, 1.0, 6))
    figure.legend(loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def sigma_figure(layers: Layers, *, curve: NoiseCurve | None, theme: Theme, bins: int = 70) -> Figure:
    """Draw sigma of every component against its range, with the sensor's curve; values off the top are counted.

    `bins` are those of either axis.
    """
    known = np.isfinite(layers.range) & np.isfinite(layers.sigma)
    range_mm = layers.range[known].astype(np.float64)
    sigma_mm = layers.sigma[known].astype(np.float64)
    figure, axes = curve_axes("range (mm)", "sigma (mm)", log=False)
    low, high = (float(range_mm.min()), float(range_mm.max())) if range_mm.size else (0.0, 1.0)
    margin = max(1.0, 0.05 * (high - low))
    grid = np.linspace(low - margin, high + margin, 200)
    expected = np.zeros(0) if curve is None else curve.sigma(grid)
    top = 1.15 * max(1.0e-6, *np.percentile(sigma_mm, [99.0]).tolist() if sigma_mm.size else [1.0], *expected.tolist())
    edges = (np.linspace(grid[0], grid[-1], 2 * bins + 1), np.linspace(0.0, top, bins + 1))
    counts = np.histogram2d(range_mm, sigma_mm, bins=edges)[0].T
    # `none` stores the counts pixel by pixel inside the SVG instead of thousands of rectangles.
    image = axes.imshow(
        np.ma.masked_equal(counts, 0),
        cmap=DENSITY_MAP,
        norm=LogNorm(1, max(10.0, float(counts.max()))),
        origin="lower",
        extent=(grid[0], grid[-1], 0.0, top),
        aspect="auto",
        interpolation="none",
    )
    bar = figure.colorbar(image, ax=axes, label="components", pad=0.02, format=_PLAIN_NUMBER)
    bar.outline.set_visible(False)
    if curve is not None:
        axes.plot(grid, expected, color=theme.accent, linewidth=2.0, label="the sensor's curve")
        axes.legend(loc="upper left")
    off = int((sigma_mm > top).sum())
    if off:
        axes.set_title(f"{counted(off, 'component')} above this view", loc="left")
    return figure


def gap_histogram(
    gap_errors: FloatArray,
    *,
    tolerance: float,
    theme: Theme,
    least_errors: float = 5.0,
    bins: int = 60,  # of the axis of differences
) -> Figure:
    """Draw differences of ranges in combined standard errors, with the normal law and the tolerance.

    gap_errors of any shape; values that are not finite are passed over, those beyond the view counted in its title.

    The axis shows at least `least_errors` to either side.
    """
    finite = gap_errors[np.isfinite(gap_errors)]
    most = max(least_errors, 1.3 * tolerance)
    figure, axes = curve_axes("range in B minus range in A (combined standard errors)", "layers")
    edges = np.linspace(-most, most, bins + 1)
    counts = np.histogram(finite, edges)[0]
    axes.stairs(counts, edges, baseline=None, color=theme.layers[0], linewidth=1.8, label="layers")
    middles = 0.5 * (edges[1:] + edges[:-1])
    normal = finite.size * np.exp(-0.5 * np.square(middles)) / np.sqrt(2.0 * np.pi) * (edges[1] - edges[0])
    axes.plot(middles, normal, color=theme.ink, linestyle="-.", linewidth=1.2, label="two recordings, noise alone")
    for side in (-1, 1):
        axes.axvline(
            side * tolerance,
            color=theme.accent,
            linestyle="--",
            linewidth=1.2,
            label="tolerance" if side > 0 else None,
        )
    axes.set_ylim(bottom=0.7, top=3.0 * max(10, int(counts.max(initial=0)), float(normal.max(initial=0.0))))
    axes.set_xlim(-most, most)
    outside = int((np.abs(finite) > most).sum())
    if outside:
        axes.set_title(f"{counted(outside, 'layer')} outside this view", loc="left", fontsize="small")
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0)
    return figure


def curve_axes(xlabel: str, ylabel: str, *, log: bool = True) -> tuple[Figure, Axes]:
    """Axes with a grid, the vertical one logarithmic, in a figure of the size of all histograms."""
    figure = Figure(figsize=_HISTOGRAM_INCH, layout="constrained")
    axes = figure.add_subplot(xlabel=xlabel, ylabel=ylabel)
    if log:
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.7)
        axes.yaxis.set(major_formatter=_PLAIN_NUMBER, minor_formatter=NullFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(nbins=8))
    axes.grid(linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _layer_steps(axes: Axes, values: FloatArray, edges: FloatArray, theme: Theme) -> None:
    """Outline a histogram a layer; values (row, col, layer), those not finite passed over."""
    tallest = 1
    for k in range(min(SHOWN_LAYERS, values.shape[-1])):
        layer = values[..., k]
        counts = np.histogram(layer[np.isfinite(layer)], edges)[0]
        tallest = max(tallest, int(counts.max()))
        axes.stairs(
            counts,
            edges,
            baseline=None,
            color=theme.layers[k],
            linestyle=LAYER_LINES[k],
            linewidth=1.8,
            label=f"{ordinal(k + 1)} layer",
        )
    axes.set_ylim(top=3.0 * max(10, tallest))
