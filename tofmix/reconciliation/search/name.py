"""Step 3: fit each effect of the registry to the fitting data, and score it on the held-out data.

The score is the gain in held-out log predictive density over the model with the effects added so far. Frames and pixels
are held out in blocks. The model moved within its tolerance (poses by a part of sigma, the scale of the noise by a
tenth of that part) is a rival, `tolerated`: an effect must explain more than this rival.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from tofmix.arrays import Float32Array, FloatArray
from tofmix.reconciliation.evidence import BLOCK_FRAMES, Evidence
from tofmix.reconciliation.ledger import Ledger, name_of_effect
from tofmix.reconciliation.likelihood.beats import FrameNoise, fit_beat
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import fit_memory, memory_gain
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import marginal_pattern, pixel_biases, spreads_of
from tofmix.reconciliation.parameters.fits import Fitted, fit
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.search import links
from tofmix.reconciliation.search.links import find_lattice
from tofmix.simulation.effects import EFFECTS, Effect, basic_kind
from tofmix.simulation.effects.base import Basic, Target
from tofmix.simulation.effects.hidden import (
    DisturbedFrames,
    FrameChain,
    HiddenState,
    PatternSpreads,
    PixelBias,
    PixelValue,
    RangeStep,
    RememberedNoise,
)
from tofmix.simulation.effects.search import EFFECT_NATS, OwnProblems

_Hidden = TypeVar("_Hidden", bound=HiddenState)

PRICE_NATS = 3.0  # of each free parameter
FAINT_SHARE = 0.01
"""An effect is faint if it gains less than this share of the others' gain: no law of theirs is exact."""

_MANY_FRAMES = 80  # with so many or more, half of them rank the candidates
_STEPS = 2  # of poses, within the tolerance
_HALVINGS = 6  # a sixty-fourth of a tolerated step changes nothing
_ANY_NOISE = math.log(4)  # limit of the logarithm of a noise scale
SLACK = 1.15
"""Factor on the tolerance, which is a typical error and not the largest one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriedEffect:
    """An effect that was tried.

    Parameters
    ----------
    effect : Effect
        With its fitted parameters.
    gain : float
        Held-out gain over the model with the effects added so far, nats.
    parameters : int
        Free parameters.
    state : ModelState
        The model with this effect.
    fitted : Fitted or None
        The end of its search, if it was searched for.
    others : tuple of TriedEffect
        The effects added before, if they were fitted again together with it; else empty.
    price_nats : float
        Price of an optional part of its law, if it was not searched for; else its search has it.
    """

    effect: Effect
    gain: float
    parameters: int
    state: ModelState
    fitted: Fitted | None = None
    others: tuple["TriedEffect", ...] = ()
    price_nats: float = 0.0

    @property
    def kind(self) -> str:
        """Its kind."""
        return self.effect.kind

    @property
    def static(self) -> bool:
        """Whether it gives each pixel a constant bias."""
        return self.effect.target is Target.BIAS

    @property
    def patterned(self) -> bool:
        """Whether it gives each pixel a bias of its own, so that it can imitate every static effect."""
        return isinstance(self.effect.hidden, PixelBias)

    @property
    def exact(self) -> bool:
        """Whether its law is exact. Its gain then does not limit the remaining deviation."""
        return self.effect.exact_law

    @property
    def loses(self) -> bool:
        """Whether it loses samples. Its gain, from lost samples, then says nothing about the ranges of the others."""
        return self.effect.target is Target.LOSS

    @property
    def score(self) -> float:
        """Gain less the price."""
        return self.gain - self.price

    @property
    def form(self) -> str:
        """Which of its kind's forms it is."""
        return "" if self.fitted is None else self.fitted.problem.form

    @property
    def price(self) -> float:
        """Price of the parameters, and of an optional part of the law, nats."""
        part = self.price_nats if self.fitted is None else self.fitted.problem.price_nats
        return PRICE_NATS * self.parameters + part


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """Data that all candidates of one round share.

    `ledger` receives each set that is fitted, with its evidence: that of the state is `evidence_nats`.
    """

    likelihood: Likelihood
    state: ModelState
    mixture: Mixture
    scores: Float32Array
    fit_part: Part
    test_part: Part
    base: float
    ledger: Ledger = field(default_factory=Ledger)
    evidence_nats: float = 0.0

    def weigh(self, candidate: "TriedEffect", why_not: str | None = None) -> None:
        """Enter the state with one more effect into the ledger."""
        names = [*map(name_of_effect, self.state.effects), name_of_effect(candidate.effect)]
        self.ledger.weigh(names, self.evidence_of(candidate), why_not)

    def evidence_of(self, candidate: "TriedEffect") -> float:
        """Log evidence, nats, of the state with one more effect over that of the model as given."""
        gain = of_all_samples(self.likelihood, self.test_part, candidate.gain)
        return self.evidence_nats + gain - candidate.price

    @property
    def names(self) -> set[tuple[str, str]]:
        """Kinds, and surfaces, that the model has already."""
        return {(e.kind, getattr(e, "surface", "")) for e in self._effects}

    def has_hidden(self, kind: type[Effect]) -> bool:
        """Whether the model has a hidden state of the same sort as a kind; it can have one."""
        return any(type(e.hidden) is type(kind.hidden) for e in self._effects)

    @property
    def _effects(self) -> tuple[Effect, ...]:
        return (*self.likelihood.scene.effects, *self.state.effects)


