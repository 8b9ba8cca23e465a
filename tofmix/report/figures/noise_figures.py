"""Pictures of learnt noise: the curve with single pixels, the shape with the Gaussian, and the widths of the pixels."""

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tofmix.arrays import FloatArray
from tofmix.noise_shape import NoiseShape
from tofmix.report.figures.curves import curve_axes
from tofmix.report.pixels.single_pixels import SinglePixels
from tofmix.report.theme import Theme
from tofmix.sensor import NoiseCurve
from tofmix.wording import counted

_PLACES = 400  # points of a drawn curve

_LEAST_DENSITY = 1.0e-5
"""Lowest density drawn of a shape, per sigma: one sample in a few ten thousand."""

_LEAST_REACH, _MOST_REACH = 5.0, 12.0
"""How far errors are drawn at least and at most, in sigmas."""


def curve_figure(curve: NoiseCurve, singles: SinglePixels, *, theme: Theme, most_medians: float = 5.0) -> Figure:
    """Draw sigma(r) and a point for each pixel of one layer; points off the top are counted in the title.

    Pixels wider than `most_medians` times the median are above the view, unless the curve is there.
    """
    figure, axes = curve_axes("range (mm)", "sigma (mm)", log=False)
    seen = singles.range_mm if singles.range_mm.size else curve.range_mm
    low, high = float(seen.min()), float(seen.max())
    margin = max(1.0, 0.05 * (high - low))
    grid = np.linspace(low - margin, high + margin, _PLACES)
    expected = curve.sigma(grid)
    most = [1.15 * float(expected.max())]
    if singles.sigma_mm.size:
        middle, high = np.quantile(singles.sigma_mm, (0.5, 0.98)).tolist()
        most.append(min(1.15 * high, most_medians * middle))
    top = max(most)
    shown = singles.sigma_mm <= top
    said = "samples of a pixel" if singles.from_samples else "a pixel's fitted sigma"
    if shown.any():
        axes.plot(
            singles.range_mm[shown],
            singles.sigma_mm[shown],
            "o",
            color=theme.layers[0],
            markersize=3.0,
            markeredgewidth=0,
            alpha=0.6,
            label=said,
        )
    axes.plot(grid, expected, color=theme.accent, linewidth=2.0, label="the curve")
    axes.set(xlim=(grid[0], grid[-1]), ylim=(0.0, top))
    if not shown.all():
        axes.set_title(f"{counted(int((~shown).sum()), 'pixel')} above this view", loc="left", fontsize="small")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def shape_figure(shape: NoiseShape, singles: SinglePixels, *, theme: Theme, bins: int = 60) -> Figure:
    """Draw the learnt density of the error, the Gaussian and the samples, on a logarithmic axis.

    `bins` are those of the errors of the samples.
    """
    figure, axes = curve_axes("error (sigma)", "density (1/sigma)", log=False)
    low, high = _reach(shape)
    z = np.linspace(low, high, _PLACES)
    density, gaussian = shape.pdf(z), np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    if singles.errors.size and singles.held > 0:
        edges = np.linspace(low, high, bins + 1)
        bars = np.histogram(singles.errors, edges)[0] / (singles.errors.size * np.diff(edges))
        bars = np.maximum((bars - singles.background) / singles.held, 0.0)
        axes.stairs(bars, edges, fill=True, color=theme.grid, label="samples", baseline=_LEAST_DENSITY)
    axes.plot(
        z, np.where(gaussian > 0, gaussian, np.nan), color=theme.ink, linestyle="--", linewidth=1.2, label="Gaussian"
    )
    axes.plot(z, np.where(density > 0, density, np.nan), color=theme.accent, linewidth=2.0, label="learnt")
    axes.set_yscale("log")
    axes.set(xlim=(low, high), ylim=(_LEAST_DENSITY, 2.0 * max(float(density.max()), float(gaussian.max()))))
    _, _, skewness, kurtosis = shape.moments()
    axes.set_title(f"skewness {skewness:.2f}, excess kurtosis {kurtosis:.2f}", loc="left", fontsize="small")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def width_figure(
    widths: FloatArray, spread: float, *, theme: Theme, bins: int = 40, least_log_width: float = 0.3
) -> Figure:
    """Draw the pixels' own widths (pixel,) and the learnt log-normal distribution of this spread of log width.

    `bins` are those of log width, which is drawn to `least_log_width` at least to either side of 0.
    """
    figure, axes = curve_axes("own width (1)", "pixels", log=False)
    log_width = np.log(widths)
    reach = max(least_log_width, 4.0 * spread, float(np.abs(log_width).max(initial=0.0)) * 1.05)
    edges = np.linspace(-reach, reach, bins + 1)
    counts = np.histogram(log_width, edges)[0]
    axes.stairs(counts, np.exp(edges), fill=True, color=theme.layers[0], alpha=0.6, label="pixels")
    places = np.linspace(-reach, reach, _PLACES)
    normal = np.exp(-0.5 * np.square(places / spread)) / (spread * math.sqrt(2.0 * math.pi))
    expected = widths.size * normal * (edges[1] - edges[0])
    axes.plot(np.exp(places), expected, color=theme.accent, linewidth=2.0, label=f"learnt spread, {100 * spread:.0f} %")
    axes.set_xscale("log")
    axes.set_xlim(math.exp(-reach), math.exp(reach))
    ticks = _width_ticks(reach)
    axes.set_xticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _reach(shape: NoiseShape) -> tuple[float, float]:
    """Range of the drawn density, to either side."""
    seen = shape.z[shape.density > _LEAST_DENSITY]
    low = float(np.clip(-seen.min(), _LEAST_REACH, _MOST_REACH))
    return -low, float(np.clip(seen.max(), _LEAST_REACH, _MOST_REACH))


def _width_ticks(reach: float) -> list[float]:
    """Round widths within exp(+-reach)."""
    all_of_them = (0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 2.0, 3.0, 5.0, 10.0)
    inside = [tick for tick in all_of_them if abs(math.log(tick)) <= reach]
    if len(inside) <= 7:  # noqa: PLR2004  labels that fit
        return inside
    return [tick for tick in inside if tick in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0)]
