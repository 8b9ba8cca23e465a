"""Whether a pixel's range jumps rather than drifts: a jump in mid-window is two surfaces, a slow drift is one.

A smooth polynomial follows a jump far enough to beat two surfaces whose samples may come in any order. So the drift is
held against one jump at the best of all times, with as many free numbers: where the jump gains as much as a further
surface must, the pixel is given no drift, and its surfaces are counted.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    OWN,
    SIGMA,
    SUPPORT,
    WEIGHT,
)
from tofmix.estimation.learnt.fitting import Samples, background_density, log_priors, value_of
from tofmix.estimation.learnt.law import Law, at_table
from tofmix.learnt_noise import DRIFTS

NEAR_SIGMAS = 5.0
"""Samples farther from the drifting surface than this do not say when the jump was; half a jump counts as well."""

LEAST_AFTER = 2
"""Samples on either side of a jump."""

SIGNIFICANT = 2.0
"""Standard errors by which a width or a drift must differ from none before it may stand for something else."""

_ROUNDS = 8  # scoring steps for the range on one side of a jump


@borrowing
def _side(value: FloatArray, start: float, weight: float, background: float, width: float, law: Law) -> float:
    """Log likelihood, nat, of the samples on one side of the jump, at the best place of the surface there."""
    place, total = start, 0.0
    for _ in range(_ROUNDS):
        push, held, total = 0.0, 0.0, 0.0
        for j in range(len(value)):
            z = (value[j] - place) / width
            density = at_table(z, law.density) / width
            p = weight * density + background
            push += weight * at_table(z, law.slope) / (width * p)
            held += weight * density / p
            total += math.log(p)
        if held < 1.0:
            break
        place += min(max(push / (law.information * held), -1.0), 1.0) * width
    return total


@jit
def value_of_jump(data: Samples, fit: FloatArray, law: Law, beam: Beam) -> float:
    """Log likelihood, nat, of the samples of `fit`, of one surface, with one jump at the best time instead of a drift.

    Minus infinity where there are too few samples for two sides.
    """
    n = len(data.value)
    width = math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, 0]
    reach = 0.0
    for d in range(DRIFTS):
        reach += abs(fit[DRIFT + d, 0])
    reach += NEAR_SIGMAS * width
    order = np.argsort(data.time)
    value = np.empty(n)
    for j in range(n):
        value[j] = data.value[order[j]]
    inside, total = 0, 0.0
    for j in range(n):
        if abs(value[j] - fit[MEAN, 0]) <= reach:
            inside += 1
            total += value[j]
    before, below, best, at = 0, 0.0, -1.0, -1
    first_mean, second_mean = 0.0, 0.0
    for j in range(n):
        if abs(value[j] - fit[MEAN, 0]) > reach:
            continue
        before += 1
        below += value[j]
        after = inside - before
        if before < LEAST_AFTER or after < LEAST_AFTER:
            continue
        between = below * below / before + (total - below) ** 2 / after
        if between > best or at < 0:
            best, at = between, j
            first_mean, second_mean = below / before, (total - below) / after
    if at < 0:
        return -math.inf
    background = fit[OWN, BACKGROUND] * background_density(beam) + 1.0e-30
    weight = fit[WEIGHT, 0]
    jump = _side(value[: at + 1], first_mean, weight, background, width, law)
    jump += _side(value[at + 1 :], second_mean, weight, background, width, law)
    return jump


@borrowing
def drift_exceeds_noise(i: int, fit: FloatArray, law: Law, n: float) -> bool:
    """Whether the drift of a surface of `n` samples exceeds noise: its root mean square over the standard error."""
    sigma = math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, i]
    square = 0.0
    for d in range(DRIFTS):
        square += fit[DRIFT + d, i] ** 2 / (2.0 * d + 3.0)  # mean square of the polynomial
    return bool(square > (SIGNIFICANT * sigma) ** 2 / (law.information * n))


@jit
def gain_of_jump(data: Samples, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Gain in log likelihood, nat, of one jump over the drift in a fit of one surface; 0 where it does not drift."""
    if not drift_exceeds_noise(0, fit, law, max(fit[SUPPORT, 0], 1.0)):
        return 0.0
    drifting = value_of(data, 1, fit, law, beam, scratch) - log_priors(1, fit, law)
    return value_of_jump(data, fit, law, beam) - drifting
