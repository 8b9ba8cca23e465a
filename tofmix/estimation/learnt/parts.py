"""The parts of the noise beyond sigma(r): background and its density, drift, widths and shape, each under the others.

A part is learnt from isolated clusters (`clusters`), the background from a count (`background`). The variance
that samples alone give to fitted widths, drifts and shares is subtracted. `learning` decides which parts are used.

Memory of the noise: the correlation of errors from one frame to the next, as of AR(1) noise.

It changes no fit of a pixel, but sigma, standard errors, and the gains that noise alone gives.
"""

import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.background import CELL_SIGMAS, cells_of_surface, smooth_density
from tofmix.estimation.learnt.clusters import ClusterFits
from tofmix.estimation.learnt.folds import Fold
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD, precision_of_t
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.population import spread_beside_pairs
from tofmix.estimation.learnt.shape_fit import fit_shape, histogram
from tofmix.estimation.learnt.sigma_curve import FREE_WIDTH, ROUNDS, variance_left, with_sigma
from tofmix.estimation.noise.isolated_clusters import FREE_DRIFT_SIGMAS, LEAST_CLUSTERS, Clusters
from tofmix.noise_shape import DRIFTS, MOST_LOG_WIDTH, TAIL_DEGREES

LEAST_MEMORY, MOST_MEMORY = 0.05, 0.95
"""Correlations below the first count as 0, and none above the second is given."""


_CENTRAL = 4.0
"""Largest error of a surface, in sigmas; a larger one is background."""


