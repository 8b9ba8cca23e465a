"""Step 4, forward: add effects one by one while they gain.

An effect is added if its held-out gain, less the price of its parameters, exceeds two limits: log(candidates / alpha)
plus the gain of the model within its tolerance, and 1 % of the gain of the others. A fixed pattern can imitate any
static bias: an effect that gains in its presence is added before it.

If two effects are hidden, a third one may gain more than either alone. If it is added first, it prevents both. So close
rivals of earlier effects are tried again together with the later ones, and if nothing explains the recording, another
search starts from other candidates.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.reconciliation.comparison.compare import Compared, compare, disagreements
from tofmix.reconciliation.ledger import Ledger, WeighedSet
from tofmix.reconciliation.likelihood.joint import views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.search.alternatives import Alternatives, Explained, alternatives, apart, as_candidates
from tofmix.reconciliation.search.columns import summed_up
from tofmix.reconciliation.search.drop import drop, exchange
from tofmix.reconciliation.search.name import (
    FAINT_SHARE,
    Trial,
    TriedEffect,
    begin_trial,
    candidates,
    of_any_noise,
    tolerated,
)
from tofmix.reconciliation.search.pattern_fits import (
    best_with_pattern,
    settled_within,
    together,
    with_the_others,
    worth,
)
from tofmix.reconciliation.search.refit import begin, refit, without
from tofmix.reconciliation.search.search_state import SearchState, Settings, fit_part, held_out, name_of
from tofmix.reconciliation.search.static_fits import fold
from tofmix.reconciliation.verdict import inexact
from tofmix.simulation.effects.base import Basic
from tofmix.simulation.effects.hidden import PixelBias, PixelValue, RangeStep

_TRIED = 4  # rivals that are compared with the model moved within its tolerance
_FAIR = 0.5  # least score, as a share of the best one's, of a candidate that starts another search

_COVERED = 0.999  # share of the beam that surfaces fill


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Added:
    """The result of a search.

    Parameters
    ----------
    state : ModelState
        The model with the effects that were added.
    chosen : tuple of TriedEffect
        The added effects, in the order in which they were added.
    first : tuple of TriedEffect
        All candidates of the first round, best first.
    panel : Compared
        Panel on held-out frames of the refined model, moved within its tolerance to where it fits them best.
    sets : Alternatives or None
        The evidence of other sets of effects; None if no effect moves or widens samples and nothing stands out.
    rivals : tuple of tuple of TriedEffect
        For each of `chosen`: the other candidates of its round, best first.
    considered : tuple of WeighedSet
        Of the one search: the set, its aliases and the best others, each with the reason why it is not the answer.
    law : str or None
        Of the one search: axis of a smooth law that is clearly better than every set of effects; None without one.
    laws_tried : bool
        Whether smooth laws have competed in the search.
    """

    state: ModelState
    chosen: tuple[TriedEffect, ...]
    first: tuple[TriedEffect, ...]
    panel: Compared
    sets: Alternatives | None = None
    rivals: tuple[tuple[TriedEffect, ...], ...] = ()
    considered: tuple[WeighedSet, ...] = ()
    law: str | None = None
    laws_tried: bool = False


def ways(
    likelihood: Likelihood,
    settings: Settings,
    tick: Callable[[str], None] = lambda _: None,
    ledger: Ledger | None = None,
) -> Iterator[Added]:
    """Searches until the panel agrees, no candidate gains enough, or `max_effects` is reached; lazily, one by one.

    The first is greedy. If the comparison of all sets of effects finds a better set, of no more numbers or, if a
    statistic still stands out, of any size, the first starts from this set. The second starts from the set of any size
    that explains most, the third from another effect.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    settings : Settings
        Options of the search.
    tick : callable
        Called with each kind that was tried.
    ledger : Ledger, optional
        Gets each set that is fitted; if it ends the search, the first search ends with its effects so far.
    """
    ledger = Ledger() if ledger is None else ledger
    best = _begun(likelihood, settings, tick, ledger)
    added = _followed(best)
    if not added.chosen and not disagreements(added.panel, settings.alpha):
        yield added
        return
    first = _or_better(best, added)
    yield first
    if ledger.ends():
        return
    larger = None if first.sets is None else first.sets.better(larger=True)
    other = None if larger is None else _from_set(best, first, larger)
    if other is not None:
        yield other
    beginning = _beginning(best)
    if beginning is not None:
        search = _begun(likelihood, settings, tick, ledger)
        search.first = best.first
        _take(search, (beginning,), best.first)
        yield _followed(search)


def _begun(likelihood: Likelihood, settings: Settings, tick: Callable[[str], None], ledger: Ledger) -> SearchState:
    """A search at its beginning: the model as given, with the fold of its range axis if the samples are a turn off."""
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.tolerance)
    search = SearchState(likelihood, settings, tick, start, ledger=ledger)
    search.weigh(start, ())
    folded = fold(likelihood, start, held_out(likelihood, settings)) if settings.max_effects else None
    chance = math.log(max(len(settings.kinds), 1) / settings.alpha)
    if folded is not None and folded.kind in settings.kinds and folded.gain > chance:
        _take(search, (folded,), (folded,))
        search.begun = None  # other searches start from the folded axis too
    return search


def _or_better(search: SearchState, added: Added) -> Added:
    """The outcome, or a subset of it that is enough, or another set of effects that explains more."""
    sets = added.sets
    if sets is None or search.ledger.ends():
        return added
    stands_out = bool(_open(search, added.panel))
    enough = None if stands_out else sets.enough
    part = None if enough is None else _elsewhere(search, added, enough)
    if part is not None and not _open(search, part.panel):
        return part
    for better in (*_of_more_numbers(sets, added), *_alternatives(sets, larger=stands_out)):
        if search.ledger.ends():
            break
        other = None if better is enough else _elsewhere(search, added, better)  # `enough` did not explain it
        if other is None:  # it leads back
            continue
        larger = _numbers(other) > _numbers(added)  # effects that the search adds to the set count too
        if (stands_out or not larger) and _leads(search, other, added):
            return other
    return added


def _of_more_numbers(sets: Alternatives, added: Added) -> list[Explained]:
    """The found set itself, if the summaries give one of its effects more numbers than the search did.

    A shift and the tilts of a surface have joint errors, and the tilts may only show beside effects that were added
    after the shift. So the evidence decides for each pose, even if no statistic stands out: of a surface that few
    pixels see, a shift alone may leave less than the laws of the others may leave.
    """
    own = {name_of(c): c.parameters for c in added.chosen}
    return [sets.found] if any(t.searched > own.get(t.name, math.inf) for t in sets.found.terms) else []


def _alternatives(sets: Alternatives, *, larger: bool) -> list[Explained]:
    """The smallest better set, the best set, and a simpler one, in case the search from the others leads back."""
    ways_ = (sets.better(larger=larger), sets.best(larger=larger), sets.simpler)
    return [s for k, s in enumerate(ways_) if s is not None and s not in ways_[:k]]


def _elsewhere(search: SearchState, added: Added, begun: Explained) -> Added | None:
    """The end of a search from a set of effects; None if it leads back to the effects that were added."""
    other = _from_set(search, added, begun)
    return None if other is None or _names(other) == _names(added) else other


def _names(added: Added) -> set[tuple[str, str, str, int]]:
    """Kinds and surfaces with their form and numbers: a pose with tilts is another explanation than a shift."""
    return {(*name_of(c), c.form, c.parameters) for c in added.chosen}


def _numbers(added: Added) -> int:
    """How many numbers the effects have, counted as for sets: a choice among a few values does not count."""
    of_sets = 0 if added.sets is None else added.sets.found.numbers
    rest = (c.parameters for c in added.chosen if added.sets is None or not summed_up(c.kind))
    return of_sets + sum(rest)


def _leads(search: SearchState, one: Added, other: Added) -> bool:
    """Whether one outcome explains more than another, by the evidence of the summaries and by held-out frames."""
    likelihood, settings = search.likelihood, search.settings
    if one.sets is None or other.sets is None:
        return False
    test, part = held_out(likelihood, settings), fit_part(likelihood, settings)
    values = []
    for each in (other, one):
        # A law of more numbers follows the errors of poses, so all may move within the tolerance
        near = settled_within(likelihood, each.state, each.chosen, part, settings.tolerance)
        values.append(likelihood.value(near, test) - sum(c.price for c in each.chosen))
    return one.sets.found.evidence - other.sets.found.evidence + values[1] - values[0] > 0


def _from_set(search: SearchState, added: Added, better: Explained) -> Added | None:
    """The end of a search from a set of effects instead of those that were added; None if it cannot start there."""
    likelihood, settings = search.likelihood, search.settings
    part = fit_part(likelihood, settings)
    kept, state = [c for c in added.chosen if not summed_up(c.kind)], apart(added.state)
    if len(kept) + len(better.terms) > settings.max_effects:  # a pattern can imitate every static effect
        kept = [c for c in kept if not c.patterned]
        state = replace(state, effects=tuple(e for e in state.effects if not isinstance(e.hidden, PixelBias)))
    if len(kept) + len(better.terms) > settings.max_effects:
        return None
    new = as_candidates(likelihood, state, better, part)
    if not new:
        return None
    chosen = [*kept, *new]
    state = replace(state, effects=(*state.effects, *(c.effect for c in new)))
    state, chosen = refit(likelihood, state, chosen, part)
    other = SearchState(
        likelihood, settings, search.tick, state, first=search.first, ledger=search.ledger, given=search.given
    )
    other.weigh(state, chosen)
    other.chosen, other.rivals = _with_gains(other, chosen), [()] * len(chosen)
    other.begun = chosen[-len(new)]
    drop(other)
    return _followed(other)


def _with_gains(search: SearchState, chosen: Sequence[TriedEffect]) -> list[TriedEffect]:
    """Effects with their gains on held-out data in the presence of the others."""
    likelihood = search.likelihood
    test = likelihood.evidence.part(fit=False, split=search.settings.split)
    whole = likelihood.value(search.state, test)
    out = []
    for k, candidate in enumerate(chosen):
        if candidate.fitted is None:
            out.append(candidate)
            continue
        rest = without(search.state, k)
        out.append(replace(candidate, gain=whole - likelihood.value(rest, test)))
    return out


def _beginning(best: SearchState) -> TriedEffect | None:
    """The candidate of the first round from which another search starts, of another kind than that of the first search.

    Never a fixed pattern, because it can imitate every static effect.
    """
    if best.begun is None:
        return None
    begun = best.begun.kind
    other = next((c for c in best.first if c.kind != begun and not c.patterned), None)
    return other if other is not None and other.score > _FAIR * best.begun.score else None


def _followed(search: SearchState) -> Added:
    """Continue a search to its end."""
    likelihood, settings = search.likelihood, search.settings
    stood: list[list[tuple[str, str]]] = []
    while True:
        panel = _panel(likelihood, settings, search.state, search.chosen)
        done = not disagreements(panel, settings.alpha) or len(search.chosen) >= settings.max_effects
        if done or search.ledger.ends():
            break
        names = sorted(name_of(c) for c in search.chosen)
        if names in stood or not _round(search, _open(search, panel)):  # an effect that was removed is added again
            break
        stood.append(names)
    told = any(summed_up(c.kind) for c in search.chosen) or bool(disagreements(panel, settings.alpha))
    told = told and not search.ledger.ends()
    return Added(
        state=search.state,
        chosen=tuple(search.chosen),
        first=search.first,
        panel=panel,
        sets=alternatives(likelihood, search.state, search.chosen, settings) if told else None,
        rivals=tuple(search.rivals),
    )


def _panel(likelihood: Likelihood, settings: Settings, state: ModelState, chosen: Sequence[TriedEffect]) -> Compared:
    """The panel of the model, within its tolerance, that fits held-out frames best.

    It tests whether any model within the tolerance agrees with these frames. A model fitted to other frames would have
    their noise.
    """
    held = held_out(likelihood, settings)
    near = settled_within(likelihood, state, chosen, held, settings.tolerance)
    return compare(likelihood, near, covered(likelihood, state, held), seed=settings.seed)


def without_faint(likelihood: Likelihood, settings: Settings, added: Added, failed: Sequence[int]) -> Added | None:
    """The outcome of a search without the faint effects that leave the statistics open in which they must show.

    A faint effect gains less than `FAINT_SHARE` of the others' gain. It is added because such a statistic stands out.
    If that statistic still stands out, the effect does not explain it. The laws of the others may be wrong by as much,
    so that they are judged alone.

    Parameters
    ----------
    likelihood, settings
        The recording and the scene; options of the search.
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
        added,
        state=state,
        chosen=tuple(chosen),
        panel=_panel(likelihood, settings, state, chosen),
        sets=alternatives(likelihood, state, chosen, settings) if any(summed_up(k) for k in kinds) else None,
        rivals=tuple(own for k, own in enumerate(added.rivals) if k not in faint),
    )


