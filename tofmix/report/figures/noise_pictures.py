"""The page's part about learnt noise: a line of words, and a picture for each part that there is."""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.layers import Layers, Provenance
from tofmix.noise_shape import NoiseShape
from tofmix.report.figures.noise_figures import curve_figure, shape_figure, width_figure
from tofmix.report.figures.picture import Picture, figure_picture, range_picture
from tofmix.report.pixels.pixels import drifts
from tofmix.report.pixels.single_pixels import SinglePixels
from tofmix.report.summary.noise_numbers import NoiseNumbers
from tofmix.sensor import NoiseCurve
from tofmix.wording import counted

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
