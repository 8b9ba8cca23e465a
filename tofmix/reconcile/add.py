"""Step 4: add effects one by one while they gain, and drop those that no longer earn their place.

An effect is added if its held-out gain, less the price of its parameters, is above what chance gives among all that
was tried, above what a model within its tolerance gains, and no mere crumb of what was gained so far. A fixed
pattern, which can stand for any static bias, must leave every structured effect that gains beside it the precedence.

Where two effects are hidden, a third may gain more than either alone, and taken first it stands in the way of both. So
close rivals of earlier effects are tried again beside the later ones, and where no explanation is reached, the search
begins anew with other candidates.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tofmix.reconcile.beside import ALIAS_NATS, best_beside, settled_within, with_the_others, worth
from tofmix.reconcile.compare import Compared, compare
from tofmix.reconcile.joint import views
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.localise import disagreements
from tofmix.reconcile.name import PRICE_NATS, Candidate, Trial, begin_trial, candidates, recast, tolerated
from tofmix.reconcile.refit import begin, refit, without
from tofmix.reconcile.static_fits import STATIC
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.stuck_pixels import StuckPixels

CRUMB = 0.01
"""Share of the gain so far below which a further effect is not believed: no law of ours is exact."""

EXACT = ("phase_wrapping", "stuck_pixels", "quantisation")
"""Kinds whose law is exact. Each sample that they explain gains as much as many that are a little off, so that their
gains say nothing of what is left."""

LOST = ("dropout", "saturation")
"""Kinds that lose samples. What they gain, a sample each, says nothing of the ranges of the others."""

_TRIED = 4  # rivals that are looked at with the model within its tolerance
_FAIR = 0.5  # share of the best candidate's score from which another may begin a way

_COVERED = 0.999  # share of the beam that surfaces fill
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
    panel : Compared
        Panel of the refined model, on held-out frames, moved within its tolerance to where it fits them best.
    """

    state: State
    chosen: tuple[Candidate, ...]
    first: tuple[Candidate, ...]
    aliases: tuple[tuple[Candidate, ...], ...]
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
    begun: Candidate | None = None
    rivals: list[tuple[Candidate, ...]] = field(default_factory=list)  # of each that was chosen, at its time


def ways(likelihood: Likelihood, settings: Settings, tick: Callable[[str], None] = lambda _: None) -> Iterator[Added]:
    """Ways of adding effects until the panel agrees, nothing gains, or there are enough; each when it is asked for.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    settings : Settings
        How.
    tick : callable
        Told of each kind that was tried.
    """
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.tolerance)
    best = _Search(likelihood, settings, tick, start)
    yield _followed(best)
    other = _beginning(best)
    if other is not None:
        search = _Search(likelihood, settings, tick, start, first=best.first)
        likelihood.scene.anchor(search.state.effects)
        _take(search, _Taken((other,), _near(other, best.first)), best.first)
        yield _followed(search)


def _beginning(best: _Search) -> Candidate | None:
    """The next candidate of the first round to begin with, of another kind than the best way did.

    A fixed pattern is none: it takes all that is static, whatever it is.
    """
    if best.begun is None:
        return None
    kinds = (best.begun.kind, FixedPattern.kind)
    other = next((c for c in best.first if c.kind not in kinds), None)
    return other if other is not None and other.score > _FAIR * best.begun.score else None