def covered(likelihood: Likelihood, state: ModelState, part: Part) -> Part:
    """The part without pixels that see open space, if more noise was added.

    Its law does not change samples without a return; ambient light does. Such samples would test the law and not the
    name.
    """
    if not any(e.is_basic(Basic.NOISE) for e in state.effects):
        return part
    lit = np.ones(likelihood.evidence.shape[1], dtype=bool)
    for view in views(likelihood, likelihood.scene.mixture(), part):
        lit &= (view.mixture.weight[0] * view.mixture.lit[0]).sum(axis=0) > _COVERED
    pixels = part[1][lit[part[1]]]
    return (part[0], pixels) if pixels.size else part


def _open(search: SearchState, panel: Compared) -> set[str]:
    """Statistics that stand out by more than the possible error of the laws of the added effects."""
    if search.before is None:
        search.before = panel
    return {c.statistic for c in disagreements(panel, search.settings.alpha) if c.size > inexact(c, search.before)}


def _round(search: SearchState, open_: set[str]) -> bool:
    """Try all kinds, and add the best candidate if it is good enough.

    A faint effect may follow the errors of the added effects' laws. This does not hold if a statistic that the
    candidate must change stands out by more than these errors.
    """
    settings, likelihood = search.settings, search.likelihood
    stands = search.evidence_nats(search.state, search.chosen)
    trial = begin_trial(
        likelihood, search.state, settings.split, settings.seed, ledger=search.ledger, evidence_nats=stands
    )
    near = tolerated(likelihood, search.state, fit_part(likelihood, settings), settings.tolerance)
    allowed = max(0.0, likelihood.value(near, trial.test_part) - trial.base)
    tried = candidates(trial, settings.kinds, search.tick)
    found = with_the_others(trial, search.chosen, tried)
    chance = math.log(max(len(found), 1) / settings.alpha)
    faint_gain = FAINT_SHARE * sum(c.gain for c in search.chosen if not (c.exact or c.loses))
    lost = FAINT_SHARE * sum(c.gain for c in search.chosen if not c.exact)
    found = [c for c in found if not c.loses or c.score > lost]
    found, beyond = _tolerant(search, trial, found, near)
    search.missed |= {c.kind for c in found[:1] if search.chosen and open_ & set(c.effect.shows_in)}
    if found and found[0].kind in search.missed:
        faint_gain = 0.0
    needed = max(allowed + chance, faint_gain)
    search.first = search.first or tuple(found)
    if not found:
        return False
    if found[0].score <= needed and beyond <= max(chance, faint_gain):
        faint = _faint_pattern(search, found, near, needed)
        if faint is not None:
            _take(search, (faint,), found)
        return faint is not None
    taken = _best(search, trial, found, near, needed)
    if len(taken) == 1 and taken[0].score <= needed:
        taken = (found[0],)
    _take(search, _with_partner(search, trial, taken, max(chance, faint_gain)), found)
    return True


