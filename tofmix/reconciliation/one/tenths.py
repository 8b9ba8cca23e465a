"""Biases in tenths of the time, and how far a memory of the noise lets independent samples overstate what they tell."""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.likelihood.likelihood import ModelState, Part
from tofmix.reconciliation.likelihood.memory import inflation, memory_of
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.one.columns import by_tenth
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.reconciliation.one.static_errors import LEAST_INFORMATION

_NUDGE = 0.3  # of sigma, for slopes of quantised samples
_LEAST = 0.05  # of the information of independent samples, below which quantised samples tell nothing of a bias


def observed(task: SearchTask, mixture: Mixture) -> tuple[FloatArray, FloatArray]:
    """Mean, mm, and log width (tenth, recording, pixel) of the main surfaces of the given model."""
    most = max(len(r.tenths) for r in task.recordings)
    mean, width = np.full((2, most, *task.lit.shape), np.nan)
    for number, recording in enumerate(task.recordings):
        own = slice(len(recording.tenths)), number
        mean[own], width[own] = by_tenth(mixture, recording.tenths, recording.surface)
    return mean, width


def biases_by_tenth(
    task: SearchTask, state: ModelState, mixture: Mixture, bias_mm: FloatArray, used: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Bias, mm, and information, 1/mm2, (tenth, recording, pixel) by a step of Newton's from that of all frames.

    Parameters
    ----------
    task, state, mixture
        The recordings, the model, and its prediction.
    bias_mm, used : (recording, pixel)
        Bias of each pixel by all frames, and which pixels are asked for.
    """
    most = max(len(r.tenths) for r in task.recordings)
    shifts, told = np.zeros((most, *used.shape)), np.zeros((most, *used.shape))
    for number, recording in enumerate(task.recordings):
        for tenth, frames in enumerate(recording.tenths):
            slope, information = _slope_of(task, state, mixture, (frames, task.part[1]), bias_mm[number])
            good = used[number] & (information > LEAST_INFORMATION)
            shifts[tenth, number] = bias_mm[number] + np.where(
                good, slope / np.maximum(information, LEAST_INFORMATION), 0.0
            )
            told[tenth, number] = np.where(good, information, 0.0)
        task.passes += 1
    return shifts, told


def _slope_of(
    task: SearchTask, state: ModelState, mixture: Mixture, part: Part, bias: FloatArray
) -> tuple[FloatArray, FloatArray]:
    like = task.likelihood
    here = like.sums(mixture, state, part, bias=bias).by_pixel
    if mixture.step <= task.sigma_mm:
        return here[:, 1], here[:, 2]
    nudge = _NUDGE * task.sigma_mm
    up, down = (like.sums(mixture, state, part, bias=bias + d).by_pixel[:, 1] for d in (nudge, -nudge))
    exact = (down - up) / (2 * nudge)
    return here[:, 1], np.where(exact > _LEAST * here[:, 2], exact, 0.0)


def overstated(task: SearchTask, state: ModelState, mixture: Mixture) -> FloatArray:
    """Factor (recording, pixel) by which independent samples would overstate the information about a bias."""
    if not memory_of(state):
        return np.ones(task.lit.shape)
    return np.stack([inflation(task.likelihood, mixture, state, r.part) for r in task.recordings])


def overstated_width(of_bias: FloatArray) -> FloatArray:
    """The same of the information about a width, for noise of which each sample remembers the last one.

    With a coefficient rho, the variance of a mean grows by (1 + rho) / (1 - rho), that of a mean square by
    (1 + rho^2) / (1 - rho^2).
    """
    return (of_bias**2 + 1.0) / (2.0 * of_bias)