def of_all_samples(likelihood: Likelihood, part: Part, gain: float) -> float:
    """The gain, nats, that all samples have where those of a part have this one."""
    frames, pixels = likelihood.evidence.shape
    return gain * (frames * pixels) / max(len(part[0]) * len(part[1]), 1)


def begin_trial(
    likelihood: Likelihood,
    state: ModelState,
    split: str,
    seed: int,
    *,
    ledger: Ledger | None = None,
    evidence_nats: float = 0.0,
) -> Trial:
    """Prepare a round; the ledger gets its sets, and the evidence is that of the state."""
    mixture = likelihood.mixture(state)
    test = likelihood.evidence.part(fit=False, split=split)
    frames, pixels = likelihood.evidence.shape
    whole = np.arange(frames), np.arange(pixels)
    return Trial(
        likelihood=likelihood,
        state=state,
        mixture=mixture,
        scores=likelihood.scores(state, whole, seed, mixture),
        fit_part=thinned(likelihood.evidence, likelihood.evidence.part(fit=True, split=split)),
        test_part=test,
        base=likelihood.value(state, test, mixture),
        ledger=Ledger() if ledger is None else ledger,
        evidence_nats=evidence_nats,
    )


def thinned(evidence: Evidence, part: Part) -> Part:
    """Every second block of the frames, if there are many. They rank candidates; added effects are fitted to all."""
    frames, pixels = part
    if len(frames) < _MANY_FRAMES:
        return part
    return frames[evidence.frame_number[frames] // (2 * BLOCK_FRAMES) % 2 == 0], pixels


def candidates(trial: Trial, kinds: Iterable[str], tick: Callable[[str], None] = lambda _: None) -> list[TriedEffect]:
    """Every possible effect of these kinds, best first; if the ledger ends the search, those that were tried so far.

    Parameters
    ----------
    trial : Trial
        The round.
    kinds : iterable of str
        Kinds to try.
    tick : callable
        Called with each kind that is done.
    """
    found: list[TriedEffect] = []
    for kind in kinds:
        if trial.ledger.ends():
            break
        special = _BY_HIDDEN.get(type(EFFECTS[kind].hidden))
        if special is not None and not trial.has_hidden(EFFECTS[kind]):
            candidate = special(trial, EFFECTS[kind])
            if candidate is not None:
                trial.weigh(candidate)
                found.append(candidate)
        if special is None or isinstance(EFFECTS[kind], OwnProblems):
            found += _by_search(trial, kind)
        tick(kind)
    return sorted(found, key=lambda c: -c.score)


def _by_search(trial: Trial, kind: str) -> list[TriedEffect]:
    out = []
    for problem in problems(kind, trial.likelihood, trial.mixture):
        if trial.ledger.ends():
            break
        if problem.starts and problem.starts[0] is not None:
            try:
                surface = getattr(problem.make(np.array(problem.starts[0])), "surface", "")
            except ValueError:
                continue
            if (kind, surface) in trial.names:
                continue
        fitted = fit(problem, trial.likelihood, trial.state, trial.fit_part)
        if not np.isfinite(fitted.value):
            continue
        state = replace(trial.state, effects=(*trial.state.effects, fitted.effect))
        gain = trial.likelihood.value(state, trial.test_part) - trial.base
        new = TriedEffect(effect=fitted.effect, gain=gain, parameters=problem.parameters, state=state, fitted=fitted)
        why_not = _refused(trial, new)
        trial.weigh(new, why_not)
        if why_not is None:
            out.append(new)
    return out


def _refused(trial: Trial, new: TriedEffect) -> str | None:
    """Why a candidate is none, whatever it gains; None for a candidate."""
    if new.fitted is not None and new.fitted.at_a_bound:
        return AT_A_BOUND
    if new.static and new.gain > 0:
        ends = (trial.state, trial.mixture), (new.state, trial.likelihood.mixture(new.state))
        if not moves_by_itself(trial.likelihood, *ends, trial.test_part):
            return f"{new.kind} moves no range: its only trace is noise"
    return None


AT_A_BOUND = "a number is at its bound, where another effect does the same"


def moves_by_itself(
    likelihood: Likelihood, before: tuple[ModelState, Mixture], after: tuple[ModelState, Mixture], part: Part
) -> bool:
    """Whether the bias of an effect gives more than a faint part of its gain; the rest is by a change of the noise.

    Some effects on light change both. A second path that is longer by one turn only adds noise to a surface. Noise has
    many causes, and a bias that is not seen is an unlikely one.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    before, after : (ModelState, Mixture)
        The model without and with the effect.
    part : (frames, pixels)
        Data of the gains.
    """
    (without_it, bare), (with_it, mixture) = before, after
    if mixture.mean.shape != bare.mean.shape or np.array_equal(mixture.sigma, bare.sigma):
        return True
    whole = likelihood.value(with_it, part, mixture)
    by_bias = whole - likelihood.value(with_it, part, replace(mixture, mean=bare.mean))
    gain = whole - likelihood.value(without_it, part, bare)
    return by_bias > max(2 * PRICE_NATS, FAINT_SHARE * gain)


_Kind = type[Effect]


def _declared(kind: _Kind, sort: type[_Hidden]) -> _Hidden:
    """The declaration of a kind with this sort of hidden state."""
    if not isinstance(kind.hidden, sort):
        raise TypeError(f"{kind.kind} has no {sort.__name__}")
    return kind.hidden


def _stuck(trial: Trial, kind: _Kind) -> TriedEffect | None:
    values = links.find_stuck(trial.likelihood, trial.mixture)
    if values is None:
        return None
    hidden = _declared(kind, PixelValue)
    effect = hidden.with_map(hidden.made(kind, ()), values.reshape(trial.likelihood.evidence.image))
    state = replace(trial.state, effects=(*trial.state.effects, effect), stuck_mm=values)
    frames, pixels = trial.test_part
    stuck = pixels[~state.working[pixels]]
    all_stuck = np.flatnonzero(~state.working)
    part = (frames, stuck if stuck.size else all_stuck)
    before = trial.likelihood.sums(trial.mixture, trial.state, part).total
    gain = -before - links.VALUE_NATS * part[1].size
    return TriedEffect(effect=state.effects[-1], gain=gain, parameters=1, state=state)


def _lattice(trial: Trial, kind: _Kind) -> TriedEffect | None:
    step_mm = find_lattice(trial.likelihood.evidence, trial.state)
    if step_mm is None:
        return None
    effect = _declared(kind, RangeStep).made(kind, (step_mm,))
    state = replace(trial.state, effects=(*trial.state.effects, effect))
    gain = trial.likelihood.value(state, trial.test_part) - trial.base
    return TriedEffect(effect=effect, gain=gain, parameters=1, state=state)


def _bursts(trial: Trial, kind: _Kind) -> TriedEffect | None:
    """Bursts, or a beat if it explains more: one number more, its phase, at the price of one more effect."""
    bursts = links.fit_bursts(trial.likelihood, trial.mixture, trial.state, trial.fit_part)
    beat = fit_beat(FrameNoise(trial.likelihood, trial.mixture, trial.state, trial.fit_part))
    found = [] if bursts is None else [_of_frames(trial, kind, bursts, 3, 0.0)]
    found += [] if beat is None else [_of_frames(trial, kind, beat[0], 4, EFFECT_NATS)]
    return max(found, key=lambda c: c.score, default=None)


def _of_frames(trial: Trial, kind: _Kind, chain: FrameChain, parameters: int, price_nats: float) -> TriedEffect:
    effect = _declared(kind, DisturbedFrames).made(kind, chain)
    frames = links.disturbed_frames(trial.likelihood, trial.mixture, trial.state, chain)
    state = replace(trial.state, effects=(*trial.state.effects, effect), disturbed=frames)
    gain = trial.likelihood.value(state, trial.test_part, trial.mixture) - trial.base
    return TriedEffect(effect=effect, gain=gain, parameters=parameters, state=state, price_nats=price_nats)


def _pattern(trial: Trial, kind: _Kind) -> TriedEffect | None:
    fitted = links.fit_pattern(trial.likelihood, trial.mixture, trial.state, trial.fit_part)
    if fitted is None:
        return None
    spreads, _ = fitted
    gain = pattern_gain(trial, spreads)
    frames = np.flatnonzero(trial.likelihood.evidence.fit_frames)
    pattern, variance = links.pattern_map(trial.likelihood, trial.mixture, trial.state, spreads, frames)
    hidden, image = _declared(kind, PixelBias), links.pattern_image(pattern, trial.likelihood.evidence.image)
    effect = hidden.with_map(hidden.made(kind, spreads), image)
    effects, bias = (*trial.state.effects, effect), trial.state.pixel_bias + pattern
    state = replace(trial.state, effects=effects, pixel_bias=bias, pixel_variance=variance)
    parameters = spreads_of(trial.likelihood.evidence.image)
    return TriedEffect(effect=effect, gain=gain, parameters=parameters, state=state)


def pattern_gain(trial: Trial, spreads: PatternSpreads) -> float:
    """Held-out gain of a pattern, with its values integrated out, because those of held-out pixels are not fitted."""
    found = pixel_biases(trial.likelihood, trial.mixture, trial.state, trial.test_part)
    return marginal_pattern(found, trial.likelihood.evidence.image, spreads)[0]


def _memory(trial: Trial, kind: _Kind) -> TriedEffect | None:
    coefficient = fit_memory(trial.likelihood, trial.scores, trial.mixture, trial.fit_part)
    if coefficient is None:
        return None
    effect = _declared(kind, RememberedNoise).made(kind, (coefficient,))
    gain = memory_gain(trial.likelihood, trial.scores, trial.mixture, trial.test_part, coefficient)
    state = replace(trial.state, effects=(*trial.state.effects, effect))
    return TriedEffect(effect=effect, gain=gain, parameters=1, state=state)


_BY_HIDDEN: Mapping[type, Callable[[Trial, _Kind], TriedEffect | None]] = {
    PixelValue: _stuck,
    RangeStep: _lattice,
    DisturbedFrames: _bursts,
    PixelBias: _pattern,
    RememberedNoise: _memory,
}
"""What finds a hidden state; a kind with another one, or without one, is searched for by its numbers."""

KINDS = tuple(EFFECTS)
"""All kinds that are tried."""


def tolerated(likelihood: Likelihood, state: ModelState, part: Part, tolerance: float) -> ModelState:
    """The model with poses and noise scale moved within the tolerance to where they fit best.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : ModelState
        The model with the effects added so far.
    part : (frames, pixels)
        Data of the fit.
    tolerance : float
        Accepted error of a surface's ranges by its position, in sigma of the pixels that see it; of the noise scale, in
        tenths. Tilts are not accepted.
    """
    if tolerance <= 0:
        return state
    best, value = _within(likelihood, state, part, tolerance)
    if any(e.is_basic(Basic.NOISE) for e in (*likelihood.scene.effects, *state.effects)):
        return best
    if state.bursts is not None:  # integrated out below, but not where poses were moved
        value = likelihood.value(best, part)

    noise = basic_kind(Basic.NOISE)

    def scaled(factor: float) -> ModelState:
        return replace(best, effects=(*best.effects, noise.of_magnitude(factor)))

    limit = 0.1 * tolerance * SLACK
    if state.errors is not None:  # the noise of a measured scene has an error too
        limit += 2.0 * state.errors.common_log_width
    less, more = (likelihood.value(scaled(1 + sign * limit), part) for sign in (-1, 1))
    curve = less - 2 * value + more
    peak = 0.5 * (less - more) / curve if curve < 0 else float(np.sign(more - less))
    return scaled(1 + limit * float(np.clip(peak, -1, 1)))


def of_any_noise(likelihood: Likelihood, state: ModelState, part: Part) -> ModelState:
    """The state with the scale of the noise that fits best, in place of the tolerated one; parameters as above.

    Static effects on light change the noise too. Noise has many causes, such as a pattern that is not fitted yet, so
    effects are compared by their biases.
    """
    if state.bursts is not None or any(e.is_basic(Basic.NOISE) for e in likelihood.scene.effects):
        return state
    others = tuple(e for e in state.effects if not e.is_basic(Basic.NOISE))
    named = next((e for e in state.effects if e.is_basic(Basic.NOISE)), basic_kind(Basic.NOISE).of_magnitude(1.0))

    def scaled(log_factor: float) -> ModelState:
        return replace(state, effects=(*others, named.with_magnitude(math.exp(log_factor))))

    best = minimize_scalar(
        lambda x: -likelihood.value(scaled(x), part),
        bounds=(-_ANY_NOISE, _ANY_NOISE),
        method="bounded",
        options={"xatol": 0.01},
    )
    return scaled(float(best.x))


def _within(likelihood: Likelihood, state: ModelState, part: Part, tolerance: float) -> tuple[ModelState, float]:
    """The model with poses moved within the tolerance to where they fit best, and its log-likelihood.

    Newton steps, each halved until the log-likelihood rises: for quantised ranges it is no parabola.
    """

    def at(shifts: FloatArray) -> _Slopes:
        moved = replace(state, effects=(*state.effects, *_poses(likelihood, shifts)))
        return _slopes(likelihood, moved, part, shifts)

    here = at(np.zeros(len(likelihood.scene.names)))
    for _ in range(_STEPS):
        step = here.step(likelihood, tolerance)
        for _ in range(_HALVINGS):
            there = at(here.shifts + step)
            if there.value >= here.value:
                break
            step = 0.5 * step
        else:
            break
        here = there
    return here.state, here.value


def _poses(likelihood: Likelihood, shifts: FloatArray) -> tuple[Effect, ...]:
    names, pose = likelihood.scene.names, basic_kind(Basic.POSE)
    return tuple(pose.of_magnitude(float(d), surface=n) for n, d in zip(names, shifts, strict=True) if d)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Slopes:
    """Log-likelihood of a model whose surfaces (surface,) are moved by `shifts` mm, with its derivatives by them."""

    state: ModelState
    shifts: FloatArray
    value: float
    slope: FloatArray
    information: FloatArray

    def step(self, likelihood: Likelihood, tolerance: float) -> FloatArray:
        """Newton's step (surface,), mm, that ends within the tolerance."""
        out = np.zeros(self.shifts.size)
        sigma = np.nan_to_num(likelihood.scene.sigma_of_place)  # if no pixel sees a surface, its position is unknown
        for number in np.flatnonzero(self.information > 0):
            limit = SLACK * tolerance * float(sigma[number])
            to = self.shifts[number] + self.slope[number] / self.information[number]
            out[number] = float(np.clip(to, -limit, limit)) - self.shifts[number]
        return out


def _slopes(likelihood: Likelihood, state: ModelState, part: Part, shifts: FloatArray) -> _Slopes:
    m = likelihood.mixture(state)
    value, slope, information = 0.0, np.zeros(shifts.size), np.zeros(shifts.size)
    for view in views(likelihood, m, part):
        sums = likelihood.marginal(m, state, view.part_of_all)
        value += sums.total
        _add_slopes(likelihood, view, sums.by_pixel, slope, information)
    return _Slopes(state=state, shifts=shifts, value=value, slope=slope, information=information)


def _add_slopes(
    likelihood: Likelihood, view: RecordingView, sums: FloatArray, slope: FloatArray, information: FloatArray
) -> None:
    """Add slope and information of one recording about the shifts of surfaces."""
    m = view.mixture
    surface, single = m.of_main(m.surface), m.of_main(m.weight) > 0.9 * m.told
    for own_number, name in enumerate(view.scene.names):
        own = single & (surface == own_number)
        number = likelihood.scene.names.index(name)
        lever = m.of_main(m.true_range)[own] / likelihood.scene.distance[number]
        information[number] += float((sums[own, 2] * lever**2).sum())
        slope[number] += float((sums[own, 1] * lever).sum())
