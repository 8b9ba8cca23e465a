"""Step 4, forward: add effects one by one while they gain.

An effect is added if its held-out gain, less the price of its parameters, is above what chance gives among all that
was tried, above what a model within its tolerance gains, and not faint beside the others. A fixed pattern, which can
stand for any static bias, must leave every structured effect that gains beside it the precedence.

Where two effects are hidden, a third may gain more than either alone, and taken first it stands in the way of both. So
close rivals of earlier effects are tried again beside the later ones, and where no explanation is reached, the search
begins anew with other candidates.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.reconciliation.alternatives import Alternatives, alternatives, apart, as_candidates
from tofmix.reconciliation.beside import ALIAS_NATS, best_beside, settled_within, together, with_the_others, worth
from tofmix.reconciliation.columns import summed_up
from tofmix.reconciliation.compare import Compared, compare
from tofmix.reconciliation.drop import drop, exchange
from tofmix.reconciliation.joint import views
from tofmix.reconciliation.likelihood import Likelihood, Part, State
from tofmix.reconciliation.localise import disagreements
from tofmix.reconciliation.name import PRICE_NATS, Candidate, Trial, begin_trial, candidates, tolerated
from tofmix.reconciliation.refit import begin, refit, without
from tofmix.reconciliation.subsets import Explained
from tofmix.reconciliation.verdict import inexact
from tofmix.reconciliation.way import FAINT_SHARE, Settings, Way, fit_part, held_out, name_of
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.stuck_pixels import StuckPixels

_TRIED = 4  # rivals that are looked at with the model within its tolerance
_FAIR = 0.5  # share of the best candidate's score from which another may begin a way

_COVERED = 0.999  # share of the beam that surfaces fill
_ALIAS_SHARE = 0.002  # of the gain, by which candidates are alike


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Added:
    """What came of the way.

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
    sets : Alternatives or None
        What other sets of effects explain; None where there is nothing of which summaries tell.
    """

    state: State
    chosen: tuple[Candidate, ...]
    first: tuple[Candidate, ...]
    aliases: tuple[tuple[Candidate, ...], ...]
    panel: Compared
    sets: Alternatives | None = None


def ways(likelihood: Likelihood, settings: Settings, tick: Callable[[str], None] = lambda _: None) -> Iterator[Added]:
    """Ways of adding effects until the panel agrees, nothing gains, or there are enough; each when it is asked for.

    The first is the greedy one, or what all sets of effects together show to be better: a set of no more numbers, or of
    any size where the greedy way leaves something to be explained. Then the set of any size that explains most; then
    one that begins with another effect.

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
    best = Way(likelihood, settings, tick, start)
    added = _followed(best)
    if not added.chosen and not disagreements(added.panel, settings.alpha):
        yield added
        return
    first = _or_better(best, added)
    yield first
    larger = None if first.sets is None else first.sets.better(larger=True)
    other = None if larger is None else _from_set(best, first, larger)
    if other is not None:
        yield other
    beginning = _beginning(best)
    if beginning is not None:
        way = Way(likelihood, settings, tick, start, first=best.first)
        _take(way, _Taken((beginning,), _near(beginning, best.first)), best.first)
        yield _followed(way)


def _or_better(way: Way, added: Added) -> Added:
    """What was added, or a part of it that is enough, or another set of effects that explains more."""
    sets = added.sets
    if sets is None:
        return added
    stands_out = bool(_open(way, added.panel))
    enough = None if stands_out else sets.enough
    part = None if enough is None else _elsewhere(way, added, enough)
    if part is not None and not _open(way, part.panel):
        return part
    other = None
    for better in _alternatives(sets, larger=stands_out):
        if better is not enough:  # that has led back, or does not explain it
            other = other or _elsewhere(way, added, better)
    if other is None:
        return added
    larger = _numbers(other) > _numbers(added)  # what the search has added to the set counts too
    return other if (stands_out or not larger) and _leads(way, other, added) else added


