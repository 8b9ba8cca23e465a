"""Pixels of one layer, compared with the learnt noise: the width of their samples, and the shape of their errors."""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.estimation.beam import beam_of, is_uniform
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.pixel_mixture import drifts_of, legendre, times
from tofmix.layers import Layers, Provenance
from tofmix.noise_shape import CENTRAL
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.report.pixels.pixels import drifts
from tofmix.report.summary.quantiles import Quantiles, spread_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SinglePixels:
    """Pixels of one layer in one window."""

    # (pixel,) float64: range, and half the width of the central 68 % of the pixel's samples, less their drift and
    # background; without a recording sigma as the layers file has it.
    range_mm: FloatArray
    sigma_mm: FloatArray
    over_curve: FloatArray  # (pixel,) float64: `sigma_mm` over sigma(r)
    # (sample,) float64: errors of the samples of all pixels, in units of the pixel's sigma; empty without a recording.
    errors: FloatArray
    # Expected density of background at any of them, over one unit of the errors, as a share of all errors.
    background: float
    held: float  # share of the errors that are the surfaces'
    pixels_of_one_layer: int  # all of them in the window
    from_samples: bool  # whether there was a recording

    def spread(self) -> Quantiles | None:
        """Quantiles of `over_curve`; None without a pixel."""
        return spread_of(self.over_curve) if self.over_curve.size else None


