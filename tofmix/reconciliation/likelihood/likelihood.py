"""Log-likelihood of a recording under a model with effects, with hidden states integrated out.

One compiled pass computes the log-likelihood of each pixel and frame, with its slope and information for a bias. The
latent states use these sums: disturbed frames (hidden Markov chain), the bias of each pixel (Gaussian, in
`tofmix.reconciliation.likelihood.pixel_pattern`), stuck pixels, pixels that an effect affects or not (integrated out
pixel by pixel), and the memory of the noise.
"""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import betaln, expit, ndtri

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.kernel import Sorted, empty_sums, log_likelihood, sort_pixels, transform
from tofmix.reconciliation.likelihood.mixture import Mixture, Scene, Scenes
from tofmix.reconciliation.likelihood.reference_errors import ReferenceErrors
from tofmix.reconciliation.likelihood.smooth_kernel import LatentEvents
from tofmix.reconciliation.likelihood.unsteady_way import UnsteadyWay
from tofmix.simulation.effects.base import Effect, with_hidden
from tofmix.simulation.effects.hidden import AffectedPixels, DisturbedFrames, FrameChain, RememberedNoise
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.reconciliation.likelihood.side_information import SideInformation

_LEAST = 1.0e-100  # probability of a state


def forward(quiet: FloatArray, loud: FloatArray, frames: IntArray, chain: FrameChain) -> tuple[float, FloatArray]:
    """Log-likelihood of frames that a hidden Markov chain disturbs, and the probability (n,) that each one is.

    Parameters
    ----------
    quiet, loud : (n,) float64
        Log-likelihood of each frame in either state.
    frames : (n,) int64
        Their numbers, ascending (`Evidence.frame_number`); the chain also runs over gaps.
    chain : FrameChain
        Share and length of the bursts.
    """
    p = min(max(chain.probability, 1e-6), 1 - 1e-6)
    stop = min(1 / chain.burst_frames, (1 - p) / p)
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


_CHUNKS = 2  # as many as threads, fixed, so that sums do not depend on their number
_SIDE, _AWAY = 1 / 6, 3**0.5
"""Three points of Gauss-Hermite quadrature: weight of each side, and its distance in standard errors."""


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """Threads for all passes: there are thousands of passes, and starting a thread takes as long as a small pass."""
    return ThreadPoolExecutor(_CHUNKS)


Part = tuple[IntArray, IntArray]
"""Frames and pixels."""


class SurfaceShifts(NamedTuple):
    """How far the surfaces that share pixels are from their places in the model."""

    pixels: IntArray
    """(n,), the pixels."""

    shift_mm: FloatArray
    """(recording, surface + 1, n); the last row is 0, for what is no surface."""

    shares: "tuple[tuple[IntArray, FloatArray] | None, ...]"
    """Of each recording the surface of each component (component, n), -1 for none, and the change of its share."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelState:
    """A model with effects, and with the latent states that were estimated for them.

    Parameters
    ----------
    effects : tuple of Effect
        Effects beyond those of the model.
    given : tuple of Effect
        Effects of the model that link samples.
    pixel_bias : (pixel,) float64
        Known bias of each pixel, mm.
    pixel_variance : (pixel,) float64
        Variance of this bias, mm2.
    stuck_mm : (pixel,) float64
        Value of stuck pixels, NaN for the others.
    compared : (pixel,) bool
        Pixels of which the scene predicts any sample; no effect gives the others one.
    disturbed : (frame,) float64
        Probability that a frame is disturbed, used for scores; the square of its part of the noise in a beat.
    log_width, log_width_error : (recording, pixel) float64
        Logarithm of each pixel's own width of the noise in each recording, and its standard error; 0 if all pixels of
        the camera have the same width.
    errors : ReferenceErrors or None
        Errors of a measured scene; None if the scene is given.
    shifts : SurfaceShifts or None
        The model's own errors of surfaces in the pixels that they share; None without any.
    way : UnsteadyWay or None
        What is uneven in the way of surfaces that move; None if nothing moves.
    """

    effects: tuple[Effect, ...]
    given: tuple[Effect, ...]
    pixel_bias: FloatArray
    pixel_variance: FloatArray
    stuck_mm: FloatArray
    compared: BoolArray
    disturbed: FloatArray
    log_width: FloatArray
    log_width_error: FloatArray
    errors: ReferenceErrors | None = None
    shifts: SurfaceShifts | None = None
    way: UnsteadyWay | None = None

    @property
    def linking(self) -> tuple[Effect, ...]:
        """All effects that may link samples, the model's own first."""
        return (*self.given, *self.effects)

    @property
    def bursts(self) -> FrameChain | None:
        """The chain that disturbs frames, or their beat, if any."""
        return next((hidden.chain(e) for e, hidden in with_hidden(self.linking, DisturbedFrames)), None)

    @property
    def some_pixels(self) -> tuple[tuple[Effect, float], ...]:
        """The effects that act in some pixels, each with the share of these pixels."""
        return tuple((e, hidden.share(e)) for e, hidden in with_hidden(self.linking, AffectedPixels))

    @property
    def memory(self) -> float:
        """Coefficient of the memory of the noise; 0 without one."""
        return next((hidden.coefficient(e) for e, hidden in with_hidden(self.linking, RememberedNoise)), 0.0)

    @property
    def unpatterned(self) -> "ModelState":
        """The state without known biases of pixels; their variance is that of the scene."""
        nothing = np.zeros_like(self.pixel_bias)
        return replace(
            self, pixel_bias=nothing, pixel_variance=nothing if self.errors is None else self.errors.variance_mm2
        )

    @property
    def working(self) -> BoolArray:
        """Pixels that are compared, and not stuck."""
        return np.asarray(np.isnan(self.stuck_mm) & self.compared)


