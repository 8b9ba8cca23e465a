"""sigma(r) from pixels: first curves to start from, and a curve measured anew under a noise model."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.learnt.clusters import SIGMAS, ClusterFits
from tofmix.estimation.learnt.folds import Fold
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.noise.isolated_clusters import LEAST_CLUSTERS, Clusters
from tofmix.estimation.noise.series import sigma_from_differences
from tofmix.estimation.noise.training_pixels import Pixels, medians
from tofmix.sensor import NoiseCurve, Sensor

SCALES = (1.0, 0.5, 0.25, 0.125)
"""Factors on the sigma of the differences: where surfaces lie close in every pixel, this sigma is too large."""

ROUNDS = 3
"""Rounds of measuring under the last noise."""

FREE_WIDTH = 0.6
"""Spread of log width while widths are measured: this prior leaves each width to its samples."""


SEVERAL = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Parts of the clusters that may be of several surfaces, where sigma is the most likely one; the likeliest is taken."""

_WINDOW, _PLACES, _MOST_WINDOWS = 0.2, 81, 20
"""Half the interval of log sigma in which sigma is sought between `SIGMAS`, the places in it, and the most intervals.
Places lie 0.005 apart: 10^4 samples tell the width of a cluster to 0.007."""


_LEAST_IN_BIN, _WIDEST_BIN = 20, 0.12
"""Least clusters in a bin of range, and greatest width of the bin by its range."""

_FARTHEST_IN_BIN, _FEW = 10.0, 3
"""Largest factor between ranges in a bin, however few clusters it then has: sigma at 3 cm says nothing of that at 3 m.
A bin of fewer clusters than the second number keeps its sigma, scaled as that of all: one cluster may be of chance."""


def first_curves(pixels: Pixels, start: NoiseCurve | None) -> list[NoiseCurve]:
    """Return curves to start from: `start`, that of the differences of samples, and smaller ones.

    Parameters
    ----------
    pixels : Pixels
        Pixels of the recording.
    start : NoiseCurve or None
        A curve measured in another way.

    Returns
    -------
    list of NoiseCurve
        Empty if no two samples of a pixel differ.
    """
    curves = [] if start is None else [with_least_sigma(start, pixels)]
    samples = pixels.smooth
    found = sigma_from_differences(samples)
    if found is not None:
        ranges, sigmas = found
    else:
        seen = samples[np.isfinite(samples).sum(axis=1) > 1]
        if len(seen) == 0:
            return curves
        away = np.abs(seen - medians(seen)[:, None])
        spread = MAD_TO_SIGMA * float(np.median(medians(away)))
        if not spread > 0:
            return curves
        ranges, sigmas = np.array([float(np.median(medians(seen)))]), np.array([spread])
    different_factor = 1.1  # curves to start from differ by more than this factor
    for scale in SCALES:
        curve = with_least_sigma(NoiseCurve(ranges, sigmas * scale), pixels)
        if all(abs(math.log(typical_ratio(curve, other))) > math.log(different_factor) for other in curves):
            curves.append(curve)
    return curves


def with_least_sigma(curve: NoiseCurve, pixels: Pixels) -> NoiseCurve:
    """The curve with the least sigma that the step of the stored ranges tells, where it is below."""
    if pixels.step is None:
        return curve
    return replace(curve, sigma_mm=np.maximum(curve.sigma_mm, pixels.least_sigma(curve.range_mm)))


def different_starts(
    folds: Sequence[Fold], curves: Sequence[NoiseCurve], sensor: Sensor
) -> Iterator[tuple[NoiseCurve, list[PixelNoise]]]:
    """Yield each curve with the Gaussian noise that each fold measures from it, unless a curve before gave the same."""
    known: list[list[PixelNoise]] = []
    for curve in curves:
        first = PixelNoise.gaussian(curve, sensor.outlier_probability)
        noises = [with_sigma(fold, first) for fold in folds]
        if not any(all(map(_nearly_equal, noises, others)) for others in known):
            known.append(noises)
            yield curve, noises


def _nearly_equal(one: PixelNoise, other: PixelNoise) -> bool:
    """Whether two curves have about the same sigma at all ranges of the first one."""
    equal_factor = 1.02  # curves within this factor count as equal: no count differs by it
    return bool(
        np.all(np.abs(np.log(one.curve.sigma_mm / other.curve.sigma(one.curve.range_mm))) < math.log(equal_factor))
    )


def typical_ratio(one: NoiseCurve, other: NoiseCurve) -> float:
    """Median ratio of two curves, in the logarithm, at the ranges of the first one."""
    return float(np.exp(np.median(np.log(one.sigma_mm / other.sigma(one.range_mm)))))