def _alternatives(sets: Alternatives, *, larger: bool) -> list[Explained]:
    """The smallest set that is better, and the best of all, should the search from that lead back."""
    smallest, best = sets.better(larger=larger), sets.best(larger=larger)
    return [s for s in (smallest, best if best is not smallest else None) if s is not None]


def _elsewhere(way: Way, added: Added, begun: Explained) -> Added | None:
    """Where a search ends that begins with a set of effects; None if it leads back to those that were added."""
    other = _from_set(way, added, begun)
    return None if other is None or _names(other) == _names(added) else other


def _names(added: Added) -> set[tuple[str, str]]:
    return {name_of(c) for c in added.chosen}


def _numbers(added: Added) -> int:
    """How many numbers the effects have, counted as those of sets: what is chosen of a few values is none."""
    of_sets = 0 if added.sets is None else added.sets.found.numbers
    rest = (c.parameters for c in added.chosen if added.sets is None or not summed_up(c.kind))
    return of_sets + sum(rest)


def _n_parameters(added: Added) -> int:
    return sum(c.parameters for c in added.chosen)


def _leads(way: Way, one: Added, other: Added) -> bool:
    """Whether one outcome explains more than another, by the summaries' evidence and by frames that no fit has seen."""
    likelihood, settings = way.likelihood, way.settings
    if one.sets is None or other.sets is None:
        return False
    test, part = held_out(likelihood, settings), fit_part(likelihood, settings)
    values = []
    for each in (other, one):
        # A law of more numbers follows the errors of poses: all may move within the tolerance
        near = settled_within(likelihood, each.state, each.chosen, part, settings.tolerance)
        values.append(likelihood.value(near, test) - PRICE_NATS * _n_parameters(each))
    return one.sets.found.evidence - other.sets.found.evidence + values[1] - values[0] > 0


def _from_set(way: Way, added: Added, better: Explained) -> Added | None:
    """Where a search ends that begins with a set of effects instead of those that were added; None if it cannot."""
    likelihood, settings = way.likelihood, way.settings
    part = fit_part(likelihood, settings)
    kept, state = [c for c in added.chosen if not summed_up(c.kind)], apart(added.state)
    if len(kept) + len(better.terms) > settings.max_effects:  # a pattern takes what is static, whatever it is
        kept = [c for c in kept if c.kind != FixedPattern.kind]
        state = replace(state, effects=tuple(e for e in state.effects if e.kind != FixedPattern.kind))
    if len(kept) + len(better.terms) > settings.max_effects:
        return None
    new = as_candidates(likelihood, state, better, part)
    if not new:
        return None
    chosen = [*kept, *new]
    state = replace(state, effects=(*state.effects, *(c.effect for c in new)))
    state, chosen = refit(likelihood, state, chosen, part)
    other = Way(likelihood, settings, way.tick, state, first=way.first)
    other.chosen, other.rivals = _with_gains(other, chosen), [()] * len(chosen)
    other.begun = chosen[-len(new)]
    drop(other)
    return _followed(other)