def _faint_pattern(
    search: SearchState, found: Sequence[TriedEffect], near: ModelState, needed: float
) -> TriedEffect | None:
    """A fixed pattern that the held-out pixels do not show, but which gains enough on all pixels.

    Its values are integrated out, so, like a law of few numbers, it needs no held-out pixels.
    """
    pattern = next((c for c in found if c.patterned), None)
    if pattern is None:
        return None
    parts = fit_part(search.likelihood, search.settings), held_out(search.likelihood, search.settings)
    mixture = search.likelihood.mixture(near)
    bare, patterned = (worth(search.likelihood, near, mixture, parts, patterned=p) for p in (False, True))
    gain = patterned - bare - pattern.price
    return pattern if gain > needed else None


def _with_partner(
    search: SearchState, trial: Trial, taken: tuple[TriedEffect, ...], needed: float
) -> tuple[TriedEffect, ...]:
    """An effect that changes in time, with its static partner if the partner gains enough in its presence.

    Alone, the effect may absorb so much of both that the panel agrees, with wrong numbers.
    """
    first, likelihood = taken[0], trial.likelihood
    if len(taken) > 1 or not first.effect.static_partner or first.fitted is None:
        return taken
    mixture = likelihood.mixture(first.state)
    base = likelihood.value(first.state, trial.test_part, mixture)
    stands = trial.evidence_of(first)
    now = replace(trial, state=first.state, mixture=mixture, base=base, evidence_nats=stands)
    surface = getattr(first.effect, "surface", "")
    found = (c for c in candidates(now, (first.effect.static_partner,)) if getattr(c.effect, "surface", "") == surface)
    both = [together(now, [*(first.others or search.chosen), first], c) for c in found]
    near = tolerated(likelihood, first.state, fit_part(likelihood, search.settings), search.settings.tolerance)
    allowed = max(0.0, likelihood.value(near, trial.test_part) - base)
    if not both or not both[0].others or both[0].score <= allowed + needed:
        return taken
    *others, first = both[0].others
    state = replace(both[0].state, effects=both[0].state.effects[:-1])
    return replace(first, state=state, others=tuple(others)), both[0]


