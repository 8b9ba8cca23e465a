"""The peer of `reconcile`: greedy selection by BIC, on the same likelihood.

In each round every kind is fitted to all samples beside the effects that were added. The effect with the lowest BIC is
added, and all are fitted again. The search ends where BIC rises. There is no other rule: no held-out data, no
tolerance of the model, no rivals, no aliases, and no check of what is left.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.outcome import refitted
from tofmix.reconciliation.one.proposals import About, Columns, Proposal, by_trial
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.reconciliation.parameters.pattern_errors import latent_errors
from tofmix.reconciliation.parameters.polish import numbers_of
from tofmix.reconciliation.parameters.standard_errors import standard_errors
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.simulation.model import Model


def greedy_bic(
    model: Model, evidence: Evidence, settings: Settings, tick: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Add effects as long as BIC falls.

    Parameters
    ----------
    model : Model
        As the user has it.
    evidence : Evidence
        The recording.
    settings : Settings
        Kinds that are tried, and how many effects at most; nothing else of it is used but the seed.
    tick : callable
        Told of each kind that was tried.

    Returns
    -------
    dict
        What `users.score.score` takes of a `gap.json`: ``agree`` without an effect, ``explained`` with one.

    References
    ----------
    Schwarz, Ann. Statist. 6 (1978) 461.
    """
    task = SearchTask(joint_likelihood(((model, evidence),)), replace(settings, tolerance=0.0))
    price = 0.5 * math.log(max(int((evidence.samples > 0).sum()), 1))  # of a number: half of BIC's, as gains are nats
    columns, best = Columns.of(task), FittedSet.without_effects(task).fit()
    value = best.log_likelihood(best.x, final=True)
    while len(best.keys) < settings.max_effects:
        tried = []
        for p in chain(About(columns, best).sets(len(best.keys) + 1), by_trial(best)):
            fitted = _fitted(p) if p.keys > best.keys else None
            if fitted is not None:
                tried.append((fitted.log_likelihood(fitted.x, final=True) - price * _numbers(fitted), fitted))
            tick("")
        top, first = max(tried, key=lambda pair: pair[0], default=(-math.inf, best))
        if top <= value:
            break
        value, best = top, first
    return {"verdict": "explained" if best.keys else "agree", "effects": _described(best), "aliases": []}


def _fitted(proposal: Proposal) -> FittedSet | None:
    """A set at its most likely numbers; None if it cannot be."""
    try:
        fitted = proposal.build().fit()
    except ValueError:
        return None
    return None if fitted.refused or not np.isfinite(fitted.evidence) else fitted


def _numbers(fitted: FittedSet) -> int:
    hidden = [e.hidden for e in fitted.linked] + ([fitted.pattern[0].hidden] if fitted.pattern else [])
    return fitted.x.size + sum(max(len(h.numbers), 1) for h in hidden if h is not None)


def _described(best: FittedSet) -> list[dict[str, Any]]:
    """Each effect with its numbers and their standard errors."""
    task, (state, chosen) = best.task, refitted(best)
    like = task.likelihood
    errors_of = standard_errors(numbers_of(like, state, chosen, fit_part(like, task.settings)))
    out = []
    for k, candidate in enumerate(chosen):
        effect, errors = state.effects[k], errors_of.get(k, {})
        if candidate.fitted is None and k not in errors_of:
            effect, errors = latent_errors(like, state, effect, task.settings.seed)
        values = {name: getattr(effect, name) for name in effect.parameters()}
        out.append({"kind": effect.kind, "parameters": values, "stderr": errors})
    return out
