"""Step 4: add effects one by one while they gain, and drop those that no longer earn their place.

An effect is added if its held-out gain, less the price of its parameters, is above what chance gives among all that
was tried, above what a model within its tolerance gains, and no mere crumb of what was gained so far. A fixed
pattern, which can stand for any static bias, must leave every structured effect that gains beside it the precedence.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from tofmix.arrays import IntArray
from tofmix.reconcile import links
from tofmix.reconcile.compare import Compared, compare
from tofmix.reconcile.curvature import Numbers
from tofmix.reconcile.fits import fit
from tofmix.reconcile.joint import views
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.localise import disagreements
from tofmix.reconcile.name import PRICE_NATS, Candidate, Trial, begin_trial, candidates, pattern_gain, tolerated
from tofmix.reconcile.standard_errors import polish
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.interference import Interference

CRUMB = 0.01
"""Share of the gain so far below which a further effect is not believed: no law of ours is exact."""

_COVERED = 0.999  # share of the beam that surfaces fill
_ALIAS_NATS = 6.0
_ALIAS_SHARE = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How reconciliation goes about.

    Parameters
    ----------
    kinds : tuple of str
        Effects that are tried.
    max_effects : int
        Most effects that are added.
    alpha : float
        Level of all tests, after correction.
    tolerance : float
        Error of the model that is taken as right: of a pose in sigma, of the noise's scale in tenths.
    split : str
        What is held out: ``frames``, ``pixels`` or ``frames,pixels``.
    seed : int
        Seed of every draw.
    """

    kinds: tuple[str, ...]
    max_effects: int = 3
    alpha: float = 0.01
    tolerance: float = 0.1
    split: str = "frames,pixels"
    seed: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Added:
    """What came of the search.

    Parameters
    ----------
    state : State
        The model with the effects that were added.
    chosen : tuple of Candidate
        They, in the order of their adding.
    first : tuple of Candidate
        All candidates of the first round, best first.
    aliases : tuple of tuple of Candidate
        Candidates that the recording cannot tell from a chosen one, which stands first.
    tolerated : State
        The refined model within its tolerance.
    panel : Compared
        Panel of the refined model within its tolerance, on held-out frames.
    """

    state: State
    chosen: tuple[Candidate, ...]
    first: tuple[Candidate, ...]
    aliases: tuple[tuple[Candidate, ...], ...]
    tolerated: State
    panel: Compared


@dataclass(slots=True, eq=False)
class _Search:
    likelihood: Likelihood
    settings: Settings
    tick: Callable[[str], None]
    state: State
    chosen: list[Candidate] = field(default_factory=list)
    first: tuple[Candidate, ...] = ()
    aliases: list[tuple[Candidate, ...]] = field(default_factory=list)


def add(likelihood: Likelihood, settings: Settings, tick: Callable[[str], None] = lambda _: None) -> Added:
    """Look for effects until the panel agrees, nothing gains, or there are enough.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    settings : Settings
        How.
    tick : callable
        Told of each kind that was tried.
    """
    search = _Search(likelihood, settings, tick, likelihood.start())
    held = held_out(likelihood, settings)
    while True:
        near = tolerated(likelihood, search.state, fit_part(likelihood, settings), settings.tolerance)
        panel = compare(likelihood, near, _covered(likelihood, search.state, held), seed=settings.seed)
        if not disagreements(panel, settings.alpha) or len(search.chosen) >= settings.max_effects:
            break
        if not _round(search, near):
            break
        _refit(search)
        _drop(search)
    return Added(
        state=search.state, chosen=tuple(search.chosen), first=search.first, aliases=tuple(search.aliases),
        tolerated=near, panel=panel,
    )  # fmt: skip


def _covered(likelihood: Likelihood, state: State, part: Part) -> Part:
    """The part without pixels that see nothing, where the noise was scaled.

    The law of `excess_noise` leaves samples without a return as they are; light that adds noise does not. What
    they show then speaks of the law, not of the name.
    """
    if not any(isinstance(e, ExcessNoise) for e in state.effects):
        return part
    lit = np.ones(likelihood.evidence.shape[1], dtype=bool)
    for view in views(likelihood, likelihood.scene.mixture(), part):
        lit &= (view.mixture.weight[0] * view.mixture.lit[0]).sum(axis=0) > _COVERED
    pixels = part[1][lit[part[1]]]
    return (part[0], pixels) if pixels.size else part


def held_out(likelihood: Likelihood, settings: Settings) -> Part:
    """Frames that no fit has seen, all pixels; the held-out pixels where frames are not split."""
    if "frames" not in settings.split:
        return likelihood.evidence.part(fit=False, split=settings.split)
    return np.flatnonzero(~likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])


def fit_part(likelihood: Likelihood, settings: Settings) -> Part:
    """What joint fits see: the rest of `held_out`."""
    if "frames" not in settings.split:
        return likelihood.evidence.part(fit=True, split=settings.split)
    return np.flatnonzero(likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])


def _round(search: _Search, near: State) -> bool:
    """Try all kinds and add the best, if it is good enough."""
    settings, likelihood = search.settings, search.likelihood
    trial = begin_trial(likelihood, search.state, settings.split, settings.seed)
    allowed = max(0.0, likelihood.value(near, trial.test_part) - trial.base)
    found = candidates(trial, settings.kinds, search.tick)
    search.first = search.first or tuple(found)
    best = _best(trial, found)
    if best is None:
        return False
    needed = allowed + math.log(max(len(found), 1) / settings.alpha)
    needed = max(needed, CRUMB * sum(c.gain for c in search.chosen))
    if best.score <= needed:
        return False
    search.aliases += _aliases(best, found)
    search.chosen.append(best)
    search.state = best.state
    return True


