"""Step 2: the parameters of equation (1) by expectation-maximisation.

Fit a given number of surfaces to one pixel. How many there are comes from
`modes` and `counting`; nothing here chooses it.

p(c_r) and mu_0 = range_max are held fixed, as in the paper. sigma_i is tied to
the noise curve, drawn towards it by a prior, or free. A free sigma runs away
where a component is weak (1252 mm in the paper's Table II); the prior counts as
`PRIOR_SAMPLES` samples that agree with the curve, which a weak component cannot
outvote and a strong one can.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.circle import fold
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.density import sigma_at
from tofmix.estimation.samples import sorted_valid
from tofmix.estimation.settings import MODE_FREE, MODE_TIED, EstimateOptions, knobs_of
from tofmix.estimation.unrolling import unrolled_pixel
from tofmix.jit import jit
from tofmix.sensor import Sensor

PRIOR_SAMPLES = 50.0
"""Weight of the noise curve in the prior of sigma_i, in samples."""

FREE_SIGMA_FLOOR = 0.1
"""Least free sigma_i in units of the curve's: below it a component shrinks onto one sample without end."""

_ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


class Components(NamedTuple):
    """The surfaces of a mixture under fit, changed in place: arrays (capacity,) float64.

    `support` is the sum of a component's responsibilities, in samples; `gain` what the likelihood loses
    without it, nat; `scratch` has four rows for the
    sums of one E step, `vectors` three for an acceleration. `no_return` holds p(c_0) and its support.
    """

    mean: FloatArray
    sigma: FloatArray
    weight: FloatArray
    support: FloatArray
    gain: FloatArray
    no_return: FloatArray
    scratch: FloatArray
    vectors: FloatArray


@jit
def new_components(capacity: int) -> Components:
    """Room for `capacity` surfaces."""
    return Components(
        np.zeros(capacity),
        np.zeros(capacity),
        np.zeros(capacity),
        np.zeros(capacity),
        np.zeros(capacity),
        np.zeros(2),
        np.zeros((4, capacity)),
        np.zeros((3, 3 * capacity + 1)),
    )


@jit
def gaussian(range_mm: float, mean: float, sigma: float) -> float:
    """Normal density, 1/mm."""
    z = (range_mm - mean) / sigma
    return math.exp(-0.5 * z * z) / (sigma * _ROOT_TWO_PI)


@jit
def sample_densities(sample: float, k: int, fit: Components, beam: Beam) -> tuple[float, float]:
    """p(r | surfaces) of equation (1) and its c_0 term; the surfaces' terms go to scratch[0]."""
    no_return = 0.0
    if fit.no_return[0] > 0.0:
        no_return = fit.no_return[0] * gaussian(sample, beam.range_max, beam.sigma_max)
    total = beam.outlier_density + no_return
    for i in range(k):
        term = fit.weight[i] * gaussian(sample, fit.mean[i], fit.sigma[i])
        fit.scratch[0, i] = term
        total += term
    return total, no_return


@jit
def log_likelihood(samples: FloatArray, k: int, fit: Components, beam: Beam) -> float:
    """Log likelihood of the samples under equation (1), nat."""
    out = 0.0
    for j in range(len(samples)):
        out += math.log(sample_densities(samples[j], k, fit, beam)[0])
    return out


@jit
def _expect(samples: FloatArray, k: int, fit: Components, beam: Beam) -> float:
    """E step: support, and in scratch[2] and [3] the first and second moments about the means.

    Return the log likelihood of the values that it started from.
    """
    likelihood = 0.0
    fit.no_return[1] = 0.0
    for i in range(k):
        fit.support[i] = 0.0
        fit.scratch[2, i] = 0.0
        fit.scratch[3, i] = 0.0
    for j in range(len(samples)):
        total, no_return = sample_densities(samples[j], k, fit, beam)
        likelihood += math.log(total)
        fit.no_return[1] += no_return / total
        for i in range(k):
            share = fit.scratch[0, i] / total  # p(c_i | r_j)
            away = samples[j] - fit.mean[i]
            fit.support[i] += share
            fit.scratch[2, i] += share * away
            fit.scratch[3, i] += share * away * away
    return likelihood


@jit
def _new_sigma(curve_sigma: float, squares: float, support: float, mode: int) -> float:
    """sigma_i from the squares about the new mean, by the chosen mode."""
    if mode == MODE_TIED:
        return curve_sigma
    if mode == MODE_FREE:
        return max(math.sqrt(squares / support), FREE_SIGMA_FLOOR * curve_sigma)
    return math.sqrt((PRIOR_SAMPLES * curve_sigma**2 + squares) / (PRIOR_SAMPLES + support))


