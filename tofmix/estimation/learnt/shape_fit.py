"""The density of standardised errors, by penalised maximum likelihood from their histogram.

The penalty is on the third derivative of the log density. A parabola has none: with few errors the fit is the nearest
Gaussian, and with many errors it follows them. The weight of the penalty is chosen by the errors of other pixels.

References
----------
Silverman, Annals of Statistics 10(3), 1982, doi:10.1214/aos/1176345872.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from tofmix.arrays import FloatArray
from tofmix.noise_shape import NoiseShape

STEP = 0.125
"""Width of a bin in sigmas."""

REACH = 16.0
"""Ends of the bins, in sigmas, and of the shape."""

RING = (12.0, 16.0)
"""Distances, in sigmas, at which errors are background."""

_PENALTIES = np.logspace(-5, 5, 11)
"""Weights of the mean square of the third derivative that are tried, by error."""


CENTRES = np.arange(-round(REACH / STEP), round(REACH / STEP) + 1) * STEP


def histogram(z: FloatArray, weight: FloatArray | None = None) -> FloatArray:
    """Count the errors z, in sigmas, in each bin of `CENTRES`: (bin,); NaN is in none."""
    edges = np.concatenate([CENTRES - 0.5 * STEP, [CENTRES[-1] + 0.5 * STEP]])
    return np.histogram(z, edges, weights=weight)[0].astype(np.float64)


def fit_shape(folds: tuple[FloatArray, FloatArray]) -> NoiseShape | None:
    """Fit the shape of the errors in two histograms, of different pixels.

    Parameters
    ----------
    folds : two (bin,) float64
        Errors in the bins of `CENTRES`, background included.

    Returns
    -------
    NoiseShape or None
        None where there is no error.
    """
    surface = [_without_background(fold) for fold in folds]
    if min(fold.sum() for fold in surface) <= 0:
        return None
    best, chosen = -math.inf, _PENALTIES[-1]
    for penalty in _PENALTIES:
        score = 0.0
        for learnt, held in (surface, surface[::-1]):
            score += float(held @ _log_density(learnt, float(penalty)))
        if score > best:
            best, chosen = score, penalty
    both = surface[0] + surface[1]
    log_density = _with_tails(_log_density(both, float(chosen)), both)
    fine = np.linspace(CENTRES[0], CENTRES[-1], 2 * len(CENTRES) - 1)
    return NoiseShape.standardised(fine, np.exp(CubicSpline(CENTRES, log_density)(fine)))


def shapes_differ(
    error: FloatArray,
    *,
    least_ratio: float = 1.3,
    standard_errors: float = 5.0,
    far_sigmas: float = 4.0,
    least_samples: int = 10,
    least_surfaces: int = 30,
) -> bool:
    """Whether the shape of the error differs between surfaces.

    The statistic of a surface is the mean of the third Hermite polynomial, H3(z) = z^3 - 3 z: its skewness, which
    neither its mean nor its width changes. For one shape, these means would have the variance within surfaces by the
    number of samples. Shapes differ where their variance is larger by `least_ratio`, and this ratio exceeds 1 by
    `standard_errors`.

    Parameters
    ----------
    error : (surface, frame) float64
        Standardised errors, NaN where there is none.
    least_ratio : float
        Least ratio. Noise of one shape has 0.4 to 1.0, also where widths, drifts and backgrounds differ.
    standard_errors : float
        Least excess of the ratio over 1, in its standard errors.
    far_sigmas : float
        Larger errors, in sigmas, are left out: they may be background.
    least_samples, least_surfaces : int
        Least samples of a surface that is compared, and least of such surfaces.
    """
    known = np.isfinite(error) & (np.abs(error) < far_sigmas)
    z = np.where(known, error, 0.0)
    number = known.sum(axis=1)
    kept = number >= least_samples
    if kept.sum() < least_surfaces:
        return False
    z, known, number = z[kept], known[kept], number[kept]
    skewness = np.where(known, z**3 - 3.0 * z, 0.0)
    mean = skewness.sum(axis=1) / number
    within = np.where(known, (skewness - mean[:, None]) ** 2, 0.0).sum(axis=1) / (number - 1)
    # Each surface counts equally, by its own variance: some may have longer tails than others.
    square = (mean - np.average(mean, weights=number)) ** 2 * number / np.maximum(within, within.mean())
    ratio, spread = float(square.mean()), math.sqrt(2.0 / len(square))
    return ratio > max(least_ratio, 1.0 + standard_errors * spread)


def _without_background(
    counts: FloatArray,
    *,
    rounds: int = 6,  # of EM between the shape and the background under it
) -> FloatArray:
    """Errors of the surface (bin,): those of each bin over the level of `RING`, by rounds of EM with a smooth fit."""
    ring = (np.abs(CENTRES) >= RING[0]) & (np.abs(CENTRES) <= RING[1])
    level = float(counts[ring].mean())
    inside = np.abs(CENTRES) < RING[0]
    if level <= 0.0:
        return np.where(inside, counts, 0.0)
    surface = np.where(inside, np.maximum(counts - level, 0.0), 0.0)
    for _ in range(rounds):
        expected = surface.sum() * STEP * np.exp(_log_density(surface, 1.0))
        surface = np.where(inside, counts * expected / (expected + level), 0.0)
    return surface


def _log_density(
    counts: FloatArray,
    penalty: float,
    *,
    most_steps: int = 40,  # of Newton's
    tolerance: float = 1e-6,  # gain of the penalised log likelihood by error, nat, below which a fit ends
) -> FloatArray:
    """Penalised maximum likelihood of the logarithm of the density in each bin, by Newton's method."""
    n = counts.sum()
    mean = float(counts @ CENTRES / n)
    spread = max(float(counts @ (CENTRES - mean) ** 2 / n), STEP**2)
    g = -0.5 * (CENTRES - mean) ** 2 / spread - 0.5 * math.log(2.0 * math.pi * spread)
    third = np.array([-1.0, 3.0, -3.0, 1.0]) / STEP**3
    weight = penalty * n * STEP / len(CENTRES)
    band = np.zeros((4, len(CENTRES)))  # lower form of D'D
    for start in range(len(CENTRES) - 3):
        for a in range(4):
            for b in range(a + 1):
                band[a - b, start + b] += weight * third[a] * third[b]

    def value(log_density: NDArray[np.floating]) -> float:
        bend = np.convolve(log_density, third[::-1], mode="valid")
        return float(counts @ log_density - n * STEP * np.exp(log_density).sum() - 0.5 * weight * bend @ bend)

    now = value(g)
    ridge = 1e-11  # damps Newton's steps where rounding makes the matrix singular: the penalty leaves parabolas free
    for _ in range(most_steps):
        expected = n * STEP * np.exp(g)
        slope = counts - expected - _times(band, g)
        bent = band.copy()
        bent[0] += expected + ridge * band[0].max() + 1e-9 * n
        step = solveh_banded(bent, slope, lower=True)
        size = 1.0
        while size > 1e-4:  # noqa: PLR2004  shorter steps change nothing
            after = g + size * step
            if np.abs(size * step).max() < 20.0 and value(after) > now:  # noqa: PLR2004  e^20 would overflow the next
                break
            size *= 0.5
        else:
            break
        gained = value(after) - now
        g, now = after, now + gained
        if gained < tolerance * n:
            break
    return np.asarray(g, dtype=np.float64)


def _times(band: FloatArray, vector: NDArray[np.floating]) -> FloatArray:
    """Product of a symmetric matrix in lower band form with a vector."""
    out = band[0] * vector
    for k in range(1, len(band)):
        out[k:] += band[k, :-k] * vector[:-k]
        out[:-k] += band[k, :-k] * vector[k:]
    return np.asarray(out, dtype=np.float64)


def _with_tails(log_density: FloatArray, counts: FloatArray) -> FloatArray:
    """Make the density fall on either side of its peak, also beyond the last errors."""
    out, peak = log_density.copy(), int(np.argmax(log_density))
    outward = np.cumsum(counts[::-1])[::-1], np.cumsum(counts)
    last_errors = 3.0  # errors from a bin outward up to which it counts as beyond the last errors
    least_fall = 0.5  # least fall of the log density by sigma beyond the last errors
    for j in range(peak + 1, len(out)):
        fall = 0.0 if outward[0][j] > last_errors else least_fall * STEP
        out[j] = min(out[j], out[j - 1] - fall)
    for j in range(peak - 1, -1, -1):
        fall = 0.0 if outward[1][j] > last_errors else least_fall * STEP
        out[j] = min(out[j], out[j + 1] - fall)
    return out
