"""Pictures with two numeric axes: the section through a row, and histograms."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from tofmix.arrays import FloatArray
from tofmix.geometry import pixel_angles
from tofmix.layers import Layers
from tofmix.report.tables import ordinal
from tofmix.report.theme import LAYER_LINES, LAYER_MARKERS, RANGE_MAP, Theme
from tofmix.sensor import NoiseCurve

SHOWN_LAYERS = len(LAYER_MARKERS)
"""Layers that are drawn each for itself; more cannot be told apart."""

_SECTION_INCH, _COLUMNS_INCH, _HISTOGRAM_INCH = (5.6, 5.4), (5.6, 3.8), (5.0, 3.3)
_MANY_POINTS = 3000
_RANGE_BINS, _WEIGHT_BINS, _SIGMA_BINS, _GAP_BINS = 80, 25, 70, 60
_LEAST_ERRORS = 5.0

_PLAIN_NUMBER = FuncFormatter(lambda value, _: f"{value:,.0f}")

Place: TypeAlias = tuple[FloatArray, FloatArray]
"""Horizontal and vertical coordinates of points, one a column of the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """One row of an image.

    range_mm, weight (col, layer); averaged_mm (col,), mm; fov_horizontal_deg, None where it is not known.
    """

    range_mm: FloatArray
    weight: FloatArray
    averaged_mm: FloatArray
    fov_horizontal_deg: float | None