def single_pixels(
    layers: Layers,
    provenance: Provenance,
    *,
    recording: SampleSource | None,
    start: int,
    stop: int,
    most_pixels: int = 1000,
    most_samples: int = 200_000,
    most_frames: int = 1000,
    least_samples: int = 12,
    reach_sigmas: float = 12.0,
) -> SinglePixels:
    """Look at pixels of one layer.

    Parameters
    ----------
    layers : Layers
        One window, of the leading shape (row, col).
    provenance : Provenance
        Of the layers; its sensor has a noise curve.
    recording : SampleSource, optional
        Source of the layers.
    start, stop : int
        Frames of the window.
    most_pixels : int
        Most pixels that are used, evenly spread over the image; a picture does not show more.
    most_samples : int
        Samples of all of them; there are fewer pixels where they have more.
    most_frames : int
        Frames of a window; longer windows are thinned out evenly.
    least_samples : int
        Fewest samples of a pixel for the width of their central 68 %: of 12, at least two lie outside on either side.
    reach_sigmas : float
        Samples more than this many sigma from the surface are background. Its part nearer to the surface is subtracted.
    """
    sensor, length = provenance.sensor, provenance.unambiguous_range_mm
    curve = sensor.noise
    if curve is None:
        raise ValueError("the sensor has no noise curve")
    known = np.isfinite(layers.range[..., 0]) & (layers.sigma[..., 0] > 0) & np.isfinite(layers.sigma[..., 0])
    one = np.flatnonzero(((layers.n_modes == 1) & known & (layers.weight[..., 0] > 0)).ravel())
    each = 1 if recording is None else samples_a_frame(recording)
    frames = (stop - start) * each
    step = max(1, math.ceil(frames / most_frames))
    most = most_pixels if recording is None else max(1, min(most_pixels, most_samples // max(1, frames // step)))
    chosen = one[np.unique(np.linspace(0, max(0, one.size - 1), min(one.size, most)).astype(np.int64))]
    range_mm = layers.range[..., 0].ravel()[chosen].astype(np.float64)
    sigma_mm = layers.sigma[..., 0].ravel()[chosen].astype(np.float64)
    if recording is None or chosen.size == 0:
        return SinglePixels(
            range_mm=range_mm,
            sigma_mm=sigma_mm,
            over_curve=sigma_mm / curve.sigma(range_mm),
            errors=np.zeros(0),
            background=0.0,
            held=1.0,
            pixels_of_one_layer=one.size,
            from_samples=recording is not None,
        )
    samples = _samples(recording, chosen, slice(start * each, stop * each), step)
    away = samples - range_mm[:, np.newaxis]
    if length is not None:
        away -= length * np.round(away / length)
    share = np.nan_to_num(layers.weight_outlier.ravel()[chosen].astype(np.float64))
    weight = layers.weight[..., 0].ravel()[chosen].astype(np.float64)
    beam = beam_of(sensor, length)
    density = share / (beam.range_top - beam.range_min)
    if not is_uniform(beam):
        density = share * np.interp(range_mm, beam.background.range_mm, beam.background.density)
    freedom = np.zeros(chosen.size)
    if drifts(provenance):
        law, _ = PixelNoise.of(sensor).laws()
        away, freedom = _without_drift(away, sigma_mm, weight, density, law)
    number = np.isfinite(away).sum(axis=1)
    each_pixel = zip(away, reach_sigmas * sigma_mm, density, weight, strict=True)
    half = np.array([_half_width(*values, least_samples) for values in each_pixel])
    half *= np.sqrt(number / np.maximum(number - freedom, 1.0))
    told = np.isfinite(half)
    every = max(1, int(number.sum()))
    return SinglePixels(
        range_mm=range_mm[told],
        sigma_mm=half[told],
        over_curve=half[told] / curve.sigma(range_mm[told]),
        errors=(away / sigma_mm[:, np.newaxis])[np.isfinite(away)],
        background=float((number * density * sigma_mm).sum() / every),
        held=float((number * weight).sum() / every),
        pixels_of_one_layer=one.size,
        from_samples=True,
    )


def _samples(recording: SampleSource, pixels: IntArray, frames: slice, step: int) -> FloatArray:
    """Samples (pixel, frame) of pixels of the flattened image, ascending, mm, every `step`-th, NaN where invalid."""
    _, rows, cols = recording.shape
    band = max(1, recording.row_step)
    kept = np.arange(frames.start, frames.stop, step)
    out = np.full((len(pixels), len(kept)), np.nan)
    frames_a_block = 256  # frames that are read at once
    for top in sorted({int(row) // band * band for row in pixels // cols}):
        here = (pixels // cols >= top) & (pixels // cols < top + band)
        for first in range(frames.start, frames.stop, frames_a_block):
            last = min(first + frames_a_block, frames.stop)
            wanted = (kept >= first) & (kept < last)
            if not wanted.any():
                continue
            block = recording.read_range(slice(first, last), slice(top, min(top + band, rows)))
            series = block[kept[wanted] - first].reshape(int(wanted.sum()), -1)
            out[np.ix_(here, wanted)] = series[:, pixels[here] - top * cols].T
    return out


def _without_drift(
    away: FloatArray, sigma_mm: FloatArray, weight: FloatArray, density: FloatArray, law: Law
) -> tuple[FloatArray, FloatArray]:
    """Errors (pixel, frame) minus the drift of each pixel, and the degrees of freedom of the drift."""
    drift, freedom = drifts_of(
        away,
        range_mm=np.zeros((len(away), 1)),
        sigma_mm=sigma_mm[:, np.newaxis],
        weight=weight[:, np.newaxis],
        rest=np.repeat(density[:, np.newaxis], away.shape[1], axis=1),
        law=law,
    )
    return away - drift[:, 0] @ legendre(times(away.shape[1])), freedom[:, 0]


def _half_width(away: FloatArray, reach: float, density: float, weight: float, least_samples: int) -> float:
    """Half the width of the central 68 % of the errors within `reach`, without background; NaN for few errors.

    Quantiles are those of rank (k - 1/3) / (n + 1/3), whose median is right for any distribution (Hyndman and Fan,
    Am. Stat. 50(4), 1996, type 8).
    """
    near = np.sort(away[np.abs(away) < reach])
    if near.size < least_samples:
        return math.nan
    random = 2.0 * reach * density
    share = random / (random + weight)
    below = (np.arange(1, near.size + 1) - 1.0 / 3.0) / (near.size + 1.0 / 3.0)
    surface = (below - share * 0.5 * (near / reach + 1.0)) / (1.0 - share)
    low, _, high = np.interp(CENTRAL, np.maximum.accumulate(surface), near)
    return float(0.5 * (high - low))
