"""Frames that a hidden Markov chain disturbs: the latent state of `interference`, integrated out."""

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.simulation.effects.interference import Interference

_LEAST = 1.0e-100


def forward(quiet: FloatArray, loud: FloatArray, frames: IntArray, effect: Interference) -> tuple[float, FloatArray]:
    """Log-likelihood of frames that a hidden Markov chain disturbs, and the probability (n,) that each one is.

    Parameters
    ----------
    quiet, loud : (n,) float64
        Log-likelihood of each frame in either state.
    frames : (n,) int64
        Their numbers, ascending (`Evidence.frame_number`); gaps are bridged by the chain.
    effect : Interference
        Share and length of the bursts.
    """
    p = min(max(effect.probability, 1e-6), 1 - 1e-6)
    stop = min(1 / effect.burst_frames, (1 - p) / p)
    start = min(stop * p / (1 - p), 1.0)
    step = np.array([[1 - start, start], [stop, 1 - stop]])
    emit = np.stack([quiet, loud], axis=1)
    top = emit.max(axis=1)
    emit = np.maximum(np.exp(emit - top[:, None]), _LEAST)  # no state is ever ruled out: nothing divides by 0
    step = (step + _LEAST) / (1 + 2 * _LEAST)
    gaps = np.diff(frames, prepend=frames[0])
    alpha = np.empty_like(emit)
    scale = np.empty(len(frames))
    belief = np.array([1 - p, p])
    powers = {int(g): np.linalg.matrix_power(step, int(g)) for g in np.unique(gaps)}
    for n, gap in enumerate(gaps):
        belief = (belief @ powers[int(gap)] if n else belief) * emit[n]
        scale[n] = belief.sum()
        belief = belief / scale[n]
        alpha[n] = belief
    beta = np.ones(2)
    posterior = np.empty(len(frames))
    for n in range(len(frames) - 1, -1, -1):
        both = alpha[n] * beta
        posterior[n] = both[1] / both.sum()
        if n:
            beta = powers[int(gaps[n])] @ (emit[n] * beta)
            beta /= beta.sum()
    return float(np.log(scale).sum() + top.sum()), posterior
