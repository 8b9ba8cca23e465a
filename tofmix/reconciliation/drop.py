"""Step 4, backward: exchange or drop effects that no longer earn their place beside what came since."""

from dataclasses import replace

import numpy as np

from tofmix.reconciliation.beside import worth
from tofmix.reconciliation.likelihood import Part, State
from tofmix.reconciliation.name import PRICE_NATS, Candidate
from tofmix.reconciliation.refit import refit, without
from tofmix.reconciliation.way import FAINT_SHARE, Way, fit_part, held_out, name_of
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.multipath import Multipath
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.surface_pose import SurfacePose


def exchange(way: Way, part: Part) -> None:
    """Put a rival in the place of an earlier effect where it does better beside what has come since."""
    likelihood = way.likelihood
    test = likelihood.evidence.part(fit=False, split=way.settings.split)
    for k in range(len(way.chosen)):
        for rival, needed in _worth_a_trial(way, k):
            old = way.chosen[k]
            stood = likelihood.value(way.state, test) - PRICE_NATS * old.parameters
            effects = (*way.state.effects[:k], rival.effect, *way.state.effects[k + 1 :])
            trial = [*way.chosen[:k], rival, *way.chosen[k + 1 :]]
            state, trial = refit(likelihood, replace(way.state, effects=effects), trial, part)
            if likelihood.value(state, test) - PRICE_NATS * rival.parameters > stood + needed:
                way.state, way.chosen = state, trial


def _worth_a_trial(way: Way, number: int) -> list[tuple[Candidate, float]]:
    """Rivals of an effect that was added, and by how much each must do better.

    The closest one, if it was no further behind than what the later effects have gained. What has become flat beside
    them, with numbers at a bound, is an offset; and a second path that moves a surface is a pose, if that does as well.
    """
    old = way.chosen[number]
    flat = old.fitted is not None and old.fitted.at_a_bound
    newest = number == len(way.chosen) - 1
    names = [name_of(c) for c in way.chosen]
    usable = [c for c in way.rivals[number] if c.fitted is not None and name_of(c) not in names]
    if flat:
        return [(c, 0.0) for c in usable if c.kind == RangeOffset.kind][:1]
    if newest:
        return []
    later = sum(c.gain for c in way.chosen[number + 1 :])
    found = [(c, PRICE_NATS) for c in usable[:1] if old.score - c.score < later]
    if isinstance(old.effect, Multipath):
        pose = SurfacePose.kind, old.effect.surface
        found += [(c, 0.0) for c in usable if name_of(c) == pose and c not in [f for f, _ in found]]
    return found


def drop(way: Way) -> None:
    """Drop what no longer earns its place: beside the newest effect, or it, which may have led the others right."""
    if len(way.chosen) <= 1:
        return
    likelihood = way.likelihood
    part = likelihood.evidence.part(fit=False, split=way.settings.split)
    whole = likelihood.value(way.state, part)
    for k in range(len(way.chosen) - 1, -1, -1):
        candidate = way.chosen[k]
        if len(way.chosen) == 1:
            break
        if candidate.kind == FixedPattern.kind:
            if not _pattern_gains(way, k):
                way.state = _bare(way.state, k)
                whole = likelihood.value(way.state, part)
                del way.chosen[k], way.rivals[k]
            continue
        if candidate.fitted is None:
            continue
        rest, others = without(way.state, k), [*way.chosen[:k], *way.chosen[k + 1 :]]
        worth_ = likelihood.value(rest, part)
        needed = max(PRICE_NATS * candidate.parameters, _faint_gain(way, k))
        if needed <= whole - worth_ < FAINT_SHARE * sum(c.gain for c in others) and not rest.pixel_bias.any():
            # The others were fitted beside it, and may do without it with other numbers
            rest, others = refit(likelihood, rest, others, fit_part(likelihood, way.settings))
            worth_ = likelihood.value(rest, part)
        if whole - worth_ < needed or _is_pattern(way, k):
            way.state, way.chosen, whole = rest, others, worth_
            del way.rivals[k]


def _faint_gain(way: Way, number: int) -> float:
    """Gain, nat, up to which noise or a change in time is faint beside the others, as if it were added after them.

    A static effect may be hidden in a fixed pattern, which gains far more than it.
    """
    own = way.chosen[number]
    if own.static or own.exact or own.loses or own.kind in way.missed:
        return 0.0
    others = (*way.chosen[:number], *way.chosen[number + 1 :])
    return FAINT_SHARE * sum(c.gain for c in others if not (c.kind == FixedPattern.kind or c.exact or c.loses))


def _bare(state: State, pattern: int) -> State:
    """The state without the fixed pattern that is the so-many-th of what was added, and without its map."""
    nothing = np.zeros_like(state.pixel_bias)
    return replace(without(state, pattern), pixel_bias=nothing, pixel_variance=nothing)


def _pattern_gains(way: Way, number: int) -> bool:
    """Whether a fixed pattern, its values integrated out, still gains beside all else."""
    bare, likelihood = _bare(way.state, number), way.likelihood
    unseen = held_out(likelihood, way.settings)
    mixture = likelihood.mixture(bare)
    alone, patterned = (
        worth(likelihood, bare, mixture, (unseen, unseen), patterned=patterned) for patterned in (False, True)
    )
    return patterned - alone > PRICE_NATS * way.chosen[number].parameters


def _is_pattern(way: Way, number: int) -> bool:
    """Whether a static effect is as well a part of the fixed pattern, whose map was found beside it.

    The map has the opposite of what the effect has too much.
    """
    state, candidate = way.state, way.chosen[number]
    pattern = next((k for k, c in enumerate(way.chosen) if c.kind == FixedPattern.kind), None)
    if pattern is None or not candidate.static:
        return False
    likelihood, bare = way.likelihood, _bare(state, pattern)
    rest = without(bare, number - (pattern < number))
    unseen = held_out(likelihood, way.settings)
    values = []
    for each in (bare, rest):
        mixture = likelihood.mixture(each)
        values.append(worth(likelihood, each, mixture, (unseen, unseen), patterned=True))
    return values[0] - values[1] < PRICE_NATS * candidate.parameters
