"""EM that arrives: squared extrapolation on top of `mixture`'s E and M steps.

Where surfaces overlap, EM creeps: a hundred iterations may leave a mean a good
part of its standard error away. Two steps of EM tell how fast it creeps; the
extrapolation jumps ahead by that, and a jump that lowers the likelihood is taken
back. The end is a fixed point of EM, as without it.

References
----------
Varadhan and Roland, Scandinavian J. Statistics 35(2), 2008, doi:10.1111/j.1467-9469.2007.00585.x: scheme S3.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.density import sigma_at
from tofmix.estimation.mixture import PRIOR_SAMPLES, Components, em_step
from tofmix.estimation.settings import MODE_PRIOR, MODE_TIED
from tofmix.jit import jit

_LONGEST_JUMP = 64.0
_LEAST_SHARE = 1.0e-9


@jit
def _pack(k: int, fit: Components, unit: FloatArray, out: FloatArray) -> None:
    """Write means (in sigmas), log sigmas, shares and p(c_0) as one vector."""
    for i in range(k):
        out[i] = fit.mean[i] / unit[i]
        out[k + i] = math.log(fit.sigma[i])
        out[2 * k + i] = fit.weight[i]
    out[3 * k] = fit.no_return[0]


@jit
def _unpack(k: int, vector: FloatArray, unit: FloatArray, fit: Components, beam: Beam, mode: int) -> bool:
    """Set the components from a vector; false, and nothing is set, where a share is not above 0."""
    total = vector[3 * k]
    for i in range(k):
        if vector[2 * k + i] < _LEAST_SHARE:
            return False
        total += vector[2 * k + i]
    if vector[3 * k] < 0.0 or (vector[3 * k] < _LEAST_SHARE < fit.no_return[0]):
        return False
    scale = (1.0 - beam.p_outlier) / total
    for i in range(k):
        fit.mean[i] = vector[i] * unit[i]
        fit.weight[i] = vector[2 * k + i] * scale
        if mode == MODE_TIED:
            fit.sigma[i] = sigma_at(fit.mean[i], beam.curve_range, beam.curve_sigma)
        else:
            fit.sigma[i] = math.exp(vector[k + i])
    fit.no_return[0] = vector[3 * k] * scale
    return True


@jit
def _penalty(k: int, fit: Components, beam: Beam, mode: int) -> float:
    """Log density of the prior of the sigmas, which EM climbs beside the likelihood."""
    out = 0.0
    if mode == MODE_PRIOR:
        for i in range(k):
            ratio = sigma_at(fit.mean[i], beam.curve_range, beam.curve_sigma) / fit.sigma[i]
            out += PRIOR_SAMPLES * (math.log(ratio) - 0.5 * ratio * ratio)
    return out


@jit
def maximise_likelihood(
    samples: FloatArray, k: int, fit: Components, beam: Beam, mode: int, max_iter: int, tol: float
) -> int:
    """Run accelerated EM on `k` surfaces from the values in `fit`.

    Return its EM iterations, negative if it did not converge. It has converged when what is left to go, by the
    rate at which the steps shrink, is below `tol`, in sigmas and in shares.
    """
    first, second, third, unit = fit.vectors[0], fit.vectors[1], fit.vectors[2], fit.scratch[1]
    iterations = 0
    while iterations + 2 <= max_iter:
        for i in range(k):
            unit[i] = fit.sigma[i]
        _pack(k, fit, unit, first)
        em_step(samples, k, fit, beam, mode)
        _pack(k, fit, unit, second)
        before = _penalty(k, fit, beam, mode) + em_step(samples, k, fit, beam, mode)
        _pack(k, fit, unit, third)
        iterations += 2
        step2, bend2, last = 0.0, 0.0, 0.0
        for m in range(3 * k + 1):
            step = second[m] - first[m]
            bend = third[m] - second[m] - step
            step2 += step * step
            bend2 += bend * bend
            last = max(last, abs(third[m] - second[m]))
        jump = min(math.sqrt(step2 / bend2), _LONGEST_JUMP) if bend2 > 0.0 else 1.0
        if last * max(jump, 1.0) < tol:
            return iterations
        if jump <= 1.0 or iterations >= max_iter:
            continue
        for m in range(3 * k + 1):
            step = second[m] - first[m]
            bend = third[m] - second[m] - step
            first[m] += 2.0 * jump * step + jump * jump * bend
        if _unpack(k, first, unit, fit, beam, mode):
            penalty = _penalty(k, fit, beam, mode)
            iterations += 1
            if penalty + em_step(samples, k, fit, beam, mode) < before:
                _unpack(k, third, unit, fit, beam, mode)
    if iterations < max_iter:
        em_step(samples, k, fit, beam, mode)
        iterations += 1
    return -iterations
