"""Whether the range axis folds: of two static biases that fit equally, the one of a turn is no bias.

A wall beyond the unambiguous range appears a turn nearer. A bias, a pose or a second path of metres fits such samples
as well, and the fold alone fits them badly where a pixel has a bias of several sigma. So both hypotheses are compared
with a bias of each pixel integrated out, whose spread is fitted: without the fold it is a turn, with it some mm.
"""

from dataclasses import replace

import numpy as np

from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases, with_pattern
from tofmix.reconciliation.parameters.searches import problems
from tofmix.simulation.effects import basic_kind
from tofmix.simulation.effects.base import Basic, Effect


def fold(likelihood: Likelihood, state: ModelState, part: Part) -> tuple[Effect, ModelState] | None:
    """The fold of the camera's phase, and the state with it, if it explains more than the state; None if not.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        The model with the effects added so far.
    part : (frames, pixels)
        The samples.
    """
    mixture = likelihood.mixture(state)
    if mixture.period > 0:
        return None
    for problem in problems(basic_kind(Basic.FOLD).kind, likelihood, mixture):
        effect = problem.make(np.array(problem.starts[0]))
        folded = replace(state, effects=(*state.effects, effect))
        if _with_biases(likelihood, folded, part) > _with_biases(likelihood, state, part):
            return effect, folded
    return None


def _with_biases(likelihood: Likelihood, state: ModelState, part: Part) -> float:
    """Log-likelihood of a part with a bias of each pixel integrated out, of normal spreads that are fitted."""
    mixture = likelihood.mixture(state)
    found = pixel_biases(likelihood, mixture, state, part)
    bare = likelihood.marginal(mixture, state, part).total
    pattern = hidden_fits.fit_spreads(found, likelihood.evidence.image)
    return bare if pattern is None else bare + with_pattern(found, likelihood.evidence.image, pattern[0])
