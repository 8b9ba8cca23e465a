"""Whether the range axis folds: of two static biases that fit equally, the one of a turn is no bias.

A wall beyond the unambiguous range appears a turn nearer. A bias, a pose or a second path of metres fits such samples
as well, and the fold alone fits them badly where a pixel has a bias of several sigma. So both hypotheses are compared
with a bias of each pixel integrated out, whose spread is fitted: without the fold it is a turn, with it some mm.
"""

from dataclasses import replace

import numpy as np

from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases, with_pattern
from tofmix.reconciliation.parameters.fits import fit
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.search import links
from tofmix.reconciliation.search.name import TriedEffect
from tofmix.reconciliation.search.static_fits import spreads
from tofmix.simulation.effects.phase_wrapping import PhaseWrapping


def fold(likelihood: Likelihood, state: ModelState, part: Part) -> TriedEffect | None:
    """The fold of the camera's phase as a candidate, with its gain in nats over the state; None if there is none.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : State
        The model with the effects added so far.
    part : (frames, pixels)
        The samples.
    """
    mixture = likelihood.mixture(state)
    if mixture.period > 0:
        return None
    for problem in problems(PhaseWrapping.kind, likelihood, mixture):
        fitted = fit(problem, likelihood, state, part)
        folded = replace(state, effects=(*state.effects, fitted.effect))
        gain = _with_biases(likelihood, folded, part) - _with_biases(likelihood, state, part)
        if np.isfinite(gain) and gain > 0:
            return TriedEffect(
                effect=fitted.effect, gain=gain, parameters=problem.parameters, state=folded, fitted=fitted
            )
    return None


def _with_biases(likelihood: Likelihood, state: ModelState, part: Part) -> float:
    """Log-likelihood of a part with a bias of each pixel integrated out, of normal spreads that are fitted."""
    mixture = likelihood.mixture(state)
    found = pixel_biases(likelihood, mixture, state, part)
    bare = likelihood.sums(mixture, state, part).total
    pattern = links.fit_spreads(found, likelihood.evidence.image)
    return bare if pattern is None else bare + with_pattern(found, likelihood.evidence.image, spreads(pattern[0]))
