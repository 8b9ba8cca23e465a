"""Two forward models that the paper argues against, to compare equation (1) with.

The thin beam knows one surface; decaying shares know several, but not what share
of the beam each has. Use them for comparisons such as docs/results/paper.md: nothing in
`layering` comes through here. Slow and plain, one pixel at a time.

Both keep the rest of equation (1): p(c_r), c_0 and the noise curve's sigma(mu).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam, beam_of
from tofmix.sensor import Sensor

MAX_ITER = 500
TOL = 1.0e-6
"""EM stops when no mean moves by more than this many sigma, and no share by more than this."""

_LEAST_SHARE = 1.0e-12
"""Least p(c_r) in the density: a sample far from every surface must have some likelihood."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForwardModel:
    """A forward model with its parameters: the form of equation (1), however they were found."""

    mean_mm: FloatArray
    sigma_mm: FloatArray
    weight: FloatArray
    """(k,) float64. `mean_mm`, `sigma_mm`, `weight`: mu_i and sigma_i in mm, and p(c_i); k may be 0."""
    weight_no_return: float
    """p(c_0)."""
    weight_outlier: float
    """p(c_r)."""
    sensor: Sensor
    """The working range, over which p(c_r) is spread, and sigma(r_max)."""
    converged: bool = True
    """Whether the fit settled."""

    def log_likelihood(self, samples_mm: ArrayLike) -> float:
        """Log likelihood of samples, those of the fit or others.

        Parameters
        ----------
        samples_mm : (n,) array_like
            Samples, mm; values that are not finite are left out.

        Returns
        -------
        float
            Sum over the samples of log p(r), nat, p(r) being in 1/mm.

        Raises
        ------
        ValueError
            If no sample is finite, or the sensor has no noise curve.

        References
        ----------
        Pathak, Birk and Poppinga, IROS 2008, equation (1).
        """
        terms = _terms(_finite(samples_mm), self, beam_of(self.sensor))
        return float(np.log(terms.sum(axis=1)).sum())


def _finite(samples_mm: ArrayLike) -> FloatArray:
    samples = np.asarray(samples_mm, dtype=np.float64).ravel()
    samples = samples[np.isfinite(samples)]
    if samples.size == 0:
        raise ValueError("samples: none is finite")
    return samples


def _gaussian(range_mm: FloatArray, mean: FloatArray | float, sigma: FloatArray | float) -> FloatArray:
    z = (range_mm - mean) / sigma
    return np.asarray(np.exp(-0.5 * z * z) / (sigma * math.sqrt(2.0 * math.pi)))


def _terms(samples: FloatArray, model: ForwardModel, beam: Beam) -> FloatArray:
    """Terms of equation (1), 1/mm: (n, k + 2), the surfaces in order, then c_0 and c_r."""
    terms = np.zeros((len(samples), len(model.mean_mm) + 2))
    terms[:, :-2] = model.weight * _gaussian(samples[:, np.newaxis], model.mean_mm, model.sigma_mm)
    if model.weight_no_return > 0.0:
        terms[:, -2] = model.weight_no_return * _gaussian(samples, beam.range_max, beam.sigma_max)
    terms[:, -1] = max(model.weight_outlier, _LEAST_SHARE) / (beam.range_top - beam.range_min)
    return terms


def _model(sensor: Sensor, mean: FloatArray, weight: FloatArray, no_return: float, outlier: float) -> ForwardModel:
    """Take sigma_i = sigma(mu_i) from the noise curve."""
    if sensor.noise is None:
        raise ValueError("the sensor has no noise curve sigma(r)")
    return ForwardModel(
        mean_mm=mean,
        sigma_mm=sensor.noise.sigma(mean),
        weight=weight,
        weight_no_return=float(no_return),
        weight_outlier=float(outlier),
        sensor=sensor,
    )


def _fit(samples: FloatArray, start: ForwardModel, shares: FloatArray, *, free_outliers: bool) -> ForwardModel:
    """Run EM; the surfaces split what c_0 and c_r leave as `shares` (k,), which sum to one, from near to far."""
    sensor, model = start.sensor, start
    beam = beam_of(sensor)
    for _ in range(MAX_ITER):
        terms = _terms(samples, model, beam)
        belongs = terms / terms.sum(axis=1, keepdims=True)  # p(c_i | r_j)
        support = belongs.sum(axis=0)
        mean = model.mean_mm.copy()
        held = support[:-2] > 0.0
        mean[held] = (belongs[:, :-2].T @ samples)[held] / support[:-2][held]
        outlier = support[-1] / support.sum() if free_outliers else model.weight_outlier
        no_return = (1.0 - outlier) * support[-2] / max(support[:-1].sum(), math.ulp(0.0))
        moved = np.abs(mean - model.mean_mm) / model.sigma_mm
        changed = abs(no_return - model.weight_no_return), abs(outlier - model.weight_outlier)
        # The shares belong to the order of range: means that changed places change shares.
        model = _model(sensor, np.sort(mean), shares * (1.0 - outlier - no_return), no_return, outlier)
        if max(*moved, *changed) < TOL:
            return model
    return replace(model, converged=False)