def _followed(search: _Search) -> Added:
    """Go on from where a search stands to its end."""
    likelihood, settings = search.likelihood, search.settings
    held = held_out(likelihood, settings)
    stood: list[list[tuple[str, str]]] = []
    while True:
        # The test asks whether any model within the tolerance agrees with these frames: fitted to others, it would
        # bring the chance of those along
        near = settled_within(likelihood, search.state, search.chosen, held, settings.tolerance)
        panel = compare(likelihood, near, _covered(likelihood, search.state, held), seed=settings.seed)
        if not disagreements(panel, settings.alpha) or len(search.chosen) >= settings.max_effects:
            break
        names = sorted(_name(c) for c in search.chosen)
        if names in stood or not _round(search):  # what was added before was dropped again
            break
        stood.append(names)
    kept = {c.kind for c in search.chosen}
    return Added(
        state=search.state, chosen=tuple(search.chosen), first=search.first,
        aliases=tuple(group for group in search.aliases if group[0].kind in kept), panel=panel,
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


def _round(search: _Search) -> bool:
    """Try all kinds and add the best, if it is good enough."""
    settings, likelihood = search.settings, search.likelihood
    trial = begin_trial(likelihood, search.state, settings.split, settings.seed)
    near = tolerated(likelihood, search.state, fit_part(likelihood, settings), settings.tolerance)
    allowed = max(0.0, likelihood.value(near, trial.test_part) - trial.base)
    tried = candidates(trial, settings.kinds, search.tick)
    found = _recast(trial, with_the_others(trial, search.chosen, tried))
    chance = math.log(max(len(found), 1) / settings.alpha)
    crumb = CRUMB * sum(c.gain for c in search.chosen if c.kind not in (*EXACT, *LOST))
    lost = CRUMB * sum(c.gain for c in search.chosen if c.kind not in EXACT)
    found = [c for c in found if c.kind not in LOST or c.score > lost]
    needed = max(allowed + chance, crumb)
    found, beyond = _tolerant(search, trial, found, near)
    search.first = search.first or tuple(found)
    if not found:
        return False
    if found[0].score <= needed and beyond <= max(chance, crumb):
        faint = _faint_pattern(search, found, near, needed)
        if faint is not None:
            _take(search, _Taken((faint,), ()), found)
        return faint is not None
    taken = _best(search, trial, found, near, needed)
    if len(taken.best) == 1 and taken.best[0].score <= needed:
        taken = _Taken((found[0],), _near(found[0], found))
    _take(search, taken, found)
    return True


def _faint_pattern(search: _Search, found: Sequence[Candidate], near: State, needed: float) -> Candidate | None:
    """A fixed pattern that the held-out pixels are too few for, but which gains enough over all of them.

    Its values being integrated out, it needs no pixels that are held out, as laws of few numbers need none.
    """
    pattern = next((c for c in found if c.kind == FixedPattern.kind), None)
    if pattern is None:
        return None
    parts = fit_part(search.likelihood, search.settings), held_out(search.likelihood, search.settings)
    mixture = search.likelihood.scene.mixture(near.effects)
    bare, patterned = (worth(search.likelihood, near, mixture, parts, patterned=p) for p in (False, True))
    gain = patterned - bare - PRICE_NATS * pattern.parameters
    return pattern if gain > needed else None


@dataclass(frozen=True, slots=True)
class _Taken:
    """What a round takes, and what the recording cannot tell from the first of it."""

    best: tuple[Candidate, ...]
    aliases: tuple[Candidate, ...]


def _recast(trial: Trial, found: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, best first, those that move a surface with its edges, if they are among the best."""
    fair = max((_FAIR * c.score for c in found[:1]), default=0.0)
    cast_ = [recast(trial, c) if c.score > fair else c for c in found]
    return sorted(cast_, key=lambda c: -c.score)


def _tolerant(search: _Search, trial: Trial, found: list[Candidate], near: State) -> tuple[list[Candidate], float]:
    """The candidates, first the one that is best in a model that may move within its tolerance; what it gains there.

    A law of more numbers follows the errors of the model's poses too, by which it gains over the simple one that is
    there; of a model that has taken them up already, it gains nothing.
    """
    likelihood, tolerance = search.likelihood, search.settings.tolerance
    if tolerance <= 0 or not found or found[0].kind not in STATIC:
        return found, -math.inf
    part, test = fit_part(likelihood, search.settings), trial.test_part
    static = [c for c in found if c.kind in STATIC and c.fitted is not None and c.gain > 0]
    simple = [c for c in static if c.parameters <= found[0].parameters]
    offset = [c for c in simple[_TRIED:] if c.kind == RangeOffset.kind]
    scored = []
    for c in (*simple[:_TRIED], *offset):
        likelihood.scene.anchor(c.state.effects)
        moved = settled_within(likelihood, c.state, [*search.chosen, c], part, tolerance)
        scored.append((likelihood.value(moved, test) - PRICE_NATS * c.parameters, c))
    likelihood.scene.anchor(trial.state.effects)
    if not scored:
        return found, -math.inf
    score, best = max(scored, key=lambda pair: pair[0])
    beyond = score - likelihood.value(near, test)
    if found[0].fitted is None:
        return found, beyond
    return [best, *(c for c in found if c is not best)], beyond


def _take(search: _Search, taken: _Taken, found: Sequence[Candidate]) -> None:
    """Add candidates to the model, as far as there is room, and fit all anew."""
    best = taken.best[: search.settings.max_effects - len(search.chosen)]
    search.begun = search.begun or best[0]
    if taken.aliases:
        search.aliases.append((best[0], *taken.aliases))
    state = best[0].state
    for candidate in best[1:]:  # one that goes with it: all are fitted anew
        state = replace(state, effects=(*state.effects, candidate.effect))
    for candidate in best:
        search.chosen.append(candidate)
        search.rivals.append(tuple(c for c in found if _name(c) not in {_name(b) for b in best}))
    search.state = state
    part = fit_part(search.likelihood, search.settings)
    search.state, search.chosen = refit(search.likelihood, search.state, search.chosen, part)
    _exchange(search, part)
    _drop(search)


def _exchange(search: _Search, part: Part) -> None:
    """Put the closest rival in the place of an earlier effect where it does better beside what has come since.

    A rival is worth the trial if it was no further behind than what the later effects have gained. What has become flat
    beside them, with numbers at a bound, is an offset.
    """
    likelihood = search.likelihood
    test = likelihood.evidence.part(fit=False, split=search.settings.split)
    for k, old in enumerate(search.chosen):
        flat = old.fitted is not None and old.fitted.at_a_bound
        later = sum(c.gain for c in search.chosen[k + 1 :])
        names = [_name(c) for c in search.chosen]
        usable = (c for c in search.rivals[k] if c.fitted is not None and _name(c) not in names)
        rival = next((c for c in usable if not flat or c.kind == RangeOffset.kind), None)
        newest = k == len(search.chosen) - 1
        if rival is None or (not flat and (newest or old.score - rival.score >= later)):
            continue
        stood = likelihood.value(search.state, test) - PRICE_NATS * old.parameters
        effects = (*search.state.effects[:k], rival.effect, *search.state.effects[k + 1 :])
        trial = [*search.chosen[:k], rival, *search.chosen[k + 1 :]]
        state, trial = refit(likelihood, replace(search.state, effects=effects), trial, part)
        if likelihood.value(state, test) - PRICE_NATS * rival.parameters > stood + (0.0 if flat else PRICE_NATS):
            search.state, search.chosen = state, trial
        likelihood.scene.anchor(search.state.effects)


def _name(candidate: Candidate) -> tuple[str, str]:
    return candidate.kind, getattr(candidate.effect, "surface", "")


def _best(search: _Search, trial: Trial, found: Sequence[Candidate], near: State, needed: float) -> _Taken:
    """The best candidate; before a fixed pattern, a structured effect that gains beside it.

    Before all of them pixels that hold one value: there is no doubt of them, and to a pattern they are large biases.
    Only a lattice goes before these, which holds pixels at one value too.
    """
    sure = {c.kind: c for c in found if c.score > 0}
    if StuckPixels.kind in sure:
        first = sure.get(Quantisation.kind, sure[StuckPixels.kind])
        return _Taken((first,), _near(first, found))
    if found[0].kind == FixedPattern.kind:
        parts = fit_part(search.likelihood, search.settings), held_out(search.likelihood, search.settings)
        beside = best_beside(trial, search.chosen, found, parts, near)
        if beside is not None:
            # The pattern's turn comes when no more gain beside it, unless it hides the effect
            if not beside.patterned or beside.first.score > needed:
                return _Taken((beside.first,), beside.rivals)
            return _Taken((beside.first, _second(search, trial, found, beside.first, parts)), beside.rivals)
    return _Taken((found[0],), _near(found[0], found))


def _second(
    search: _Search, trial: Trial, found: Sequence[Candidate], first: Candidate, parts: tuple[Part, Part]
) -> Candidate:
    """What goes with an effect that a fixed pattern hides: another effect that gains beside both, or the pattern."""
    likelihood = trial.likelihood
    likelihood.scene.anchor(first.state.effects)
    now = replace(trial, state=first.state, mixture=likelihood.scene.mixture(first.state.effects))
    near = tolerated(likelihood, first.state, parts[0], search.settings.tolerance)
    rest = [c for c in found if c.kind in STATIC and _name(c) != _name(first)]
    beside = best_beside(now, [*search.chosen, first], rest, parts, near)
    likelihood.scene.anchor(trial.state.effects)
    return found[0] if beside is None else beside.first


def _near(best: Candidate, found: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Candidates of other kinds that gain as much."""
    limit = max(ALIAS_NATS, _ALIAS_SHARE * best.gain)
    return tuple(c for c in found if c.kind != best.kind and abs(best.gain - c.gain) < limit)


def _drop(search: _Search) -> None:
    """Drop what no longer earns its place: beside the newest effect, or it, which may have led the others right."""
    if len(search.chosen) <= 1:
        return
    likelihood = search.likelihood
    part = likelihood.evidence.part(fit=False, split=search.settings.split)
    whole = likelihood.value(search.state, part)
    for k in range(len(search.chosen) - 1, -1, -1):
        candidate = search.chosen[k]
        if len(search.chosen) == 1:
            break
        if candidate.kind == FixedPattern.kind:
            if not _pattern_gains(search, k):
                search.state = _bare(search.state, k)
                whole = likelihood.value(search.state, part)
                del search.chosen[k], search.rivals[k]
            continue
        if candidate.fitted is None:
            continue
        rest = without(search.state, k)
        likelihood.scene.anchor(rest.effects)  # a pose that goes takes its edges with it
        worth_ = likelihood.value(rest, part)
        if whole - worth_ < PRICE_NATS * candidate.parameters or _is_pattern(search, k):
            search.state, whole = rest, worth_
            del search.chosen[k], search.rivals[k]
    likelihood.scene.anchor(search.state.effects)


def _bare(state: State, pattern: int) -> State:
    """The state without the fixed pattern that is the so-many-th of what was added, and without its map."""
    nothing = np.zeros_like(state.pixel_bias)
    return replace(without(state, pattern), pixel_bias=nothing, pixel_variance=nothing)


def _pattern_gains(search: _Search, number: int) -> bool:
    """Whether a fixed pattern, its values integrated out, still gains beside all else."""
    bare, likelihood = _bare(search.state, number), search.likelihood
    likelihood.scene.anchor(bare.effects)
    unseen = held_out(likelihood, search.settings)
    mixture = likelihood.scene.mixture(bare.effects)
    alone, patterned = (
        worth(likelihood, bare, mixture, (unseen, unseen), patterned=patterned) for patterned in (False, True)
    )
    return patterned - alone > PRICE_NATS * search.chosen[number].parameters


def _is_pattern(search: _Search, number: int) -> bool:
    """Whether a static effect is as well a part of the fixed pattern, whose map was found beside it.

    The map has the opposite of what the effect has too much.
    """
    state, candidate = search.state, search.chosen[number]
    pattern = next((k for k, c in enumerate(search.chosen) if c.kind == FixedPattern.kind), None)
    if pattern is None or candidate.kind not in STATIC:
        return False
    likelihood, bare = search.likelihood, _bare(state, pattern)
    rest = without(bare, number - (pattern < number))
    unseen = held_out(likelihood, search.settings)
    values = []
    for each in (bare, rest):
        likelihood.scene.anchor(each.effects)
        mixture = likelihood.scene.mixture(each.effects)
        values.append(worth(likelihood, each, mixture, (unseen, unseen), patterned=True))
    return values[0] - values[1] < PRICE_NATS * candidate.parameters
