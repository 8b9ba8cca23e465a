"""Summaries of the samples about a model: biases in tenths of the time, and widths of the noise.

They are nearly linear in the numbers of small effects, and nearly Gaussian, so that `proposals` compares thousands of
sets by them.
"""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.likelihood.memory import sees_one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import PixelBiases
from tofmix.reconciliation.one.expansion import WIDTH_NUDGE, medians, pixel_sums
from tofmix.reconciliation.one.recordings import SearchTask, biases_by_tenth, overstated, overstated_width
from tofmix.reconciliation.one.static_errors import LEAST_INFORMATION
from tofmix.simulation.effects.hidden import PatternSpreads

_FAR_WIDTH = 1.0  # longest step of the logarithm of a width
_FAR_BIAS = 0.3  # longest step of a bias of quantised samples, over the quantisation step
_STEPS = 4  # of Newton's, of a bias
_WIDTH_STEPS = 2  # of Newton's, of a width
_PARABOLA = 4.5  # nats, up to which a pixel's log-likelihood is taken as a parabola in any case


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Summary:
    """Summaries of the samples about a model; arrays of pixels that see one surface, without information elsewhere.

    Parameters
    ----------
    bias_mm, bias_information : (tenth, recording, pixel) float64
        Bias of each tenth of the time, mm, and its information, 1/mm2.
    width, width_information : (recording, pixel) float64
        Logarithm of the noise's width over the one that the model's effects predict, and its information.
    """

    bias_mm: FloatArray
    bias_information: FloatArray
    width: FloatArray
    width_information: FloatArray

    @classmethod
    def of(cls, task: SearchTask, state: ModelState) -> "Summary":
        """Summarise the samples about a state; a pattern's values are a part of the biases.

        Parameters
        ----------
        task, state
            The recordings, and the model.
        """
        mixture = task.likelihood.mixture(state)
        over = overstated(task, state, mixture)
        bias, information, gain = _biases(task, state, mixture)
        # far from the model the log-likelihood is no parabola; one of its height has less information
        high = 0.5 * bias**2 * information
        share = np.where(
            high > np.maximum(gain, _PARABOLA), np.maximum(gain, 0.5) / np.maximum(high, LEAST_INFORMATION), 1.0
        )
        alone = np.stack([sees_one_surface(m) & s for m, s in zip(task.split(mixture), task.single, strict=True)])
        used = alone & (information > LEAST_INFORMATION) & state.working
        shifts, told = biases_by_tenth(task, state, mixture, bias, used)
        width, width_information = _widths(task, state, mixture, bias, shifts, told, used)
        # a spread about the mean of the same samples is too small, and so is the logarithm of its square
        width += (over + overstated_width(over)) / np.maximum(width_information, 1.0)
        return cls(
            bias_mm=np.where(used, shifts, 0.0),
            bias_information=told * share / over,
            width=np.where(used, width + state.log_width, 0.0),
            width_information=np.where(used, width_information / overstated_width(over), 0.0),
        )

    @property
    def mean_mm(self) -> FloatArray:
        """Bias (recording, pixel) over all tenths, mm."""
        total = np.maximum(self.bias_information.sum(axis=0), LEAST_INFORMATION)
        return np.asarray((self.bias_mm * self.bias_information).sum(axis=0) / total)


def _biases(task: SearchTask, state: ModelState, mixture: Mixture) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Most likely bias of each pixel (recording, pixel), its information, and the log-likelihood that it gains."""
    at = np.zeros(task.lit.shape)
    first, slope, information = pixel_sums(task, state, mixture, at, exact=True)
    value = first
    limit = _FAR_BIAS * mixture.step if mixture.step > 0 else math.inf
    if state.working.any():  # a bias of many sigma is not reached step by step
        far = medians(task, mixture)
        there = pixel_sums(task, state, mixture, far, exact=True)
        better = there[0] > value
        at = np.where(better, far, at)
        value, slope, information = (
            np.where(better, new, old) for new, old in zip(there, (value, slope, information), strict=True)
        )
    for _ in range(_STEPS):
        move = np.where(information > LEAST_INFORMATION, slope / np.maximum(information, LEAST_INFORMATION), 0.0)
        at = at + np.clip(move, -limit, limit)
        value, slope, information = pixel_sums(task, state, mixture, at, exact=True)
    return at, information, value - first


def _widths(
    task: SearchTask,
    state: ModelState,
    mixture: Mixture,
    bias: FloatArray,
    shifts: FloatArray,
    told: FloatArray,
    used: BoolArray,
) -> tuple[FloatArray, FloatArray]:
    """Logarithm of each pixel's width and its information, with each surface moved as it moves in time."""
    width, known = np.zeros(used.shape), np.zeros(used.shape)
    for number, recording in enumerate(task.recordings):
        moved = _moves(shifts[:, number] - bias[number], told[:, number], recording.surface, used[number])
        own = np.zeros(used.shape[1])
        for _ in range(_WIDTH_STEPS):
            below, middle, above = (
                sum(
                    task.likelihood.sums(wider, state, (frames, task.part[1]), bias=bias[number] + move).by_pixel[:, 0]
                    for frames, move in zip(recording.tenths, moved, strict=False)
                )
                for wider in (mixture.widened(own + step) for step in (-WIDTH_NUDGE, 0.0, WIDTH_NUDGE))
            )
            task.passes += 3
            known[number] = np.maximum((2 * middle - below - above) / WIDTH_NUDGE**2, 0.0)
            step = (above - below) / (2 * WIDTH_NUDGE) / np.maximum(known[number], 1.0)
            own = own + np.clip(step, -_FAR_WIDTH, _FAR_WIDTH)
        width[number] = own
    return width, known


def _moves(change: FloatArray, told: FloatArray, surface: IntArray, used: BoolArray) -> FloatArray:
    """Shift of each surface in each tenth (tenth, pixel), mm: a mean over its pixels."""
    out = np.zeros_like(change)
    for number in np.unique(surface[used]):
        own = used & (surface == number)
        total = np.maximum(told[:, own].sum(axis=1), LEAST_INFORMATION)
        out[:, own] = ((change * told)[:, own].sum(axis=1) / total)[:, None]
    return out


def spreads_of_biases(task: SearchTask, bias_mm: FloatArray, information: FloatArray) -> PatternSpreads | None:
    """Spreads of the pattern that biases (recording, pixel) show together; None if they show none."""
    total = information.sum(axis=0)
    mean = (bias_mm * information).sum(axis=0) / np.maximum(total, LEAST_INFORMATION)
    known = task.known_with_scene(np.where(total > LEAST_INFORMATION, total, 0.0))
    mean = np.where(known > 0, mean, 0.0)
    found = PixelBiases(bias=mean, information=known, gain=0.5 * mean**2 * known)
    fitted = hidden_fits.fit_spreads(found, task.likelihood.evidence.image)
    return None if fitted is None else fitted[0]