def fit_thin_beam(samples_mm: ArrayLike, sensor: Sensor, *, free_outliers: bool = False) -> ForwardModel:
    """Fit the model of a thin beam, one surface: a Gaussian, c_0 and a uniform part.

    p(r) = p(c_r) / (r_max - r_min) + p(c_0) N(r; r_max, sigma(r_max)^2) + p(c_1) N(r; mu, sigma(mu)^2)

    EM starts at the sample that explains most of the others.

    Parameters
    ----------
    samples_mm : (n,) array_like
        Samples of one pixel, mm; values that are not finite are left out.
    sensor : Sensor
        Noise curve, working range and p(c_r).
    free_outliers : bool
        Fit p(c_r) as well. It then takes what a second surface would: the kindest reading of the model.

    Returns
    -------
    ForwardModel
        With one surface.

    Raises
    ------
    ValueError
        If no sample is finite, or the sensor has no noise curve.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, section I: "a Gaussian centered at the occupied cell mixed with a uniform
    random distribution". Thrun, Burgard and Fox, Probabilistic Robotics, MIT Press 2005.
    """
    samples, beam = _finite(samples_mm), beam_of(sensor)
    outlier = 0.1 if free_outliers else beam.p_outlier
    no_return = 0.25 * (1.0 - outlier) if math.isfinite(beam.range_max) else 0.0
    weight = np.array([1.0 - outlier - no_return])
    starts = [_model(sensor, np.array([place]), weight, no_return, outlier) for place in np.unique(samples)]
    best = max(starts, key=lambda start: start.log_likelihood(samples))
    return _fit(samples, best, np.ones(1), free_outliers=free_outliers)


def fit_decaying_shares(samples_mm: ArrayLike, start_mm: ArrayLike, sensor: Sensor, *, ratio: float) -> ForwardModel:
    """Fit surfaces whose shares decay with their order of range by a given ratio: p(c_i+1) = ratio p(c_i).

    The means are fitted by EM, and p(c_0), which is what the surfaces' shares leave; p(c_r) is the sensor's. The
    ratio alone says how the surfaces divide the rest.

    Parameters
    ----------
    samples_mm : (n,) array_like
        Samples of one pixel, mm; values that are not finite are left out.
    start_mm : (k,) array_like
        Starting means, mm, one a surface, in any order. EM finds the best fit near them only: try several.
    sensor : Sensor
        Noise curve, working range and p(c_r).
    ratio : float
        Share of a surface in units of that of the nearer one before it, above 0 and at most 1.

    Returns
    -------
    ForwardModel
        Surfaces from near to far.

    Raises
    ------
    ValueError
        If no sample is finite, there is no start or one is not finite, the ratio is out of its bounds, or the
        sensor has no noise curve.

    References
    ----------
    Thrun, Learning occupancy grids with forward sensor models, Autonomous Robots 15, 2003, as described in section I
    of Pathak, Birk and Poppinga, IROS 2008: the ratio of successive modes known, each weaker than the one before.
    """
    if not 0.0 < ratio <= 1.0:
        raise ValueError(f"ratio: {ratio:g} is not above 0 and at most 1")
    start = np.sort(np.asarray(start_mm, dtype=np.float64).ravel())
    if start.size == 0 or not np.isfinite(start).all():
        raise ValueError("starting means: there must be one, and all must be finite")
    samples, beam = _finite(samples_mm), beam_of(sensor)
    powers = np.power(ratio, np.arange(len(start), dtype=np.float64))
    shares = np.asarray(powers / powers.sum(), dtype=np.float64)
    no_return = (1.0 - beam.p_outlier) / (len(start) + 1) if math.isfinite(beam.range_max) else 0.0
    first = _model(sensor, start, shares * (1.0 - beam.p_outlier - no_return), no_return, beam.p_outlier)
    return _fit(samples, first, shares, free_outliers=False)
