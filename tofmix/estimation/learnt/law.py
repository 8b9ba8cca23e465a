"""The learnt noise as kernels read it: tables of the shape, and the priors of width, drift and background.

The density of a stored sample: the noise integrated over the step on which it lies.

A sample x that is stored on a step s stands for all ranges from x - s / 2 to x + s / 2. With the noise's distribution
F, its density is (F((x + s / 2 - mu) / w) - F((x - s / 2 - mu) / w)) / s, which is that of the noise where s is small
against its width w. Learning, EM, gains and standard errors all take it from here. Row `CELL` of the scratch has s / 2
of each sample, and 0 without a step.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.estimation.beam import Beam, sigma_at
from tofmix.noise_shape import DRIFTS, SIGMA_OF_STEP, TAIL_DEGREES, NoiseShape

STEPS = 32
"""Points of the tables by sigma."""

REACH = 24.0
"""Ends of the tables, in sigmas from the surface; the density is 0 beyond."""

SCALE_OF_SPREAD = 0.831
"""Scale s of the Student t of n = `TAIL_DEGREES` with the largest likelihood for values x of a standard Gaussian, to
three decimals: the mean of (n + 1) x^2 / (n s^2 + x^2) is 1."""


class Law(NamedTuple):
    """The learnt noise of all pixels.

    `density`, `slope` and `distribution` (point,) are f(z), -f'(z) and the integral of f at z from -`REACH` to `REACH`,
    in sigmas. `information` is the
    mean of (f' / f)^2 and `width_information` that of (z f' / f + 1)^2: Fisher's information of location and log scale;
    `cross_information` is that of both together. Beyond `low` and `high`, in sigmas, the density is negligible.
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
    # less of its peak plays no part in the search for a surface
    seen = np.flatnonzero(density > 1.0e-4 * density.max())
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


@borrowing
def has_steps(beam: Beam) -> bool:
    """Whether the samples are stored on a step that matters."""
    return len(beam.steps.step_mm) > 0


@borrowing
def step_at(range_mm: float, beam: Beam) -> float:
    """Step of stored ranges, mm, at a range, mm; 0 without one."""
    if len(beam.steps.step_mm) == 0:
        return 0.0
    return sigma_at(range_mm, beam.steps.range_mm, beam.steps.step_mm)


@borrowing
def spread_at(range_mm: float, beam: Beam) -> float:
    """Standard deviation, mm, of stored samples of a surface at a range, mm: sigma and rounding."""
    sigma = sigma_at(range_mm, beam.curve_range, beam.curve_sigma)
    if len(beam.steps.step_mm) == 0:
        return sigma
    rounding = SIGMA_OF_STEP * step_at(range_mm, beam)
    return math.sqrt(sigma * sigma + rounding * rounding)


@borrowing
def distribution_at(z: float, law: Law) -> float:
    """F(z), linear between the points of its table."""
    t = (z + REACH) * STEPS
    if not t > 0.0:
        return 0.0
    if t >= len(law.distribution) - 1:
        return 1.0
    j = int(t)
    return float(law.distribution[j] + (t - j) * (law.distribution[j + 1] - law.distribution[j]))


@borrowing
def density_at(z: float, half: float, law: Law) -> float:
    """Density of a stored sample at z, the half of its step being `half`, both in sigmas; f(z) where it is 0."""
    if half <= 0.0:
        return at_table(z, law.density)
    return (distribution_at(z + half, law) - distribution_at(z - half, law)) / (2.0 * half)


@borrowing
def slope_at(z: float, half: float, law: Law) -> float:
    """Minus the derivative of `density_at` by z."""
    if half <= 0.0:
        return at_table(z, law.slope)
    return (at_table(z - half, law.density) - at_table(z + half, law.density)) / (2.0 * half)


@borrowing
def edges_at(z: float, half: float, law: Law) -> float:
    """Mean of f at both ends of the step: density plus the derivative by log width is z times the slope less this."""
    return 0.5 * (at_table(z - half, law.density) + at_table(z + half, law.density))


@borrowing
def lend_cells(
    y: FloatArray,
    half: FloatArray,
    n: int,
    mean: float,
    width: float,
    law: Law,
    density: FloatArray,
    slope: FloatArray,
) -> None:
    """Fill `density`, 1/mm, and `slope` at the first `n` of y, as `em.lend`, for samples with steps of twice `half`."""
    scale = 1.0 / width
    for j in range(n):
        z, h = (y[j] - mean) * scale, half[j] * scale
        density[j] = scale * density_at(z, h, law)
        slope[j] = scale * slope_at(z, h, law)


@borrowing
def fill_edges(y: FloatArray, half: FloatArray, mean: float, width: float, law: Law, out: FloatArray) -> None:
    """Fill `out` with `edges_at`, 1/mm, of samples y with steps of twice `half`, mm, of a surface."""
    scale = 1.0 / width
    for j in range(len(out)):
        out[j] = scale * edges_at((y[j] - mean) * scale, half[j] * scale, law)


@borrowing
def cell_information(offset: float, step: float, law: Law) -> tuple[float, float, float]:
    """Fisher's information of location and log width, and that of both together, of one sample.

    `offset` is the distance of some stored value from the mean, and `step` that of neighbouring ones, in sigmas.
    """
    location, width, cross = 0.0, 0.0, 0.0
    upper = offset - step * (int((offset + REACH) / step) + 0.5)
    end_density, end_distribution = at_table(upper, law.density), distribution_at(upper, law)
    negligible = 1.0e-12  # probability of a cell that has no part in the information
    while upper < REACH:
        lower, low_density, low_distribution = upper, end_density, end_distribution
        upper += step
        end_density, end_distribution = at_table(upper, law.density), distribution_at(upper, law)
        probability = end_distribution - low_distribution
        if probability > negligible:
            by_mean, by_width = low_density - end_density, lower * low_density - upper * end_density
            location += by_mean * by_mean / probability
            width += by_width * by_width / probability
            cross += by_mean * by_width / probability
    return location, width, cross


@borrowing
def information_of(
    value: FloatArray, support: float, mean: float, width: float, law: Law, beam: Beam
) -> tuple[float, float, float]:
    """`cell_information` of a surface of `support` of the samples (n,), ascending, mm; that of the law without a step.

    Samples of one value tell the range to no better than their step, and to no worse.
    """
    step = step_at(mean, beam)
    if step <= 0.0:
        return law.information, law.width_information, law.cross_information
    first, stop = 0, len(value) - 1
    while first < stop:
        middle = (first + stop) // 2
        if value[middle] < mean - 0.5 * step:
            first = middle + 1
        else:
            stop = middle
    location, own, cross = cell_information((value[first] - mean) / width, step / width, law)
    rounding = SIGMA_OF_STEP * step / width
    return max(location, 1.0 / (1.0 + support * rounding * rounding)), own, cross
