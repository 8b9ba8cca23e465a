"""The hidden states of a recording under a model: begun with the model as given, and fitted again beside effects.

If the camera of the model has a spread of widths, the width of each pixel's noise is one of them: each recording has
its own. Like a fixed pattern's map, widths are estimated from the fitting frames. Then each difference between the
noise of pixels is taken as width.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.mixture import Mixture
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


_GRID = np.linspace(-3.5, 3.5, 8)
"""Starts, in spreads from the mean; one log-normal number in two thousand lies beyond."""

_AROUND = np.linspace(-3.5, 3.5, 9)
"""Points of the average over possible widths, in standard errors from the most likely width."""

_NUDGE = 0.02  # of the log width: a Gaussian's log-likelihood is a parabola over that to 1e-3
_FARTHEST = 0.5
"""Longest step of a log width: the log-likelihood is no parabola over more."""

_LEAST_TOLD = 1e-3
"""Least share of a pixel's width that its samples determine, not the other pixels."""

_COMMON = 3.0
"""Standard errors by which the mean log width of all pixels may differ from 0; beyond, the noise differs."""


def with_widths(likelihood: Likelihood, state: ModelState, frames: IntArray) -> ModelState:
    """The state with the widths of pixels and their standard errors; unchanged without a spread of widths.

    A width is the mean under the likelihood of the frames and the log-normal prior. Noise that is wider in all pixels
    is no matter of widths: a mean log width beyond noise is subtracted.

    Parameters
    ----------
    likelihood, state
        The state's own widths are the start.
    frames : (n,) int64
        Frames for the estimate.
    """
    spread = likelihood.scene.model.sensor.noise.width_spread
    if state.errors is not None:  # the widths of a measured scene are known, to within these errors
        spread = state.errors.typical_log_width
    if not spread:
        return state
    mixture = likelihood.predicted(state)
    everything = frames, np.arange(likelihood.evidence.shape[1])
    log_width, error = state.log_width.copy(), state.log_width_error.copy()
    for view in views(likelihood, mixture, everything):
        log_width[view.number], error[view.number] = _found(likelihood, state, mixture, view, spread)
    return replace(state, log_width=log_width, log_width_error=error)


def _found(
    likelihood: Likelihood, state: ModelState, mixture: Mixture, view: RecordingView, spread: float
) -> tuple[FloatArray, FloatArray]:
    """The log widths (pixel,) of one recording with their errors."""

    def value(log_width: FloatArray) -> FloatArray:
        return np.asarray(likelihood.marginal(mixture.widened(log_width), state, view.part_of_all).by_pixel[:, 0])

    at = state.log_width[view.number]
    if not state.log_width_error[view.number].any():
        starts = spread * _GRID
        values = [value(np.full(at.size, start)) - 0.5 * (start / spread) ** 2 for start in starts]
        at = starts[np.argmax(values, axis=0)]
    found, mean = _climbed(value, at, spread, free=False)
    free = abs(float(found[0].mean())) > _COMMON * spread / np.sqrt(at.size)
    if free:
        found, mean = _climbed(value, found[0], spread, free=True)
    middle, error = _weighed(value, *found, spread, mean)
    return middle - middle.mean() if free else middle, error


def _climbed(
    value: Callable[[FloatArray], FloatArray], at: FloatArray, spread: float, *, free: bool
) -> tuple[tuple[FloatArray, FloatArray], float]:
    """Newton steps from log widths (pixel,) upwards; their mean is 0 or, if `free`, is estimated.

    Returns the widths with their errors, and the mean.
    """
    error, mean = np.full(at.size, spread), 0.0
    for _ in range(5):  # Newton steps of the log widths
        low, middle, high = (value(at + step) for step in (-_NUDGE, 0.0, _NUDGE))
        variance = 1.0 / (np.maximum((2 * middle - low - high) / _NUDGE**2, 0.0) + 1.0 / spread**2)
        slope = (high - low) / (2 * _NUDGE)
        if free:  # the mean of all log widths after this step
            told = max(1.0 - float(variance.mean()) / spread**2, _LEAST_TOLD)
            mean = float((at + variance * (slope - at / spread**2)).mean()) / told
        at = at + np.clip(variance * (slope - (at - mean) / spread**2), -_FARTHEST, _FARTHEST)
        error = np.sqrt(variance)
    return (at, error), mean


def _weighed(
    value: Callable[[FloatArray], FloatArray], at: FloatArray, error: FloatArray, spread: float, mean: float
) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation (pixel,) of the possible log widths, near the most likely one.

    With few samples the most likely width differs from the mean: for n Gaussian samples by 1 / (2 n) in the logarithm.
    """
    places = np.stack([at + far * error for far in _AROUND])
    height = np.stack([value(place) - 0.5 * ((place - mean) / spread) ** 2 for place in places])
    weight = np.exp(height - height.max(axis=0))
    weight /= weight.sum(axis=0)
    middle = (weight * places).sum(axis=0)
    return middle, np.sqrt((weight * (places - middle) ** 2).sum(axis=0))
