"""Step 5, last rival: an effect of the given model with other numbers.

If such an effect has wrong numbers, added effects can only imitate the correction.
"""

from collections.abc import Sequence
from dataclasses import replace

from tofmix.reconciliation.likelihood.joint import Recording, joint_likelihood
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.search.name import PRICE_NATS, TriedEffect, begin_trial, candidates
from tofmix.reconciliation.search.refit import begin
from tofmix.reconciliation.search.search_state import Settings, fit_part, name_of
from tofmix.reconciliation.verification.smooth_laws import CLEARLY_NATS
from tofmix.simulation.effects.base import Effect, Latent
from tofmix.simulation.effects.registry import EFFECTS
from tofmix.simulation.model import Model


def better_model_effect(
    recordings: Sequence[Recording],
    likelihood: Likelihood,
    added: tuple[float, Sequence[TriedEffect]],
    settings: Settings,
) -> Effect | None:
    """The model's own effect with numbers that are better than all added effects; None without one.

    Parameters
    ----------
    recordings : sequence of (Model, Evidence)
        As given.
    likelihood : Likelihood
        Of them.
    added : (float, sequence of Candidate)
        Held-out log-likelihood with the added effects, and these effects.
    settings : Settings
        How.
    """
    value, chosen = added
    best, top = None, value - PRICE_NATS * sum(c.parameters for c in chosen) + CLEARLY_NATS
    searched = (e for e in likelihood.scene.effects if e.latent is Latent.NONE and e.kind in EFFECTS)
    for effect in dict.fromkeys(searched):  # recorded amplitudes are among the effects, but are no registered kind
        without = joint_likelihood([(_less(model, effect), evidence) for model, evidence in recordings])
        part = fit_part(without, settings)
        trial = begin_trial(without, begin(without, part[0], settings.tolerance), settings.split, settings.seed)
        for candidate in candidates(trial, (effect.kind,)):
            if name_of(candidate) != (effect.kind, getattr(effect, "surface", "")):
                continue
            score = trial.base + candidate.score
            if score > top:
                best, top = candidate.effect, score
    return best


def _less(model: Model, effect: Effect) -> Model:
    return replace(model, effects=tuple(e for e in model.effects if e != effect))
