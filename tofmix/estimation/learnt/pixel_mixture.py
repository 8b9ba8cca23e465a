"""The fitted mixture of a pixel from the numbers of a layers file, to draw it and to compare it with samples.

A layers file has ranges, shares, widths and background of a pixel, but no drift. `drifts_of` fits the drift to the
samples again, all else held, by the scoring of `tofmix.estimation.learnt.em`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.circle import open_at
from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt.law import REACH, Law
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.noise_shape import DRIFTS, TAIL_DEGREES, BackgroundDensity
from tofmix.sensor import Sensor

_WIDER = (4.0, 2.0, 1.0)
"""Factors on sigma, one after another: with a wider shape, a drift of several sigmas is found from afar."""

_ITERATIONS, _TOLERANCE = 60, 1.0e-3
"""Most steps at each factor, and the step, in sigmas, that ends them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelMixture:
    """The fitted mixture of one pixel under the learnt noise.

    Parameters
    ----------
    range_mm, sigma_mm, weight : (layer,) float64
        Its layers; sigma includes the pixel's width. A layer with an impossible number has the share 0.
    width : float
        The pixel's width, a factor on the common sigma.
    background : float
        Share of samples that are random values, between the ends of `span_mm`.
    span_mm : (float, float)
        Ends of the working range, mm.
    no_return : (float, float, float)
        Share of the samples without a return, their mean and their sigma, mm.
    drift_mm : (layer, DRIFTS) float64
        Coefficients of the Legendre polynomials of time, of the degrees 1 to 3; 0 without samples.
    time : (time,) float64
        Times of samples, -1 to 1 over the window.
    z, density : (point,) float64
        The shape of the error.
    drifts : bool
        Whether ranges may drift within the window.
    random_density : BackgroundDensity, optional
        Density of random values; uniform without it.
    """

    range_mm: FloatArray
    sigma_mm: FloatArray
    weight: FloatArray
    width: float
    background: float
    span_mm: tuple[float, float]
    no_return: tuple[float, float, float]
    drift_mm: FloatArray
    time: FloatArray
    z: FloatArray
    density: FloatArray
    drifts: bool
    random_density: BackgroundDensity | None = None

    def component(self, k: int, range_mm: FloatArray) -> FloatArray:
        """Share times density of a layer, 1/mm, at ranges (place,): the mean over the window where it drifts."""
        moved = self.range_mm[k] + self.drift(k)
        total = np.zeros(len(range_mm))
        for centre in moved:
            total += np.interp((range_mm - centre) / self.sigma_mm[k], self.z, self.density, left=0.0, right=0.0)
        return np.asarray(self.weight[k] * total / (len(moved) * self.sigma_mm[k]))

    def floor(self, range_mm: FloatArray) -> FloatArray:
        """Share times density, 1/mm, of background and of samples without a return, at ranges (place,)."""
        low, high = self.span_mm
        inside = (range_mm >= low) & (range_mm <= high)
        density = np.full(range_mm.shape, 1.0 / (high - low))
        if self.random_density is not None:
            density = self.random_density.at(range_mm)
        floor = np.where(inside, self.background * density, 0.0)
        share, place, spread = self.no_return
        if share > 0.0:
            floor = floor + share * _bell((range_mm - place) / spread) / spread
        return np.asarray(floor, dtype=np.float64)

    def total(self, range_mm: FloatArray) -> FloatArray:
        """The whole density, 1/mm, at ranges (place,)."""
        parts = (self.component(k, range_mm) for k in range(len(self.range_mm)))
        return np.asarray(sum(parts, start=self.floor(range_mm)))

    def drift(self, k: int) -> FloatArray:
        """Drift of a layer at each of the times, mm; one 0 where it does not drift."""
        if not self.drift_mm[k].any() or self.time.size == 0:
            return np.zeros(1)
        return np.asarray(self.drift_mm[k] @ legendre(self.time))

    def drift_extent_mm(self) -> FloatArray:
        """Span of the drift of each layer (layer,), mm: its largest value less its least."""
        return np.array([float(np.ptp(self.drift(k))) for k in range(len(self.range_mm))])

    def opened(self, cut_mm: float, unambiguous_range_mm: float) -> "PixelMixture":
        """Return the mixture on a line that begins at a cut of the circle; see `tofmix.circle.open_at`."""
        share, place, spread = self.no_return
        at = float(open_at(np.array([place]), cut_mm, unambiguous_range_mm)[0]) if math.isfinite(place) else place
        return replace(
            self,
            range_mm=open_at(self.range_mm, cut_mm, unambiguous_range_mm),
            span_mm=(cut_mm, cut_mm + unambiguous_range_mm),
            no_return=(share, at, spread),
        )


