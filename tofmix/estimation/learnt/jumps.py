"""Whether a pixel's range drifts or jumps: a slow drift is one surface, a jump within the window is two.

A polynomial follows a jump well enough to have a larger likelihood than two surfaces, whose samples may come in any
order. So the drift is compared with one jump at the best of all times, which has as many free numbers. Where the jump
gains as much as a further surface must, the surfaces of the pixel are counted without drift.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam, background_at
from tofmix.estimation.learnt.acceleration import value_of
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    OWN,
    SIGMA,
    SUPPORT,
    WEIGHT,
    Samples,
)
from tofmix.estimation.learnt.em import log_priors
from tofmix.estimation.learnt.law import Law, density_at, slope_at, step_at
from tofmix.noise_shape import DRIFTS

NEAR_SIGMAS = 5.0
"""Samples this near to the drifting surface, in sigmas beyond its drift, determine the time of the jump."""

LEAST_AFTER = 2
"""Least samples on either side of a jump."""

SIGNIFICANT = 2.0
"""Standard errors from which on a width or a drift exceeds noise, and may stand for a further surface."""

_ROUNDS = 8
"""Steps of scoring for the range on one side of a jump."""


@borrowing
def _side(
    value: FloatArray, start: float, weight: float, background: FloatArray, width: float, half: float, law: Law
) -> float:
    """Log likelihood, nat, of the samples on one side of the jump, at the best range there, from `start`, mm, on.

    `background` is its share times density at each sample, 1/mm, and `half` the half of the step of stored ranges, in
    widths.
    """
    place, total = start, 0.0
    for _ in range(_ROUNDS):
        push, held, total = 0.0, 0.0, 0.0
        for j in range(len(value)):
            z = (value[j] - place) / width
            density = density_at(z, half, law) / width
            p = weight * density + background[j]
            push += weight * slope_at(z, half, law) / (width * p)
            held += weight * density / p
            total += math.log(p)
        if held < 1.0:
            break
        place += min(max(push / (law.information * held), -1.0), 1.0) * width
    return total


@jit
def value_of_jump(data: Samples, fit: FloatArray, law: Law, beam: Beam) -> float:
    """Log likelihood, nat, of one surface with a jump at the best time, instead of the drift of `fit`.

    Minus infinity where the samples are too few for two sides.
    """
    n = len(data.value)
    width = math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, 0]
    reach = 0.0
    for d in range(DRIFTS):
        reach += abs(fit[DRIFT + d, 0])
    reach += NEAR_SIGMAS * width
    order = np.argsort(data.time)
    value, background = np.empty(n), np.empty(n)
    for j in range(n):
        value[j] = data.value[order[j]]
        background[j] = fit[OWN, BACKGROUND] * background_at(value[j], beam) + 1.0e-30
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
    weight = fit[WEIGHT, 0]
    half = 0.5 * step_at(fit[MEAN, 0], beam) / width
    jump = _side(value[: at + 1], first_mean, weight, background[: at + 1], width, half, law)
    jump += _side(value[at + 1 :], second_mean, weight, background[at + 1 :], width, half, law)
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
