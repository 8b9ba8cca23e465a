"""The samples about static errors of biases and of widths, with these errors integrated out.

About errors b0, a pixel's log-likelihood L with slope s and information I is a parabola with its top at b = b0 + s / I,
so that with the covariance C of the errors and N = 1 / I of the noise

    log p = sum(L + s^2 / 2 I) - b' (C + N)^-1 b / 2 - log |1 + N^-1 C| / 2.

For other numbers of the effects, b0 follows: each pixel's most likely bias and width change by as much as its
prediction does, so that the samples are taken about the errors that these numbers leave.

The logarithms of the widths of the noise have errors of the same form, and are integrated out in the same way: those of
the model within its tolerance, and those of single pixels of a camera whose widths are spread. If the squares of n
samples about their own mean add up to S, L(w) = -n w - S exp(-2 w) / 2 has its top at log(S / n) / 2, with the
information 2 n.

References
----------
Rasmussen and Williams, Gaussian Processes for Machine Learning, section 3.4, for the expansion.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import ModelState, SurfaceShifts
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.one.recordings import SearchTask, overstated, overstated_width
from tofmix.reconciliation.one.static_errors import LEAST_INFORMATION, StaticErrors
from tofmix.reconciliation.one.steps_kernel import by_values, is_static
from tofmix.simulation.effects.hidden import PatternSpreads

NUDGE = 0.3
"""Step of a bias for the slopes of quantised samples that change in time, of sigma."""

WIDTH_NUDGE = 0.05
"""Step of the logarithm of a width for differences of the log-likelihood."""

FAR_NATS = 4.5
"""Gain of a pixel's own bias, nats, up to which its log-likelihood is taken as a parabola in any case: three sigma."""

_LEAST = 0.05  # of the information of independent samples, below which quantised samples tell nothing of a bias
_WIDTH_STEPS = 3  # of log widths, where samples are too far for a parabola
_THIRD = 3  # every third frame, for a faster pass


