"""A set of effects at its most likely numbers, and its score: the log evidence, less a price for each member.

`FittedSet` owns all that belongs to a set: laws, vectors, their curvature, hidden states, the static errors about which
samples are expanded, evidence and score.

The log evidence is that of Laplace, on all samples. The static errors of pixels are integrated out for each vector of
numbers: about errors b0, a pixel's log-likelihood L with slope s and information I is a parabola with its top at
b = b0 + s / I, so that with the covariance C of the errors and N = 1 / I of the noise

    log p = sum(L + s^2 / 2 I) - b' (C + N)^-1 b / 2 - log |1 + N^-1 C| / 2.

References
----------
MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28, for the evidence; Rasmussen and Williams,
Gaussian Processes for Machine Learning, section 3.4, for the expansion.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.ledger import Named
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.likelihood import ModelState, Part, forward
from tofmix.reconciliation.likelihood.memory import inflation, memory_gain, memory_of, one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import PixelBiases
from tofmix.reconciliation.one.coordinates import Key, Law
from tofmix.reconciliation.one.recordings import SearchTask, hidden_of
from tofmix.reconciliation.one.static_errors import LEAST_INFORMATION, StaticErrors
from tofmix.reconciliation.one.steps_kernel import by_values, is_static
from tofmix.simulation.effects import Effect, basic_kind
from tofmix.simulation.effects.base import Basic
from tofmix.simulation.effects.hidden import (
    DisturbedFrames,
    PatternSpreads,
    PixelValue,
    RangeStep,
)

_TURNS = 8  # of Newton's steps
_FULL_HESSIAN = 2  # turn from which correlations are numerical
_AGAIN_NATS = 5.0  # of a step, after which samples are expanded anew
_ENOUGH_NATS = 0.05  # of a step
_NUDGE = 0.3  # of sigma, for slopes of quantised samples that change in time
_THIRD = 3  # every third frame, for such samples in the steps of a fit
_FLAT = 1e-3  # least curvature in a step
_DROP = (0.02, 50.0)  # nats by which a step changes the log-likelihood
_LEVEL = 1e-4  # nats: a drop that shows no curvature
_PATTERN_CHANGE = 0.1  # relative change of a spread after which a set is fitted again
_WIDTH_NUDGE, _FAR_WIDTH = 0.05, 1.0  # of the logarithm of a width: step for slopes, longest step
_ALTERNATIONS = 4  # of means of pixels and of surfaces
_LEAST_SCATTER = 0.1  # of tenths, over that of independent samples
_PARABOLA = 4.5  # nats, up to which a pixel's log-likelihood is taken as a parabola in any case


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Summary:
    """Summaries of the samples about a set; arrays of pixels that see one surface, without information elsewhere.

    Parameters
    ----------
    bias_mm, bias_information : (tenth, recording, pixel) float64
        Bias of each tenth of the time, mm, and its information, 1/mm2.
    width, width_information : (recording, pixel) float64
        Logarithm of the noise's width over the predicted one, and its information.
    """

    bias_mm: FloatArray
    bias_information: FloatArray
    width: FloatArray
    width_information: FloatArray

    @property
    def mean_mm(self) -> FloatArray:
        """Bias (recording, pixel) over all tenths, mm."""
        total = np.maximum(self.bias_information.sum(axis=0), LEAST_INFORMATION)
        return np.asarray((self.bias_mm * self.bias_information).sum(axis=0) / total)


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
        The vectors of all laws, then, if the model may have one, its own error of log sigma.
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
    """

    task: SearchTask
    laws: tuple[Law, ...] = ()
    x: FloatArray = field(default_factory=lambda: np.zeros(1))
    linked: tuple[Effect, ...] = ()
    pattern: tuple[type[Effect], PatternSpreads] | None = None
    stuck_mm: FloatArray | None = None
    disturbed: FloatArray | None = None
    hessian: FloatArray | None = None
    evidence: float = -math.inf
    score: float = -math.inf
    refused: str = ""
    started: float | None = None
    beta: FloatArray | None = None
    memory_nats: float | None = None
    _offset: float = 0.0
    _bias: FloatArray | None = None
    _use: BoolArray | None = None
    errors: StaticErrors | None = None

    @classmethod
    def without_effects(cls, task: SearchTask) -> "FittedSet":
        """The empty set."""
        return cls(task=task, x=np.zeros(1 if task.noise_sd > 0 else 0))

    # ---- identity ------------------------------------------------------------------------------------------------
    @property
    def keys(self) -> frozenset[Key]:
        """Its members, with the search of each."""
        states = (*(e.kind for e in self.linked), *((self.pattern[0].kind,) if self.pattern else ()))
        return frozenset([*(law.key for law in self.laws), *((kind, "", 0) for kind in states)])

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

    @property
    def free_noise(self) -> bool:
        """Whether the model's own error of log sigma is the last number."""
        own = (law.make(part) for law, part in zip(self.laws, self.parts(self.x), strict=True))
        return self.task.noise_sd > 0 and not any(e.is_basic(Basic.NOISE) for e in own)

    def parts(self, x: FloatArray) -> list[FloatArray]:
        """The vector of each law."""
        return np.split(x, np.cumsum([law.size for law in self.laws]))[: len(self.laws)]

    @property
    def _cut(self) -> int:
        """Where the vectors of the laws end."""
        return sum(law.size for law in self.laws)

    def members(self, x: FloatArray | None = None) -> tuple[Effect, ...]:
        """The effects of its laws; ValueError out of bounds."""
        own = tuple(law.make(p) for law, p in zip(self.laws, self.parts(self.x if x is None else x), strict=True))
        scene = self.task.likelihood.scene
        for effect in own:
            effect.check(scene.model.sensor, scene.names)
        return own

    def state(self, x: FloatArray | None = None) -> ModelState:
        """The model with its effects and without biases of pixels; ValueError out of bounds."""
        x = self.x if x is None else x
        noise: tuple[Effect, ...] = ()
        if x.size > self._cut and x[-1]:
            noise = (basic_kind(Basic.NOISE).of_magnitude(math.exp(x[-1])),)
        null = self.task.null
        return replace(
            null,
            effects=(*self.members(x), *noise, *self.linked),
            stuck_mm=null.stuck_mm if self.stuck_mm is None else self.stuck_mm,
            disturbed=null.disturbed if self.disturbed is None else self.disturbed,
        )

    # ---- value ---------------------------------------------------------------------------------------------------
    def expanded(
        self, state: ModelState, mixture: Mixture, beta: FloatArray, *, thin: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log-likelihood, slope and information (recording, pixel) about biases; of a third of the frames if `thin`."""
        out = [
            self._of_one(number, own, state, mixture, beta[number], thin=thin)
            for number, own in enumerate(self.task.split(mixture))
        ]
        value, slope, information = np.stack(out, axis=1)
        if thin:
            return _THIRD * value, _THIRD * slope, _THIRD * information
        return value, slope, information

    def _of_one(
        self, number: int, own: Mixture, state: ModelState, mixture: Mixture, beta: FloatArray, *, thin: bool
    ) -> FloatArray:
        """The same of one recording, (3, pixel)."""
        like, recording = self.task.likelihood, self.task.recordings[number]
        self.task.passes += 1
        plain = state.bursts is None and not state.some_pixels
        if plain and is_static(own):
            found = np.where(state.working[:, None], by_values(recording.values, own, beta), 0.0).T
            if thin:
                found = found / _THIRD
            least = 0.05 * recording.part[0].size / own.of_main(own.sigma) ** 2
            found[2] = np.where(found[2] > least, found[2], 0.0)
            return np.asarray(found)
        frames, pixels = recording.part
        part = (frames[1::_THIRD], pixels) if thin else (frames, pixels)
        out = like.sums(mixture, state, part, bias=beta).by_pixel[:, :3].T.copy()
        if own.step > self.task.sigma_mm:  # slopes that take a cell as noise are wrong there
            self.task.passes += 2
            nudge = _NUDGE * self.task.sigma_mm
            up, down = (like.sums(mixture, state, part, bias=beta + d).by_pixel[:, 0] for d in (nudge, -nudge))
            exact = (2 * out[0] - up - down) / nudge**2
            out[1] = (up - down) / (2 * nudge)
            out[2] = np.where(exact > 0.05 * out[2], exact, 0.0)
        return np.asarray(out)

    @property
    def _thin(self) -> bool:
        """Whether passes are slow: quantised samples that change in time."""
        stepped = self.task.mixture.step > 0 or hidden_of(self.linked, RangeStep) is not None
        return stepped and (self.disturbed is not None or any(law.kind.changes_in_time for law in self.laws))

    def settle_errors(self, x: FloatArray | None = None, *, final: bool = False, passes: int = 2) -> None:
        """Expand the samples about the most likely static errors; ValueError out of bounds."""
        task = self.task
        state = self.state(x)
        mixture = task.likelihood.mixture(state)
        thin = self._thin and not final
        overstated = self._overstated(state, mixture)
        beta = np.zeros(task.lit.shape) if self.beta is None else self.beta
        for _ in range(passes):
            _, slope, information = self.expanded(state, mixture, beta, thin=thin)
            self._use = task.lit & (information > LEAST_INFORMATION) & state.working
            information = np.where(self._use, information, 0.0)
            self.errors = self._covariance(information / overstated, state)
            self._bias = beta + np.where(self._use, slope / np.maximum(information, LEAST_INFORMATION), 0.0)
            beta = self.errors.mean(self._bias)
        self.beta = beta

    def _covariance(self, information: FloatArray, state: ModelState) -> StaticErrors:
        spreads = self.task.given if self.pattern is None else self.pattern[1]
        image = self.task.likelihood.evidence.image
        return StaticErrors.of(self.task.low, information, image, spreads, state.pixel_variance)

    def _overstated(self, state: ModelState, mixture: Mixture) -> FloatArray:
        """Factor (recording, pixel) by which independent samples would overstate the information about a bias."""
        task = self.task
        if not memory_of(state):
            return np.ones(task.lit.shape)
        out = np.stack([inflation(task.likelihood, mixture, state, r.part) for r in task.recordings])
        # of quantised samples the coefficient says too little, so the scatter of tenths has the last word
        beta = np.zeros(task.lit.shape) if self.beta is None else self.beta
        bias, told = self._by_tenth(state, mixture, beta, task.single & state.working)
        for number, recording in enumerate(task.recordings):
            used = task.single[number] & (told[:, number] > 0).all(axis=0)
            scatter = scatter_of_tenths(bias[:, number, used], told[:, number, used], recording.surface[used])
            if scatter is not None:
                out[number] *= max(scatter, _LEAST_SCATTER) / float(out[number][used].mean())
        return out

    def log_likelihood(self, x: FloatArray, *, final: bool = False) -> float:
        """Log density of samples and side information, static errors integrated out; minus infinity out of bounds."""
        if self.errors is None or self.beta is None or self._use is None:
            raise TypeError("samples are not expanded yet")
        task = self.task
        try:
            state = self.state(x)
        except (ValueError, OverflowError):
            return -math.inf
        mixture = task.likelihood.mixture(state)
        value, slope, information = self.expanded(state, mixture, self.beta, thin=self._thin and not final)
        use = self._use & (information > LEAST_INFORMATION)
        step = np.zeros(slope.shape)
        step[use] = slope[use] / information[use]
        self._bias = self.beta + step
        total = float(value.sum()) + 0.5 * float((slope[use] * step[use]).sum())
        total -= 0.5 * (self.errors.square(self._bias) + self.errors.logdet)
        if final:
            total += self._of_states(state, mixture, float(value.sum()))
        return total + task.likelihood.side_log_density(state)

    def _of_states(self, state: ModelState, mixture: Mixture, samples: float) -> float:
        """Log density by hidden states of frames, noise and pixels."""
        total = 0.0
        if state.bursts is not None:
            chain, self.disturbed = self.chain(state, mixture)
            total += chain - samples
        self.memory_nats = self._memory_gain(state, mixture)
        total += self.memory_nats
        if self.stuck_mm is not None:
            total -= hidden_fits.VALUE_NATS * float(np.isfinite(self.stuck_mm).sum())
        return total

    def chain(self, state: ModelState, mixture: Mixture) -> tuple[float, FloatArray]:
        """Log-likelihood with the states of frames integrated out, and the probability that each is disturbed."""
        like = self.task.likelihood
        if state.bursts is None:
            raise TypeError("no effect disturbs frames")
        beta = np.zeros(self.task.lit.shape) if self.beta is None else self.beta
        frames = like.evidence.shape[0]
        pair, unsure = np.zeros((2, frames)), 0.0  # sums by frame take the more likely state of each pixel as known
        for recording, bias in zip(self.task.recordings, beta, strict=True):
            self.task.passes += 2
            for number, size in enumerate((0.0, state.bursts.sigma_mm)):
                added = np.full(frames, size**2)
                sums = like.sums(mixture, state, recording.part, bias=bias, variance=added)
                pair[number] += sums.by_frame[:, 0]
                unsure += (1 - number) * (sums.total - float(sums.by_frame[:, 0].sum()))
        total, disturbed = forward(pair[0], pair[1], like.evidence.frame_number, state.bursts)
        return total + unsure, disturbed

    def _memory_gain(self, state: ModelState, mixture: Mixture) -> float:
        """Log density of the scores as AR(1) over that of independent ones, each pixel's own bias given."""
        task, coefficient = self.task, memory_of(state)
        if not coefficient:
            return 0.0
        known = replace(state, pixel_bias=np.zeros(task.part[1].size) if self.beta is None else self.beta.mean(axis=0))
        z = task.likelihood.scores(known, task.part, task.settings.seed, mixture)
        return memory_gain(task.likelihood, z, mixture, task.part, coefficient)

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
        total = sum(law.log_density(p) for law, p in zip(self.laws, self.parts(x), strict=True))
        return total - 0.5 * (x[-1] / self.task.noise_sd) ** 2 if x.size > self._cut else total

    def _prior_precision(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Log density of the numbers relative to their modes, and the precision of the prior."""
        total, precision, start = 0.0, np.zeros((x.size, x.size)), 0
        for law, part in zip(self.laws, self.parts(x), strict=True):
            relative, own = law.prior_at(part)
            total += relative
            precision[start : start + law.size, start : start + law.size] = own
            start += law.size
        if x.size > start:
            total -= 0.5 * (x[-1] / self.task.noise_sd) ** 2
            precision[start, start] = self.task.noise_sd**-2
        return total, precision

    # ---- fit -----------------------------------------------------------------------------------------------------
    @property
    def _members_price(self) -> float:
        return self.task.price_nats * len(self.keys) + sum(law.price_nats for law in self.laws)

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
        x, here = self.x.copy(), self.started
        again = self.pattern is not None
        sd = self._prior_sd(x)
        steps = np.minimum(1.0 / np.sqrt(np.maximum(np.diag(self.hessian), 1e-12)), sd)
        unit = _correlations(self.hessian)
        for turn in range(_TURNS if x.size else 0):
            slope, curve, steps = self._slopes(x, here, steps, sd)
            if turn >= _FULL_HESSIAN:
                unit = _correlations(self._curvature(x, steps, slope, curve, here))
            self.hessian = unit * np.sqrt(curve)[:, None] * np.sqrt(curve) / steps[:, None] / steps
            move, expected = self._newton(x, slope, steps)
            if here + 4 * expected + self._offset < hopeless:
                break
            x, there = self._climbed(x, here, move) if expected > _ENOUGH_NATS else (x, here)
            gained, here = there - here, there
            if gained < _ENOUGH_NATS:
                if not again:
                    break
                again = self._refit_pattern(x)
            elif gained > _AGAIN_NATS:
                self.settle_errors(x)
            here = self.log_likelihood(x) + self.log_prior(x)
        self.x = x
        self.finish()
        return self

    def _newton(self, x: FloatArray, slope: FloatArray, steps: FloatArray) -> tuple[FloatArray, float]:
        """The step to the top of the parabola, and how many nats it is expected to gain."""
        _, precision = self._prior_precision(x)
        whole = (_positive(self.hessian) + precision) * steps[:, None] * steps
        rise = slope + self._prior_slope(x, steps)
        move = np.linalg.solve(whole, rise)
        # where the log density is no parabola, a step may be as long as nothing that the prior has
        far = float((np.abs(move * steps) / self._prior_sd(x)).max(initial=0.0))
        return np.asarray(move * steps) / max(far, 1.0), 0.5 * float(rise @ move) / max(far, 1.0)

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

    def _refit_pattern(self, x: FloatArray) -> bool:
        """Fit the pattern's spreads to the biases about `x`; whether one has changed by more than a tenth."""
        if self.pattern is None or self.errors is None or self._bias is None:
            return False
        fitted = spreads_of_biases(self.task, self._bias, self.errors.weight)
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
            self.settle_errors(self.x, final=True)
            relative, precision = self._prior_precision(self.x)
        except (ValueError, OverflowError):
            self.refused = "cannot have these numbers"
            return
        here = self.log_likelihood(self.x, final=True)
        self.evidence = here + relative - self._occam(precision) - self.price_of_states
        self.score = self.evidence - self._members_price
        if bad is not None:
            self.refused, self.score = f"{_spoken(bad[0])} {bad[1]}", -math.inf

    # ---- what proposals need -------------------------------------------------------------------------------------
    def summary(self) -> Summary:
        """Summarise the samples about the set; a pattern's values are a part of the biases."""
        task = self.task
        state = self.state()
        mixture = task.likelihood.mixture(state)
        overstated = self._overstated(state, mixture)
        bias, information, gain = self._biases(state, mixture)
        # far from the model the log-likelihood is no parabola; one of its height has less information
        high = 0.5 * bias**2 * information
        share = np.where(
            high > np.maximum(gain, _PARABOLA), np.maximum(gain, 0.5) / np.maximum(high, LEAST_INFORMATION), 1.0
        )
        alone = np.stack([one & s for one, s in zip(self._alone(mixture), task.single, strict=True)])
        used = alone & (information > LEAST_INFORMATION) & state.working
        shifts, told = self._by_tenth(state, mixture, bias, used)
        known = told * share / overstated
        width, width_information = self._widths(state, mixture, bias, shifts, told, used)
        return Summary(
            bias_mm=np.where(used, shifts, 0.0),
            bias_information=known,
            width=np.where(used, width, 0.0),
            width_information=np.where(used, width_information / overstated, 0.0),
        )

    def _alone(self, mixture: Mixture) -> list[BoolArray]:
        return [one_surface(own) for own in self.task.split(mixture)]

    def _biases(self, state: ModelState, mixture: Mixture) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Most likely bias of each pixel (recording, pixel), its information, and the log-likelihood that it gains."""
        task = self.task
        at = np.zeros(task.lit.shape)
        first, slope, information = self.expanded(state, mixture, at)
        value = first
        limit = 0.3 * mixture.step if mixture.step > 0 else math.inf
        for far in self._starts(state, mixture):  # a bias of many sigma is not reached step by step
            there = self.expanded(state, mixture, far)
            better = there[0] > value
            at = np.where(better, far, at)
            value, slope, information = (
                np.where(better, new, old) for new, old in zip(there, (value, slope, information), strict=True)
            )
        for _ in range(4):
            move = np.where(information > LEAST_INFORMATION, slope / np.maximum(information, LEAST_INFORMATION), 0.0)
            at = at + np.clip(move, -limit, limit)
            value, slope, information = self.expanded(state, mixture, at)
        return at, information, value - first

    def _starts(self, state: ModelState, mixture: Mixture) -> list[FloatArray]:
        """Median of a pixel's samples minus the mean of its main surface, mm (recording, pixel)."""
        out = []
        for recording, own in zip(self.task.recordings, self.task.split(mixture), strict=True):
            samples = recording.view.evidence.samples
            few = samples[:: max(1, len(samples) // 25)].astype(np.float64)
            few[few == 0] = np.nan
            away = own.near_turn(few - own.of_main(own.mean))
            median = np.zeros(few.shape[1])
            some = ~np.isnan(away).all(axis=0) & own.of_main(own.lit).astype(bool)
            median[some] = np.nanmedian(away[:, some], axis=0)
            out.append(median)
        return [np.stack(out)] if state.working.any() else []

    def _by_tenth(
        self, state: ModelState, mixture: Mixture, bias: FloatArray, used: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Bias, mm, and information (tenth, recording, pixel) by a step of Newton's from that of all frames."""
        task = self.task
        most = max(len(r.tenths) for r in task.recordings)
        shifts, told = np.zeros((most, *used.shape)), np.zeros((most, *used.shape))
        for number, recording in enumerate(task.recordings):
            for tenth, frames in enumerate(recording.tenths):
                part = frames, task.part[1]
                slope, information = self._slope_of(state, mixture, part, bias[number])
                good = used[number] & (information > LEAST_INFORMATION)
                shifts[tenth, number] = bias[number] + np.where(
                    good, slope / np.maximum(information, LEAST_INFORMATION), 0.0
                )
                told[tenth, number] = np.where(good, information, 0.0)
            task.passes += 1
        return shifts, told

    def _slope_of(
        self, state: ModelState, mixture: Mixture, part: Part, bias: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        like = self.task.likelihood
        here = like.sums(mixture, state, part, bias=bias).by_pixel
        if mixture.step <= self.task.sigma_mm:
            return here[:, 1], here[:, 2]
        nudge = _NUDGE * self.task.sigma_mm
        up, down = (like.sums(mixture, state, part, bias=bias + d).by_pixel[:, 0] for d in (nudge, -nudge))
        exact = (2 * here[:, 0] - up - down) / nudge**2
        return (up - down) / (2 * nudge), np.where(exact > 0.05 * here[:, 2], exact, 0.0)

    def _widths(
        self,
        state: ModelState,
        mixture: Mixture,
        bias: FloatArray,
        shifts: FloatArray,
        told: FloatArray,
        used: BoolArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Logarithm of each pixel's width and its information, with each surface moved as it moves in time."""
        task = self.task
        width, known = np.zeros(used.shape), np.zeros(used.shape)
        for number, recording in enumerate(task.recordings):
            moved = _moves(shifts[:, number] - bias[number], told[:, number], recording.surface, used[number])
            own = np.zeros(used.shape[1])
            for _ in range(2):
                below, middle, above = (
                    sum(
                        task.likelihood.sums(wider, state, (frames, task.part[1]), bias=bias[number] + move).by_pixel[
                            :, 0
                        ]
                        for frames, move in zip(recording.tenths, moved, strict=False)
                    )
                    for wider in (mixture.widened(own + step) for step in (-_WIDTH_NUDGE, 0.0, _WIDTH_NUDGE))
                )
                task.passes += 3
                known[number] = np.maximum((2 * middle - below - above) / _WIDTH_NUDGE**2, 0.0)
                step = (above - below) / (2 * _WIDTH_NUDGE) / np.maximum(known[number], 1.0)
                own = own + np.clip(step, -_FAR_WIDTH, _FAR_WIDTH)
            # a spread about the mean of the same samples is too small by this
            width[number] = own + 0.5 / recording.part[0].size
        return width, known


def scatter_of_tenths(bias_mm: FloatArray, information: FloatArray, surface: IntArray) -> float | None:
    """Mean square of biases of tenths about their pixel's mean and their surface's course, over that of noise.

    Parameters
    ----------
    bias_mm, information : (tenth, pixel) float64
        Biases, and their information by independent samples.
    surface : (pixel,) int64
        Surface of each pixel.

    Returns
    -------
    float or None
        1 for independent samples; None if there are not enough tenths or pixels.
    """
    tenths, pixels = bias_mm.shape
    surfaces = np.unique(surface)
    free = (tenths - 1) * (pixels - surfaces.size)
    if free <= 0:
        return None
    away = bias_mm
    for _ in range(_ALTERNATIONS):  # of both means: weights differ
        away = away - (away * information).sum(axis=0) / information.sum(axis=0)
        for number in surfaces:
            own = surface == number
            away[:, own] -= ((away * information)[:, own].sum(axis=1) / information[:, own].sum(axis=1))[:, None]
    return float((away**2 * information).sum() / free)


def spreads_of_biases(task: SearchTask, bias_mm: FloatArray, information: FloatArray) -> PatternSpreads | None:
    """Spreads of the pattern that biases (recording, pixel) show together; None if they show none."""
    total = information.sum(axis=0)
    mean = (bias_mm * information).sum(axis=0) / np.maximum(total, LEAST_INFORMATION)
    known = np.where(total > LEAST_INFORMATION, total, 0.0)
    mean = np.where(known > 0, mean, 0.0)
    found = PixelBiases(bias=mean, information=known, gain=0.5 * mean**2 * known)
    fitted = hidden_fits.fit_spreads(found, task.likelihood.evidence.image)
    return None if fitted is None else fitted[0]


def _moves(change: FloatArray, told: FloatArray, surface: IntArray, used: BoolArray) -> FloatArray:
    """Shift of each surface in each tenth (tenth, pixel), mm: a mean over its pixels."""
    out = np.zeros_like(change)
    for number in np.unique(surface[used]):
        own = used & (surface == number)
        total = np.maximum(told[:, own].sum(axis=1), LEAST_INFORMATION)
        out[:, own] = ((change * told)[:, own].sum(axis=1) / total)[:, None]
    return out


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