def _best(trial: Trial, found: Sequence[Candidate]) -> Candidate | None:
    """The best candidate; before a fixed pattern, a structured effect that gains beside it."""
    if not found or found[0].kind != FixedPattern.kind:
        return found[0] if found else None
    alone = found[0].gain
    beside = []
    for other in found[1:]:
        if other.fitted is None or other.gain < PRICE_NATS * other.parameters + 10:
            continue
        gain = _with_pattern(trial, other, found[0])
        if gain - alone > PRICE_NATS * other.parameters + 10 + 0.002 * alone:
            beside.append((gain, other))
    return max(beside, key=lambda pair: pair[0])[1] if beside else found[0]


def _with_pattern(trial: Trial, other: Candidate, pattern: Candidate) -> float:
    """Held-out gain of a structured effect and a pattern together."""
    mixture = trial.likelihood.scene.mixture(other.state.effects)
    fitted = links.fit_pattern(trial.likelihood, mixture, other.state, trial.fit_part)
    effect = fitted[0] if fitted is not None else cast("FixedPattern", pattern.effect)
    return other.gain + pattern_gain(trial, other.state, mixture, effect)


def _aliases(best: Candidate, found: Sequence[Candidate]) -> list[tuple[Candidate, ...]]:
    near = tuple(
        c for c in found
        if c is not best and c.kind != best.kind and best.gain - c.gain < max(_ALIAS_NATS, _ALIAS_SHARE * best.gain)
    )  # fmt: skip
    return [(best, *near)] if near else []


def _refit(search: _Search) -> None:
    """Fit all effects anew, each given the others, on the fitting frames and all their pixels."""
    likelihood, part = search.likelihood, fit_part(search.likelihood, search.settings)
    for _ in range(2 if len(search.chosen) > 1 else 1):
        for k, candidate in enumerate(search.chosen):
            if candidate.fitted is None or not candidate.fitted.problem.steps:
                continue
            rest = _without(search.state, k)
            likelihood.scene.anchor(search.state.effects)
            fitted = fit(candidate.fitted.problem, likelihood, rest, part, start=candidate.fitted.vector)
            search.chosen[k] = replace(candidate, effect=fitted.effect, fitted=fitted)
            search.state = replace(search.state, effects=_at(rest.effects, k, fitted.effect))
    likelihood.scene.anchor(search.state.effects)
    search.state = latent_states(likelihood, search.state, part[0])
    last = polish(numbers(likelihood, search.state, search.chosen, part))
    likelihood.scene.anchor(last.state.effects)
    search.state = latent_states(likelihood, last.state, part[0])
    for k, candidate in enumerate(search.chosen):
        search.chosen[k] = replace(candidate, effect=search.state.effects[k], fitted=last.fits.get(k, candidate.fitted))


def numbers(likelihood: Likelihood, state: State, chosen: Sequence[Candidate], part: Part) -> Numbers:
    """The effects that were searched for, as one vector of numbers."""
    fits = {k: c.fitted for k, c in enumerate(chosen) if c.fitted is not None and c.fitted.problem.steps}
    return Numbers(likelihood=likelihood, state=state, fits=fits, part=part)


def _without(state: State, number: int) -> State:
    return replace(state, effects=(*state.effects[:number], *state.effects[number + 1 :]))


def _at(effects: tuple[Effect, ...], number: int, effect: Effect) -> tuple[Effect, ...]:
    return (*effects[:number], effect, *effects[number:])


def latent_states(likelihood: Likelihood, state: State, frames: IntArray) -> State:
    """Fit the effects that link samples anew, given the others.

    Parameters
    ----------
    likelihood, state
        As they stand.
    frames : (n,) int64
        What a pattern's map is made from.
    """
    effects = list(state.effects)
    mixture = likelihood.scene.mixture(state.effects)
    part = frames, np.arange(likelihood.evidence.shape[1])
    for k, effect in enumerate(effects):
        if isinstance(effect, FixedPattern):
            bare = replace(state, pixel_bias=np.zeros_like(state.pixel_bias))
            fitted = links.fit_pattern(likelihood, mixture, bare, part)
            spread = effect if fitted is None else fitted[0]
            effects[k] = spread
            pattern, variance = links.pattern_map(likelihood, mixture, bare, spread, frames)
            effects[k] = links.with_map(spread, pattern, likelihood.evidence.image)
            state = replace(state, pixel_bias=pattern, pixel_variance=variance, effects=tuple(effects))
        elif isinstance(effect, Interference):
            bare = replace(state, effects=tuple(e for e in state.effects if e is not effect))
            fitted_bursts = links.fit_interference(likelihood, mixture, bare, part)
            bursts = effect if fitted_bursts is None else fitted_bursts
            effects[k] = bursts
            disturbed = links.disturbed_frames(likelihood, mixture, bare, bursts)
            state = replace(state, disturbed=disturbed, effects=tuple(effects))
    return replace(state, effects=tuple(effects))


def _drop(search: _Search) -> None:
    """Drop what no longer earns its place beside the newest effect."""
    if len(search.chosen) <= 1:
        return
    likelihood = search.likelihood
    part = likelihood.evidence.part(fit=False, split=search.settings.split)
    whole = likelihood.value(search.state, part)
    for k in range(len(search.chosen) - 2, -1, -1):
        candidate = search.chosen[k]
        if candidate.fitted is None:
            continue
        if whole - likelihood.value(_without(search.state, k), part) < PRICE_NATS * candidate.parameters:
            search.state = _without(search.state, k)
            del search.chosen[k]
