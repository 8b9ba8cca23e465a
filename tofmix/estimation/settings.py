"""What the steps of the estimator share: the options, and equation (1)'s fixed part.

`EstimateOptions` is what a caller chooses. `Beam` is what the kernels read: the
noise curve and the constants of equation (1), the same for every pixel.
"""

from dataclasses import dataclass, fields
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.layers import MAX_LAYERS_LIMIT
from tofmix.sensor import Sensor

NO_RETURN_SIGMAS = 2.0
"""A surface within this many sigma of `range_max_mm` is taken as no return, c_0."""

LEAST_SAMPLES = 2
"""Samples below which nothing can be fitted: no layer rests on a single one."""

_SMALLEST_OUTLIER_PROBABILITY = 1.0e-12


class SigmaMode(StrEnum):
    """How a component's sigma is found."""

    TIED = "tied"
    PRIOR = "prior"
    FREE = "free"


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateOptions:
    """Every choice that affects the values of an estimate.

    Parameters
    ----------
    sigma : SigmaMode
        ``tied``: sigma_i = sigma(mu_i); ``prior``: a prior around it; ``free``: the paper's form.
    max_layers : int
        Most surfaces kept in a pixel, 1 to 32; the weakest are left out.
    gamma : float
        Smallest share of the samples that makes a peak, in [0, 1): gamma of the test (5), as the
        share of the surface whose peak would just reach it.
    epsilon : float
        Largest slope at a peak, in units of p(r) / h(r), above 0: epsilon of the test (5).
    max_iter : int
        Most EM iterations, at least 1.
    tol : float
        EM stops when no mean moves by more than `tol` sigma and no weight by more than `tol`.
    min_samples : int
        Fewest valid samples that a pixel is fitted with, at least 2.

    Raises
    ------
    ValueError
        If a value is out of these bounds.
    """

    sigma: SigmaMode = SigmaMode.PRIOR
    max_layers: int = 6
    gamma: float = 0.02
    epsilon: float = 0.01
    max_iter: int = 50
    tol: float = 1.0e-3
    min_samples: int = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", SigmaMode(self.sigma))
        bounds = (
            (1 <= self.max_layers <= MAX_LAYERS_LIMIT, "max_layers", f"1 to {MAX_LAYERS_LIMIT}"),
            (0 <= self.gamma < 1, "gamma", "in [0, 1)"),
            (0 < self.epsilon < np.inf, "epsilon", "above 0"),
            (1 <= self.max_iter < 2**16, "max_iter", "1 to 65535"),
            (0 < self.tol < 1, "tol", "in (0, 1)"),
            (self.min_samples >= LEAST_SAMPLES, "min_samples", f"at least {LEAST_SAMPLES}"),
        )
        for fits, name, text in bounds:
            if not fits:
                raise ValueError(f"{name}: {getattr(self, name)} is not {text}")

    def as_dict(self) -> dict[str, str | int | float]:
        """The options by name, for provenance."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return values | {"sigma": self.sigma.value}


class Beam(NamedTuple):
    """The fixed part of equation (1), in mm, as the kernels read it.

    `range_max` is infinite where the sensor has no such limit; there is no c_0 then.
    `outlier_density` is p(c_r) / (range_max - range_min), 1/mm.
    """

    curve_range: FloatArray
    curve_sigma: FloatArray
    range_max: float
    sigma_max: float
    no_return_from: float
    p_outlier: float
    outlier_density: float


def beam_of(sensor: Sensor) -> Beam:
    """Take the fixed part of equation (1) from a sensor.

    Without `range_max_mm`, the random values spread up to the last range of the noise curve.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or the random values have no interval to spread over.
    """
    if sensor.noise is None:
        raise ValueError("the sensor has no noise curve sigma(r)")
    low = sensor.range_min_mm or 0.0
    high = float(sensor.noise.range_mm[-1]) if sensor.range_max_mm is None else sensor.range_max_mm
    if high <= low:
        raise ValueError(f"range_min_mm {low:g} is not below the last range {high:g} of the noise curve")
    range_max = np.inf if sensor.range_max_mm is None else sensor.range_max_mm
    sigma_max = float(sensor.noise.sigma(high))
    p_outlier = sensor.outlier_probability
    return Beam(
        curve_range=np.array(sensor.noise.range_mm),
        curve_sigma=np.array(sensor.noise.sigma_mm),
        range_max=float(range_max),
        sigma_max=sigma_max,
        no_return_from=float(range_max - NO_RETURN_SIGMAS * sigma_max),
        p_outlier=p_outlier,
        # With p(c_r) = 0 a sample far from every surface would have no likelihood at all.
        outlier_density=max(p_outlier, _SMALLEST_OUTLIER_PROBABILITY) / (high - low),
    )


class Knobs(NamedTuple):
    """`EstimateOptions` as the kernels read them; `mode` is 0 tied, 1 prior, 2 free."""

    mode: int
    max_layers: int
    gamma: float
    epsilon: float
    max_iter: int
    tol: float
    min_samples: int


MODE_TIED, MODE_PRIOR, MODE_FREE = 0, 1, 2


def knobs_of(options: EstimateOptions) -> Knobs:
    """Translate options for the kernels."""
    mode = {SigmaMode.TIED: MODE_TIED, SigmaMode.PRIOR: MODE_PRIOR, SigmaMode.FREE: MODE_FREE}[options.sigma]
    return Knobs(
        mode=mode,
        max_layers=options.max_layers,
        gamma=float(options.gamma),
        epsilon=float(options.epsilon),
        max_iter=options.max_iter,
        tol=float(options.tol),
        min_samples=options.min_samples,
    )
