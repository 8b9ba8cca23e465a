"""Accelerated EM under the learnt noise: its steps are extrapolated, as in `tofmix.estimation.mixture.em`.

A vector holds all numbers of a fit. Two steps of EM give three vectors, and a jump along the curve through them stands
for many steps. A jump that lowers the objective is taken back.

References
----------
Varadhan and Roland, Scandinavian J. Statistics 35(2), 2008, doi:10.1111/j.1467-9469.2007.00585.x: scheme S3.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.estimation.beam import Beam, sigma_at
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DRIFT,
    FIRST,
    LOG_WIDTH,
    MEAN,
    OWN,
    OWN_NUMBERS,
    PLACE,
    SECOND,
    SIGMA,
    THIRD,
    VECTOR,
    WEIGHT,
    Samples,
)
from tofmix.estimation.learnt.em import drifts, em_step, mix, objective, step_up
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.mixture.em import LEAST_SHARE
from tofmix.noise_shape import DRIFTS, MOST_LOG_WIDTH

LEARNING_ITER, LEARNING_TOL = 60, 1.0e-3
"""Most EM iterations, and tolerance in sigmas, of the fits that noise is learnt from."""


@borrowing
def _pack(k: int, fit: FloatArray, law: Law, row: int) -> None:
    """Write means (in sigmas), shares, drifts (in sigmas) and the pixel's numbers to the rows from `row` on."""
    unit, moving = fit[PLACE, -1], drifts(law) > 0
    for i in range(k):
        fit[row, i] = fit[MEAN, i] / unit
        fit[row + 1, i] = fit[WEIGHT, i]
        if moving:
            for d in range(DRIFTS):
                fit[row + 2 + d, i] = fit[DRIFT + d, i] / unit
    fit[row + 1, -1] = fit[WEIGHT, -1]
    for number in range(OWN_NUMBERS):
        fit[row + VECTOR - 1, number] = fit[OWN, number]


@borrowing
def _unpack(k: int, fit: FloatArray, law: Law, row: int, beam: Beam) -> bool:
    """Set the fit from the rows that `_pack` fills; false, and nothing is set, where a share is too small."""
    unit, no_return, total = fit[PLACE, -1], fit[row + 1, -1], 0.0
    own = row + VECTOR - 1
    background = fit[own, BACKGROUND]
    for i in range(k):
        if fit[row + 1, i] < LEAST_SHARE:
            return False
        total += fit[row + 1, i]
    if no_return < 0.0 or (no_return < LEAST_SHARE < fit[WEIGHT, -1]) or not 0.0 <= background < 1.0:
        return False
    scale = (1.0 - background) / (total + no_return)
    moving = drifts(law) > 0
    for i in range(k):
        fit[MEAN, i] = fit[row, i] * unit
        fit[SIGMA, i] = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        fit[WEIGHT, i] = fit[row + 1, i] * scale
        if moving:
            for d in range(DRIFTS):
                fit[DRIFT + d, i] = fit[row + 2 + d, i] * unit
    fit[WEIGHT, -1] = no_return * scale
    fit[OWN, LOG_WIDTH] = min(max(fit[own, LOG_WIDTH], -MOST_LOG_WIDTH), MOST_LOG_WIDTH)
    fit[OWN, BACKGROUND] = background
    return True


@borrowing
def _step_and_bend(k: int, fit: FloatArray, law: Law) -> tuple[float, float, float]:
    """Squared norms of the step and of its change from vector to vector, and the largest last step of a number."""
    step2, bend2, last = 0.0, 0.0, 0.0
    for row in range(VECTOR):
        if 2 <= row < VECTOR - 1 and drifts(law) == 0:  # noqa: PLR2004  rows of drifts
            continue
        for i in range(OWN_NUMBERS if row == VECTOR - 1 else k):
            step = fit[SECOND + row, i] - fit[FIRST + row, i]
            after = fit[THIRD + row, i] - fit[SECOND + row, i]
            step2 += step * step
            bend2 += (after - step) ** 2
            last = max(last, abs(after))
    step = fit[SECOND + 1, -1] - fit[FIRST + 1, -1]
    after = fit[THIRD + 1, -1] - fit[SECOND + 1, -1]
    return step2 + step * step, bend2 + (after - step) ** 2, max(last, abs(after))


@borrowing
def _extrapolate(k: int, jump: float, fit: FloatArray, law: Law) -> None:
    """Set the first vector to the place that the three vectors lead to."""
    for row in range(VECTOR):
        if 2 <= row < VECTOR - 1 and drifts(law) == 0:  # noqa: PLR2004  rows of drifts
            continue
        for i in range(OWN_NUMBERS if row == VECTOR - 1 else k):
            step = fit[SECOND + row, i] - fit[FIRST + row, i]
            bend = fit[THIRD + row, i] - fit[SECOND + row, i] - step
            fit[FIRST + row, i] += 2.0 * jump * step + jump * jump * bend
    step = fit[SECOND + 1, -1] - fit[FIRST + 1, -1]
    bend = fit[THIRD + 1, -1] - fit[SECOND + 1, -1] - step
    fit[FIRST + 1, -1] += 2.0 * jump * step + jump * jump * bend


@borrowing
def maximise(
    data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, max_iter: int, tol: float, scratch: FloatArray
) -> int:
    """Run accelerated EM on `k` surfaces from the values in `fit`; return its iterations, negative if not converged.

    It has converged if no number of a vector moves by more than `tol`, in sigmas or as a share.
    """
    if k == 0 and fit[WEIGHT, -1] == 0.0:
        fit[OWN, BACKGROUND] = 1.0
        return 0
    iterations = 0
    fit[PLACE, -1] = fit[SIGMA, 0] if k > 0 else beam.sigma_max
    longest_jump = 32.0  # most EM steps that one jump stands for
    while iterations + 2 <= max_iter:
        _pack(k, fit, law, FIRST)
        em_step(data, k, fit, law, beam, scratch)
        _pack(k, fit, law, SECOND)
        em_step(data, k, fit, law, beam, scratch)
        _pack(k, fit, law, THIRD)
        iterations += 2
        step2, bend2, last = _step_and_bend(k, fit, law)
        jump = min(math.sqrt(step2 / bend2), longest_jump) if bend2 > 0.0 else 1.0
        if last * max(jump, 1.0) < tol:
            return iterations
        if jump <= 1.0 or iterations >= max_iter:
            continue
        # The scratch array still holds p(r) at the second vector.
        _unpack(k, fit, law, SECOND, beam)
        before = objective(data, k, fit, law, scratch)
        _extrapolate(k, jump, fit, law)
        if _unpack(k, fit, law, FIRST, beam):
            iterations += 1
            mix(data, k, fit, law, beam, scratch)
            worse = objective(data, k, fit, law, scratch) < before
            if worse:
                _unpack(k, fit, law, THIRD, beam)
            else:
                step_up(data, k, fit, law, beam, scratch)
        else:
            _unpack(k, fit, law, THIRD, beam)
    return -iterations


@borrowing
def value_of(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Objective of a fit, nat; calls `mix`."""
    mix(data, k, fit, law, beam, scratch)
    return objective(data, k, fit, law, scratch)
