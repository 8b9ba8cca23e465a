"""Fit an effect's parameters by maximum likelihood, with the simplex of Nelder and Mead."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.joint import acting_part
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.search import Problem

_MOST_CALLS = 90  # of the likelihood, for up to three numbers
_NEAR = 0.1  # of a step, if the start is the end of another search
_ENOUGH_X, _ENOUGH_NATS = 2e-2, 0.1  # enough for a ranking; the last step is Newton's, for all numbers together


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """The end of a search: the effect, its vector, and the log-likelihood that was reached."""

    effect: Effect
    vector: FloatArray
    problem: Problem
    value: float

    @property
    def at_a_bound(self) -> bool:
        """Whether the numbers are so close to a bound that another effect describes the same."""
        return self.problem.other is not None and self.problem.other(self.vector)


def fit(
    problem: Problem, likelihood: Likelihood, state: ModelState, part: Part, *, start: FloatArray | None = None
) -> Fitted:
    """Maximise the log-likelihood of a part over the parameters of one more effect.

    Parameters
    ----------
    problem : Problem
        The search.
    likelihood : Likelihood
        Of the recording.
    state : State
        The model with the effects added so far.
    part : (frames, pixels)
        Data of the fit.
    start : (parameter,), optional
        Start instead of the starts of the problem. It is close to the end, so steps are small.
    """
    part = _part_where_it_acts(problem, likelihood, part)

    def cost(x: FloatArray) -> float:
        try:
            effect = problem.make(np.asarray(x))
            effect.check(likelihood.scene.model.sensor, likelihood.scene.names)
            return -likelihood.objective(replace(state, effects=(*state.effects, effect)), part)
        except ValueError:
            return math.inf

    starts = problem.starts if start is None else (tuple(start),)
    costs = [cost(np.array(x)) for x in starts]
    best = np.array(starts[int(np.argmin(costs))], dtype=np.float64)
    value = min(costs)
    if problem.steps and math.isfinite(value):
        steps = np.array(problem.steps) * (1.0 if start is None else _NEAR)
        simplex = np.vstack([best, best + np.diag(steps)])
        options: Any = {"initial_simplex": simplex, "maxfev": _MOST_CALLS, "xatol": _ENOUGH_X, "fatol": _ENOUGH_NATS}
        found = minimize(cost, best, method="Nelder-Mead", options=options)
        best, value = np.asarray(found.x), float(found.fun)
    return Fitted(effect=problem.make(best), vector=best, problem=problem, value=-value)


def _part_where_it_acts(problem: Problem, likelihood: Likelihood, part: Part) -> Part:
    """The part without recordings in which the effect does not act."""
    for start in problem.starts:
        try:
            return acting_part(likelihood, problem.make(np.array(start)), part)
        except ValueError:
            continue
    return part