@dataclass(slots=True, eq=False)
class Sums:
    """Results of a pass: columns are log-likelihood, slope (1/mm), information (1/mm2), valid samples."""

    by_pixel: FloatArray
    by_frame: FloatArray
    common: float = 0.0  # of the log-likelihood: what no pixel has by itself

    @property
    def total(self) -> float:
        """The log-likelihood."""
        return float(self.by_pixel[:, 0].sum()) + self.common


def _chance(others: Sums, affected: Sums, share: float) -> FloatArray:
    """Probability (pixel,) of the affected state, of a share of the pixels, by their sums in both states."""
    if not 0 < share < 1:
        return np.full(len(others.by_pixel), float(share))
    odds = math.log(share) - math.log1p(-share) + affected.by_pixel[:, 0] - others.by_pixel[:, 0]
    return np.asarray(expit(odds))


def _in_rows(mixture: Mixture) -> Mixture:
    """The same with rows of pixels in memory, whatever made it: kernels are compiled for this one order."""
    m = mixture
    return replace(
        mixture,
        weight=np.ascontiguousarray(m.weight),
        mean=np.ascontiguousarray(m.mean),
        sigma=np.ascontiguousarray(m.sigma),
        rate=np.ascontiguousarray(m.rate),
        lit=np.ascontiguousarray(m.lit),
    )


def _events(m: Mixture, extra_variance: FloatArray, pixel_bias: FloatArray) -> LatentEvents:
    """The mixture for kernels, with the variance (frame,) and the bias (pixel,) that a state adds."""
    return LatentEvents(
        m.key, m.since, m.frame_bias, extra_variance, pixel_bias, m.weight, m.mean, m.sigma, m.rate, m.lit
    )


def _reshared(mixture: Mixture, where: Any, surface: IntArray, change: FloatArray) -> FloatArray:  # noqa: ANN401
    """Weights (time, component, n) with changed shares; those of pixels whose surfaces effects have moved stay."""
    weight, own, ranges = (of[where] for of in (mixture.weight, mixture.surface, mixture.true_range))
    count = len(surface)
    if weight.shape[1] < count:
        return np.asarray(weight[:, :count])
    weight = weight[:, :count]
    there = (own[:, :count] >= 0) | (ranges[:, :count] > 0)  # else no pixel has such a component
    same = ((own[:, :count] == surface) & (there | (change == 0))).all(axis=1)
    total = weight.sum(axis=1)
    new = np.maximum(weight + change * total[:, None], 0.0)
    same &= new.sum(axis=1) > 0
    new *= np.where(same, total / np.where(same, new.sum(axis=1), 1.0), 1.0)[:, None]
    return np.asarray(np.where(same[:, None], new, weight))


