"""Fits of one effect's numbers by the simplex of Nelder and Mead: a slow reference that needs no slopes."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.parameters.fits import Fitted
from tofmix.simulation.effects.search import Problem


def fit(problem: Problem, likelihood: Likelihood, state: ModelState, part: Part) -> Fitted:
    """Maximise the log-likelihood of a part over the numbers of one more effect, from the best start of its search."""

    def cost(x: Any) -> float:  # noqa: ANN401
        try:
            effect = problem.make(np.asarray(x))
            effect.check(likelihood.scene.model.sensor, likelihood.scene.names)
            return -likelihood.objective(replace(state, effects=(*state.effects, effect)), part)
        except ValueError:
            return math.inf

    best = min((np.array(start, dtype=np.float64) for start in problem.starts), key=cost)
    value = cost(best)
    if problem.steps and math.isfinite(value):
        simplex = np.vstack([best, best + np.diag(problem.steps)])
        options: Any = {"initial_simplex": simplex, "maxfev": max(90, 30 * len(problem.steps)), "fatol": 0.1}
        found = minimize(cost, best, method="Nelder-Mead", options=options | {"xatol": 2e-2})
        best, value = np.asarray(found.x), float(found.fun)
    return Fitted(effect=problem.make(best), vector=best, problem=problem)