def _with_gains(way: Way, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Effects with what each gains on held-out data beside the others."""
    likelihood = way.likelihood
    test = likelihood.evidence.part(fit=False, split=way.settings.split)
    whole = likelihood.value(way.state, test)
    out = []
    for k, candidate in enumerate(chosen):
        if candidate.fitted is None:
            out.append(candidate)
            continue
        rest = without(way.state, k)
        out.append(replace(candidate, gain=whole - likelihood.value(rest, test)))
    return out


def _beginning(best: Way) -> Candidate | None:
    """The next candidate of the first round to begin with, of another kind than the best way did.

    A fixed pattern is none: it takes all that is static, whatever it is.
    """
    if best.begun is None:
        return None
    kinds = (best.begun.kind, FixedPattern.kind)
    other = next((c for c in best.first if c.kind not in kinds), None)
    return other if other is not None and other.score > _FAIR * best.begun.score else None


def _followed(way: Way) -> Added:
    """Go on from where a search stands to its end."""
    likelihood, settings = way.likelihood, way.settings
    stood: list[list[tuple[str, str]]] = []
    while True:
        panel = _panel(likelihood, settings, way.state, way.chosen)
        if not disagreements(panel, settings.alpha) or len(way.chosen) >= settings.max_effects:
            break
        names = sorted(name_of(c) for c in way.chosen)
        if names in stood or not _round(way, _open(way, panel)):  # what was added before was dropped again
            break
        stood.append(names)
    kept = {c.kind for c in way.chosen}
    told = any(summed_up(c.kind) for c in way.chosen) or bool(disagreements(panel, settings.alpha))
    return Added(
        state=way.state, chosen=tuple(way.chosen), first=way.first,
        aliases=tuple(group for group in way.aliases if group[0].kind in kept), panel=panel,
        sets=alternatives(likelihood, way.state, way.chosen, settings) if told else None,
    )  # fmt: skip


def _panel(likelihood: Likelihood, settings: Settings, state: State, chosen: Sequence[Candidate]) -> Compared:
    """The panel of the model nearest to frames that no fit has seen.

    It asks whether any model within the tolerance agrees with these frames: fitted to others, it would bring the chance
    of those along.
    """
    held = held_out(likelihood, settings)
    near = settled_within(likelihood, state, chosen, held, settings.tolerance)
    return compare(likelihood, near, _covered(likelihood, state, held), seed=settings.seed)


def without_faint(likelihood: Likelihood, settings: Settings, added: Added, failed: Sequence[int]) -> Added | None:
    """The outcome of a search without the faint effects that leave the statistics open in which they must show.

    A faint effect gains less than `FAINT_SHARE` of the others' gain. It is added because such a statistic stands out.
    If that statistic still stands out, the effect does not explain it. The laws of the others may be wrong by as much,
    so that they are judged alone.

    Parameters
    ----------
    likelihood, settings
        The recording and the scene; how.
    added : Added
        The outcome of a search.
    failed : sequence of int
        Numbers of the effects that leave their statistics open.

    Returns
    -------
    Added or None
        None if there is no such effect.
    """
    gains = [c.gain for c in added.chosen]
    faint = {
        k for k in failed if added.chosen[k].fitted is not None and gains[k] < FAINT_SHARE * (sum(gains) - gains[k])
    }
    if not faint:
        return None
    state, chosen = added.state, [c for k, c in enumerate(added.chosen) if k not in faint]
    for k in sorted(faint, reverse=True):
        state = without(state, k)
    state, chosen = refit(likelihood, state, chosen, fit_part(likelihood, settings))
    kinds = {c.kind for c in chosen}
    return replace(
        added, state=state, chosen=tuple(chosen), panel=_panel(likelihood, settings, state, chosen),
        aliases=tuple(group for group in added.aliases if group[0].kind in kinds),
        sets=alternatives(likelihood, state, chosen, settings) if any(summed_up(k) for k in kinds) else None,
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


def _open(way: Way, panel: Compared) -> set[str]:
    """Statistics that stand out by more than what the laws of the effects that were added may be wrong by."""
    if way.before is None:
        way.before = panel
    return {c.statistic for c in disagreements(panel, way.settings.alpha) if c.size > inexact(c, way.before)}


def _round(way: Way, open_: set[str]) -> bool:
    """Try all kinds and add the best, if it is good enough.

    A faint effect may follow what the laws of the others are wrong by, but not where it must show in a statistic that
    stands out by more.
    """
    settings, likelihood = way.settings, way.likelihood
    trial = begin_trial(likelihood, way.state, settings.split, settings.seed)
    near = tolerated(likelihood, way.state, fit_part(likelihood, settings), settings.tolerance)
    allowed = max(0.0, likelihood.value(near, trial.test_part) - trial.base)
    tried = candidates(trial, settings.kinds, way.tick)
    found = with_the_others(trial, way.chosen, tried)
    chance = math.log(max(len(found), 1) / settings.alpha)
    faint_gain = FAINT_SHARE * sum(c.gain for c in way.chosen if not (c.exact or c.loses))
    lost = FAINT_SHARE * sum(c.gain for c in way.chosen if not c.exact)
    found = [c for c in found if not c.loses or c.score > lost]
    found, beyond = _tolerant(way, trial, found, near)
    way.missed |= {c.kind for c in found[:1] if way.chosen and open_ & set(c.effect.shows_in)}
    if found and found[0].kind in way.missed:
        faint_gain = 0.0
    needed = max(allowed + chance, faint_gain)
    way.first = way.first or tuple(found)
    if not found:
        return False
    if found[0].score <= needed and beyond <= max(chance, faint_gain):
        faint = _faint_pattern(way, found, near, needed)
        if faint is not None:
            _take(way, _Taken((faint,), ()), found)
        return faint is not None
    taken = _best(way, trial, found, near, needed)
    if len(taken.best) == 1 and taken.best[0].score <= needed:
        taken = _Taken((found[0],), _near(found[0], found))
    _take(way, _with_partner(way, trial, taken, max(chance, faint_gain)), found)
    return True


def _faint_pattern(way: Way, found: Sequence[Candidate], near: State, needed: float) -> Candidate | None:
    """A fixed pattern that the held-out pixels are too few for, but which gains enough over all of them.

    Its values being integrated out, it needs no pixels that are held out, as laws of few numbers need none.
    """
    pattern = next((c for c in found if c.kind == FixedPattern.kind), None)
    if pattern is None:
        return None
    parts = fit_part(way.likelihood, way.settings), held_out(way.likelihood, way.settings)
    mixture = way.likelihood.mixture(near)
    bare, patterned = (worth(way.likelihood, near, mixture, parts, patterned=p) for p in (False, True))
    gain = patterned - bare - PRICE_NATS * pattern.parameters
    return pattern if gain > needed else None


@dataclass(frozen=True, slots=True)
class _Taken:
    """What a round takes, and what the recording cannot tell from the first of it."""

    best: tuple[Candidate, ...]
    aliases: tuple[Candidate, ...]


def _with_partner(way: Way, trial: Trial, taken: _Taken, needed: float) -> _Taken:
    """An effect that changes in time, and with it its static partner, where that gains beside it as any other would.

    Alone, the effect may take up so much of both that the panel agrees, with the wrong numbers.
    """
    first, likelihood = taken.best[0], trial.likelihood
    if len(taken.best) > 1 or not first.effect.static_partner or first.fitted is None:
        return taken
    mixture = likelihood.mixture(first.state)
    base = likelihood.value(first.state, trial.test_part, mixture)
    now = replace(trial, state=first.state, mixture=mixture, base=base)
    surface = getattr(first.effect, "surface", "")
    found = (c for c in candidates(now, (first.effect.static_partner,)) if getattr(c.effect, "surface", "") == surface)
    both = [together(now, [*(first.others or way.chosen), first], c) for c in found]
    near = tolerated(likelihood, first.state, fit_part(likelihood, way.settings), way.settings.tolerance)
    allowed = max(0.0, likelihood.value(near, trial.test_part) - base)
    if not both or not both[0].others or both[0].score <= allowed + needed:
        return taken
    *others, first = both[0].others
    state = replace(both[0].state, effects=both[0].state.effects[:-1])
    return _Taken((replace(first, state=state, others=tuple(others)), both[0]), taken.aliases)


def _tolerant(way: Way, trial: Trial, found: list[Candidate], near: State) -> tuple[list[Candidate], float]:
    """The candidates, first the one that is best in a model that may move within its tolerance; what it gains there.

    A law of more numbers follows the errors of the model's poses too, by which it gains over the simple one that is
    there; of a model that has taken them up already, it gains nothing.
    """
    likelihood, tolerance = way.likelihood, way.settings.tolerance
    if tolerance <= 0 or not found or not found[0].static:
        return found, -math.inf
    part, test = fit_part(likelihood, way.settings), trial.test_part
    static = [c for c in found if c.static and c.fitted is not None and c.gain > 0]
    simple = [c for c in static if c.parameters <= found[0].parameters]
    offset = [c for c in simple[_TRIED:] if c.kind == RangeOffset.kind]
    scored = []
    for c in (*simple[:_TRIED], *offset):
        moved = settled_within(likelihood, c.state, [*way.chosen, c], part, tolerance)
        scored.append((likelihood.value(moved, test) - PRICE_NATS * c.parameters, c))
    if not scored:
        return found, -math.inf
    score, best = max(scored, key=lambda pair: pair[0])
    beyond = score - likelihood.value(near, test)
    if found[0].fitted is None:
        return found, beyond
    return [best, *(c for c in found if c is not best)], beyond


def _take(way: Way, taken: _Taken, found: Sequence[Candidate]) -> None:
    """Add candidates to the model, as far as there is room, and fit all anew."""
    best = taken.best[: way.settings.max_effects - len(way.chosen)]
    way.begun = way.begun or best[0]
    if taken.aliases:
        way.aliases.append((best[0], *taken.aliases))
    state = best[0].state
    for candidate in best[1:]:  # one that goes with it: all are fitted anew
        state = replace(state, effects=(*state.effects, candidate.effect))
    way.chosen = list(best[0].others) or way.chosen
    for candidate in best:
        way.chosen.append(candidate)
        way.rivals.append(tuple(c for c in found if name_of(c) not in {name_of(b) for b in best}))
    way.state = state
    part = fit_part(way.likelihood, way.settings)
    way.state, way.chosen = refit(way.likelihood, way.state, way.chosen, part)
    exchange(way, part)
    drop(way)


def _best(way: Way, trial: Trial, found: Sequence[Candidate], near: State, needed: float) -> _Taken:
    """The best candidate; before a fixed pattern, a structured effect that gains beside it.

    Before all of them pixels that hold one value: there is no doubt of them, and to a pattern they are large biases.
    Only a lattice goes before these, which holds pixels at one value too.
    """
    sure = {c.kind: c for c in found if c.score > 0}
    if StuckPixels.kind in sure:
        first = sure.get(Quantisation.kind, sure[StuckPixels.kind])
        return _Taken((first,), _near(first, found))
    if found[0].kind == FixedPattern.kind:
        parts = fit_part(way.likelihood, way.settings), held_out(way.likelihood, way.settings)
        beside = best_beside(trial, way.chosen, found, parts, near)
        if beside is not None:
            # The pattern's turn comes when no more gain beside it, unless it hides the effect
            if not beside.patterned or beside.first.score > needed:
                return _Taken((beside.first,), beside.rivals)
            return _Taken((beside.first, _second(way, trial, found, beside.first, parts)), beside.rivals)
    return _Taken((found[0],), _near(found[0], found))


def _second(
    way: Way, trial: Trial, found: Sequence[Candidate], first: Candidate, parts: tuple[Part, Part]
) -> Candidate:
    """What goes with an effect that a fixed pattern hides: another effect that gains beside both, or the pattern."""
    likelihood = trial.likelihood
    now = replace(trial, state=first.state, mixture=likelihood.mixture(first.state))
    near = tolerated(likelihood, first.state, parts[0], way.settings.tolerance)
    rest = [c for c in found if c.static and name_of(c) != name_of(first)]
    beside = best_beside(now, [*way.chosen, first], rest, parts, near)
    return found[0] if beside is None else beside.first


def _near(best: Candidate, found: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Candidates of other kinds that gain as much."""
    limit = max(ALIAS_NATS, _ALIAS_SHARE * best.gain)
    return tuple(c for c in found if c.kind != best.kind and abs(best.gain - c.gain) < limit)
