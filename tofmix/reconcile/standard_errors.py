"""Standard errors of a fitted effect's numbers, from the curvature of the log-likelihood."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconcile.fits import Fitted
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.simulation.effects import Effect

_UNIT = (0.3, 3.0)  # a drop of the log-likelihood that counts as 1


def standard_errors(fitted: Fitted, likelihood: Likelihood, state: State, part: Part) -> dict[str, float]:
    """Standard errors of an effect's numbers from the curvature of the log-likelihood.

    Parameters
    ----------
    fitted : Fitted
        The effect at its maximum.
    likelihood, state, part
        As for `fit`; the state without the effect.
    """
    x0, n = fitted.vector, fitted.problem.parameters
    if n == 0:
        return {}

    def value(x: FloatArray) -> float:
        try:
            return likelihood.objective(replace(state, effects=(*state.effects, fitted.problem.make(x))), part)
        except ValueError:
            return -math.inf

    top = value(x0)
    steps: FloatArray = np.array([_unit_drop(value, x0, k, fitted.problem.steps[k], top) for k in range(n)])
    hessian = np.zeros((n, n))
    unit = np.diag(steps)
    single = [(value(x0 + unit[k]), value(x0 - unit[k])) for k in range(n)]
    for i in range(n):
        hessian[i, i] = -(single[i][0] + single[i][1] - 2 * top)
        for j in range(i):
            both = value(x0 + unit[i] + unit[j]) + value(x0 - unit[i] - unit[j])
            hessian[i, j] = hessian[j, i] = -0.5 * (both - sum(single[i]) - sum(single[j]) + 2 * top)
    if not np.isfinite(hessian).all():
        hessian = np.diag(np.where(np.isfinite(np.diag(hessian)), np.diag(hessian), 1.0))
    covariance = np.linalg.pinv(hessian + 1e-6 * np.eye(n))
    return _to_parameters(fitted, np.asarray(covariance, dtype=np.float64), steps)


def _unit_drop(value: Callable[[FloatArray], float], x0: FloatArray, k: int, step: float, top: float) -> float:
    """A step along one number that lowers the log-likelihood by about 1."""
    h = step * 0.05
    for _ in range(4):
        shift = np.zeros(x0.size)
        shift[k] = h
        drop = 0.5 * (2 * top - value(x0 + shift) - value(x0 - shift))
        if not math.isfinite(drop):
            h *= 0.2
        elif drop <= 0:
            h *= 5
        elif not _UNIT[0] < drop < _UNIT[1]:
            h *= min(max(drop**-0.5, 0.02), 20.0)
        else:
            break
    return h


def _to_parameters(fitted: Fitted, covariance: FloatArray, steps: FloatArray) -> dict[str, float]:
    """Standard errors of the effect's own numbers, by the slopes of `make`."""
    numbers = numeric(fitted.effect)
    slopes = np.zeros((len(numbers), steps.size))
    for k in range(steps.size):
        shift = np.zeros(steps.size)
        shift[k] = 0.3 * steps[k]
        try:
            above, below = (numeric(fitted.problem.make(fitted.vector + s * shift)) for s in (1, -1))
        except ValueError:
            continue
        for row, name in enumerate(numbers):
            change = above[name] - below[name]
            if name == "phase_rad":
                change = math.remainder(change, 2 * math.pi)
            slopes[row, k] = change / 0.6
    variance = np.einsum("ik,kl,il->i", slopes, covariance, slopes)
    return {name: float(math.sqrt(max(v, 0.0))) for name, v in zip(numbers, variance, strict=True)}


def numeric(effect: Effect) -> dict[str, float]:
    """An effect's numbers by name."""
    values = {name: getattr(effect, name) for name in effect.parameters()}
    return {name: float(v) for name, v in values.items() if isinstance(v, int | float)}