def with_sigma(fold: Fold, noise: PixelNoise) -> PixelNoise:
    """Measure sigma(r) anew: the median width of the clusters near each range, or of pixels where clusters are rare."""
    # Least clusters a pixel that sigma(r) is measured with: fewer may be isolated by chance.
    least_clusters_a_pixel = 0.05
    converged = 0.01  # change of log sigma that ends the rounds: samples determine sigma less exactly
    for _ in range(ROUNDS):
        coarse = None
        free = replace(noise, curve=replace(noise.curve, width_spread=FREE_WIDTH))
        clusters = fold.clusters(noise)
        if len(clusters.pixel) >= max(LEAST_CLUSTERS, least_clusters_a_pixel * len(fold.training.samples)):
            fits = fold.fits(free, clusters)
            place, wide = fits.place, fits.log_width
            bias = _log_bias(noise, fits.support, 1.0)
            coarse = _coarse(fold, noise, clusters, fits)
        else:
            pixels = fold.widths(noise, free)
            if len(pixels.place) < LEAST_CLUSTERS:
                return noise
            place, wide = pixels.place, pixels.log_width
            bias = _log_bias(noise, pixels.support, pixels.surfaces)
        # Where rounding is a part of the spread, sigma lacks as much of a smaller whole.
        bias = bias * (1.0 + fold.rounding_variance(place, noise.curve.sigma(place) * np.exp(wide)))
        curve = with_least_sigma(_curve_through(place, wide + bias, noise.curve, coarse), fold.training)
        change = abs(math.log(typical_ratio(curve, noise.curve)))
        noise = replace(noise, curve=curve)
        if change < converged:
            break
    return noise


def _log_bias(noise: PixelNoise, support: FloatArray, surfaces: FloatArray | float) -> FloatArray:
    """Log factor that fitted widths lack, because fitted means and drifts remove a part of the spread.

    With memory rho this part is larger: slow errors have (1 + rho) / (1 - rho) times the variance of all errors.
    """
    taken = surfaces * (1.0 + np.count_nonzero(noise.drift_mm)) * (1.0 + noise.memory) / (1.0 - noise.memory)
    return np.asarray(-0.5 * np.log(variance_left(taken, support)))


def variance_left(taken: FloatArray | float, support: FloatArray) -> FloatArray:
    """Part of the errors' variance that fits of `taken` parameters to `support` (n,) samples leave: 1 - taken / n."""
    least_variance_left = 0.1  # least part of the variance that fits leave, for clusters of few samples
    return np.asarray(np.maximum(1.0 - taken / np.maximum(support, taken + 2.0), least_variance_left))


class _Coarse(NamedTuple):
    """Clusters on a step: the log of each step (cluster,), mm, and the log likelihood of each sigma of `SIGMAS`."""

    log_step: FloatArray
    likelihood: FloatArray

    def in_steps_of(self, log_step: float, some: IntArray) -> FloatArray:
        """Log likelihood (n, `SIGMAS`) of some clusters, where sigma is in steps of a log, mm, that all share."""
        shift = log_step - self.log_step[some]
        if not shift.any():
            return self.likelihood[some]
        return np.array([_between(self.likelihood[k])(by) for k, by in zip(some, shift, strict=True)])


def _between(likelihood: FloatArray) -> Callable[[float], FloatArray]:
    """Function that gives log likelihoods (..., `SIGMAS`) at log sigmas greater by a number; constant past the ends."""
    from scipy.interpolate import CubicSpline

    log_sigma = np.log(SIGMAS)
    spline = CubicSpline(log_sigma, likelihood, axis=-1)
    return lambda by: np.asarray(spline(np.clip(log_sigma + by, log_sigma[0], log_sigma[-1])))


def _coarse(fold: Fold, noise: PixelNoise, clusters: Clusters, fits: ClusterFits) -> _Coarse | None:
    """What clusters on a step tell of sigma; None without a step."""
    step = fold.training.step
    if step is None:
        return None
    likelihood = fold.sigma_likelihoods(noise, clusters, fits)
    if noise.curve.width_spread > 0.0:
        likelihood = _over_widths(likelihood, noise.curve.width_spread)
    return _Coarse(np.log(step.at(fits.place, clusters.pixel)), likelihood)


def _over_widths(likelihood: FloatArray, spread: float) -> FloatArray:
    """Log of the mean likelihood (cluster, `SIGMAS`) over the widths of pixels."""
    widths = 41  # widths over which a likelihood is averaged: a fifth of their spread apart, up to four spreads
    node = np.linspace(-4.0, 4.0, widths)
    log_weight = -0.5 * node**2 - np.log(np.exp(-0.5 * node**2).sum())
    between, out = _between(likelihood), np.full_like(likelihood, -np.inf)
    for x, weight in zip(node, log_weight, strict=True):
        np.logaddexp(out, weight + between(spread * x), out=out)
    return out


