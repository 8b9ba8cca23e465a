"""Step 2: the parameters of equation (1) by expectation-maximisation.

Fit a given number of surfaces to one pixel. How many there are comes from
`modes` and `counting`; nothing here chooses it.

p(c_r) and mu_0 = range_max are held fixed, as in the paper. sigma_i is tied to
the noise curve, drawn towards it by a prior, or free. A free sigma runs away
where a component is weak (1252 mm in the paper's Table II); the prior counts as
`PRIOR_SAMPLES` samples that agree with the curve, which a weak component cannot
outvote and a strong one can.

Where surfaces overlap, EM creeps: a hundred iterations may leave a mean a good part of its standard error away. Two
steps of EM give the rate of convergence, and the extrapolation uses this rate. A step that lowers the likelihood is
undone. The end is a fixed point of EM, as without it.

The surfaces under fit and the scratch arrays are plain arrays with a row for each quantity, because fits are
copied, sorted and extrapolated as wholes. A structure of four arrays would be as fast: 0.34 and 0.33 us a round of EM.

`Components` (ROWS, capacity + 1): rows MEAN and SIGMA in mm, WEIGHT, SUPPORT (the sum of a surface's responsibilities,
in samples), GAIN (loss of likelihood without the surface, nat), and scratch rows. The last column is that of c_0: its
WEIGHT is p(c_0).

`Scratch` (rows, values): TOTAL is p(r_j), SHARE the count of r_j by p(r_j), SPARE and OTHER are free for any loop.
RANDOM is p(c_r) times the density of random values, 1/mm, where these are not uniform (`fill_random`). From DENSITY on
follow the normal densities of the surfaces, in 1/mm, and `no_return_row` is that of c_0. From `gradient_row` on there
is room for three rows more for each surface.

References
----------
Varadhan and Roland, Scandinavian J. Statistics 35(2), 2008, doi:10.1111/j.1467-9469.2007.00585.x: scheme S3.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.circle import fold
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import exp_minus, log_of, moments_of, product_of, total_of
from tofmix.estimation.beam import Beam, beam_of, is_uniform, outlier_density_at, sigma_at
from tofmix.estimation.samples import Readings, readings_of
from tofmix.estimation.settings import MODE_FREE, MODE_PRIOR, MODE_TIED, EstimateOptions, kernel_options
from tofmix.estimation.unrolling import unrolled_pixel
from tofmix.sensor import Sensor

MEAN, SIGMA, WEIGHT, SUPPORT, GAIN, MOMENT_1, MOMENT_2, UNIT = range(8)
STEPS = 8
"""From this row on: three vectors of an acceleration, three rows each."""

ROWS = STEPS + 9

TOTAL, SHARE, SPARE, OTHER, MEAN_SCORE, SHARE_SCORE, RANDOM, DENSITY = range(8)

Components = FloatArray
Scratch = FloatArray


@jit
def new_components(capacity: int) -> Components:
    """Room for `capacity` surfaces and c_0."""
    return np.zeros((ROWS, capacity + 1))


@jit
def new_scratch(capacity: int, values: int) -> Scratch:
    """Room for pixels of up to `values` different values and `capacity` surfaces."""
    return np.empty((DENSITY + 4 * capacity + 1, values))


@borrowing
def fill_random(values: FloatArray, beam: Beam, scratch: Scratch) -> None:
    """Fill row RANDOM at values, mm; `em.mix` reads it where random values are not uniform."""
    if not is_uniform(beam):
        for j in range(len(values)):
            scratch[RANDOM, j] = outlier_density_at(values[j], beam)


@borrowing
def capacity_of(fit: Components) -> int:
    """Most surfaces that fit."""
    return len(fit[MEAN]) - 1


@borrowing
def no_return_row(fit: Components) -> int:
    """Row of the densities of c_0."""
    return DENSITY + capacity_of(fit)


@borrowing
def gradient_row(fit: Components) -> int:
    """First row of the gradient."""
    return DENSITY + capacity_of(fit) + 1


@borrowing
def copy_components(k: int, source: Components, target: Components) -> None:
    """Copy the state of `k` surfaces and of c_0."""
    for row in (MEAN, SIGMA, WEIGHT, SUPPORT):
        for i in range(k):
            target[row, i] = source[row, i]
        target[row, -1] = source[row, -1]


@borrowing
def remove_surface(k: int, index: int, fit: Components) -> int:
    """Close the gap that surface `index` leaves; return k - 1."""
    for row in (MEAN, SIGMA, WEIGHT, SUPPORT):
        for i in range(index, k - 1):
            fit[row, i] = fit[row, i + 1]
    return k - 1


@borrowing
def sort_surfaces(k: int, fit: Components, rows: int) -> None:
    """Put the surfaces in order, near to far, in the first `rows` rows: EM may have moved one past another."""
    for i in range(1, k):
        for j in range(i, 0, -1):
            if fit[MEAN, j - 1] <= fit[MEAN, j]:
                break
            for row in range(rows):
                fit[row, j - 1], fit[row, j] = fit[row, j], fit[row, j - 1]


PRIOR_SAMPLES = 50.0
"""Weight of the noise curve in the prior of sigma_i, in samples."""

FREE_SIGMA_FLOOR = 0.1
"""Least free sigma_i in units of the curve's: below it a component shrinks onto one sample without end."""

ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


