"""EM that arrives: squared extrapolation on top of `mixture`'s E and M steps.

Where surfaces overlap, EM creeps: a hundred iterations may leave a mean a good part of its standard error away. Two
steps of EM give the rate of convergence, and the extrapolation uses this rate. A step that lowers the likelihood is
undone. The end is a fixed point of EM, as without it.

References
----------
Varadhan and Roland, Scandinavian J. Statistics 35(2), 2008, doi:10.1111/j.1467-9469.2007.00585.x: scheme S3.
"""

import math

from tofmix.compiled.jit import borrowing
from tofmix.estimation.beam import Beam
from tofmix.estimation.mixture.components import MEAN, SIGMA, STEPS, UNIT, WEIGHT, Components, Scratch
from tofmix.estimation.mixture.em import PRIOR_SAMPLES, em_step, expect, maximise
from tofmix.estimation.noise.kernel import sigma_at
from tofmix.estimation.samples import Readings
from tofmix.estimation.settings import MODE_PRIOR, MODE_TIED

_LONGEST_JUMP = 64.0
"""Most EM steps that one extrapolation stands for."""

_LEAST_SHARE = 1.0e-9
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
        if fit[row + 2, i] < _LEAST_SHARE:
            return False
        total += fit[row + 2, i]
    if no_return < 0.0 or (no_return < _LEAST_SHARE < fit[WEIGHT, -1]):
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
        jump = min(math.sqrt(step2 / bend2), _LONGEST_JUMP) if bend2 > 0.0 else 1.0
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