@jit
def _maximise(k: int, fit: Components, beam: Beam, mode: int) -> float:
    """M step; return the largest change: of a mean in sigmas, of a weight as it is."""
    total = fit.no_return[1]
    for i in range(k):
        total += fit.support[i]
    scale = (1.0 - beam.p_outlier) / total if total > 0.0 else 0.0
    change = float(abs(scale * fit.no_return[1] - fit.no_return[0]))
    fit.no_return[0] = scale * fit.no_return[1]
    for i in range(k):
        support = fit.support[i]
        weight = scale * support
        change = max(change, float(abs(weight - fit.weight[i])))
        fit.weight[i] = weight
        if support <= 0.0:
            continue
        shift = fit.scratch[2, i] / support
        fit.mean[i] += shift
        change = max(change, float(abs(shift) / fit.sigma[i]))
        curve_sigma = sigma_at(fit.mean[i], beam.curve_range, beam.curve_sigma)
        squares = max(fit.scratch[3, i] - support * shift * shift, 0.0)
        fit.sigma[i] = _new_sigma(curve_sigma, squares, support, mode)
    return change


@jit
def em_step(samples: FloatArray, k: int, fit: Components, beam: Beam, mode: int) -> float:
    """One iteration of EM; return the log likelihood of the values that it started from."""
    likelihood = _expect(samples, k, fit, beam)
    _maximise(k, fit, beam, mode)
    return likelihood


@jit
def expectation_maximisation(
    samples: FloatArray, k: int, fit: Components, beam: Beam, mode: int, max_iter: int, tol: float
) -> int:
    """Run EM on `k` surfaces from the values in `fit`; return its iterations, negative if it did not converge."""
    for iteration in range(max_iter):
        _expect(samples, k, fit, beam)
        if _maximise(k, fit, beam, mode) < tol:
            return iteration + 1
    return -max_iter


@jit
def start_at(places: FloatArray, heights: FloatArray, k: int, no_return: float, fit: Components, beam: Beam) -> None:
    """Start `fit` at step 1's places with weights in proportion to their heights."""
    total = no_return + np.sum(heights[:k])
    scale = (1.0 - beam.p_outlier) / total if total > 0.0 else 0.0
    for i in range(k):
        fit.mean[i] = places[i]
        fit.sigma[i] = sigma_at(places[i], beam.curve_range, beam.curve_sigma)
        fit.weight[i] = scale * heights[i]
    fit.no_return[0] = scale * no_return


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixtureFit:
    """A fitted mixture of one pixel.

    mean_mm, sigma_mm, weight are (k,) float64 in the order of the starting means; log_likelihood in nat.
    """

    mean_mm: FloatArray
    sigma_mm: FloatArray
    weight: FloatArray
    weight_no_return: float
    log_likelihood: float
    n_iter: int
    converged: bool


def fit_mixture(
    samples_mm: ArrayLike, start_mm: ArrayLike, sensor: Sensor, options: EstimateOptions | None = None
) -> MixtureFit:
    """Fit equation (1) with a given number of surfaces to one pixel's samples.

    Parameters
    ----------
    samples_mm : (n,) array_like
        Samples, mm; values that are not finite are left out.
    start_mm : (k,) array_like
        Starting means, mm; one a surface.
    sensor : Sensor
        Noise curve, p(c_r), and the range up to which there is a c_0.
    options : EstimateOptions, optional
        `sigma`, `max_iter`, `tol` and `unambiguous_range_mm` are used.

    Returns
    -------
    MixtureFit
        The fit.

    Raises
    ------
    ValueError
        If there is no finite sample, a start is not finite, or the sensor has no noise curve.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, equation (1) and section V.
    """
    samples = sorted_valid(samples_mm)
    start = np.asarray(start_mm, dtype=np.float64).ravel()
    if not np.isfinite(start).all():
        raise ValueError("start: a starting mean is not finite")
    options = options or EstimateOptions()
    length = options.unambiguous_range_mm
    knobs = knobs_of(options)
    if length is None:
        beam = beam_of(sensor)
    else:
        samples, start, beam = unrolled_pixel(samples, start, sensor, length)
    k = len(start)
    fit = new_components(max(k, 1))
    no_return = 1.0 if math.isfinite(beam.range_max) else 0.0
    start_at(start, np.ones(k), k, no_return, fit, beam)
    n_iter = expectation_maximisation(samples, k, fit, beam, knobs.mode, knobs.max_iter, knobs.tol)
    return MixtureFit(
        mean_mm=fit.mean[:k].copy() if length is None else fold(fit.mean[:k], length),
        sigma_mm=fit.sigma[:k].copy(),
        weight=fit.weight[:k].copy(),
        weight_no_return=float(fit.no_return[0]),
        log_likelihood=float(log_likelihood(samples, k, fit, beam)),
        n_iter=abs(n_iter),
        converged=n_iter > 0,
    )