def pixel_mixture(
    sensor: Sensor,
    *,
    range_mm: FloatArray,
    sigma_mm: FloatArray,
    weight: FloatArray,
    width: float,
    background: float,
    no_return: float,
    samples_mm: FloatArray | None,
    unambiguous_range_mm: float | None = None,
) -> PixelMixture:
    """Make the mixture of one pixel, with the drift that fits its samples.

    Parameters
    ----------
    sensor : Sensor
        With a noise curve.
    range_mm, sigma_mm, weight : (layer,) float64
        The pixel's layers.
    width, background, no_return : float
        Its width, its share of random values, and its share without a return; 1, 0 and 0 where not finite.
    samples_mm : (frame,) float64, optional
        Its samples in the order of time, NaN where invalid; default: no drift.
    unambiguous_range_mm : float, optional
        Length of the circle of ranges, mm, on which no pixel drifts.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or `tofmix.estimation.beam.beam_of` refuses it.
    """
    beam = beam_of(sensor, unambiguous_range_mm)
    law, _ = PixelNoise.of(sensor).laws()
    fitted = np.isfinite(range_mm) & np.isfinite(sigma_mm) & (sigma_mm > 0.0) & (weight > 0.0)
    range_mm, sigma_mm = np.where(fitted, range_mm, 0.0), np.where(fitted, sigma_mm, 1.0)
    weight = np.where(fitted, weight, 0.0)
    share = no_return if math.isfinite(no_return) and math.isfinite(beam.range_max) else 0.0
    mixture = PixelMixture(
        range_mm=range_mm,
        sigma_mm=sigma_mm,
        weight=weight,
        width=width if math.isfinite(width) else 1.0,
        background=background if math.isfinite(background) else 0.0,
        span_mm=(beam.range_min, beam.range_top),
        no_return=(share, beam.range_max, beam.sigma_max),
        drift_mm=np.zeros((len(range_mm), DRIFTS)),
        time=np.zeros(0),
        z=np.arange(len(law.density)) / ((len(law.density) - 1) / (2.0 * REACH)) - REACH,
        density=law.density,
        drifts=unambiguous_range_mm is None and bool(law.drift_mm.any()),
        random_density=sensor.noise.background_density if sensor.noise and unambiguous_range_mm is None else None,
    )
    if samples_mm is None or len(range_mm) == 0 or not mixture.drifts:
        return mixture
    known = np.isfinite(samples_mm)
    samples = np.where(known, samples_mm, 0.0)
    found = drifts_of(
        samples_mm[np.newaxis],
        range_mm=range_mm[np.newaxis],
        sigma_mm=sigma_mm[np.newaxis],
        weight=weight[np.newaxis],
        rest=mixture.floor(samples)[np.newaxis],
        law=law,
    )[0]
    time = times(len(samples_mm))[known]
    most_times = 200  # most times at which a drifting surface is drawn
    some = np.unique(np.linspace(0, max(0, len(time) - 1), min(len(time), most_times)).astype(int))
    return replace(mixture, drift_mm=found[0], time=time[some])


