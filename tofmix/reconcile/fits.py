"""How the search for an effect's parameters runs: maximum likelihood by the simplex of Nelder and Mead."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tofmix.arrays import FloatArray
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.searches import Problem
from tofmix.simulation.effects import Effect

_MOST_CALLS = 90


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """The end of a search: the effect, its vector, and the log-likelihood that was reached."""

    effect: Effect
    vector: FloatArray
    problem: Problem
    value: float


def fit(
    problem: Problem, likelihood: Likelihood, state: State, part: Part, *, start: FloatArray | None = None
) -> Fitted:
    """Maximise the log-likelihood of a part over the parameters of one more effect.

    Parameters
    ----------
    problem : Problem
        The search.
    likelihood : Likelihood
        Of the recording.
    state : State
        The model as it stands.
    part : (frames, pixels)
        What the fit may see.
    start : (parameter,), optional
        Where to start, instead of the problem's starts.
    """

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
        steps = np.array(problem.steps)
        simplex = np.vstack([best, best + np.diag(steps)])
        options: Any = {"initial_simplex": simplex, "maxfev": _MOST_CALLS, "xatol": 1e-4, "fatol": 0.02}
        found = minimize(cost, best, method="Nelder-Mead", options=options)
        best, value = np.asarray(found.x), float(found.fun)
    return Fitted(effect=problem.make(best), vector=best, problem=problem, value=-value)
