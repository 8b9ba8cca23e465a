"""Frames that a hidden Markov chain disturbs: the latent state of `interference`, integrated out."""

import math

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.simulation.effects.interference import Interference

_LEAST = 1.0e-100  # probability of a state


def forward(quiet: FloatArray, loud: FloatArray, frames: IntArray, effect: Interference) -> tuple[float, FloatArray]:
    """Log-likelihood of frames that a hidden Markov chain disturbs, and the probability (n,) that each one is.

    Parameters
    ----------
    quiet, loud : (n,) float64
        Log-likelihood of each frame in either state.
    frames : (n,) int64
        Their numbers, ascending (`Evidence.frame_number`); the chain also runs over gaps.
    effect : Interference
        Share and length of the bursts.
    """
    p = min(max(effect.probability, 1e-6), 1 - 1e-6)
    stop = min(1 / effect.burst_frames, (1 - p) / p)
    start = min(stop * p / (1 - p), 1.0)
    step = np.array([[1 - start, start], [stop, 1 - stop]])
    emit = np.stack([quiet, loud], axis=1)
    top = emit.max(axis=1)
    emit = np.maximum(np.exp(emit - top[:, None]), _LEAST)  # no state has probability 0, so nothing divides by 0
    step = (step + _LEAST) / (1 + 2 * _LEAST)
    gaps = np.diff(frames, prepend=frames[0])
    lengths, which = np.unique(gaps, return_inverse=True)
    powers = np.stack([np.linalg.matrix_power(step, int(g)) for g in lengths])
    total, posterior = _chain(emit, powers, which, np.array([1 - p, p]))
    return float(total + top.sum()), posterior


@jit
def _chain(emit: FloatArray, powers: FloatArray, which: IntArray, belief: FloatArray) -> tuple[float, FloatArray]:
    """Forward and backward pass over the frames; `which` is the power of the step that leads to each frame."""
    n = len(emit)
    alpha, posterior = np.empty((n, 2)), np.empty(n)
    total, quiet, loud = 0.0, belief[0], belief[1]
    for t in range(n):
        if t > 0:
            step = powers[which[t]]
            quiet, loud = quiet * step[0, 0] + loud * step[1, 0], quiet * step[0, 1] + loud * step[1, 1]
        quiet, loud = quiet * emit[t, 0], loud * emit[t, 1]
        scale = quiet + loud
        total += math.log(scale)
        quiet, loud = quiet / scale, loud / scale
        alpha[t, 0], alpha[t, 1] = quiet, loud
    after_quiet, after_loud = 1.0, 1.0
    for back in range(n):
        t = n - 1 - back
        quiet, loud = alpha[t, 0] * after_quiet, alpha[t, 1] * after_loud
        posterior[t] = loud / (quiet + loud)
        if t > 0:
            step = powers[which[t]]
            quiet, loud = emit[t, 0] * after_quiet, emit[t, 1] * after_loud
            after_quiet, after_loud = step[0, 0] * quiet + step[0, 1] * loud, step[1, 0] * quiet + step[1, 1] * loud
            scale = after_quiet + after_loud
            after_quiet, after_loud = after_quiet / scale, after_loud / scale
    return total, posterior
