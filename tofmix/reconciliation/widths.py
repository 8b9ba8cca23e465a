"""Each pixel's own width of the noise, where the model's camera has a spread of widths: what it is in a recording.

A model says how widths are spread, not which they are. They are found in the frames that fits may see, as a fixed
pattern's map is, and what a pixel's noise has more or less than its neighbours' is then taken as its width.
"""

from dataclasses import replace

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood import Likelihood, State

_GRID = np.linspace(-3.5, 3.5, 8)
"""Starts, in spreads from the middle: one log-normal number in two thousand lies beyond."""

_TURNS = 4
_NUDGE = 0.02  # of the log width: a Gaussian's log-likelihood is a parabola over that to 1e-3
_COMMON = 3.0
"""Standard errors by which the mean log width of all pixels may differ from 0: beyond, the noise is another."""


def with_widths(likelihood: Likelihood, state: State, frames: IntArray) -> State:
    """The state with the pixels' own widths and their standard errors; itself where the camera has no spread of them.

    Widths are where the log-likelihood of the frames and the log-normal distribution together are highest. That the
    noise of all pixels is wider than the model's is no matter of widths: their mean is held near 0.

    Parameters
    ----------
    likelihood, state
        As they stand.
    frames : (n,) int64
        What the widths are found in.
    """
    spread = likelihood.scene.model.sensor.noise.width_spread
    if not spread:
        return state
    part = frames, np.arange(likelihood.evidence.shape[1])
    mixture = likelihood.scene.mixture(state.effects)

    def value(log_width: FloatArray) -> FloatArray:
        wide = replace(mixture, sigma=mixture.sigma * np.exp(log_width))
        seen = likelihood.sums(wide, state, part).by_pixel[:, 0]
        return np.asarray(seen - 0.5 * (log_width / spread) ** 2)

    pixels = state.log_width.size
    if state.log_width_error.any():
        at = state.log_width.copy()
    else:
        starts = spread * _GRID
        values = np.stack([value(np.full(pixels, start)) for start in starts])
        at = starts[values.argmax(axis=0)]
    error = np.full(pixels, spread)
    for _ in range(_TURNS):
        low, middle, high = value(at - _NUDGE), value(at), value(at + _NUDGE)
        curvature = np.maximum((2 * middle - low - high) / _NUDGE**2, 1.0 / spread**2)
        step = (high - low) / (2 * _NUDGE * curvature)
        error = np.minimum(1.0 / np.sqrt(curvature), spread)
        moved = at + np.clip(step, -0.5, 0.5)
        at = np.where(value(moved) >= middle, moved, at)
    common = float(at.mean())
    allowed = _COMMON * spread / np.sqrt(pixels)
    at = at - np.sign(common) * max(abs(common) - allowed, 0.0)
    return replace(state, log_width=at, log_width_error=error)
