"""The learnt noise as kernels read it: tables of the shape, and the priors of width, drift and background."""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.learnt_noise import DRIFTS, TAIL_DEGREES
from tofmix.noise_shape import NoiseShape

STEPS = 32
"""Points of the tables by sigma."""

REACH = 24.0
"""Ends of the tables, in sigmas from the surface; the density is 0 beyond."""

NEGLIGIBLE = 1.0e-4
"""Part of its peak below which the density plays no part in the search for a surface."""

SCALE_OF_SPREAD = 0.831
"""Scale s of the Student t of n = `TAIL_DEGREES` with the largest likelihood for values x of a standard Gaussian, to
three decimals: the mean of (n + 1) x^2 / (n s^2 + x^2) is 1."""


class Law(NamedTuple):
    """The learnt noise of all pixels.

    `density`, `slope` and `distribution` (point,) are f(z), -f'(z) and the integral of f at z from -`REACH` to `REACH`,
    in sigmas. `information` is the
    mean of (f' / f)^2 and `width_information` that of (z f' / f + 1)^2: Fisher's information of location and log scale;
    `cross_information` is that of both together. Beyond `low` and `high`, in sigmas, the density is `NEGLIGIBLE`.
    `width_spread` is the scale of log width, 0 where all widths are equal; `drift_mm` (DRIFTS,) has the scale of each
    polynomial, 0 without this polynomial. `background_near` and `background_far` are the pseudo-counts, in samples, of
    background and of the rest.
    """

    density: FloatArray
    slope: FloatArray
    distribution: FloatArray
    information: float
    width_information: float
    cross_information: float
    low: float
    high: float
    width_spread: float
    drift_mm: FloatArray
    background_near: float
    background_far: float


@borrowing
def at_table(z: float, table: FloatArray) -> float:
    """Interpolate linearly in a table of `Law` at z, in sigmas; 0 beyond its ends."""
    t = (z + REACH) * STEPS
    if not 0.0 <= t < len(table) - 1:
        return 0.0
    j = int(t)
    return float(table[j] + (t - j) * (table[j + 1] - table[j]))


@borrowing
def log_prior_t(value: float, scale: float) -> float:
    """Logarithm of a Student t density at `value`, less that at 0; 0 where the scale is 0."""
    if scale <= 0.0:
        return 0.0
    ratio = value / scale
    return float(-0.5 * (TAIL_DEGREES + 1.0) * math.log(1.0 + ratio * ratio / TAIL_DEGREES))


@borrowing
def precision_of_t(value: float, scale: float) -> float:
    """Precision of the Gaussian whose log density has the slope of the log prior at `value`, for a step of EM."""
    return (TAIL_DEGREES + 1.0) / (TAIL_DEGREES * scale * scale + value * value)


def _distribution(density: FloatArray) -> FloatArray:
    """Integral of a density (point,), linear between its points, from the first point on; 1 at the last."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.ascontiguousarray(total / total[-1])


def law_of(
    shape: NoiseShape | None,
    *,
    background: tuple[float, float],
    width_spread: float = 0.0,
    drift_mm: FloatArray | None = None,
) -> Law:
    """Make the tables of a shape, with the priors.

    Parameters
    ----------
    shape : NoiseShape or None
        None is a Gaussian.
    background : (float, float)
        Pseudo-counts of background and of the rest.
    width_spread : float
        Scale of log width; 0: all widths are equal.
    drift_mm : (DRIFTS,) float64, optional
        Scale of each polynomial of time, mm; default: no drift.
    """
    z = np.arange(-REACH * STEPS, REACH * STEPS + 1) / STEPS
    if shape is None:
        density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
        slope = z * density
    else:
        density = shape.pdf(z)
        slope = -np.gradient(density, z)
    area = density.sum() / STEPS
    density, slope = density / area, slope / area
    # With g = sqrt(f), (f' / f)^2 f = 4 g'^2: no quotient of small numbers where a density ends at an edge.
    root = np.sqrt(density)
    steep = -0.5 * z * root if shape is None else np.gradient(root, z)
    wide = 2.0 * z * steep + root
    seen = np.flatnonzero(density > NEGLIGIBLE * density.max())
    return Law(
        density=np.ascontiguousarray(density),
        slope=np.ascontiguousarray(slope),
        distribution=_distribution(density),
        information=float(4.0 * (steep @ steep) / STEPS),
        width_information=float(wide @ wide / STEPS),
        cross_information=float(2.0 * (steep @ wide) / STEPS),
        low=float(z[seen[0]]),
        high=float(z[seen[-1]]),
        width_spread=float(width_spread),
        drift_mm=np.zeros(DRIFTS) if drift_mm is None else np.array(drift_mm, dtype=np.float64),
        background_near=float(background[0]),
        background_far=float(background[1]),
    )
