"""The peer of `reconcile`: greedy selection by BIC, on the same likelihood.

In each round every kind is fitted to all samples beside the effects that were added. The effect with the lowest BIC is
added, and all are fitted again. The search ends where BIC rises. There is no other rule: no held-out data, no
tolerance of the model, no rivals, no aliases, and no check of what is left.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.parameters.pattern_errors import latent_errors
from tofmix.reconciliation.parameters.standard_errors import standard_errors
from tofmix.reconciliation.search.name import Trial, TriedEffect, candidates
from tofmix.reconciliation.search.refit import begin, numbers, refit
from tofmix.reconciliation.search.search_state import Settings
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
    likelihood = joint_likelihood(((model, evidence),))
    frames, pixels = evidence.shape
    whole = np.arange(frames), np.arange(pixels)
    price = 0.5 * math.log(max(int((evidence.samples > 0).sum()), 1))  # of a number: half of BIC's, as gains are nats
    state, chosen = begin(likelihood, whole[0], settings.tolerance), list[TriedEffect]()
    while len(chosen) < settings.max_effects:
        found = candidates(_all_samples(likelihood, state, whole, settings.seed), settings.kinds, tick)
        best = max(found, key=lambda c: c.gain - price * c.parameters, default=None)
        if best is None or best.gain <= price * best.parameters:
            break
        state, chosen = refit(likelihood, best.state, [*chosen, best], whole)
    effects = _described(likelihood, state, chosen, whole, settings.seed)
    return {"verdict": "explained" if chosen else "agree", "effects": effects, "aliases": []}


def _all_samples(likelihood: Likelihood, state: ModelState, whole: Part, seed: int) -> Trial:
    """A round in which each effect is fitted to all samples, and gains on all samples."""
    mixture = likelihood.mixture(state)
    return Trial(
        likelihood=likelihood,
        state=state,
        mixture=mixture,
        scores=likelihood.scores(state, whole, seed, mixture),
        fit_part=whole,
        test_part=whole,
        base=likelihood.value(state, whole, mixture),
    )


def _described(
    likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], whole: Part, seed: int
) -> list[dict[str, Any]]:
    """Each effect with its numbers and their standard errors."""
    errors_of = standard_errors(numbers(likelihood, state, chosen, whole))
    out = []
    for k, candidate in enumerate(chosen):
        effect, errors = state.effects[k], errors_of.get(k, {})
        if candidate.fitted is None and k not in errors_of:
            effect, errors = latent_errors(likelihood, state, effect, seed)
        values = {name: getattr(effect, name) for name in effect.parameters()}
        out.append({"kind": effect.kind, "parameters": values, "stderr": errors})
    return out
