"""Summaries of each pixel's samples: a bias in each tenth of the time, and the width of the noise, with errors.

A recording of a million samples becomes some ten thousand normally distributed numbers. Effects that move or widen
samples act on them almost linearly, so `tofmix.reconciliation.search.alternatives` compares a set of effects with them
in a millisecond. For numbers and verdicts use the likelihood of the samples
(`tofmix.reconciliation.likelihood.likelihood`): the summaries contain no tails, no lost samples, no pixels that see
several surfaces, and no change of the noise in time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import inflation, one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases

TENTHS = 10  # parts of the time
_STEPS = 2  # of Newton's, from the bias of the whole recording
_NUDGE = 0.05  # step of the logarithm of a width, for its slopes
_FAR = 1.0  # longest step of the logarithm of a width
_LEAST = 1e-10  # least information of a cell with data, 1/mm2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelSummary:
    """The summary of one recording's pixels that see one surface.

    Parameters
    ----------
    view : View
        The recording, and the prediction of the model with the effects added so far.
    used : (pixel,) bool
        Pixels with data; the others have no information.
    bias_mm, bias_information : (tenth, pixel) float64
        Bias of the mean against the prediction, mm, and its information, 1/mm2.
    width, width_information : (pixel,) float64
        Logarithm of the width of the noise, over the predicted one, and its information.
    elapsed_s : (tenth,) float64
        Mean time of the frames of the tenth.
    own_variance : (pixel,) float64
        Variance of a bias that each pixel has in all tenths, mm2: an error of a measured scene.
    common_variance : float
        Variance of what these biases have in common, in sigma squared.
    common_log_width : float
        Standard error of the logarithm of all widths together.
    """

    view: RecordingView
    used: BoolArray
    bias_mm: FloatArray
    bias_information: FloatArray
    width: FloatArray
    width_information: FloatArray
    elapsed_s: FloatArray
    own_variance: FloatArray
    common_variance: float = 0.0
    common_log_width: float = 0.0


def summaries(likelihood: Likelihood, state: ModelState, part: Part) -> list[PixelSummary]:
    """Summarise a part of each recording, relative to a state.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        The model with the effects added so far; its latent states are taken as known.
    part : (frames, pixels)
        The samples.

    Returns
    -------
    list of Summary
        One for each recording that has frames in the part.

    References
    ----------
    The score over the information is the maximum of a log-likelihood after one step of Newton's; Kay, Fundamentals of
    Statistical Signal Processing I, 7.7.
    """
    mixture = likelihood.mixture(state)
    return [_summed(likelihood, state, mixture, view) for view in views(likelihood, mixture, part)]


def _summed(likelihood: Likelihood, state: ModelState, mixture: Mixture, view: RecordingView) -> PixelSummary:
    whole = pixel_biases(likelihood, mixture, state, view.part_of_all)
    m = view.mixture
    used = one_surface(m) & m.of_main(m.lit).astype(bool) & (whole.information > _LEAST)
    overstated = inflation(likelihood, mixture, state, view.part_of_all)
    tenths = [(f, view.part[1]) for f in np.array_split(view.part_of_all[0], TENTHS) if f.size]
    shifts, information = [], []
    for part in tenths:
        shift = state.pixel_bias + whole.bias
        for _ in range(_STEPS):
            sums = likelihood.sums(mixture, state, part, bias=shift).by_pixel
            shift = shift + np.where(used, sums[:, 1] / np.maximum(sums[:, 2], _LEAST), 0.0)
        shifts.append(shift)
        information.append(np.where(used, sums[:, 2], 0.0) / overstated)
    moved = _surfaces_move(view, np.stack(shifts) - state.pixel_bias - whole.bias, np.stack(information))
    about = [(part, state.pixel_bias + whole.bias + move) for part, move in zip(tenths, moved, strict=True)]
    width, known = _widths(likelihood, state, mixture, about)
    width += 0.5 / max(len(view.part[0]), 1)  # a spread about the mean of the same samples is too small by this
    return PixelSummary(
        view=view,
        used=used,
        bias_mm=np.where(used, np.stack(shifts) - state.pixel_bias, 0.0),
        bias_information=np.stack(information),
        width=np.where(used, width, 0.0),
        width_information=np.where(used, _with_error(known / overstated, state, view.number), 0.0),
        elapsed_s=np.array([float(likelihood.evidence.time_s[frames].mean()) for frames, _ in tenths]),
        own_variance=np.zeros(used.size) if state.errors is None else state.pixel_variance,
        common_variance=0.0 if state.errors is None else state.errors.common_to(len(view.part[0]), state.memory),
        common_log_width=0.0 if state.errors is None else state.errors.common_log_width,
    )


def _with_error(information: FloatArray, state: ModelState, recording: int) -> FloatArray:
    """The information of widths (pixel,) about the camera, if those of a measured scene have errors."""
    if state.errors is None:
        return information
    return np.asarray(information / (1.0 + information * state.log_width_error[recording] ** 2))


def _surfaces_move(view: RecordingView, change: FloatArray, information: FloatArray) -> FloatArray:
    """Shift of each surface in each tenth against the whole recording (tenth, pixel), mm: a mean over its pixels."""
    seen = view.mixture.of_main(view.mixture.surface)
    out = np.zeros_like(change)
    for number in np.unique(seen):
        own = seen == number
        total = np.maximum(information[:, own].sum(axis=1, keepdims=True), _LEAST)
        out[:, own] = (change * information)[:, own].sum(axis=1, keepdims=True) / total
    return out


def _widths(
    likelihood: Likelihood, state: ModelState, mixture: Mixture, about: Sequence[tuple[Part, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Logarithm (pixel,) of the noise's width, over the predicted one, and its information, at given biases."""
    width, information = np.zeros(state.pixel_bias.size), np.zeros(state.pixel_bias.size)
    for _ in range(_STEPS + 1):
        below, here, above = (
            sum(likelihood.sums(wider, state, part, bias=shift).by_pixel[:, 0] for part, shift in about)
            for wider in (mixture.widened(width + step) for step in (-_NUDGE, 0.0, _NUDGE))
        )
        information = np.maximum((2 * here - below - above) / _NUDGE**2, 0.0)
        step = (above - below) / (2 * _NUDGE) / np.maximum(information, 1.0)
        width = width + np.clip(step, -_FAR, _FAR)
    return width, information


def surfaces_of(summary: PixelSummary) -> Iterator[tuple[str, BoolArray]]:
    """Each surface's name, and the pixels (pixel,) with data that see it."""
    m = summary.view.mixture
    seen = m.of_main(m.surface)
    for number, name in enumerate(summary.view.scene.names):
        own = summary.used & (seen == number)
        if own.any():
            yield name, own