def section_figure(section: Section, *, theme: Theme) -> Figure:
    """Averaged points against layers, from above in metres; over the columns where the field of view is unknown.

    Pixel `col` looks along the azimuth ``(col - (cols - 1) / 2) * fov_horizontal / cols``. Markers grow with
    the layer's share; a line joins what one pixel sees. The view holds every layer; averaged points beyond it
    are counted in the title.
    """
    from_above = section.fov_horizontal_deg is not None
    figure = Figure(figsize=_SECTION_INCH if from_above else _COLUMNS_INCH, layout="constrained")
    axes = figure.add_subplot()
    averaged = _place(section, section.averaged_mm)
    layers = [_place(section, section.range_mm[:, k]) for k in range(min(SHOWN_LAYERS, section.range_mm.shape[1]))]
    rasterised = section.range_mm.size > _MANY_POINTS
    beams = LineCollection(
        _beams(averaged, layers), colors=theme.hatch, linewidths=0.8, zorder=1.5, rasterized=rasterised,
        label="one pixel's layers",
    )  # fmt: skip
    axes.add_collection(beams, autolim=False)
    axes.scatter(
        *averaged, marker="x", s=12, linewidths=0.8, color=theme.accent, label="averaged", zorder=3,
        rasterized=rasterised,
    )  # fmt: skip
    for k, place in enumerate(layers):
        area = 14.0 + 30.0 * np.nan_to_num(section.weight[:, k])
        axes.scatter(
            *place, s=area, marker=LAYER_MARKERS[k], color=theme.layers[k], alpha=0.6, linewidths=0,
            label=f"{ordinal(k + 1)} layer", zorder=2, rasterized=rasterised,
        )  # fmt: skip
    outside = _frame(axes, averaged, layers)
    axes.set(xlabel="x, to the right (m)" if from_above else "column (pixels)")
    axes.set(ylabel="z, away from the sensor (m)" if from_above else "range (m)")
    if from_above:
        axes.set_aspect("equal", adjustable="box")
    axes.grid(linewidth=0.6)
    axes.set_axisbelow(True)
    if outside:
        axes.set_title(f"{outside} averaged points lie outside this view", loc="left", fontsize="small")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def range_histogram(layers: Layers, *, theme: Theme) -> Figure:
    """Draw the ranges of each layer over a window, pixels on a logarithmic axis."""
    finite = layers.range[np.isfinite(layers.range)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = max(1.0, 0.02 * (high - low))
    edges = np.linspace(low - margin, high + margin, _RANGE_BINS + 1)
    figure, axes = _curve_axes("range (mm)", "pixels")
    _layer_steps(axes, np.asarray(layers.range, dtype=np.float64), edges, theme)
    figure.legend(loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def weight_histogram(layers: Layers, *, theme: Theme) -> Figure:
    """Draw the shares of each layer, and of no return, over a window, pixels on a logarithmic axis."""
    edges = np.linspace(0.0, 1.0, _WEIGHT_BINS + 1)
    figure, axes = _curve_axes("share of the beam (1)", "pixels")
    # A share of 1 + rounding belongs into the last bin.
    _layer_steps(axes, np.clip(np.asarray(layers.weight, dtype=np.float64), 0.0, 1.0), edges, theme)
    no_return = np.clip(layers.weight_no_return[np.isfinite(layers.weight_no_return)], 0.0, 1.0)
    axes.stairs(
        np.histogram(no_return, edges)[0], edges, baseline=None, color=theme.ink, linewidth=1.2, linestyle="-.",
        label="no return",
    )  # fmt: skip
    axes.set(xlim=(-0.02, 1.02), xticks=np.linspace(0.0, 1.0, 6))
    figure.legend(loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def sigma_figure(layers: Layers, *, curve: NoiseCurve | None, theme: Theme) -> Figure:
    """Draw sigma of every component against its range, with the sensor's curve; values off the top are counted."""
    known = np.isfinite(layers.range) & np.isfinite(layers.sigma)
    range_mm = layers.range[known].astype(np.float64)
    sigma_mm = layers.sigma[known].astype(np.float64)
    figure, axes = _curve_axes("range (mm)", "sigma (mm)", log=False)
    low, high = (float(range_mm.min()), float(range_mm.max())) if range_mm.size else (0.0, 1.0)
    margin = max(1.0, 0.05 * (high - low))
    grid = np.linspace(low - margin, high + margin, 200)
    expected = np.zeros(0) if curve is None else curve.sigma(grid)
    top = 1.15 * max(1.0e-6, *np.percentile(sigma_mm, [99.0]).tolist() if sigma_mm.size else [1.0], *expected.tolist())
    edges = (np.linspace(grid[0], grid[-1], 2 * _SIGMA_BINS + 1), np.linspace(0.0, top, _SIGMA_BINS + 1))
    counts = np.histogram2d(range_mm, sigma_mm, bins=edges)[0].T
    # `none` stores the counts pixel by pixel inside the SVG instead of thousands of rectangles.
    image = axes.imshow(
        np.ma.masked_equal(counts, 0), cmap=RANGE_MAP, norm=LogNorm(1, max(10.0, float(counts.max()))), origin="lower",
        extent=(grid[0], grid[-1], 0.0, top), aspect="auto", interpolation="none",
    )  # fmt: skip
    bar = figure.colorbar(image, ax=axes, label="components", pad=0.02, format=_PLAIN_NUMBER)
    bar.outline.set_visible(False)
    if curve is not None:
        axes.plot(grid, expected, color=theme.accent, linewidth=2.0, label="the sensor's curve")
        axes.legend(loc="upper left")
    off = int((sigma_mm > top).sum())
    if off:
        axes.set_title(f"{off} components lie above this view", loc="left")
    return figure


def gap_histogram(gap_errors: FloatArray, *, tolerance: float, theme: Theme) -> Figure:
    """Draw differences of ranges in combined standard errors, with the normal law and the tolerance.

    gap_errors of any shape; values that are not finite are passed over, those beyond the view counted in its title.
    """
    finite = gap_errors[np.isfinite(gap_errors)]
    most = max(_LEAST_ERRORS, 1.3 * tolerance)
    figure, axes = _curve_axes("range in B less range in A (combined standard errors)", "layers")
    edges = np.linspace(-most, most, _GAP_BINS + 1)
    counts = np.histogram(finite, edges)[0]
    axes.stairs(counts, edges, baseline=None, color=theme.layers[0], linewidth=1.8, label="layers")
    middles = 0.5 * (edges[1:] + edges[:-1])
    normal = finite.size * np.exp(-0.5 * np.square(middles)) / np.sqrt(2.0 * np.pi) * (edges[1] - edges[0])
    axes.plot(middles, normal, color=theme.ink, linestyle="-.", linewidth=1.2, label="two recordings, by chance")
    for side in (-1, 1):
        axes.axvline(
            side * tolerance, color=theme.accent, linestyle="--", linewidth=1.2,
            label="tolerance" if side > 0 else None,
        )  # fmt: skip
    axes.set_ylim(bottom=0.7, top=3.0 * max(10, int(counts.max(initial=0)), float(normal.max(initial=0.0))))
    axes.set_xlim(-most, most)
    outside = int((np.abs(finite) > most).sum())
    if outside:
        axes.set_title(f"{outside} layers lie outside this view", loc="left", fontsize="small")
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0)
    return figure


def _place(section: Section, range_mm: FloatArray) -> Place:
    """Horizontal and vertical coordinate of one range a column: x and z in m, or column and range in m."""
    columns = np.arange(range_mm.size, dtype=np.float64)
    if section.fov_horizontal_deg is None:
        return columns, range_mm / 1000.0
    azimuth = pixel_angles(range_mm.size, section.fov_horizontal_deg)
    return range_mm * np.sin(azimuth) / 1000.0, range_mm * np.cos(azimuth) / 1000.0


def _beams(averaged: Place, layers: list[Place]) -> list[FloatArray]:
    """Lines that join what one pixel sees: all its layers and its averaged point, where there are several layers."""
    x = np.stack([averaged[0], *(place[0] for place in layers)], axis=-1)
    y = np.stack([averaged[1], *(place[1] for place in layers)], axis=-1)
    mixed = np.flatnonzero(np.isfinite(y[:, 1:]).sum(axis=-1) > 1)
    lines = []
    for col in mixed:
        known = np.flatnonzero(np.isfinite(y[col]))
        order = known[np.argsort(y[col, known])]
        lines.append(np.stack([x[col, order], y[col, order]], axis=-1))
    return lines


def _frame(axes: Axes, averaged: Place, layers: list[Place]) -> int:
    """Set limits around the layers (around the averaged points without any); count what they leave out."""
    groups = layers if any(np.isfinite(y).any() for _, y in layers) else [averaged]
    limits = []
    for axis in (0, 1):
        values = np.concatenate([group[axis][np.isfinite(group[1])] for group in groups])
        low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
        margin = max(0.1, 0.06 * (high - low))
        limits.append((low - margin, high + margin))
    axes.set(xlim=limits[0], ylim=limits[1])
    x, y = averaged
    inside = (x >= limits[0][0]) & (x <= limits[0][1]) & (y >= limits[1][0]) & (y <= limits[1][1])
    return int((np.isfinite(y) & ~inside).sum())


def _curve_axes(xlabel: str, ylabel: str, *, log: bool = True) -> tuple[Figure, Axes]:
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
            counts, edges, baseline=None, color=theme.layers[k], linestyle=LAYER_LINES[k], linewidth=1.8,
            label=f"{ordinal(k + 1)} layer",
        )  # fmt: skip
    axes.set_ylim(top=3.0 * max(10, tallest))