def centred(error: FloatArray) -> FloatArray:
    """Errors (cluster, frame) less the mean of each cluster.

    The mean of rounded samples is not 0, nor is that about the place of a skewed shape; it is no memory.
    """
    known = np.isfinite(error) & (np.abs(error) < _CENTRAL)
    mean = np.where(known, error, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.asarray(error - mean[:, None])


def memory_of(
    fits: ClusterFits,
    noise: PixelNoise,
    *,
    rounds: int = 30,  # for the part of the memory that fitted means and drifts hide
) -> float:
    """Correlation of the errors of all clusters from frame to frame; 0 where noise without memory may give it.

    The fitted mean and each polynomial of a drift remove a part of the slow errors: `taken` / n of their variance,
    which is (1 + rho) / (1 - rho) times that of all errors for AR(1) noise. This part is missing from the covariance
    and from the variance, and is added again.

    Parameters
    ----------
    fits : ClusterFits
        Clusters of one surface, fitted under `noise`.
    noise : PixelNoise
        The noise without memory.
    """
    error = centred(fits.error)
    a, b = error[:, :-1], error[:, 1:]
    both = np.isfinite(a) & np.isfinite(b) & (np.abs(a) < _CENTRAL) & (np.abs(b) < _CENTRAL)
    least_pairs = 100  # least pairs of neighbouring frames: fewer determine a correlation to no better than 0.1
    if both.sum() < least_pairs:
        return 0.0
    x, y = a[both], b[both]
    n = max(float(np.median(fits.support)), 2.0)
    seen = float((x * y).mean() / math.sqrt((x * x).mean() * (y * y).mean()))
    taken = 1.0
    for d, scale in enumerate(noise.drift_mm.tolist()):
        information = n * noise.laws()[0].information / (float(np.median(fits.sigma)) ** 2 * (2.0 * d + 3.0))
        taken += information / (information + precision_of_t(0.0, scale)) if scale > 0.0 else 0.0
    found = seen
    for _ in range(rounds):
        slow = (1.0 + found) / (1.0 - found) * taken / n
        found = min(max(seen + slow * (1.0 - seen), 0.0), MOST_MEMORY)
    # Standard errors of a correlation, 1 / sqrt(pairs) for errors without memory, up to which it counts as 0.
    significant = 3.0
    return found if found > max(LEAST_MEMORY, significant / math.sqrt(both.sum())) else 0.0


PARTS = ("background", "density", "drift", "widths", "shape")
"""Names of the parts."""

OF_BACKGROUND = "background", "density"
"""Those of the background, in the order in which they build on each other."""

FIRST_PRIOR = (0.5, 2.0)
"""Pseudo-counts of background and of the rest, before shares are known."""

_UPPER_QUARTILE = round(NormalDist().inv_cdf(7.0 / 8.0), 4)
"""Upper quartile of |z| of a standard Gaussian, Phi^-1(7/8), to four decimals."""


_WIDTH_SCALES = np.geomspace(0.02, 1.0, 30)
"""Scales of log width that are tried."""


def with_part(fold: Fold, noise: PixelNoise, part: str) -> PixelNoise | None:
    """Learn one part under `noise`, from the training pixels of a fold, and sigma(r) again.

    Parameters
    ----------
    fold : Fold
        Pixels that teach.
    noise : PixelNoise
        The noise with its other parts.
    part : str
        One of `PARTS`.

    Returns
    -------
    PixelNoise or None
        None where there are too few clusters, or the samples alone explain the spread.
    """
    if part == "background":
        return _with_background(fold, noise)
    if part == "density":
        return _with_density(fold, noise)
    clusters, single = fold.single_surfaces(noise)
    if len(single.pixel) < LEAST_CLUSTERS:
        return None
    learnt = {"drift": _with_drift, "widths": _with_widths, "shape": _with_shape}[part]
    trial = learnt(fold, noise, single)
    if trial is not None and part != "drift":
        # Without the part, pixels that need it most look like two surfaces: they are chosen again with it.
        # Surfaces are not located under a shape that their own errors gave (`_with_shape`).
        start = noise if part == "shape" else trial
        trial = learnt(fold, start, fold.singles_of(with_sigma(fold, trial), clusters))
    return None if trial is None else with_sigma(fold, trial)


def without_part(noise: PixelNoise, part: str) -> PixelNoise:
    """Return the noise without one of `PARTS`; all else is kept as it is."""
    if part == "background":
        noise = replace(noise, background=None)
        return noise if noise.curve.background_density is None else without_part(noise, "density")
    if part == "density":
        return replace(noise, curve=replace(noise.curve, background_density=None))
    if part == "drift":
        return replace(noise, drift_mm=np.zeros(DRIFTS))
    if part == "widths":
        return replace(noise, curve=replace(noise.curve, width_spread=0.0))
    return replace(noise, curve=replace(noise.curve, shape=None))


def _with_drift(fold: Fold, noise: PixelNoise, clusters: Clusters) -> PixelNoise | None:
    """Measure the scale of each polynomial of the drift, beyond the variance that samples give to fitted drifts."""
    sigma = float(np.median(noise.curve.sigma_mm))
    free = replace(noise, drift_mm=np.full(DRIFTS, FREE_DRIFT_SIGMAS * sigma))
    fits = fold.fits(free, clusters)
    width = np.exp(fits.log_width) * fits.sigma
    information = noise.laws()[0].information
    scales = np.zeros(DRIFTS)
    for d in range(DRIFTS):
        variance = (2.0 * d + 3.0) * width**2 / (information * np.maximum(fits.support, 1.0))
        square = np.quantile(np.abs(fits.drift[:, d]), 0.75) ** 2 / _UPPER_QUARTILE**2
        # By the quartile of all drifts, or, where few pixels drift far, by a part of their mean square.
        scales[d] = math.sqrt(
            max(
                float(square - np.median(variance)),
                float(np.mean(np.clip(fits.drift[:, d] ** 2 - variance, 0.0, 9.0 * max(square, 1e-12)))) * 0.25,
                0.0,
            )
        )
    least_drift_sigmas = 0.02  # a drift of a smaller scale, in sigmas, counts as none: it changes no count
    scales[scales < least_drift_sigmas * sigma] = 0.0
    return replace(noise, drift_mm=scales)


def _with_widths(fold: Fold, noise: PixelNoise, clusters: Clusters) -> PixelNoise | None:
    """Measure the spread of log width, beyond the variance that samples give to fitted widths."""
    fits = fold.fits(replace(noise, curve=replace(noise.curve, width_spread=FREE_WIDTH)), clusters)
    variance = 1.0 / (noise.laws()[0].width_information * np.maximum(fits.support, 1.0))
    variance *= (1.0 + fold.rounding_variance(fits.place, fits.sigma)) ** 2
    log_width = freed(fits.log_width, np.asarray(variance))
    scale = width_scale(log_width - float(np.median(log_width)), np.asarray(variance))
    if scale is not None:
        scale = _beside_pairs(fold, noise, clusters, fits, scale)
    if scale is None:
        return None
    return replace(noise, curve=replace(noise.curve, width_spread=scale / SCALE_OF_SPREAD))


def freed(log_width: FloatArray, variance: FloatArray) -> FloatArray:
    """Most likely log widths (n,) of the samples alone, of those fitted with the prior of `FREE_WIDTH`.

    Where a fit ends, the slopes of the samples' log likelihood, a parabola of this variance, and of the prior cancel.
    """
    precision = [precision_of_t(value, SCALE_OF_SPREAD * FREE_WIDTH) for value in log_width.tolist()]
    return np.asarray(log_width * (1.0 + variance * np.array(precision)))


def _beside_pairs(fold: Fold, noise: PixelNoise, clusters: Clusters, fits: ClusterFits, scale: float) -> float | None:
    """Scale of log width where some clusters may be pairs; see `population.spread_beside_pairs`."""
    counted = np.maximum(np.isfinite(fits.error).sum(axis=1), 1)
    return spread_beside_pairs(
        fits.error * np.exp(fits.log_width)[:, None],
        half=0.5 * fold.steps_at(fits.place, clusters.pixel) / fits.sigma,
        rest=np.maximum(counted - fits.support, 0.5) / counted,
        span=(clusters.high - clusters.low) / fits.sigma,
        law=noise.laws()[1],
        scale=scale,
    )


def width_scale(log_width: FloatArray, variance: FloatArray) -> float | None:
    """Scale of the Student t density of log width, by maximum likelihood over `_WIDTH_SCALES`.

    Parameters
    ----------
    log_width : (n,) float64
        Fitted log widths, less their median.
    variance : (n,) float64
        Variance of each fitted log width around the true one.

    Returns
    -------
    float or None
        None where equal widths are as likely.
    """
    at = np.linspace(-MOST_LOG_WIDTH, MOST_LOG_WIDTH, 601)
    seen = np.exp(-0.5 * (log_width[:, None] - at) ** 2 / variance[:, None]) / np.sqrt(variance[:, None])
    alike = np.exp(-0.5 * log_width**2 / variance) / np.sqrt(variance)
    least_likelihood = 1e-12  # least likelihood of a scale before its logarithm is taken
    best, chosen = float(np.log(np.maximum(alike, least_likelihood)).sum()), None
    for scale in _WIDTH_SCALES:
        prior = (1.0 + (at / scale) ** 2 / TAIL_DEGREES) ** (-0.5 * (TAIL_DEGREES + 1.0))
        found = float(np.log(np.maximum(seen @ (prior / prior.sum()), least_likelihood)).sum())
        if found > best:
            best, chosen = found, float(scale)
    return chosen


def shrunken_effects(fold: Fold, noise: PixelNoise) -> FloatArray:
    """Log width and drift, mm, of each cluster of one surface (cluster, 1 + DRIFTS), shrunken to their true spread.

    The priors of log width and drift have longer tails than the pixels, and the gains that noise reaches once in 1000
    come from the tails. So `bootstrap` draws from these values, and not from the priors.
    """
    clusters = fold.clusters(noise)
    if len(clusters.pixel):
        clusters = fold.singles_of(noise, clusters)
    out = np.zeros((len(clusters.pixel), 1 + DRIFTS))
    wide, moves = noise.curve.width_spread > 0.0, noise.drift_mm > 0.0
    if not len(out) or not (wide or moves.any()):
        return out
    sigma = float(np.median(noise.curve.sigma_mm))
    free = replace(noise, drift_mm=np.where(moves, FREE_DRIFT_SIGMAS * sigma, 0.0))
    if wide:
        free = replace(free, curve=replace(free.curve, width_spread=FREE_WIDTH))
    fits, law = fold.fits(free, clusters), noise.laws()[0]
    support = np.maximum(fits.support, 1.0)
    slow = (1.0 + noise.memory) / (1.0 - noise.memory)
    if wide:
        variance = (1.0 + noise.memory**2) / (1.0 - noise.memory**2) / (law.width_information * support)
        variance *= (1.0 + fold.rounding_variance(fits.place, fits.sigma)) ** 2
        log_width = freed(fits.log_width, variance)
        out[:, 0] = shrunken(log_width - float(np.median(log_width)), variance)
    width = np.exp(fits.log_width) * fits.sigma
    for d in np.flatnonzero(moves):
        variance = slow * (2.0 * d + 3.0) * width**2 / (law.information * support)
        out[:, 1 + d] = shrunken(fits.drift[:, d], variance)
    return out


def shrunken(value: FloatArray, variance: FloatArray) -> FloatArray:
    """Shrink values about 0 towards 0, so that their mean square is that of the true values.

    Parameters
    ----------
    value : (n,) float64
        Fitted values.
    variance : (n,) float64
        Variance of each fitted value around the true one.

    Returns
    -------
    (n,) float64
        The factor is the square root of the usual one: shrunken best estimates would spread less than the true values.

    References
    ----------
    Louis, Journal of the American Statistical Association 79(386), 1984, pages 393 to 398: constrained estimates.
    """
    square = max(float(np.mean(value**2 - variance)), 0.0)
    return value * np.sqrt(square / np.maximum(square + variance, 1e-300))


def _with_shape(fold: Fold, noise: PixelNoise, clusters: Clusters) -> PixelNoise | None:
    """Learn the shape from the errors of clusters, in two folds of pixels.

    Surfaces are located once, under the shape so far. Located again under each new shape, errors would gather where
    this shape is high by chance, and the shape would become steeper than the true one from round to round.
    """
    fits = fold.fits(noise, clusters)
    taken = 1.0 + np.count_nonzero(noise.drift_mm)
    stretch = 1.0 / np.sqrt(variance_left(taken, fits.support))
    error = fold.smooth_errors(fits, clusters) * stretch[:, None]
    even = clusters.pixel % 2 == 0
    shape = fit_shape((histogram(error[even]), histogram(error[~even])))
    return None if shape is None else replace(noise, curve=replace(noise.curve, shape=shape))


def _with_background(fold: Fold, noise: PixelNoise) -> PixelNoise:
    """Learn the prior of the pixels' shares of background: a Beta density with the moments of these shares."""
    prior = noise.background or FIRST_PRIOR
    for _ in range(ROUNDS):
        prior = beta_prior(*fold.background_shares(replace(noise, background=prior)))
    return replace(noise, background=prior)


def _with_density(fold: Fold, noise: PixelNoise) -> PixelNoise | None:
    """Learn the density of background over range, and the prior of shares again; None where pixels have no shares."""
    if noise.background is None:
        noise = _with_background(fold, noise)
    edges = fold.cell_edges(noise, CELL_SIGMAS[0])
    density = smooth_density(fold.counts(edges), edges, cells_of_surface(noise.curve, edges, noise.laws()[1]))
    for cell_sigmas in CELL_SIGMAS[1:]:
        noise = replace(noise, curve=replace(noise.curve, background_density=density))
        edges = fold.cell_edges(noise, cell_sigmas)
        counts, share, number = fold.background_counts(noise, edges)
        noise = replace(noise, background=beta_prior(share, number))
        density = smooth_density(counts, edges, cells_of_surface(noise.curve, edges, noise.laws()[1]))
    return replace(noise, curve=replace(noise.curve, background_density=density))


def beta_prior(share: FloatArray, n: FloatArray) -> tuple[float, float]:
    """Pseudo-counts of background and of the rest: a Beta density with the moments of the true shares.

    Parameters
    ----------
    share : (pixel,) float64
        Share of background of each pixel.
    n : (pixel,) float64
        Samples of each pixel: the binomial variance is subtracted. Pixels with n = 0 are left out.

    Returns
    -------
    (float, float)
        `FIRST_PRIOR` where no pixel is left.
    """
    share, n = share[n > 0], n[n > 0]
    if share.size == 0:
        return FIRST_PRIOR
    mean = min(max(float(share.mean()), 1e-4), 0.99)
    binomial = float(np.mean(mean * (1.0 - mean) / n))
    square = max(float(share.var()) - binomial, 1e-4 * mean * (1.0 - mean))
    together = min(max(mean * (1.0 - mean) / square - 1.0, 0.5), 50.0)
    return mean * together, (1.0 - mean) * together