def _tolerant(
    search: SearchState, trial: Trial, found: list[TriedEffect], near: ModelState
) -> tuple[list[TriedEffect], float]:
    """The candidates, first the best one for a model that may move within its tolerance, and its gain there.

    A law of more numbers also follows the errors of the model's poses, and so gains more than the true, simpler law. If
    the model may move within its tolerance, this advantage disappears.
    """
    likelihood, tolerance = search.likelihood, search.settings.tolerance
    if tolerance <= 0 or not found or not found[0].static:
        return found, -math.inf
    part, test = fit_part(likelihood, search.settings), trial.test_part
    static = [c for c in found if c.static and c.fitted is not None and c.gain > 0]
    simple = [c for c in static if c.parameters <= found[0].parameters]
    offset = [c for c in simple[_TRIED:] if c.effect.basic is Basic.OFFSET]
    scored = []
    for c in (*simple[:_TRIED], *offset):
        moved = settled_within(likelihood, c.state, [*search.chosen, c], part, tolerance)
        level = of_any_noise(likelihood, moved, part) if len(simple) > 1 else moved
        scored.append((likelihood.value(level, test) - c.price, moved, c))
    if not scored:
        return found, -math.inf
    _, moved, best = max(scored, key=lambda tried: tried[0])
    beyond = likelihood.value(moved, test) - best.price - likelihood.value(near, test)
    if found[0].fitted is None:
        return found, beyond
    return [best, *(c for c in found if c is not best)], beyond