def pixel_sums(
    task: SearchTask,
    state: ModelState,
    mixture: Mixture,
    bias_mm: FloatArray,
    *,
    thin: bool = False,
    exact: bool = False,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log-likelihood, slope, 1/mm, and information, 1/mm2, about biases; arrays (recording, pixel).

    Parameters
    ----------
    task, state, mixture
        The recordings, the model, and its prediction.
    bias_mm : (recording, pixel) float64
        Bias of each pixel.
    thin : bool
        Take every third frame for three.
    exact : bool
        Take the exact information of quantised samples that change in time, not that of cells as noise.
    """
    out = [
        _of_one(task, number, own, state, mixture, bias_mm[number], thin=thin, exact=exact)
        for number, own in enumerate(task.split(mixture))
    ]
    value, slope, information = np.stack(out, axis=1) * (_THIRD if thin else 1)
    return value, slope, information


def _of_one(
    task: SearchTask,
    number: int,
    own: Mixture,
    state: ModelState,
    mixture: Mixture,
    bias: FloatArray,
    *,
    thin: bool,
    exact: bool,
) -> FloatArray:
    """The same of one recording, (3, pixel), and of a third if `thin`."""
    like, recording = task.likelihood, task.recordings[number]
    task.passes += 1
    if state.bursts is None and not state.some_pixels and is_static(own):
        found = np.where(state.working[:, None], by_values(recording.values, own, bias), 0.0).T
        least = _LEAST * recording.part[0].size / own.of_main(own.sigma) ** 2
        found[2] = np.where(found[2] > least, found[2], 0.0)
        return np.asarray(found / _THIRD if thin else found)
    frames, pixels = recording.part
    part = (frames[1::_THIRD], pixels) if thin else (frames, pixels)
    out = like.sums(mixture, state, part, bias=bias).by_pixel[:, :3].T.copy()
    if exact and own.step > task.sigma_mm:  # information that takes a cell as noise is wrong there
        task.passes += 2
        nudge = NUDGE * task.sigma_mm
        up, down = (like.sums(mixture, state, part, bias=bias + d).by_pixel[:, 1] for d in (nudge, -nudge))
        told = (down - up) / (2 * nudge)
        out[2] = np.where(told > _LEAST * out[2], told, 0.0)
    return np.asarray(out)


def medians(task: SearchTask, mixture: Mixture) -> FloatArray:
    """Median of a pixel's samples minus the mean of its main surface, mm (recording, pixel)."""
    out, least = [], 25  # samples of a pixel, enough for a median that a search begins with
    for recording, own in zip(task.recordings, task.split(mixture), strict=True):
        samples = recording.view.evidence.samples
        few = samples[:: max(1, len(samples) // least)].astype(np.float64)
        few[few == 0] = np.nan
        away = own.near_turn(few - own.of_main(own.mean))
        median = np.zeros(few.shape[1])
        some = ~np.isnan(away).all(axis=0) & own.of_main(own.lit).astype(bool)
        median[some] = np.nanmedian(away[:, some], axis=0)
        out.append(median)
    return np.stack(out)


def _within_reach(
    task: SearchTask, state: ModelState, mixture: Mixture, spreads: PatternSpreads, bias_mm: FloatArray
) -> FloatArray:
    """Biases (recording, pixel), mm, of pixels: the given ones, or medians where these are more likely.

    A pattern's bias of many sigma is not reached step by step: there, samples count as outliers.
    """
    far, near = medians(task, mixture), 3.0  # sigma, from which steps lead to the samples
    reached = np.abs(far - bias_mm) < near * np.exp(log_sigma(task, mixture))
    if reached.all():
        return bias_mm
    there, here = (pixel_sums(task, state, mixture, at)[0] for at in (far, bias_mm))
    variance = sum(sigma**2 for sigma in spreads)
    return np.where(~reached & (there - here > 0.5 * (far**2 - bias_mm**2) / variance), far, bias_mm)


def _components(own: Mixture, surface: IntArray | None) -> IntArray:
    """The component (pixel,) of a surface at the first time; the heaviest, or where the surface is out of the pixel.

    A change of numbers may make another surface the heaviest one, whose range and noise are no change of the first's.
    """
    if surface is None:
        return own.main
    weight = np.where(own.surface[0] == surface, own.weight[0], 0.0)
    return np.where(weight.max(axis=0) > 0, weight.argmax(axis=0), own.main)


def main_surfaces(task: SearchTask, mixture: Mixture) -> IntArray:
    """Surface (recording, pixel) of the main components."""
    return np.stack([own.of_main(own.surface) for own in task.split(mixture)])


def log_sigma(task: SearchTask, mixture: Mixture, surface: IntArray | None = None) -> FloatArray:
    """Logarithm of the predicted noise (recording, pixel) of the main components, or of a surface, mm."""
    out = []
    for k, own in enumerate(task.split(mixture)):
        place = _components(own, None if surface is None else surface[k])
        out.append(np.log(np.take_along_axis(own.sigma[0], place[None], axis=0)[0]))
    return np.stack(out)


def main_ranges(task: SearchTask, mixture: Mixture, surface: IntArray | None = None) -> FloatArray:
    """Predicted range (recording, pixel) of the main components, or of a surface, mm, a mean over the times."""
    out = []
    for k, own in enumerate(task.split(mixture)):
        place = _components(own, None if surface is None else surface[k])
        ranges = np.take_along_axis(own.mean, place[None, None], axis=1)[:, 0]
        frames = np.ones(len(ranges))
        if own.rate.any():  # what moves may be ahead of its place at each time
            rate = np.take_along_axis(own.rate, place[None, None], axis=1)[:, 0]
            frames = np.bincount(own.key, minlength=len(rate)).astype(np.float64)
            since = np.bincount(own.key, own.since, minlength=len(rate)) / np.maximum(frames, 1)
            ranges = ranges + rate * since[:, None]
        out.append(ranges[0] + np.average(own.near_turn(ranges - ranges[0]), axis=0, weights=frames))
    return np.stack(out)


def _top(square: FloatArray, count: FloatArray) -> FloatArray:
    """The log width at which samples with such a sum of squares are most likely; 0 where none tell it."""
    told = count > 0
    return np.where(told, 0.5 * np.log(np.where(told, square, 1.0) / np.where(told, count, 1.0)), 0.0)


def _unbiased(width: FloatArray, widths: StaticErrors) -> FloatArray:
    """Log widths, all recordings in one row, without the bias of a logarithm of a mean square, minus its variance."""
    told = widths.weight > 0
    return width.reshape(1, -1) + np.where(told, 1.0 / np.where(told, widths.weight, 1.0), 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expansion:
    """The samples about the most likely static errors of a model. Use `Expansion.of`.

    Parameters
    ----------
    task : SearchTask
        The recordings.
    bias_mm : (recording, pixel) float64
        The biases.
    log_width : (recording, pixel) float64
        The logarithms of widths over those that the model's effects predict.
    used : (recording, pixel) bool
        Pixels with a bias that is told.
    measured_mm : (recording, pixel) float64
        Most likely bias of each pixel by its own samples.
    errors : StaticErrors
        Covariance of the biases.
    widths : StaticErrors
        Covariance of the log widths, all recordings in one row.
    shifts : SurfaceShifts or None
        The model's errors of surfaces in pixels that they share.
    """

    task: SearchTask
    bias_mm: FloatArray
    log_width: FloatArray
    used: BoolArray
    measured_mm: FloatArray
    errors: StaticErrors
    widths: StaticErrors
    shifts: SurfaceShifts | None
    _information: FloatArray  # of the biases by independent samples, 0 where they are not used
    _surface: IntArray  # (recording, pixel), of the main components that the effects predict
    _ranges: FloatArray  # mm, of these components
    _own_log_sigma: FloatArray  # that the effects predict, without other widths
    _measured_width: FloatArray  # most likely log width of each pixel by its own samples
    _expanded_log_width: FloatArray  # about which widths are expanded
    _mean_taken: FloatArray  # degrees of freedom of its samples that a pixel's own mean takes
    _count: FloatArray  # samples that tell a width, 0 where none do
    _square: FloatArray  # sum of their squares, in units of the variance

    @classmethod
    def of(
        cls,
        task: SearchTask,
        state: ModelState,
        spreads: PatternSpreads,
        bias_mm: FloatArray,
        *,
        thin: bool = False,
        passes: int = 2,
        again: int = _WIDTH_STEPS,
    ) -> "Expansion":
        """Expand about errors that are found in some passes.

        Parameters
        ----------
        task, state
            The recordings, and the model. The state has the log widths of the start.
        spreads : PatternSpreads
            Of a fixed pattern.
        bias_mm : (recording, pixel) float64
            Biases of the start.
        thin : bool
            Take every third frame for three.
        passes : int
            Steps of the biases.
        again : int
            Most expansions about other log widths, where samples are too far for those of the start.
        """
        predicted = task.likelihood.predicted(state)
        mixture = task.likelihood.with_errors(predicted, state)
        over = overstated(task, state, mixture)
        image = task.likelihood.evidence.image
        if any(spreads):
            bias_mm = _within_reach(task, state, mixture, spreads, bias_mm)
        for _ in range(passes):
            at = bias_mm
            value, slope, information = pixel_sums(task, state, mixture, at, thin=thin, exact=True)
            used = task.lit & (information > LEAST_INFORMATION) & state.working
            information = np.where(used, information, 0.0)
            errors = StaticErrors.of(task.low, information / over, image, spreads, state.pixel_variance)
            measured = at + np.where(used, slope / np.maximum(information, LEAST_INFORMATION), 0.0)
            bias_mm = errors.mean(measured)
        up, down = (
            pixel_sums(task, state, mixture.widened(np.array(step)), at, thin=thin)[0]
            for step in (WIDTH_NUDGE, -WIDTH_NUDGE)
        )
        square = (2 * value - up - down) / (math.cosh(2 * WIDTH_NUDGE) - 1.0)
        count = (square * math.sinh(2 * WIDTH_NUDGE) - (up - down)) / (2 * WIDTH_NUDGE)
        # about a pixel's own mean, which takes a degree of freedom, and more if samples resemble those before
        mean_taken = np.where(used, over, 0.0)
        square = square - slope * np.where(used, slope / np.maximum(information, LEAST_INFORMATION), 0.0)
        count = count - mean_taken
        some = used & (count > 0) & (square > 0)
        # many sigma away samples count as outliers and have no parabola: the expected information leads there
        independent = information * np.exp(2 * log_sigma(task, mixture)) - mean_taken
        far = used & ~some & (up > down) & (independent > 0) & (task.width_variance.reshape(used.shape) > 0)
        count = np.where(far, independent, count)
        square = np.where(far, independent + (up - down) / (2 * WIDTH_NUDGE), square)
        some |= far
        count, square = np.where(some, count, 0.0), np.where(some, square, 0.0)
        widths = task.width_errors(2 * count / overstated_width(over))
        measured_width = _unbiased(state.log_width + _top(square, count), widths)
        log_width = widths.mean(measured_width).reshape(state.log_width.shape)
        shifts = task.likely_shifts(errors.coordinates_of_model(measured), state, predicted)
        if again and far.any():
            near = replace(state, log_width=log_width, shifts=shifts)
            return cls.of(task, near, spreads, bias_mm, thin=thin, passes=passes, again=again - 1)
        return cls(
            task=task,
            bias_mm=bias_mm,
            log_width=log_width,
            used=used,
            measured_mm=measured,
            errors=errors,
            widths=widths,
            shifts=shifts,
            _information=information,
            _surface=main_surfaces(task, predicted),
            _ranges=main_ranges(task, predicted),
            _own_log_sigma=log_sigma(task, predicted),
            _measured_width=measured_width,
            _expanded_log_width=state.log_width,
            _mean_taken=mean_taken,
            _count=count,
            _square=square,
        )

    def followed(self, state: ModelState) -> "Followed":
        """The samples' model for other numbers of the effects, about the errors that these numbers leave.

        Parameters
        ----------
        state : ModelState
            With these effects; its own widths and shifts do not count.
        """
        task, like = self.task, self.task.likelihood
        predicted = like.predicted(state)
        moved = predicted.near_turn(main_ranges(task, predicted, self._surface) - self._ranges)
        measured = self.measured_mm - np.where(self.used, moved, 0.0)
        by_effects = log_sigma(task, predicted, self._surface) - self._own_log_sigma
        log_width = self.widths.mean(self._measured_width - by_effects.reshape(1, -1)).reshape(by_effects.shape)
        state = replace(state, log_width=log_width)
        wider = by_effects + log_width - self._expanded_log_width
        errors = self.errors.weighed(np.exp(-2 * wider)) if wider.any() else self.errors
        state = replace(state, shifts=task.shifts(errors.coordinates_of_model(measured), self.shifts))
        return Followed(state, like.with_errors(predicted, state), errors.mean(measured), wider, errors)

    def log_likelihood(self, now: "Followed", *, thin: bool = False) -> tuple[float, float]:
        """Log density of the samples with the errors integrated out, and the log-likelihood about the errors.

        Parameters
        ----------
        now : Followed
            The model.
        thin : bool
            Take every third frame for three.
        """
        value, slope, known = pixel_sums(self.task, now.state, now.mixture, now.bias_mm, thin=thin)
        slope = np.where(self.used, slope, 0.0)
        samples = float(value.sum())
        told = np.maximum(self._information * np.exp(-2 * now.wider), LEAST_INFORMATION)
        # far from the samples a pixel may have hardly been told its bias where it was expanded, and be told it here
        told = np.where(0.5 * slope**2 > FAR_NATS * told, np.maximum(told, known), told)
        step = slope / told
        by_bias = float((slope * step).sum()) - now.errors.square(now.bias_mm + step) - now.errors.logdet
        return samples + 0.5 * (by_bias + self._by_width(now)), samples

    def _by_width(self, now: "Followed") -> float:
        """Twice the log density that is gained by log widths, where the noise is predicted wider.

        Of n samples with a sum of squares S, the parabola about their own width, log(S / n) / 2 away: that about the
        predicted width, (S / n - 1) / 2 away, would say far more where samples are many sigma off. A pixel's mean has
        one density, of one degree of freedom, whatever memory takes from the squares about it.
        """
        square, told = self._square * np.exp(-2 * now.wider), self._count > 0
        off = np.where(told, square / np.where(told, self._count, 1.0) - 1.0, 0.0)
        step = 0.5 * np.where(off > 0, np.log1p(np.maximum(off, 0.0)), off)
        gain = float((2 * (self._count * step - np.maximum(self._mean_taken - 1.0, 0.0)) * step).sum())
        width = (now.state.log_width + step).reshape(1, -1)
        return gain - self.widths.square(width) - self.widths.logdet

    def without_model_errors(self) -> tuple["Expansion", float]:
        """The samples about biases and widths without the model's own errors, and what their priors cost, nats."""
        wide = self.widths.mean_of_model(self._measured_width).reshape(self.log_width.shape)
        bias_mm = self.bias_mm - self.errors.mean_of_model(self.measured_mm)
        squares = self.errors.square_of_model(self.measured_mm), self.widths.square_of_model(self._measured_width)
        return replace(self, bias_mm=bias_mm, log_width=self.log_width - wide, shifts=None), 0.5 * sum(squares)


class Followed(NamedTuple):
    """A model, and the static errors that its numbers leave."""

    state: ModelState
    """With widths and shifts."""

    mixture: Mixture
    """Its prediction."""

    bias_mm: FloatArray
    """(recording, pixel), the biases about which samples are taken, mm."""

    wider: FloatArray
    """(recording, pixel), logarithm of the noise over that of the expansion."""

    errors: StaticErrors
    """Covariance of the biases for this noise."""
