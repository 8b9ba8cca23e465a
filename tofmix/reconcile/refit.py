"""Fit the effects that were added anew, each given the others: their numbers, and the states that link samples."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tofmix.arrays import IntArray
from tofmix.reconcile import links
from tofmix.reconcile.curvature import Numbers
from tofmix.reconcile.fits import fit
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.name import Candidate
from tofmix.reconcile.pattern_errors import pattern_of
from tofmix.reconcile.standard_errors import polish
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.interference import Interference

_MOST_TURNS = 8


def refit(
    likelihood: Likelihood, state: State, chosen: Sequence[Candidate], part: Part
) -> tuple[State, list[Candidate]]:
    """Fit all effects anew, each given the others, then all numbers at once.

    Parameters
    ----------
    likelihood, state
        As they stand.
    chosen : sequence of Candidate
        The state's effects, in its order.
    part : (frames, pixels)
        What the fits may see.
    """
    chosen = list(chosen)
    for _ in range(2 if len(chosen) > 1 else 1):
        for k, candidate in enumerate(chosen):
            if candidate.fitted is None or not candidate.fitted.problem.steps:
                continue
            rest = without(state, k)
            likelihood.scene.anchor(state.effects)
            fitted = fit(candidate.fitted.problem, likelihood, rest, part, start=candidate.fitted.vector)
            chosen[k] = replace(candidate, effect=fitted.effect, fitted=fitted)
            state = replace(state, effects=(*rest.effects[:k], fitted.effect, *rest.effects[k:]))
    likelihood.scene.anchor(state.effects)
    state = latent_states(likelihood, state, part[0])
    last = settle(numbers(likelihood, state, chosen, part))
    ends = [replace(c, fitted=last.fits.get(k, c.fitted)) for k, c in enumerate(chosen)]
    return last.state, [replace(c, effect=e) for c, e in zip(ends, last.state.effects, strict=True)]


def settle(numbers: Numbers) -> Numbers:
    """Move all numbers at once to the top of the log-likelihood; latent states follow.

    Numbers and a fixed pattern's spreads are moved by turns, until the numbers stay.
    """
    for _ in range(_MOST_TURNS):
        last = polish(numbers)
        if last is numbers:
            break
        last.likelihood.scene.anchor(last.state.effects)
        numbers = replace(last, state=latent_states(last.likelihood, last.state, last.part[0]))
        if pattern_of(numbers.state.effects) is None:
            break
    return numbers


def without(state: State, number: int) -> State:
    """The model without one of the effects."""
    return replace(state, effects=(*state.effects[:number], *state.effects[number + 1 :]))


def numbers(likelihood: Likelihood, state: State, chosen: Sequence[Candidate], part: Part) -> Numbers:
    """The effects that were searched for, as one vector of numbers."""
    fits = {k: c.fitted for k, c in enumerate(chosen) if c.fitted is not None and c.fitted.problem.steps}
    return Numbers(likelihood=likelihood, state=state, fits=fits, part=part)


def latent_states(likelihood: Likelihood, state: State, frames: IntArray) -> State:
    """Fit the effects that link samples anew, given the others.

    Parameters
    ----------
    likelihood, state
        As they stand.
    frames : (n,) int64
        What a pattern's map is made from.
    """
    effects = list(state.effects)
    mixture = likelihood.scene.mixture(state.effects)
    part = frames, np.arange(likelihood.evidence.shape[1])
    for k, effect in enumerate(effects):
        if isinstance(effect, FixedPattern):
            bare = replace(state, pixel_bias=np.zeros_like(state.pixel_bias))
            fitted = links.fit_pattern(likelihood, mixture, bare, part)
            spread = effect if fitted is None else fitted[0]
            effects[k] = spread
            pattern, variance = links.pattern_map(likelihood, mixture, bare, spread, frames)
            effects[k] = links.with_map(spread, pattern, likelihood.evidence.image)
            state = replace(state, pixel_bias=pattern, pixel_variance=variance, effects=tuple(effects))
        elif isinstance(effect, Interference):
            bare = replace(state, effects=tuple(e for e in state.effects if e is not effect))
            fitted_bursts = links.fit_interference(likelihood, mixture, bare, part)
            bursts = effect if fitted_bursts is None else fitted_bursts
            effects[k] = bursts
            disturbed = links.disturbed_frames(likelihood, mixture, bare, bursts)
            state = replace(state, disturbed=disturbed, effects=tuple(effects))
    return replace(state, effects=tuple(effects))
