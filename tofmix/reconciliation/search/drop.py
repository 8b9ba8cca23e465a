"""Step 4, backward: exchange or remove effects that no longer gain enough in the presence of later ones."""

from dataclasses import replace

from tofmix.reconciliation.likelihood.likelihood import Part
from tofmix.reconciliation.search.name import FAINT_SHARE, PRICE_NATS, TriedEffect
from tofmix.reconciliation.search.pattern_fits import worth
from tofmix.reconciliation.search.refit import refit, without, without_pattern
from tofmix.reconciliation.search.search_state import SearchState, fit_part, held_out, name_of
from tofmix.simulation.effects.base import Basic


def exchange(search: SearchState, part: Part) -> None:
    """Replace an earlier effect by a rival that gains more in the presence of the later effects."""
    likelihood = search.likelihood
    test = likelihood.evidence.part(fit=False, split=search.settings.split)
    for k in range(len(search.chosen)):
        for rival, needed in _worth_a_trial(search, k):
            old = search.chosen[k]
            stood = likelihood.value(search.state, test) - old.price
            effects = (*search.state.effects[:k], rival.effect, *search.state.effects[k + 1 :])
            trial = [*search.chosen[:k], rival, *search.chosen[k + 1 :]]
            state, trial = refit(likelihood, replace(search.state, effects=effects), trial, part)
            search.weigh(state, trial)
            if likelihood.value(state, test) - rival.price > stood + needed:
                search.state, search.chosen = state, trial


def _worth_a_trial(search: SearchState, number: int) -> list[tuple[TriedEffect, float]]:
    """Rivals of an added effect, and by how much each must be better.

    The closest rival, if its score was lower by less than the gain of the later effects. An effect whose numbers are
    now at a bound is flat: its rival is an offset. A further rival is the effect to which this one yields (a second
    path to the pose of its surface), which wins if it is as good.
    """
    old = search.chosen[number]
    flat = old.fitted is not None and old.fitted.at_a_bound
    newest = number == len(search.chosen) - 1
    names = [name_of(c) for c in search.chosen]
    usable = [c for c in search.rivals[number] if c.fitted is not None and name_of(c) not in names]
    if flat:
        return [(c, 0.0) for c in usable if c.effect.basic is Basic.OFFSET][:1]
    if newest:
        return []
    later = sum(c.gain for c in search.chosen[number + 1 :])
    found = [(c, PRICE_NATS) for c in usable[:1] if old.score - c.score < later]
    simpler = old.effect.yields_to, name_of(old)[1]
    found += [(c, 0.0) for c in usable if name_of(c) == simpler and c not in [f for f, _ in found]]
    return found


def drop(search: SearchState) -> None:
    """Remove effects that no longer gain enough, even the newest, after which the others may be right without it."""
    if len(search.chosen) <= 1:
        return
    likelihood = search.likelihood
    part = likelihood.evidence.part(fit=False, split=search.settings.split)
    whole = likelihood.value(search.state, part)
    for k in range(len(search.chosen) - 1, -1, -1):
        candidate = search.chosen[k]
        if len(search.chosen) == 1:
            break
        if candidate.patterned:
            if not _pattern_gains(search, k):
                search.state = without_pattern(search.state, k)
                whole = likelihood.value(search.state, part)
                del search.chosen[k], search.rivals[k]
            continue
        if candidate.fitted is None or not candidate.fitted.problem.steps:  # no numbers that others could absorb
            continue
        rest, others = without(search.state, k), [*search.chosen[:k], *search.chosen[k + 1 :]]
        worth_ = likelihood.value(rest, part)
        needed = max(candidate.price, _faint_gain(search, k))
        if needed <= whole - worth_ < FAINT_SHARE * sum(c.gain for c in others) and not rest.pixel_bias.any():
            # The others were fitted together with it; without it they may have other numbers
            rest, others = refit(likelihood, rest, others, fit_part(likelihood, search.settings))
            search.weigh(rest, others)
            worth_ = likelihood.value(rest, part)
        if whole - worth_ < needed or _is_pattern(search, k):
            search.state, search.chosen, whole = rest, others, worth_
            del search.rivals[k]


def _faint_gain(search: SearchState, number: int) -> float:
    """Gain, nat, that noise, or a change in time, needs in the presence of the others, as if it were added last.

    The gain of a fixed pattern does not count: a pattern may contain a static effect and gain far more.
    """
    own = search.chosen[number]
    if own.static or own.exact or own.loses or own.kind in search.missed:
        return 0.0
    others = (*search.chosen[:number], *search.chosen[number + 1 :])
    return FAINT_SHARE * sum(c.gain for c in others if not (c.patterned or c.exact or c.loses))


def _pattern_gains(search: SearchState, number: int) -> bool:
    """Whether a fixed pattern, with its values integrated out, still gains in the presence of all other effects."""
    bare, likelihood = without_pattern(search.state, number), search.likelihood
    unseen = held_out(likelihood, search.settings)
    mixture = likelihood.mixture(bare)
    alone, patterned = (
        worth(likelihood, bare, mixture, (unseen, unseen), patterned=patterned) for patterned in (False, True)
    )
    return patterned - alone > PRICE_NATS * search.chosen[number].parameters


def _is_pattern(search: SearchState, number: int) -> bool:
    """Whether a static effect can be a part of the fixed pattern.

    The map was found together with the effect, so it contains the negative error of the effect.
    """
    state, candidate = search.state, search.chosen[number]
    pattern = next((k for k, c in enumerate(search.chosen) if c.patterned), None)
    if pattern is None or not candidate.static:
        return False
    likelihood, bare = search.likelihood, without_pattern(state, pattern)
    rest = without(bare, number - (pattern < number))
    unseen = held_out(likelihood, search.settings)
    values = []
    for each in (bare, rest):
        mixture = likelihood.mixture(each)
        values.append(worth(likelihood, each, mixture, (unseen, unseen), patterned=True))
    return values[0] - values[1] < candidate.price