@borrowing
def gaussians(values: FloatArray, mean: float, sigma: float, out: FloatArray) -> None:
    """Fill `out` with the normal densities of the values, 1/mm."""
    scale, height = 1.0 / sigma, 1.0 / (sigma * ROOT_TWO_PI)
    for j in range(len(values)):
        z = (values[j] - mean) * scale
        out[j] = height * exp_minus(0.5 * z * z)


@borrowing
def mix(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> None:
    """Fill the densities of `scratch`, and p(r | surfaces) of equation (1). `fill_random` has been called."""
    values, total, m = data.value, scratch[TOTAL], len(data.value)
    if is_uniform(beam):
        for j in range(m):
            total[j] = beam.outlier_density
    else:
        for j in range(m):
            total[j] = scratch[RANDOM, j]
    if fit[WEIGHT, -1] > 0.0:
        row, weight = scratch[no_return_row(fit)], fit[WEIGHT, -1]
        gaussians(values, beam.range_max, beam.sigma_max, row)
        for j in range(m):
            total[j] += weight * row[j]
    for i in range(k):
        row, weight = scratch[DENSITY + i], fit[WEIGHT, i]
        gaussians(values, fit[MEAN, i], fit[SIGMA, i], row)
        for j in range(m):
            total[j] += weight * row[j]


@borrowing
def _sum_of_logs(data: Readings, scratch: Scratch) -> float:
    """Log likelihood, nat, from the densities that `mix` stored."""
    count, total, term = data.times, scratch[TOTAL], scratch[SPARE, : len(data.times)]
    for j in range(len(count)):
        term[j] = count[j] * log_of(total[j])
    return float(total_of(term))


@borrowing
def log_likelihood(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> float:
    """Log likelihood of the samples under equation (1), nat."""
    mix(data, k, fit, beam, scratch)
    return _sum_of_logs(data, scratch)


@borrowing
def expect(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> None:
    """E step: support, and in rows MOMENT_1 and MOMENT_2 the moments about the means."""
    mix(data, k, fit, beam, scratch)
    count, total, share = data.times, scratch[TOTAL], scratch[SHARE, : len(data.times)]
    for j in range(len(count)):
        share[j] = count[j] / total[j]
    fit[SUPPORT, -1] = 0.0
    if fit[WEIGHT, -1] > 0.0:
        fit[SUPPORT, -1] = fit[WEIGHT, -1] * product_of(share, scratch[no_return_row(fit)])
    for i in range(k):
        support, first, second = moments_of(data.value, scratch[DENSITY + i], share, fit[MEAN, i])
        fit[SUPPORT, i] = fit[WEIGHT, i] * support  # sum of p(c_i | r_j)
        fit[MOMENT_1, i] = fit[WEIGHT, i] * first
        fit[MOMENT_2, i] = fit[WEIGHT, i] * second


@borrowing
def new_sigma(curve_sigma: float, squares: float, support: float, mode: int) -> float:
    """sigma_i from the squares about the new mean, by the chosen mode."""
    if mode == MODE_TIED:
        return curve_sigma
    if mode == MODE_FREE:
        return max(math.sqrt(squares / support), FREE_SIGMA_FLOOR * curve_sigma)
    return math.sqrt((PRIOR_SAMPLES * curve_sigma**2 + squares) / (PRIOR_SAMPLES + support))


@borrowing
def maximise(k: int, fit: Components, beam: Beam, mode: int) -> float:
    """M step after `expect`; return the largest change: of a mean in sigmas, of a weight as it is."""
    total = fit[SUPPORT, -1]
    for i in range(k):
        total += fit[SUPPORT, i]
    scale = (1.0 - beam.p_outlier) / total if total > 0.0 else 0.0
    change = float(abs(scale * fit[SUPPORT, -1] - fit[WEIGHT, -1]))
    fit[WEIGHT, -1] = scale * fit[SUPPORT, -1]
    for i in range(k):
        support = fit[SUPPORT, i]
        weight = scale * support
        change = max(change, float(abs(weight - fit[WEIGHT, i])))
        fit[WEIGHT, i] = weight
        if support <= 0.0:
            continue
        shift = fit[MOMENT_1, i] / support
        fit[MEAN, i] += shift
        change = max(change, float(abs(shift) / fit[SIGMA, i]))
        curve_sigma = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        squares = max(fit[MOMENT_2, i] - support * shift * shift, 0.0)
        fit[SIGMA, i] = new_sigma(curve_sigma, squares, support, mode)
    return change


@borrowing
def draw_sigmas(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> None:
    """Draw each sigma from the curve's towards the spread of its samples, as the prior has it; all else is held.

    Sigmas that are fitted with the means cost precision where surfaces overlap: the means of a tied fit are better.
    """
    expect(data, k, fit, beam, scratch)
    for i in range(k):
        curve_sigma = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        fit[SIGMA, i] = new_sigma(curve_sigma, fit[MOMENT_2, i], fit[SUPPORT, i], MODE_PRIOR)


@borrowing
def em_step(data: Readings, k: int, fit: Components, beam: Beam, mode: int, scratch: Scratch) -> float:
    """One iteration of EM; return the log likelihood of the values that it started from."""
    expect(data, k, fit, beam, scratch)
    maximise(k, fit, beam, mode)
    return _sum_of_logs(data, scratch)


@borrowing
def expectation_maximisation(
    data: Readings, k: int, fit: Components, beam: Beam, mode: int, max_iter: int, tol: float, scratch: Scratch
) -> int:
    """Run EM on `k` surfaces from the values in `fit`; return its iterations, negative if it did not converge."""
    for iteration in range(max_iter):
        expect(data, k, fit, beam, scratch)
        if maximise(k, fit, beam, mode) < tol:
            return iteration + 1
    return -max_iter


@borrowing
def start_at(places: FloatArray, heights: FloatArray, k: int, no_return: float, fit: Components, beam: Beam) -> None:
    """Start `fit` at step 1's places with weights in proportion to their heights."""
    together = 0.0
    for i in range(k):
        together += heights[i]
    total = no_return + together
    scale = (1.0 - beam.p_outlier) / total if total > 0.0 else 0.0
    for i in range(k):
        fit[MEAN, i] = places[i]
        fit[SIGMA, i] = sigma_at(places[i], beam.curve_range, beam.curve_sigma)
        fit[WEIGHT, i] = scale * heights[i]
    fit[WEIGHT, -1] = scale * no_return


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
    data = readings_of(samples_mm)
    start = np.asarray(start_mm, dtype=np.float64).ravel()
    if not np.isfinite(start).all():
        raise ValueError("start: a starting mean is not finite")
    options = options or EstimateOptions()
    length = options.unambiguous_range_mm
    chosen = kernel_options(options)
    if length is None:
        beam = beam_of(sensor)
    else:
        values, start, beam = unrolled_pixel(data.value, start, sensor, length)
        data = Readings(values, data.times, data.total)
    k = len(start)
    fit, scratch = new_components(max(k, 1)), new_scratch(max(k, 1), len(data.value))
    fill_random(data.value, beam, scratch)
    no_return = 1.0 if math.isfinite(beam.range_max) else 0.0
    start_at(start, np.ones(k), k, no_return, fit, beam)
    n_iter = expectation_maximisation(data, k, fit, beam, chosen.mode, chosen.max_iter, chosen.tol, scratch)
    return MixtureFit(
        mean_mm=fit[MEAN, :k].copy() if length is None else fold(fit[MEAN, :k], length),
        sigma_mm=fit[SIGMA, :k].copy(),
        weight=fit[WEIGHT, :k].copy(),
        weight_no_return=float(fit[WEIGHT, -1]),
        log_likelihood=float(log_likelihood(data, k, fit, beam, scratch)),
        n_iter=abs(n_iter),
        converged=n_iter > 0,
    )


LEAST_SHARE = 1.0e-9
"""Least share after an extrapolation: one to a smaller share is taken back."""

_FIRST, _SECOND, _THIRD = STEPS, STEPS + 3, STEPS + 6
_SHARES = 2
"""Row of a vector that has c_0 too."""


@borrowing
def _pack(k: int, fit: Components, row: int) -> None:
    """Write means (in sigmas), log sigmas, and shares with p(c_0) last, to three rows from `row` on."""
    for i in range(k):
        fit[row, i] = fit[MEAN, i] / fit[UNIT, i]
        fit[row + 1, i] = math.log(fit[SIGMA, i])
        fit[row + 2, i] = fit[WEIGHT, i]
    fit[row + 2, k] = fit[WEIGHT, -1]


@borrowing
def _unpack(k: int, fit: Components, row: int, beam: Beam, mode: int) -> bool:
    """Set the components from the vector of `_pack`; return false, and set nothing, if a share is not above 0."""
    total, no_return = 0.0, fit[row + 2, k]
    for i in range(k):
        if fit[row + 2, i] < LEAST_SHARE:
            return False
        total += fit[row + 2, i]
    if no_return < 0.0 or (no_return < LEAST_SHARE < fit[WEIGHT, -1]):
        return False
    scale = (1.0 - beam.p_outlier) / (total + no_return)
    for i in range(k):
        fit[MEAN, i] = fit[row, i] * fit[UNIT, i]
        fit[WEIGHT, i] = fit[row + 2, i] * scale
        if mode == MODE_TIED:
            fit[SIGMA, i] = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        else:
            fit[SIGMA, i] = math.exp(fit[row + 1, i])
    fit[WEIGHT, -1] = no_return * scale
    return True


@borrowing
def _penalty(k: int, fit: Components, beam: Beam, mode: int) -> float:
    """Log density of the prior of the sigmas, which EM maximises together with the likelihood."""
    out = 0.0
    if mode == MODE_PRIOR:
        for i in range(k):
            ratio = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma) / fit[SIGMA, i]
            out += PRIOR_SAMPLES * (math.log(ratio) - 0.5 * ratio * ratio)
    return out


@borrowing
def maximise_likelihood(
    data: Readings, k: int, fit: Components, beam: Beam, mode: int, max_iter: int, tol: float, scratch: Scratch
) -> int:
    """Run accelerated EM on `k` surfaces from the values in `fit`.

    Return its EM iterations, negative if it did not converge. It has converged when the remaining change, by the rate
    at which the steps shrink, is below `tol`, in sigmas and in shares.
    """
    iterations = 0
    while iterations + 2 <= max_iter:
        for i in range(k):
            fit[UNIT, i] = fit[SIGMA, i]
        _pack(k, fit, _FIRST)
        expect(data, k, fit, beam, scratch)  # em_step, but for the likelihood, which nobody asks for
        maximise(k, fit, beam, mode)
        _pack(k, fit, _SECOND)
        before = _penalty(k, fit, beam, mode) + em_step(data, k, fit, beam, mode, scratch)
        _pack(k, fit, _THIRD)
        iterations += 2
        step2, bend2, last = 0.0, 0.0, 0.0
        for row in range(3):
            for i in range(k + 1 if row == _SHARES else k):
                step = fit[_SECOND + row, i] - fit[_FIRST + row, i]
                after = fit[_THIRD + row, i] - fit[_SECOND + row, i]
                step2 += step * step
                bend2 += (after - step) ** 2
                last = max(last, abs(after))
        # most EM steps that one extrapolation stands for
        jump = min(math.sqrt(step2 / bend2), 64.0) if bend2 > 0.0 else 1.0
        if last * max(jump, 1.0) < tol:
            return iterations
        if jump <= 1.0 or iterations >= max_iter:
            continue
        for row in range(3):
            for i in range(k + 1 if row == _SHARES else k):
                step = fit[_SECOND + row, i] - fit[_FIRST + row, i]
                bend = fit[_THIRD + row, i] - fit[_SECOND + row, i] - step
                fit[_FIRST + row, i] += 2.0 * jump * step + jump * jump * bend
        if _unpack(k, fit, _FIRST, beam, mode):
            penalty = _penalty(k, fit, beam, mode)
            iterations += 1
            if penalty + em_step(data, k, fit, beam, mode, scratch) < before:
                _unpack(k, fit, _THIRD, beam, mode)
    if iterations < max_iter:
        em_step(data, k, fit, beam, mode, scratch)
        iterations += 1
    return -iterations