def drifts_of(
    samples_mm: FloatArray,
    *,
    range_mm: FloatArray,
    sigma_mm: FloatArray,
    weight: FloatArray,
    rest: FloatArray,
    law: Law,
) -> tuple[FloatArray, FloatArray]:
    """Fit the drift of each surface, at its most probable value.

    Parameters
    ----------
    samples_mm : (pixel, frame) float64
        Samples in the order of time, NaN where invalid.
    range_mm, sigma_mm, weight : (pixel, layer) float64
        The surfaces.
    rest : (pixel, frame) float64
        Density of background and of samples without a return at each sample, 1/mm.
    law : Law
        The learnt noise.

    Returns
    -------
    (pixel, layer, DRIFTS) float64
        Coefficients of the Legendre polynomials of time, mm.
    (pixel, layer) float64
        Degrees of freedom of the drift, 0 to DRIFTS: trace of the samples' part of the information.
    """
    pixels, layers = range_mm.shape
    used = np.flatnonzero(law.drift_mm > 0.0)
    out, freedom = np.zeros((pixels, layers, DRIFTS)), np.zeros((pixels, layers))
    if used.size == 0 or layers == 0:
        return out, freedom
    known = np.isfinite(samples_mm)
    samples = np.where(known, samples_mm, 0.0)
    basis = legendre(times(samples_mm.shape[1]))[used]
    drift = np.zeros((pixels, layers, used.size))
    for wider in _WIDER:
        sigma = wider * sigma_mm
        for _ in range(_ITERATIONS):
            density, slope = _tables(samples, range_mm, sigma, drift @ basis, law)
            total = (weight[..., np.newaxis] * density).sum(axis=1) + rest + np.finfo(np.float64).tiny
            share = np.where(known, 1.0 / total, 0.0)[:, np.newaxis] * weight[..., np.newaxis]
            push = np.einsum("pkn,dn->pkd", share * slope, basis) / sigma[..., np.newaxis]
            seen = np.einsum("pkn,dn,en->pkde", share * density, basis, basis)
            seen *= law.information / np.square(sigma)[..., np.newaxis, np.newaxis]
            precision = (TAIL_DEGREES + 1.0) / (TAIL_DEGREES * law.drift_mm[used] ** 2 + np.square(drift))
            both = seen + precision[..., np.newaxis] * np.eye(used.size)
            step = np.linalg.solve(both, (push - precision * drift)[..., np.newaxis])[..., 0]
            longest = np.abs(step).sum(axis=-1) / sigma  # no polynomial is above 1
            drift += step / np.maximum(1.0, longest)[..., np.newaxis]
            if longest.max() < _TOLERANCE:
                break
    out[..., used] = drift
    freedom[...] = np.trace(np.linalg.solve(both, seen), axis1=-2, axis2=-1)
    return out, freedom


def times(frames: int) -> FloatArray:
    """Time of each frame of a window, -1 to 1, as in `tofmix.estimation.learnt.components.take_samples`."""
    half = 0.5 * (frames - 1) if frames > 1 else 1.0
    return np.arange(frames) / half - 1.0


def legendre(time: FloatArray) -> FloatArray:
    """Legendre polynomials (DRIFTS, time) of the degrees 1 to 3, as `pixel_samples.fill_times` fills them."""
    return np.array([time, 1.5 * time * time - 0.5, (2.5 * time * time - 1.5) * time])


def _tables(
    samples: FloatArray, range_mm: FloatArray, sigma: FloatArray, drift: FloatArray, law: Law
) -> tuple[FloatArray, FloatArray]:
    """Density f and slope -f' over sigma, 1/mm, at samples (pixel, frame) of surfaces (pixel, layer)."""
    steps = (len(law.density) - 1) / (2.0 * REACH)
    z = (samples[:, np.newaxis] - range_mm[..., np.newaxis] - drift) / sigma[..., np.newaxis]
    at = np.clip((z + REACH) * steps, 0.0, len(law.density) - 1.0)
    below = np.minimum(at.astype(np.int64), len(law.density) - 2)
    part = at - below
    return (
        _between(law.density, below, part) / sigma[..., np.newaxis],
        _between(law.slope, below, part) / sigma[..., np.newaxis],
    )


def _between(table: FloatArray, below: NDArray[np.int64], part: FloatArray) -> FloatArray:
    return np.asarray(table[below] + part * (table[below + 1] - table[below]))


def _bell(z: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))
