"""The page's part about learnt noise: a line of words, and a picture for each part that there is.

Pictures of learnt noise: the curve with single pixels, the shape with the Gaussian, and the widths of the pixels.
"""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tofmix.arrays import FloatArray
from tofmix.layers import Layers, Provenance
from tofmix.noise_shape import NoiseShape
from tofmix.report.figures.curves import curve_axes
from tofmix.report.figures.picture import Picture, figure_picture, range_picture
from tofmix.report.pixels.pixels import drifts
from tofmix.report.pixels.single_pixels import SinglePixels
from tofmix.report.summary.summary import NoiseNumbers
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


_SHARE_STEPS = (0.01, 0.02, 0.04, 0.08, 0.12, 0.16, 0.2, 0.24, 0.32, 0.4, 0.6, 0.8, 1.0)
"""Ends of the colours of a background map, with round quarters; shares below 1 % look like none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisePictures:
    """Words and pictures of the learnt noise: notes, a sentence each; those with axes; maps over the image plane."""

    notes: tuple[str, ...]
    pictures: tuple[Picture, ...]
    images: tuple[Picture, ...]


def draw_noise(layers: Layers, provenance: Provenance, singles: SinglePixels, numbers: NoiseNumbers) -> NoisePictures:
    """Draw the parts that there are of a window (row, col); the sensor of its file has a noise curve."""
    curve = provenance.sensor.noise
    assert curve is not None  # noqa: S101  its numbers are there
    pictures = [_curve_picture(curve, singles)]
    if curve.shape is not None:
        pictures.append(_shape_picture(curve.shape, singles))
    if curve.width_spread and layers.noise_width is not None and (layers.n_modes > 0).any():
        own = layers.noise_width[layers.n_modes > 0].astype(np.float64)
        pictures.append(_width_picture(own[np.isfinite(own) & (own > 0)], curve.width_spread))
    images = [] if curve.background is None else [_background_picture(curve.background, layers.shape)]
    return NoisePictures(notes=_notes(provenance, singles, numbers), pictures=tuple(pictures), images=tuple(images))


def _notes(provenance: Provenance, singles: SinglePixels, numbers: NoiseNumbers) -> tuple[str, ...]:
    curve = provenance.sensor.noise
    assert curve is not None  # noqa: S101  its numbers are there
    notes = [f"{numbers.line[:1].upper()}{numbers.line[1:]}."]
    spread = singles.spread()
    if singles.from_samples and spread is not None:
        notes.append(
            f"In {counted(spread.count, 'pixel', ',')} of one layer, half the width of the central 68 % of the samples"
            f" is {spread.q50:.2f} times the curve (median); 5 to 95 % of them lie between {spread.q05:.2f} and"
            f" {spread.q95:.2f}."
        )
    if drifts(provenance):
        ranges = "Ranges of a pixel drift within a window"
        if not singles.from_samples:
            notes.append(f"{ranges}; sigma is the spread of the samples without the drift.")
        else:
            notes.append(f"{ranges}; the drift is subtracted from the samples here.")
    if curve.law is not None:
        notes.append("Sigma falls with amplitude too: the curve is sigma at its reference amplitudes.")
    return tuple(notes)


def _curve_picture(curve: NoiseCurve, singles: SinglePixels) -> Picture:
    spread = singles.spread()
    number = counted(singles.range_mm.size, "pixel", ",")
    if spread is None:
        alt = "The noise curve against range; no pixel has exactly one layer to compare with."
    else:
        alt = f"The noise curve against range, and {number} of one layer around it: median {spread.q50:.2f} of it."
    of_all = f" ({number} of {singles.pixels_of_one_layer:,})" if singles.range_mm.size else ""
    shows = (
        f"Half the width of the central 68 % of the samples of each pixel of one layer{of_all}, beside sigma(r)."
        if singles.from_samples
        else f"Sigma of each pixel of one layer{of_all} as it was fitted, beside sigma(r). With --recording the points"
        " come from the samples themselves."
    )
    if curve.law is not None:
        shows += " Noise by amplitude spreads them too."
    elif not singles.from_samples and not curve.width_spread:
        shows += " All widths are equal here, so all lie on the curve."
    return figure_picture(
        lambda theme: curve_figure(curve, singles, theme=theme),
        title="Sigma of single pixels",
        alt=alt,
        shows=shows,
        good="Points on both sides of the curve at every range.",
        bad="Points on one side of the curve over a stretch of ranges: the curve does not fit there.",
    )


def _shape_picture(shape: NoiseShape, singles: SinglePixels) -> Picture:
    _, _, skewness, kurtosis = shape.moments()
    samples = counted(singles.errors.size, "sample", ",")
    if singles.errors.size:
        grey = f" Grey: {samples} of pixels of one layer, without their drift and background."
        good = "The learnt line along the samples, into the tails."
        bad = "Samples off the line: the shape differs between pixels, or surfaces are merged."
    else:
        grey = " With --recording the samples are drawn too."
        good = "One smooth hump, near the Gaussian in its middle."
        bad = "Several humps: pixels with two close surfaces were used for the shape."
    return figure_picture(
        lambda theme: shape_figure(shape, singles, theme=theme),
        title="Shape of the error",
        alt=f"Density of the error beside a Gaussian of the same central 68 %: skewness {skewness:.2f}, excess"
        f" kurtosis {kurtosis:.2f}.",
        shows="The learnt density of a sample's error, in units of sigma, beside the Gaussian of the same central 68 %."
        + grey,
        good=good,
        bad=bad,
    )


def _width_picture(widths: FloatArray, spread: float) -> Picture:
    low, middle, high = np.quantile(widths, (0.05, 0.5, 0.95)) if widths.size else (1.0, 1.0, 1.0)
    return figure_picture(
        lambda theme: width_figure(widths, spread, theme=theme),
        title="Widths of the pixels",
        alt=f"Histogram of the pixels' own widths: median {middle:.2f}, 5 to 95 % from {low:.2f} to {high:.2f}; the"
        f" learnt spread is {100 * spread:.0f} %.",
        shows="Each pixel's own width, a factor on sigma, beside the learnt log-normal distribution.",
        good="The histogram inside the line, or narrower: with few samples a width stays near 1.",
        bad="A second hump: some pixels have other noise, or their surfaces are merged.",
    )


def _background_picture(background: FloatArray, shape: tuple[int, ...]) -> Picture:
    share = np.broadcast_to(background, shape)
    high = next(step for step in _SHARE_STEPS if step >= float(share.max()))
    low, middle, most = 100.0 * np.quantile(share, (0.05, 0.5, 0.95))
    return range_picture(
        share,
        scale=(0.0, high),
        bar=tuple(f"{100 * value:.3g}" for value in np.linspace(0.0, high, 5)),
        unit="%",
        title="Background",
        alt=f"Share of background over the image plane: median {middle:.1f} %, 5 to 95 % of the pixels from {low:.1f}"
        f" to {most:.1f} %.",
        shows="Share of each pixel's samples that lie anywhere in the working range, as learnt from the first window or"
        " stated by the file.",
        good="Smooth, or high where the scene is dark or far.",
        bad="High on single surfaces with plain edges: samples of a surface count as background.",
    )
