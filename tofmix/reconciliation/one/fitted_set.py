"""A set of effects at its most likely numbers, and its score: the log evidence, less a price for each member.

`FittedSet` owns all that belongs to a set: laws, vectors, their curvature, hidden states, the static errors about which
samples are expanded, evidence and score. The log evidence is that of Laplace, on all samples; `expansion` integrates
the static errors out for each vector of numbers.

References
----------
MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28, for the evidence.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.found import Named
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.beats import FrameNoise, of_unknown_phase
from tofmix.reconciliation.likelihood.likelihood import ModelState, forward
from tofmix.reconciliation.likelihood.memory import fit_memory, memory_gain_at_own_widths, memory_of
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.unsteady_way import UnsteadyWay
from tofmix.reconciliation.one.coordinates import Key, Law, key_of_state
from tofmix.reconciliation.one.expansion import Expansion
from tofmix.reconciliation.one.recordings import SearchTask, hidden_of
from tofmix.reconciliation.one.summary import Summary, spreads_of_biases
from tofmix.reconciliation.one.ways import fitted_way, way_nats
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.hidden import (
    DisturbedFrames,
    PatternSpreads,
    PixelValue,
    RangeStep,
    RememberedNoise,
)
from tofmix.simulation.effects.search import EFFECT_NATS

_TURNS = 8  # of Newton's steps
_FULL_HESSIAN = 2  # turn from which correlations are numerical
_AGAIN_NATS = 5.0  # of a step, after which samples are expanded anew
_ENOUGH_NATS = 0.05  # of a step
_FLAT = 1e-3  # least curvature in a step
_DROP = (0.02, 50.0)  # nats by which a step changes the log-likelihood
_LEVEL = 1e-4  # nats: a drop that shows no curvature
_HALVINGS = 10  # of a step to a bound, after which a number stays
_PATTERN_CHANGE = 0.1  # relative change of a spread after which a set is fitted again


@dataclass(slots=True, eq=False)
class FittedSet:
    """A set of effects. It is made with a start, and fitted by `fit`.

    Parameters
    ----------
    task : SearchTask
        What all sets share.
    laws : tuple of Law
        Members with numbers.
    x : (n,) float64
        The vectors of all laws.
    linked : tuple of Effect
        Members with a hidden state other than a bias of each pixel.
    pattern : (type of Effect, PatternSpreads) or None
        The member with a bias of each pixel, with its spreads.
    stuck_mm : (pixel,) float64 or None
        Values of stuck pixels.
    disturbed : (frame,) float64 or None
        Probability that each frame is disturbed.
    hessian : (n, n) float64 or None
        Curvature of the samples' log-likelihood over `x`; before the fit that of a linear model.
    evidence, score : float
        Log evidence; less the price of each member, minus infinity for a set that cannot be.
    refused : str
        Why the set cannot be, as a predicate; empty if it can.
    started : float or None
        Log density at the start; None before `begin`.
    about : Expansion or None
        The static errors about which samples are expanded; before the fit, those of a set nearby.
    memory_nats : float or None
        Gain of the noise's memory.
    """

    task: SearchTask
    laws: tuple[Law, ...] = ()
    x: FloatArray = field(default_factory=lambda: np.zeros(0))
    linked: tuple[Effect, ...] = ()
    pattern: tuple[type[Effect], PatternSpreads] | None = None
    stuck_mm: FloatArray | None = None
    disturbed: FloatArray | None = None
    hessian: FloatArray | None = None
    evidence: float = -math.inf
    score: float = -math.inf
    refused: str = ""
    started: float | None = None
    about: Expansion | None = None
    memory_nats: float | None = None
    way: UnsteadyWay | None = None
    below_top_nats: float = math.inf
    _offset: float = 0.0

    @classmethod
    def without_effects(cls, task: SearchTask) -> "FittedSet":
        """The empty set."""
        return cls(task=task)

    # ---- identity ------------------------------------------------------------------------------------------------
    @property
    def keys(self) -> frozenset[Key]:
        """Its members, with the search of each."""
        pattern = [(self.pattern[0].kind, "", 0)] if self.pattern else []
        return frozenset([*(law.key for law in self.laws), *map(key_of_state, self.linked), *pattern])

    @property
    def names(self) -> frozenset[Named]:
        """Its members' kinds and surfaces."""
        return frozenset(key[:2] for key in self.keys)

    @property
    def named(self) -> bool:
        """Whether all members are effects."""
        return all(law.named for law in self.laws)

    @property
    def sorts(self) -> set[type]:
        """Sorts of hidden states that it or the model has."""
        of_pattern = {type(self.pattern[0].hidden)} if self.pattern else set()
        return of_pattern | {type(e.hidden) for e in (*self.linked, *self.task.null.given)}

    def parts(self, x: FloatArray) -> list[FloatArray]:
        """The vector of each law."""
        return np.split(x, np.cumsum([law.size for law in self.laws]))[: len(self.laws)]

    def members(self, x: FloatArray | None = None) -> tuple[Effect, ...]:
        """The effects of its laws; ValueError out of bounds."""
        own = tuple(law.make(p) for law, p in zip(self.laws, self.parts(self.x if x is None else x), strict=True))
        scene = self.task.likelihood.scene
        for effect in own:
            effect.check(scene.model.sensor, scene.names)
        return own

    def state(self, x: FloatArray | None = None) -> ModelState:
        """The model with its effects and errors of widths, without biases of pixels; ValueError out of bounds."""
        null = self.task.null
        return replace(
            null,
            effects=(*self.members(x), *self.linked),
            stuck_mm=null.stuck_mm if self.stuck_mm is None else self.stuck_mm,
            disturbed=null.disturbed if self.disturbed is None else self.disturbed,
            log_width=null.log_width if self.about is None else self.about.log_width,
            shifts=None if self.about is None else self.about.shifts,
            way=self.way,
        )

    @property
    def beta(self) -> FloatArray:
        """Static errors (recording, pixel), mm, about which samples are expanded."""
        return np.zeros(self.task.lit.shape) if self.about is None else self.about.bias_mm

    @property
    def with_errors(self) -> ModelState:
        """The model with its effects and the static errors; those of several recordings at their mean."""
        return replace(self.state(), pixel_bias=self.beta.mean(axis=0))

    # ---- value ---------------------------------------------------------------------------------------------------
    @property
    def thin(self) -> bool:
        """Whether passes are slow, and take every third frame for three: quantised samples that change in time."""
        stepped = self.task.mixture.step > 0 or hidden_of(self.linked, RangeStep) is not None
        return stepped and (self.disturbed is not None or any(law.kind.changes_in_time for law in self.laws))

    @property
    def _moves(self) -> bool:
        return self.task.moves_far and any(law.kind.places_in_time() for law in self.laws)

    @property
    def _spreads(self) -> PatternSpreads:
        return self.task.given if self.pattern is None else self.pattern[1]

    def settle_errors(self, x: FloatArray | None = None, *, final: bool = False, passes: int = 2) -> None:
        """Expand the samples about the most likely static errors; ValueError out of bounds."""
        thin = self.thin and not final
        if self._moves:
            first = np.zeros_like(self.beta)  # errors beside the surfaces as given are no errors of what moves
            self.way = fitted_way(self.task, self.state(x), first if self.way is None else self.beta)
        self.about = Expansion.of(self.task, self.state(x), self._spreads, self.beta, thin=thin, passes=passes)

    def log_likelihood(self, x: FloatArray, *, final: bool = False) -> float:
        """Log density of samples and side information, static errors integrated out; minus infinity out of bounds."""
        if self.about is None:
            raise TypeError("samples are not expanded yet")
        try:
            now = self.about.followed(self.state(x))
        except (ValueError, OverflowError):
            return -math.inf
        total, samples = self.about.log_likelihood(now, thin=self.thin and not final)
        total += self._of_scene(now.state, now.mixture, now.bias_mm)
        if final:
            total += self._of_states(now.state, now.mixture, samples)
        return total + self.task.likelihood.side_log_density(now.state)

    def _of_scene(self, state: ModelState, mixture: Mixture, bias_mm: FloatArray) -> float:
        """Log density by the errors of a measured scene beside those of its means."""
        total = 0.0
        for recording in self.task.recordings:
            if recording.scene.lost_frames.any():
                share = mixture.of_frames(recording.view.frames).invalid[0]
                known = ~self.task.likelihood.beyond(mixture)
                total += recording.scene.by_lost(recording.lost, recording.part[0].size, share, known)
        for k, recording in enumerate(self.task.recordings):
            if recording.scene.wanders:
                total += self.course_gain(k, state, mixture, bias_mm[k])
        total += way_nats(self.task, state, mixture, bias_mm)
        return total + self.frame_gain(state, mixture, bias_mm)

    def wanders(self) -> list[bool]:
        """Whether the samples of each recording of a measured scene show that all means wander."""
        state = self.with_errors
        mixture = self.task.likelihood.mixture(state)
        return [
            r.scene.typical_mm > 0 and self.course_gain(k, state, mixture, self.beta[k]) > 0
            for k, r in enumerate(self.task.recordings)
        ]

    def course_gain(self, number: int, state: ModelState, mixture: Mixture, bias_mm: FloatArray) -> float:
        """What a walk of all means of a recording changes in the log-likelihood, nats.

        `bias_mm` are the biases (pixel,) about which samples are taken.
        """
        memory, recording = memory_of(state), self.task.recordings[number]
        own = self._by_frame(number, state, mixture, bias_mm) * (1.0 - memory) / (1.0 + memory)
        return recording.scene.by_course(own[:, 1], own[:, 2])

    def _by_frame(
        self, number: int, state: ModelState, mixture: Mixture, bias_mm: FloatArray, added: FloatArray | None = None
    ) -> FloatArray:
        """Sums (frame, 4) over the samples of each frame of a recording, about biases of pixels."""
        self.task.passes += 1
        part = self.task.recordings[number].part
        return self.task.likelihood.sums(mixture, state, part, bias=bias_mm, variance=added).by_frame[part[0]]

    def frame_gain(self, state: ModelState, mixture: Mixture, bias_mm: FloatArray | None = None) -> float:
        """What the noise that frames of a measured scene share changes in the log-likelihood, nats.

        `bias_mm` are the biases (recording, pixel) about which samples are taken, those of the set without it.
        """
        bias_mm = self.beta if bias_mm is None else bias_mm
        gains = (self._frame_gains(k, state, mixture, bias_mm[k]) for k in range(len(self.task.recordings)))
        return float(sum(own.sum() for own in gains))

    def _frame_gains(
        self, number: int, state: ModelState, mixture: Mixture, bias_mm: FloatArray, added: FloatArray | None = None
    ) -> FloatArray:
        """What the noise that a recording's frames share changes in the log-likelihood of each (frame,), nats.

        `added` is the variance that each frame has in addition, mm2; without it, that of the state.
        """
        recording = self.task.recordings[number]
        if not recording.scene.frame_noise_mm:
            return np.zeros(recording.part[0].size)
        own = self._by_frame(number, state, mixture, bias_mm, added)
        return recording.scene.by_frames(own[:, 1], own[:, 2])

    def _of_states(self, state: ModelState, mixture: Mixture, samples: float) -> float:
        """Log density by hidden states of frames, noise and pixels."""
        total = 0.0
        if state.bursts is not None:
            chain, self.disturbed = self.chain(state, mixture)
            total += chain - samples - self.frame_gain(state, mixture)  # of which the chain has its own
        self.memory_nats = self._memory_gain(state, mixture)
        total += self.memory_nats
        if self.stuck_mm is not None:
            total -= hidden_fits.VALUE_NATS * float(np.isfinite(self.stuck_mm).sum())
        return total

    def chain(self, state: ModelState, mixture: Mixture) -> tuple[float, FloatArray]:
        """Log-likelihood with the states of frames integrated out, and the probability that each is disturbed.

        Of a beat, the phase is integrated out, and the square of each frame's overlap takes the place of a probability.
        """
        like = self.task.likelihood
        if state.bursts is None:
            raise TypeError("no effect disturbs frames")
        if state.bursts.period_frames:
            known = replace(state, pixel_bias=self.beta.mean(axis=0))
            value, overlap = of_unknown_phase(FrameNoise(like, mixture, known, self.task.part), state.bursts)
            return value + self.frame_gain(replace(state, disturbed=overlap), mixture), overlap
        frames = like.evidence.shape[0]
        pair, unsure = np.zeros((2, frames)), 0.0  # sums by frame take the more likely state of each pixel as known
        for place, (recording, bias) in enumerate(zip(self.task.recordings, self.beta, strict=True)):
            self.task.passes += 2
            for number, size in enumerate((0.0, state.bursts.sigma_mm)):
                added = np.full(frames, size**2)
                sums = like.sums(mixture, state, recording.part, bias=bias, variance=added)
                pair[number] += sums.by_frame[:, 0]
                unsure += (1 - number) * (sums.total - float(sums.by_frame[:, 0].sum()))
                pair[number, recording.part[0]] += self._frame_gains(place, state, mixture, bias, added)
        total, disturbed = forward(pair[0], pair[1], like.evidence.frame_number, state.bursts)
        return total + unsure, disturbed

    def _memory_gain(self, state: ModelState, mixture: Mixture) -> float:
        """Log density of the scores as AR(1) over that of independent ones, each pixel's own bias and width given.

        The density of independent samples is taken at each pixel's own width, and the widths' errors count by what a
        memory leaves of their information. If the gain depended on predicted widths, they would count twice.
        """
        task, coefficient = self.task, memory_of(state)
        if not coefficient:
            return 0.0
        known = replace(state, pixel_bias=self.beta.mean(axis=0))
        z = task.likelihood.scores(known, task.part, task.settings.seed, mixture)
        return memory_gain_at_own_widths(task.likelihood, z, mixture, task.part, coefficient)

    def _refit_memory(self) -> None:
        """Fit the coefficient of a memory again: other members change the scores."""
        task = self.task
        old = hidden_of(self.linked, RememberedNoise)
        if old is None or not isinstance(old.hidden, RememberedNoise):
            return
        state = self.with_errors
        mixture = task.likelihood.mixture(state)
        z = task.likelihood.scores(state, task.part, task.settings.seed, mixture)
        found = fit_memory(task.likelihood, z, mixture, task.part)
        if found is not None:
            new = old.hidden.made(type(old), (found,))
            self.linked = tuple(new if e is old else e for e in self.linked)

    @property
    def price_of_states(self) -> float:
        """Volume of the numbers of hidden states, nats: half the logarithm of the count of what tells each."""
        frames, pixels = self.task.likelihood.evidence.shape
        out = 0.0
        for effect in self.linked:
            hidden = effect.hidden
            if isinstance(hidden, DisturbedFrames):
                out += 0.5 * len(hidden.numbers) * math.log(frames)
            elif not isinstance(hidden, PixelValue):
                out += 0.5 * math.log(frames * pixels)
        if self.pattern is not None:
            image = self.task.likelihood.evidence.image
            out += 0.5 * sum(math.log(2 * count) for count in (pixels, *image))
        return out

    def log_prior(self, x: FloatArray) -> float:
        """Log density of the numbers, but for a constant; minus infinity out of bounds."""
        return sum(law.log_density(p) for law, p in zip(self.laws, self.parts(x), strict=True))

    def _prior_precision(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Log density of the numbers relative to their modes, and the precision of the prior."""
        total, precision, start = 0.0, np.zeros((x.size, x.size)), 0
        for law, part in zip(self.laws, self.parts(x), strict=True):
            relative, own = law.prior_at(part)
            total += relative
            precision[start : start + law.size, start : start + law.size] = own
            start += law.size
        return total, precision

    # ---- fit -----------------------------------------------------------------------------------------------------
    @property
    def _members_price(self) -> float:
        forms = sum(key_of_state(effect)[2] for effect in self.linked)
        return self.task.price_nats(self.keys) + sum(law.price_nats for law in self.laws) + EFFECT_NATS * forms

    @property
    def score_anyhow(self) -> float:
        """The score, also of a set that cannot be."""
        return self.evidence - self._members_price

    @property
    def is_implausible(self) -> bool:
        """Whether a member has numbers beyond those of real cameras and scenes."""
        return any(law.is_implausible(p) for law, p in zip(self.laws, self.parts(self.x), strict=True))

    def begin(self) -> float:
        """The score at the start, with the volume of the linear model; minus infinity if it is out of bounds."""
        try:
            self.settle_errors()
            relative, precision = self._prior_precision(self.x)
        except (ValueError, OverflowError):
            self.started = -math.inf
            return -math.inf
        if self.hessian is None:
            self.hessian = 100 * precision
        self.started = self.log_likelihood(self.x) + self.log_prior(self.x)
        if not math.isfinite(self.started):
            return -math.inf
        if self.memory_nats is None:
            state = self.state()
            self.memory_nats = self._memory_gain(state, self.task.likelihood.mixture(state))
        self._offset = self.memory_nats + relative - self.log_prior(self.x) - self._occam(precision)
        self._offset -= self.price_of_states + self._members_price
        return self.started + self._offset

    @property
    def at_start(self) -> float:
        """The score at the start; of `begin`."""
        return self.begin() if self.started is None else self.started + self._offset

    def _occam(self, precision: FloatArray) -> float:
        """Half the log of the prior's volume over the posterior's."""
        if not self.x.size or self.hessian is None:
            return 0.0
        whole = _positive(self.hessian) + precision
        return 0.5 * float(np.linalg.slogdet(whole)[1] - np.linalg.slogdet(precision)[1])

    def fit(self, hopeless: float = -math.inf) -> "FittedSet":
        """Newton's steps to the top, then the score.

        Curvatures along the numbers are numerical. Correlations come from the linear model of the summaries, and from
        the third step on they are numerical too. A set that can hardly reach the score `hopeless` is left where it is.
        """
        if not math.isfinite(self.at_start) or self.started is None or self.hessian is None:
            self.refused = self.refused or "cannot have these numbers"
            return self
        self._climb(hopeless)
        self.finish()
        return self

    def _climb(self, hopeless: float) -> None:
        """Newton's steps from the present numbers, as of `fit`."""
        if self.started is None or self.hessian is None:
            raise TypeError("a set is begun before it is fitted")
        self.below_top_nats = 0.0
        x, here = self.x.copy(), self.started
        again = self.pattern is not None
        sd = self._prior_sd(x)
        steps = np.minimum(1.0 / np.sqrt(np.maximum(np.diag(self.hessian), 1e-12)), sd)
        unit = _correlations(self.hessian)
        self._fit_pattern_alone()
        for turn in range(_TURNS if x.size else 0):
            slope, curve, steps = self._slopes(x, here, steps, sd)
            if turn >= _FULL_HESSIAN:
                unit = _correlations(self._curvature(x, steps, slope, curve, here))
            self.hessian = unit * np.sqrt(curve)[:, None] * np.sqrt(curve) / steps[:, None] / steps
            move, within, expected = self._newton(x, slope, steps)
            if here + 4 * expected + self._offset < hopeless:
                self.below_top_nats = 4 * expected
                break
            there = here
            for way in (move, within) if expected > _ENOUGH_NATS else ():
                if there <= here:  # where the whole step leaves bounds, numbers that do not may gain
                    x, there = self._climbed(x, here, way)
            gained, here = there - here, there
            if gained < _ENOUGH_NATS:
                if not again:
                    break
                again = self._refit_pattern(x)
            elif gained > _AGAIN_NATS:
                self.settle_errors(x)
            here = self.log_likelihood(x) + self.log_prior(x)
        self.x = x

    def _newton(self, x: FloatArray, slope: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """The step to the top of the parabola, the same within bounds, and how many nats it is expected to gain.

        A number that leaves its bounds goes at least half of the way to its bound, and the others go to the top beside
        it.
        """
        _, precision = self._prior_precision(x)
        whole = (_positive(self.hessian) + precision) * steps[:, None] * steps
        rise = slope + self._prior_slope(x, steps)
        top = np.linalg.solve(whole, rise)
        far = self._times_prior(x, top * steps)
        move, free = np.zeros(x.size), np.arange(x.size)
        while free.size:
            held = np.setdiff1d(np.arange(x.size), free)
            pull = rise[free] - whole[np.ix_(free, held)] @ move[held]
            move[free] = np.linalg.solve(whole[np.ix_(free, free)], pull)
            parts = {k: self._part_within(x, int(k), move[k] * steps[k]) for k in free}
            out = [k for k in free if parts[k] < 1]
            if not out:
                break
            for k in out:
                move[k] *= parts[k]
            free = np.setdiff1d(free, out)
        move *= steps
        return top * steps / far, move / self._times_prior(x, move), 0.5 * float(rise @ top) / far

    def _times_prior(self, x: FloatArray, move: FloatArray) -> float:
        """How many times as long as all that the prior has a step is, at least 1: there, no parabola holds."""
        return max(float((np.abs(move) / self._prior_sd(x)).max(initial=0.0)), 1.0)

    def _part_within(self, x: FloatArray, number: int, step: float) -> float:
        """The part of a step of one number that is within its bounds: a power of 1/2, or 0."""
        for part in (*(0.5**k for k in range(_HALVINGS)), 0.0):
            moved = x.copy()
            moved[number] += part * step
            try:
                self.members(moved)
            except (ValueError, OverflowError):
                continue
            return part
        return 0.0

    def _climbed(self, x: FloatArray, here: float, move: FloatArray) -> tuple[FloatArray, float]:
        """A vector on the way of a step where the log density is higher, and the log density there."""
        for share in (1.0, 0.4, 0.1, 0.02):
            there = self.log_likelihood(x + share * move) + self.log_prior(x + share * move)
            if there > here:
                return x + share * move, there
        return x, here

    def _prior_sd(self, x: FloatArray) -> FloatArray:
        _, precision = self._prior_precision(x)
        return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-12)))

    def _fit_pattern_alone(self) -> None:
        """Fit the spreads of a set without numbers: biases far from the model are reached in some steps."""
        here = -math.inf
        for _ in range(0 if self.x.size else _TURNS):
            again, there = self._refit_pattern(self.x), self.log_likelihood(self.x)
            if not again and there - here < _AGAIN_NATS:
                return
            here = there

    def _refit_pattern(self, x: FloatArray) -> bool:
        """Fit the pattern's spreads to the biases about `x`; whether one has changed by more than a tenth."""
        if self.pattern is None or self.about is None:
            return False
        fitted = spreads_of_biases(self.task, self.about.measured_mm, self.about.errors.weight)
        if fitted is None:
            return False
        old, self.pattern = self.pattern[1], (self.pattern[0], fitted)
        self.settle_errors(x)
        return any(abs(a - b) > _PATTERN_CHANGE * max(a, b, 0.1) for a, b in zip(old, fitted, strict=True))

    def _slopes(
        self, x: FloatArray, here: float, steps: FloatArray, sd: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Slope and curvature of the samples' log-likelihood along each number, in steps of about a standard error."""
        steps, here = steps.copy(), here - self.log_prior(x)
        slope, curve = np.zeros(x.size), np.ones(x.size)
        for k in range(x.size):
            for _ in range(4):
                move = np.zeros(x.size)
                move[k] = steps[k]
                above, below = self.log_likelihood(x + move), self.log_likelihood(x - move)
                drop = 2 * here - above - below
                if not math.isfinite(drop):
                    steps[k] *= 0.2
                    continue
                slope[k], curve[k] = 0.5 * (above - below), drop
                if _DROP[0] < drop < _DROP[1] or (drop <= _DROP[0] and steps[k] >= sd[k]):
                    break
                scale = 5.0 if drop <= _LEVEL else min(max(drop**-0.5, 0.02), 20.0)
                steps[k] = min(steps[k] * scale, sd[k])
        return slope, np.maximum(np.abs(curve), _FLAT), steps

    def _prior_slope(self, x: FloatArray, steps: FloatArray) -> FloatArray:
        out = np.zeros(x.size)
        for k in range(x.size):
            move = np.zeros(x.size)
            move[k] = 0.1 * steps[k]
            rise = self.log_prior(x + move) - self.log_prior(x - move)
            out[k] = rise / 0.2 if math.isfinite(rise) else 0.0
        return out

    def _curvature(
        self, x: FloatArray, steps: FloatArray, slope: FloatArray, curve: FloatArray, here: float
    ) -> FloatArray:
        """Curvature of the samples' log-likelihood, in units of the steps."""
        here = here - self.log_prior(x)
        out = np.diag(curve)
        for i in range(x.size):
            for j in range(i):
                move = np.zeros(x.size)
                move[i], move[j] = steps[i], steps[j]
                both = self.log_likelihood(x + move)
                if math.isfinite(both):
                    out[i, j] = out[j, i] = here + slope[i] + slope[j] - 0.5 * (curve[i] + curve[j]) - both
        return out

    def finish(self) -> None:
        """Evidence and score at the present numbers."""
        reasons = (law.at_a_bound(p) for law, p in zip(self.laws, self.parts(self.x), strict=True))
        bad = next(((law, why) for law, why in zip(self.laws, reasons, strict=True) if why), None)
        try:
            if self.disturbed is not None:
                self.settle_errors(self.x, passes=1)
                self.log_likelihood(self.x, final=True)  # which frames are disturbed, the static errors given
            self._refit_memory()
            self.settle_errors(self.x, final=True)
            relative, precision = self._prior_precision(self.x)
        except (ValueError, OverflowError):
            self.refused = "cannot have these numbers"
            return
        here = self.log_likelihood(self.x, final=True)
        self.evidence = here + relative - self._occam(precision) - self.price_of_states
        self.score = self.score_anyhow
        if bad is not None:
            self.refused, self.score = f"{_spoken(bad[0])} {bad[1]}", -math.inf

    def summary(self) -> Summary:
        """Summarise the samples about the set; a pattern's values are a part of the biases."""
        return Summary.of(self.task, self.state())


def _correlations(hessian: FloatArray) -> FloatArray:
    """A curvature in units of its diagonal."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(hessian)), 1e-12))
    return np.asarray(hessian / scale[:, None] / scale)


def _positive(hessian: FloatArray | None) -> FloatArray:
    """A curvature without directions in which the log-likelihood rises on both sides."""
    if hessian is None or not hessian.size:
        return np.zeros((0, 0))
    scale = np.sqrt(np.maximum(np.abs(np.diag(hessian)), 1e-12))
    values, vectors = np.linalg.eigh(hessian / scale[:, None] / scale)
    return np.asarray((vectors * np.maximum(np.abs(values), 1e-6)) @ vectors.T * scale[:, None] * scale)


def _spoken(law: Law) -> str:
    return f'{law.kind.kind} "{law.surface}"' if law.surface else law.kind.kind