def _sigma_in_steps(likelihood: FloatArray) -> float:
    """Most likely sigma, in steps, of clusters (cluster, `SIGMAS`), of which some are of several surfaces.

    A cluster of several surfaces is wider than sigma: any greater width is as likely. What many samples tell of one
    cluster's width is finer than `SIGMAS`; so sigma is sought between them.
    """
    from scipy.interpolate import CubicSpline

    log_sigma = np.log(SIGMAS)
    spline = CubicSpline(log_sigma, likelihood, axis=1)
    first, last = log_sigma[0] + _WINDOW, log_sigma[-1] - _WINDOW
    best = log_sigma[int(np.argmax(_total(likelihood, log_sigma)))]
    for _ in range(_MOST_WINDOWS):
        middle = min(max(best, first), last)
        fine = middle + _WINDOW * np.linspace(-1.0, 1.0, _PLACES)
        total = _total(spline(fine), fine, likelihood[:, log_sigma > fine[-1]])
        at = int(np.argmax(total))
        best = fine[at]
        if 0 < at < _PLACES - 1:
            below, here, above = total[at - 1 : at + 2]
            best += 0.5 * (below - above) / (below - 2.0 * here + above) * (fine[1] - fine[0])
            break
        if min(max(best, first), last) == middle:
            break  # an end of `SIGMAS`
    return math.exp(best)


def _total(likelihood: FloatArray, log_sigma: FloatArray, beyond: FloatArray | None = None) -> FloatArray:
    """Log likelihood of all clusters together at each log sigma, with the likeliest part that is of several surfaces.

    `beyond` (cluster, n) are likelihoods at greater sigmas, at the distances of `SIGMAS`.
    """
    spacing = log_sigma[1] - log_sigma[0]
    wider = np.logaddexp.accumulate(likelihood[:, ::-1], axis=1)[:, ::-1] + math.log(spacing)
    length = log_sigma[-1] - log_sigma + spacing
    if beyond is not None and beyond.shape[1]:
        apart = math.log(SIGMAS[1] / SIGMAS[0])
        wider = np.logaddexp(wider, np.logaddexp.reduce(beyond, axis=1)[:, None] + math.log(apart))
        length = length + apart * beyond.shape[1]
    wider -= np.log(length)
    out = likelihood.sum(axis=0)  # no part is of several surfaces
    for part in SEVERAL:
        out = np.maximum(out, np.logaddexp(math.log1p(-part) + likelihood, math.log(part) + wider).sum(axis=0))
    return np.asarray(out)


def _curve_through(
    at_mm: FloatArray, log_width: FloatArray, curve: NoiseCurve, coarse: _Coarse | None = None
) -> NoiseCurve:
    """Curve through the median widths of bins of range; log widths (n,) are relative to `curve` at `at_mm` (n,).

    Where the step is half a sigma or more, sigma is the most likely one of the bin: widths of single clusters
    scatter far, and those of several surfaces do not stand apart.
    """
    order = np.argsort(at_mm, kind="stable")
    place = at_mm[order]
    wide = log_width[order] + np.log(curve.sigma(place))
    ranges, sigmas, first = [], [], 0
    while first < len(place):
        stop = max(
            first + _LEAST_IN_BIN, int(np.searchsorted(place, place[first] * (1.0 + _WIDEST_BIN) + 1e-9, side="right"))
        )
        if len(place) - stop < _LEAST_IN_BIN // 2:
            stop = len(place)
        near = int(np.searchsorted(place, place[first] * _FARTHEST_IN_BIN + 1e-9, side="right"))
        stop = min(stop, max(near, first + 1))
        ranges.append(float(np.median(place[first:stop])))
        log_sigma = float(np.median(wide[first:stop]))
        if stop - first < min(_FEW, len(place)):
            log_sigma = float(np.median(log_width)) + math.log(float(curve.sigma(np.array(ranges[-1:]))[0]))
        if coarse is not None:
            some = order[first:stop]
            log_step = float(np.median(coarse.log_step[some]))
            if log_step >= log_sigma + math.log(0.5):  # `SIGMAS` reach to twice the sigma there
                log_sigma = log_step + math.log(_sigma_in_steps(coarse.in_steps_of(log_step, some)))
        sigmas.append(float(np.exp(log_sigma)))
        first = stop
    at, where = np.unique(np.round(np.array(ranges), 3), return_index=True)
    law = curve.law
    if law is not None:
        law = replace(law, reference=np.interp(at, curve.range_mm, law.reference))
    return replace(curve, range_mm=at, sigma_mm=np.array(sigmas)[where], law=law)