class LostInPart(NamedTuple):
    """Lost samples of some pixels in a part of the time. Shares of pixels are Beta(m, 1 - m) about their mean m."""

    times: IntArray
    """(time,), of a mixture."""

    lost: FloatArray
    """(n,), lost samples."""

    frames: int
    """Frames of the part."""

    usual: float
    """Mean share of the pixels."""

    @property
    def share(self) -> FloatArray:
        """Share of lost samples (n,)."""
        return np.asarray((self.lost + self.usual) / (self.frames + 1.0))

    @property
    def nats(self) -> float:
        """Log density with unknown shares, less that at `share`."""
        kept = self.frames - self.lost
        there = self.lost * np.log(self.share) + kept * np.log1p(-self.share)
        whole = betaln(self.lost + self.usual, kept + 1.0 - self.usual) - betaln(self.usual, 1.0 - self.usual)
        return float((whole - there).sum())


def _frames_of_times(mixture: Mixture) -> IntArray:
    """Frames (time,) that use each time, at least 1."""
    return np.maximum(np.bincount(mixture.key, minlength=len(mixture.mean)), 1)


@dataclass(eq=False)
class Likelihood:
    """Evaluates states on parts of a recording.

    Parameters
    ----------
    evidence : Evidence
        The recording.
    scene : Scene or Scenes
        The scene of the model, or the scenes of several recordings.
    side_information : tuple of SideInformation
        Observations of amplitudes and temperatures.
    """

    evidence: Evidence
    scene: "Scene | Scenes"
    side_information: "tuple[SideInformation, ...]" = ()

    def start(self) -> ModelState:
        """The model without added effects; latent states are not estimated yet."""
        frames, pixels = self.evidence.shape
        measured = self.scene.model.scene
        errors = None if measured is None else ReferenceErrors.of(measured, self.scene.mixture())
        return ModelState(
            effects=(),
            given=self.scene.links,
            errors=errors,
            pixel_bias=np.zeros(pixels),
            pixel_variance=np.zeros(pixels) if errors is None else errors.variance_mm2,
            stuck_mm=np.full(pixels, np.nan),
            compared=np.logical_or.reduce([own.model.seen.ravel() for own in self.scene.members]),
            disturbed=np.zeros(frames),
            log_width=np.zeros((len(self.evidence.starts), pixels)),
            log_width_error=np.zeros((len(self.evidence.starts), pixels)) if errors is None else errors.log_width[None],
        )

    @cached_property
    def _nearest(self) -> BoolArray:
        """Pixels with samples of 1 mm, which stand for all that is nearer."""
        return np.asarray((self.evidence.samples == 1).any(axis=0))

    def mixture(self, state: ModelState, *, coarse: bool = False) -> Mixture:
        """The prediction of the model and a state's effects, with the widths of pixels and shifts of surfaces."""
        return self.with_errors(self.predicted(state, coarse=coarse), state)

    def predicted(self, state: ModelState, *, coarse: bool = False) -> Mixture:
        """The prediction of the model and a state's effects, on their unsteady way."""
        rest = None if state.way is None else state.way.rest
        mixture = self.scene.mixture(state.effects, coarse=coarse, rest=rest)
        if state.way is None or not mixture.rate.any():
            return mixture
        ahead = self._ahead(mixture, state.way)
        mixture = replace(mixture, since=mixture.since + ahead)
        if rest is not None:
            mixture = replace(mixture, sigma=mixture.sigma * self._noise_on_way(mixture, ahead))
        if self.scene.model.scene is None:
            return mixture
        if state.way.noise_power:
            since = np.bincount(mixture.key, mixture.since, minlength=len(mixture.mean))
            past = self._past_known(mixture, since / _frames_of_times(mixture))
            mixture = replace(mixture, sigma=mixture.sigma * past**state.way.noise_power)
        return replace(mixture, invalid=self._lost_beyond(mixture))

    def _ahead(self, mixture: Mixture, way: UnsteadyWay) -> FloatArray:
        out = np.zeros(mixture.since.size)
        for frames in self.evidence.recordings:
            speed = mixture.of_frames(frames).typical_speed
            if speed:
                out[frames] = way.ahead_at(speed, self.evidence.time_s)[frames]
        return out

    def _noise_on_way(self, mixture: Mixture, ahead_s: FloatArray) -> FloatArray:
        """Noise (time, component, pixel) at the ranges where the surfaces are, over that at those of the steady way.

        So the noise does not depend on the speed beside a path. Thousands of pixels tell the noise far better than the
        speed, which a noise that goes with it would choose.
        """
        ahead = np.bincount(mixture.key, ahead_s, minlength=len(mixture.mean)) / _frames_of_times(mixture)
        sensor = self.scene.model.sensor
        noise = sensor.noise_at(sensor.integration_time_ms)
        there = mixture.true_range + mixture.rate * ahead[:, None, None]
        here = noise.sigma(mixture.true_range, mixture.amplitude)
        return np.where(mixture.rate != 0, noise.sigma(there, mixture.amplitude) / here, 1.0)

    def _past_known(self, mixture: Mixture, since_s: FloatArray) -> FloatArray:
        """Ranges (time, component, pixel) of what moves, over the nearest one of which a measured scene tells noise.

        They are those of a while (time,) after each time, s.
        """
        known = self.scene.model.sensor.noise.range_mm
        ranges = np.maximum(mixture.mean + mixture.rate * since_s[:, None, None], 1.0)
        return np.where(mixture.lit & (mixture.rate != 0), ranges / np.clip(ranges, known[0], known[-1]), 1.0)

    def beyond(self, mixture: Mixture) -> BoolArray:
        """Pixels (pixel,) in which what moves leaves the ranges that a measured scene tells of, in any frame.

        Those of which nothing is known, and so no sample is predicted, are none of them.
        """
        out = np.zeros(mixture.invalid.shape[1], dtype=np.bool_)
        if self.scene.model.scene is None or not mixture.rate.any():
            return out
        least = 0.05  # part of a range over which noise and light hardly change
        seen = np.bincount(mixture.key, minlength=len(mixture.mean)) > 0
        for last in (np.minimum, np.maximum):
            since = np.zeros(len(mixture.mean))
            since[mixture.key] = mixture.since
            last.at(since, mixture.key, mixture.since)
            out |= (np.abs(self._past_known(mixture, since)[seen] - 1.0) > least).any(axis=(0, 1))
        return np.asarray(out & (mixture.invalid < 1.0).any(axis=0))

    def _lost_beyond(self, mixture: Mixture) -> FloatArray:
        """Shares of lost samples (time, pixel): those that are seen, in each part of the time, where none is known."""
        there = self.beyond(mixture)
        if not there.any():
            return mixture.invalid
        invalid = mixture.invalid.copy()
        for part in self.lost_in_parts(mixture, there):
            invalid[np.ix_(part.times, there)] = part.share
        return invalid

    def lost_in_parts(self, mixture: Mixture, pixels: BoolArray) -> Iterator[LostInPart]:
        """The lost samples of some pixels in each part of the time of each recording."""
        parts = 4  # which are the same at any number of times, of which each is in one part
        for frames in self.evidence.recordings:
            own = np.arange(frames.start, frames.stop)
            key, time_s = mixture.key[own], self.evidence.time_s[own]
            middle = np.bincount(key, time_s, minlength=len(mixture.mean)) / _frames_of_times(mixture)
            part = np.minimum(parts * middle[key] / max(float(time_s[-1]), 1e-300), parts - 1).astype(np.int64)
            for number in np.unique(part):
                some = own[part == number]
                lost = self.evidence.samples[some][:, pixels] == 0
                usual = (float(lost.sum()) + 0.5) / (lost.size + 1.0)
                times = np.unique(mixture.key[some])
                yield LostInPart(times, lost.sum(axis=0).astype(np.float64), some.size, usual)

    def with_errors(self, mixture: Mixture, state: ModelState) -> Mixture:
        """What a state's effects predict, with its widths of pixels and its shifts of surfaces."""
        if state.shifts is not None:
            mixture = self._shifted(mixture, state.shifts)
        return self._widened(mixture, state.log_width) if state.log_width.any() else mixture

    def _widened(self, mixture: Mixture, log_width: FloatArray) -> Mixture:
        """A mixture of all recordings with widths (recording, pixel)."""
        return mixture.widened(log_width[self._recording_at(mixture)][:, None])

    def _recording_at(self, mixture: Mixture) -> IntArray:
        """Number of the recording of each time (time,) of a mixture of all."""
        times = np.zeros(len(mixture.sigma), dtype=np.int64)
        for number, frames in enumerate(self.evidence.recordings):
            times[int(mixture.key[frames].min()) :] = number
        return times

    def _shifted(self, mixture: Mixture, shifts: SurfaceShifts) -> Mixture:
        """A mixture of all recordings with surfaces shifted in the pixels that they share."""
        surface = mixture.surface[:, :, shifts.pixels]
        last = shifts.shift_mm.shape[1] - 1
        row = np.where((surface >= 0) & (surface < last), surface, last)
        own = np.take_along_axis(shifts.shift_mm[self._recording_at(mixture)], row, axis=1)
        mean = mixture.mean.copy()
        mean[:, :, shifts.pixels] += np.where(mixture.lit[:, :, shifts.pixels], own, 0.0)
        weight = mixture.weight.copy()
        at = self._recording_at(mixture)
        for number, shares in enumerate(shifts.shares):
            if shares is not None and shares[1].any():
                times = at == number
                own = _reshared(mixture, np.ix_(times, np.arange(weight.shape[1]), shifts.pixels), *shares)
                weight[np.ix_(times, np.arange(own.shape[1]), shifts.pixels)] = own
        return replace(mixture, mean=mean, weight=weight)

    def sums(
        self,
        mixture: Mixture,
        state: ModelState,
        part: Part,
        *,
        variance: FloatArray | None = None,
        bias: FloatArray | None = None,
    ) -> Sums:
        """One pass over a part, without stuck pixels.

        If effects act in some pixels only, the log-likelihood of a pixel is that with both of its states possible.
        Slope and information are means over the states, and sums by frame those of the more likely states.

        Parameters
        ----------
        mixture : Mixture
            The prediction.
        state : ModelState
            The model, with stuck pixels and biases of pixels.
        part : (frames, pixels)
            Samples of the pass.
        variance : (frame,), optional
            Variance that each frame adds, mm2; that of the state's disturbed frames if left out.
        bias : (pixel,), optional
            Bias of each pixel, mm, instead of the state's.

        Raises
        ------
        ValueError
            If the recording has no such frame or pixel.
        """
        frames, pixels = self._working(state, part)
        added = self._variance(state) if variance is None else variance
        shift = state.pixel_bias if bias is None else bias
        if not state.some_pixels:
            return self._one_pass(mixture, (frames, pixels), added, shift)
        out = self._of_states(mixture, state, state.some_pixels, (frames, pixels), (added, shift))
        out.by_frame = np.zeros_like(out.by_frame)
        for likely, own in self._likely(mixture, state, (frames, pixels), (added, shift)):
            out.by_frame += self._one_pass(likely, (frames, own), added, shift).by_frame
        return out

    def _one_pass(self, mixture: Mixture, part: Part, added: FloatArray, shift: FloatArray) -> Sums:
        """The sums of a part under one mixture."""
        frames, pixels = part
        density = mixture.outlier / (mixture.high - mixture.low)
        m = _in_rows(mixture)
        gaussian = m.shape is None
        chosen = sort_pixels(pixels, m.weight, m.sigma, m.invalid, m.step, m.period, self._nearest, gaussian=gaussian)
        run = partial(self._pass, m, chosen, (added, shift, density))
        results = list(_pool().map(run, np.array_split(frames, _CHUNKS)))
        out = Sums(*empty_sums(*self.evidence.shape))
        for by_pixel, by_frame in results:
            out.by_pixel += by_pixel
            out.by_frame += by_frame
        return out

    def _of_states(
        self,
        mixture: Mixture,
        state: ModelState,
        effects: tuple[tuple[Effect, float], ...],
        part: Part,
        more: tuple[FloatArray, FloatArray],
    ) -> Sums:
        """The sums of a part, with all states possible that these effects give a pixel; by frame, those without any."""
        if not effects:
            return self._one_pass(mixture, part, *more)
        (effect, share), *rest = effects
        others = self._of_states(mixture, state, tuple(rest), part, more)
        affected = self._of_states(self._in_affected(mixture, state, effect), state, tuple(rest), part, more)
        chance = _chance(others, affected, share)
        one, other = others.by_pixel, affected.by_pixel
        mean = one + chance[:, None] * (other - one)
        if 0 < share < 1:
            either = np.logaddexp(math.log1p(-share) + one[:, 0], math.log(share) + other[:, 0])
            mean[part[1], 0] = either[part[1]]
        return Sums(mean, others.by_frame)

    def _likely(
        self, mixture: Mixture, state: ModelState, part: Part, more: tuple[FloatArray, FloatArray]
    ) -> list[tuple[Mixture, IntArray]]:
        """The pixels of a part, each with the mixture of its more likely state."""
        groups = [(mixture, part[1])]
        for effect, share in state.some_pixels:
            split: list[tuple[Mixture, IntArray]] = []
            for without, pixels in groups:
                with_it = self._in_affected(without, state, effect)
                one, other = (self._one_pass(m, (part[0], pixels), *more) for m in (without, with_it))
                likely = _chance(one, other, share)[pixels] > 0.5  # noqa: PLR2004  the more likely of two
                split += [(without, pixels[~likely]), (with_it, pixels[likely])]
            groups = [(m, pixels) for m, pixels in split if pixels.size]
        return groups

    def _in_affected(self, mixture: Mixture, state: ModelState, effect: Effect) -> Mixture:
        """The prediction in pixels that an effect affects, of that in the others."""
        other = self.predicted(replace(state, effects=(*state.effects, effect.in_affected())))
        plain = self.predicted(state)
        if plain.mean.shape != mixture.mean.shape or plain.mean.shape != other.mean.shape:
            return other
        mean, sigma = mixture.mean + (other.mean - plain.mean), mixture.sigma * (other.sigma / plain.sigma)
        return replace(other, mean=mean, sigma=sigma)  # with what the mixture has beside the state's effects

    def _working(self, state: ModelState, part: Part) -> Part:
        """A part without stuck pixels. Frames and pixels out of bounds are refused, because kernels do not check."""
        for name, numbers, count in zip(("frame", "pixel"), part, self.evidence.shape, strict=True):
            if numbers.size and not 0 <= numbers.min() <= numbers.max() < count:
                raise ValueError(
                    f"{name}s {numbers.min()} to {numbers.max()} asked for, the recording has {counted(count, name)}"
                )
        return part[0], part[1][state.working[part[1]]]

    def _pass(self, m: Mixture, pixels: Sorted, more: tuple[Any, ...], frames: IntArray) -> tuple[Any, Any]:
        added, shift, density = more
        by_pixel, by_frame = empty_sums(*self.evidence.shape)
        log_likelihood(
            self.evidence.samples,
            pixels,
            frames,
            _events(m, added, shift),
            m.invalid,
            density,
            m.step,
            m.period,
            m.table,
            by_pixel,
            by_frame,
        )
        return by_pixel, by_frame

    def _variance(self, state: ModelState) -> FloatArray:
        if state.bursts is None:
            return np.zeros(self.evidence.shape[0])
        return np.asarray(state.disturbed * state.bursts.sigma_mm**2)

    def value(self, state: ModelState, part: Part, mixture: Mixture | None = None) -> float:
        """Log-likelihood of a part, with disturbed frames integrated out; the frames of a beat are known."""
        mixture = self.mixture(state) if mixture is None else mixture
        if state.bursts is not None and not state.bursts.period_frames:
            return self._with_bursts(mixture, state, part, state.bursts)
        return self.marginal(mixture, state, part).total

    def marginal(self, mixture: Mixture, state: ModelState, part: Part) -> Sums:
        """The sums of a part, with the errors of a measured scene integrated out of the log-likelihoods of pixels."""
        sums = self.sums(mixture, state, part)
        if state.errors is None:
            return sums
        repeats = (1.0 + state.memory) / (1.0 - state.memory)
        more, sums.common = state.errors.marginal(sums.by_pixel, state.pixel_variance, repeats, len(part[0]))
        sums.by_pixel[:, 0] += more
        return sums

    def objective(self, state: ModelState, part: Part) -> float:
        """The objective of fits, log posterior density but for a constant: `value` and `outside`."""
        return self.value(state, part) + self.outside(state)

    def outside(self, state: ModelState) -> float:
        """Log density of the effects' numbers by what is not the samples: their priors, and the side information."""
        return self.side_log_density(state) + sum(effect.log_prior() for effect in state.effects)

    def side_log_density(self, state: ModelState) -> float:
        """Log density of amplitudes and temperatures, given the effects."""
        return float(sum(side.log_density(effect) for effect in state.effects for side in self.side_information))

    def _with_bursts(self, mixture: Mixture, state: ModelState, part: Part, chain: FrameChain) -> float:
        numbers = self.evidence.frame_number[part[0]]
        total = forward(*self.frame_pair(mixture, state, part, chain.sigma_mm), numbers, chain)[0]
        if state.errors is None:
            return total
        return total + self.marginal(mixture, state, part).total - self.sums(mixture, state, part).total

    def frame_pair(
        self, mixture: Mixture, state: ModelState, part: Part, sigma_mm: float
    ) -> tuple[FloatArray, FloatArray]:
        """Log-likelihoods (n,) of the part's frames, quiet and disturbed."""
        frames = self.evidence.shape[0]
        quiet = self.sums(mixture, state, part, variance=np.zeros(frames)).by_frame[part[0], 0]
        loud = self.sums(mixture, state, part, variance=np.full(frames, sigma_mm**2)).by_frame[part[0], 0]
        return quiet, loud

    def scores(self, state: ModelState, part: Part, seed: int, mixture: Mixture | None = None) -> Float32Array:
        """Standard normal scores (frame, pixel) if the model is right; NaN for invalid samples and outside the part.

        Raises
        ------
        ValueError
            If the recording has no such frame or pixel.
        """
        mixture = self.mixture(state) if mixture is None else mixture
        part = self._working(state, part)
        groups = self._likely(mixture, state, part, (self._variance(state), state.pixel_bias))
        (first, own), *others = groups or [(mixture, part[1])]
        out = self._uniform(first, state, (part[0], own), seed)
        for likely, own in others:
            out[:, own] = self._uniform(likely, state, (part[0], own), seed)[:, own]
        for frame in range(len(out)):  # frame by frame: no second copy in double precision
            out[frame] = ndtri(np.clip(out[frame].astype(np.float64), 1e-9, 1 - 1e-9))
        return out

    def _uniform(self, mixture: Mixture, state: ModelState, part: Part, seed: int) -> Float32Array:
        """Values (frame, pixel) of the distribution function of each sample; NaN outside the part."""
        m, (frames, pixels) = _in_rows(mixture), part
        out: Float32Array = np.full(self.evidence.shape, np.nan, dtype=np.float32)
        added = self._variance(state)

        def run(m: Mixture, bias: FloatArray, into: Float32Array, some: IntArray) -> None:
            transform(
                self.evidence.samples,
                pixels,
                some,
                _events(m, added, bias),
                m.outlier,
                m.low,
                m.high,
                m.step,
                m.period,
                m.table,
                seed,
                into,
            )

        chunks = np.array_split(frames, _CHUNKS)
        list(_pool().map(partial(run, m, state.pixel_bias, out), chunks))
        sides: list[tuple[Mixture, FloatArray]] = []
        if state.log_width_error.any():
            sides += [(self._widened(m, sign * state.log_width_error), state.pixel_bias) for sign in (-_AWAY, _AWAY)]
        if m.shape is not None and state.pixel_variance.any():
            error = np.sqrt(state.pixel_variance)
            sides += [(m, state.pixel_bias + sign * error) for sign in (-_AWAY, _AWAY)]
        if sides:  # the mean of the transform over the possible widths and biases of a pixel
            further, aside = np.full_like(out, np.nan), np.zeros_like(out)
            for mixture_aside, bias in sides:
                list(_pool().map(partial(run, mixture_aside, bias, further), chunks))
                aside += further
            out *= np.float32(1.0 - _SIDE * len(sides))
            out += np.float32(_SIDE) * aside
        return out