def _take(search: SearchState, taken: tuple[TriedEffect, ...], found: Sequence[TriedEffect]) -> None:
    """Add candidates to the model, up to `max_effects`, and fit all effects again."""
    best = taken[: search.settings.max_effects - len(search.chosen)]
    search.begun = search.begun or best[0]
    state = best[0].state
    for candidate in best[1:]:  # added with the first one; all are fitted again
        state = replace(state, effects=(*state.effects, candidate.effect))
    search.chosen = list(best[0].others) or search.chosen
    for candidate in best:
        search.chosen.append(candidate)
        search.rivals.append(tuple(c for c in found if name_of(c) not in {name_of(b) for b in best}))
    search.state = state
    part = fit_part(search.likelihood, search.settings)
    search.state, search.chosen = refit(search.likelihood, search.state, search.chosen, part)
    search.weigh(search.state, search.chosen)
    exchange(search, part)
    drop(search)


def _best(
    search: SearchState, trial: Trial, found: Sequence[TriedEffect], near: ModelState, needed: float
) -> tuple[TriedEffect, ...]:
    """The best candidate; if it is a fixed pattern, an effect that gains in its presence comes first.

    Pixels of one value come before all others: they are certain, and a pattern would take them as large biases. Only a
    quantisation step comes before them, because it also gives pixels one value.
    """
    sure = {type(c.effect.hidden): c for c in found if c.score > 0}
    if PixelValue in sure:
        return (sure.get(RangeStep, sure[PixelValue]),)
    if found[0].patterned:
        parts = fit_part(search.likelihood, search.settings), held_out(search.likelihood, search.settings)
        beside = best_with_pattern(trial, search.chosen, found, parts, near, search.settings.alpha)
        if beside is not None:
            # The pattern is added after all effects that gain in its presence, unless it hides the effect
            if not beside.patterned or beside.first.score > needed:
                return (beside.first,)
            return beside.first, _second(search, trial, found, beside.first, parts)
    return (found[0],)


def _second(
    search: SearchState, trial: Trial, found: Sequence[TriedEffect], first: TriedEffect, parts: tuple[Part, Part]
) -> TriedEffect:
    """The partner of an effect that a fixed pattern hides: another effect that gains with both, or the pattern."""
    likelihood = trial.likelihood
    now = replace(trial, state=first.state, mixture=likelihood.mixture(first.state))
    near = tolerated(likelihood, first.state, parts[0], search.settings.tolerance)
    rest = [c for c in found if c.static and name_of(c) != name_of(first)]
    beside = best_with_pattern(now, [*search.chosen, first], rest, parts, near, search.settings.alpha)
    return found[0] if beside is None else beside.first
