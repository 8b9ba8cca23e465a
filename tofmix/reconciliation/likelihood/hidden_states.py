"""The hidden states of a recording under a model: begun with the model as given, and fitted again beside effects."""

from dataclasses import replace

import numpy as np

from tofmix.arrays import IntArray
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.widths import with_widths
from tofmix.simulation.effects.base import Effect, with_hidden
from tofmix.simulation.effects.hidden import DisturbedFrames, PixelBias, PixelValue

SLACK = 1.15
"""Factor on the tolerance, which is a typical error and not the largest one."""


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
        found = hidden_fits.find_stuck(likelihood, likelihood.scene.mixture())
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
            fitted = None if own else hidden_fits.fit_pattern(likelihood, mixture, bare, part)
            spreads = hidden.spreads(effect) if fitted is None else fitted[0]
            pattern, variance = hidden_fits.pattern_map(likelihood, mixture, bare, spreads, frames)
            state = replace(state, pixel_bias=pattern, pixel_variance=variance)
            image = hidden_fits.pattern_image(pattern, likelihood.evidence.image)
            state = _with(state, effect, hidden.with_map(hidden.changed(effect, spreads), image))
        elif isinstance(hidden, DisturbedFrames):
            bursts = hidden.chain(effect)
            bursts = bursts if own else hidden_fits.fitted_again(likelihood, mixture, state, part, bursts)
            disturbed = hidden_fits.disturbed_frames(likelihood, mixture, state, bursts)
            state = _with(replace(state, disturbed=disturbed), effect, hidden.changed(effect, bursts))
    return with_widths(likelihood, state, frames)


def _with(state: ModelState, old: Effect, new: Effect) -> ModelState:
    """The state with one of its effects replaced; the model's own effects do not change."""
    return replace(state, effects=tuple(new if e is old else e for e in state.effects))


def without(state: ModelState, number: int) -> ModelState:
    """The model without one of the effects."""
    return replace(state, effects=(*state.effects[:number], *state.effects[number + 1 :]))


def without_pattern(state: ModelState, pattern: int) -> ModelState:
    """The state without the added effect of this number, a fixed pattern, and without its map."""
    return without(state, pattern).unpatterned
