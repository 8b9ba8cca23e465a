"""Fit the added effects again, each given the others: numbers, and hidden states."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tofmix.arrays import IntArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.widths import with_widths
from tofmix.reconciliation.parameters.fits import Numbers, fit
from tofmix.reconciliation.parameters.pattern_errors import pattern_of
from tofmix.reconciliation.parameters.standard_errors import polish
from tofmix.reconciliation.search import links
from tofmix.reconciliation.search.name import SLACK, TriedEffect
from tofmix.simulation.effects.base import Effect, with_hidden
from tofmix.simulation.effects.hidden import DisturbedFrames, PixelBias, PixelValue

_MOST_TURNS = 8  # of numbers and latent states


def refit(
    likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], part: Part
) -> tuple[ModelState, list[TriedEffect]]:
    """Fit all effects again, each given the others, then all numbers together.

    Parameters
    ----------
    likelihood, state
        As they stand.
    chosen : sequence of TriedEffect
        The state's effects, in its order.
    part : (frames, pixels)
        Data of the fits.
    """
    chosen = list(chosen)
    for k, candidate in enumerate(chosen):
        if candidate.fitted is None or not candidate.fitted.problem.steps:
            continue
        rest = without(state, k)
        fitted = fit(candidate.fitted.problem, likelihood, rest, part, start=candidate.fitted.vector)
        chosen[k] = replace(candidate, effect=fitted.effect, fitted=fitted)
        state = replace(state, effects=(*rest.effects[:k], fitted.effect, *rest.effects[k:]))
    return all_together(likelihood, state, chosen, part)


def all_together(
    likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], part: Part
) -> tuple[ModelState, list[TriedEffect]]:
    """The last step of `refit`, of effects that are fitted already: all numbers move together, with hidden states.

    Parameters as of `refit`.
    """
    state = latent_states(likelihood, state, part[0])
    last = settle(numbers(likelihood, state, chosen, part))
    ends = [replace(c, fitted=last.fits.get(k, c.fitted)) for k, c in enumerate(chosen)]
    return last.state, [replace(c, effect=e) for c, e in zip(ends, last.state.effects, strict=True)]


def settle(numbers: Numbers) -> Numbers:
    """Move all numbers together to the top of the log-likelihood, then fit latent states.

    Numbers and a fixed pattern's spreads alternate until the numbers converge.
    """
    for _ in range(_MOST_TURNS):
        last = polish(numbers)
        if last is numbers:
            break
        numbers = replace(last, state=latent_states(last.likelihood, last.state, last.part[0]))
        if pattern_of(numbers.state) is None:
            break
    return numbers


def without(state: ModelState, number: int) -> ModelState:
    """The model without one of the effects."""
    return replace(state, effects=(*state.effects[:number], *state.effects[number + 1 :]))


def without_pattern(state: ModelState, pattern: int) -> ModelState:
    """The state without the added effect of this number, a fixed pattern, and without its map."""
    return without(state, pattern).unpatterned


def numbers(likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], part: Part) -> Numbers:
    """The searched effects as one vector of numbers."""
    fits = {k: c.fitted for k, c in enumerate(chosen) if c.fitted is not None and c.fitted.problem.steps}
    return Numbers(likelihood=likelihood, state=state, fits=fits, part=part)


def begin(likelihood: Likelihood, frames: IntArray, tolerance: float) -> ModelState:
    """The model as given, with the hidden states of its own effects in this recording, and no other effect.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    frames : (n,) int64
        Frames for a pattern's map.
    tolerance : float
        Error of a map of the model, in sigma. It was measured, possibly in a recording as short as this one, so its
        error is at least that of a mean over this recording.
    """
    state = likelihood.start()
    if any(hidden.map_of(e) is not None for e, hidden in with_hidden(likelihood.scene.effects, PixelBias)):
        mixture = likelihood.scene.mixture()
        least = 1.0 / likelihood.evidence.shape[0]  # a mean of as many frames
        error = max((SLACK * tolerance) ** 2, least if tolerance > 0 else 0.0)
        state = replace(state, pixel_variance=error * mixture.of_main(mixture.sigma) ** 2)
    for effect, hidden in with_hidden(state.given, PixelValue):
        known = hidden.map_of(effect)
        if known is not None:
            state = replace(state, stuck_mm=known.values.ravel().astype(np.float64))
            continue
        found = links.find_stuck(likelihood, likelihood.scene.mixture())
        if found is not None:
            state = replace(state, stuck_mm=found)
    return latent_states(likelihood, state, frames)


def latent_states(likelihood: Likelihood, state: ModelState, frames: IntArray) -> ModelState:
    """Fit the effects that link samples again, given the others; of the model's own effects, only their hidden states.

    Parameters
    ----------
    likelihood, state
        As they stand.
    frames : (n,) int64
        Frames for a pattern's map.
    """
    mixture = likelihood.mixture(state)
    part = frames, np.arange(likelihood.evidence.shape[1])
    for effect in state.linking:
        if not effect.hides:
            continue
        own = effect in state.given
        hidden = effect.hidden
        if isinstance(hidden, PixelBias):
            bare = state.unpatterned if state.errors else replace(state, pixel_bias=np.zeros_like(state.pixel_bias))
            fitted = None if own else links.fit_pattern(likelihood, mixture, bare, part)
            spreads = hidden.spreads(effect) if fitted is None else fitted[0]
            pattern, variance = links.pattern_map(likelihood, mixture, bare, spreads, frames)
            state = replace(state, pixel_bias=pattern, pixel_variance=variance)
            image = links.pattern_image(pattern, likelihood.evidence.image)
            state = _with(state, effect, hidden.with_map(hidden.changed(effect, spreads), image))
        elif isinstance(hidden, DisturbedFrames):
            bursts = hidden.chain(effect)
            bursts = bursts if own else links.fitted_again(likelihood, mixture, state, part, bursts)
            disturbed = links.disturbed_frames(likelihood, mixture, state, bursts)
            state = _with(replace(state, disturbed=disturbed), effect, hidden.changed(effect, bursts))
    return with_widths(likelihood, state, frames)


def _with(state: ModelState, old: Effect, new: Effect) -> ModelState:
    """The state with one of its effects replaced; the model's own effects do not change."""
    return replace(state, effects=tuple(new if e is old else e for e in state.effects))
