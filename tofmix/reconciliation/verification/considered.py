"""The sets of effects beside the answer, on one scale of evidence, each with the reason why it is not the answer.

After a search, the answer and the rivals that may be as likely are fitted to the samples again, all in the same way:

    evidence = gain in log-likelihood on all samples - price,

over the model as given, which may move within its tolerance as each set may. The price of effects that move or widen
samples is that of their coefficients in the linear model (`tofmix.reconciliation.search.alternatives`): their priors,
and the volume of their errors. Other effects pay `PRICE_NATS` for each number. Sets that the search saw far behind keep
the distance that they had there. A difference of a few nats says that the
samples do not separate two sets; `tofmix.reconciliation.verification.aliases` lists these.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.reconciliation.comparison.compare import compare, disagreements
from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.ledger import Ledger, Named, WeighedSet, name_of_effect, set_text
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import memory_gain
from tofmix.reconciliation.parameters.standard_errors import standard_errors
from tofmix.reconciliation.search.add import Added
from tofmix.reconciliation.search.alternatives import ALIAS_NATS, Explained, apart, as_candidates
from tofmix.reconciliation.search.columns import summed_up
from tofmix.reconciliation.search.name import AT_A_BOUND, FAINT_SHARE, TriedEffect, of_all_samples, thinned, tolerated
from tofmix.reconciliation.search.pattern_fits import settled_within, worth
from tofmix.reconciliation.search.refit import all_together, numbers, refit, without_pattern
from tofmix.reconciliation.search.search_state import Settings, fit_part, held_out, name_of
from tofmix.reconciliation.verdict import inexact
from tofmix.reconciliation.verification.contradictions import absent, implausible, refuted
from tofmix.reconciliation.verification.verify import Verified
from tofmix.simulation.effects.base import with_hidden
from tofmix.simulation.effects.hidden import PixelValue, RememberedNoise
from tofmix.wording import counted, number

OTHERS = 3
"""Most sets beside the answer and its aliases."""

_OF_SUMMARIES = 3  # sets that are weighed again, of those that the summaries rank
_OF_A_ROUND = 2  # rivals that are weighed again, of each added effect
NAMED = ("explained", "partly_explained")
"""Verdicts with names."""

_STILL = {
    "bias": "the mean",
    "spread": "the width",
    "skew": "the skew",
    "tails": "the shape of the tails",
    "pattern": "the mean of single pixels",
    "spread_pattern": "the width of single pixels",
    "invalid": "the share of lost samples",
    "common_mode": "the mean of frames",
    "bursts": "the width of frames",
    "trend": "the change in time",
    "memory": "the memory",
    "bridging": "the share of samples between two surfaces",
    "neighbour_correlation": "the correlation of neighbours",
    "discreteness": "the steps of the ranges",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """A set that was fitted to samples."""

    state: ModelState
    chosen: tuple[TriedEffect, ...]
    weighed: WeighedSet

    @property
    def names(self) -> frozenset[Named]:
        return frozenset(self.weighed.names)


def considered(
    likelihood: Likelihood, added: Added, verified: Verified, settings: Settings, ledger: Ledger
) -> tuple[WeighedSet, ...]:
    """The answer, its aliases, and the best others.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    added, verified
        The outcome of the search, and its verdict.
    settings : Settings
        Options of the search.
    ledger : Ledger
        The sets of the search; it gets those that are shown.

    Returns
    -------
    tuple of WeighedSet
        First the named set, or that without any effect; then sets that the recording cannot separate from it; then at
        most `OTHERS` others, most evidence first. Sets that contain the answer are left out: it explains the recording
        without the rest. If the search was interrupted, the sets are those that it had weighed, by its own evidence.
    """
    if ledger.ends():
        return _unfinished(added, verified, ledger)
    if added.considered:
        return _of_one_search(added, verified)
    first = WeighedSet(names=(), evidence_nats=0.0)
    if not added.chosen:
        return (first, *_others_of_search(first, ledger, "which the model within its tolerance, or chance, may give"))
    named = verified.verdict in NAMED
    scale = _Scale(likelihood, verified.start, settings)
    found = _weighed(scale, added.state, added.chosen, _explained(added, frozenset(map(name_of, added.chosen))))
    first = found.weighed if named else first
    told = [] if named else [replace(found.weighed, why_not=_refusal(added, verified))]
    for rival in _rivals(scale, added, found, ledger, named=named):
        if isinstance(rival, WeighedSet):
            told.append(replace(rival, why_not=_less_likely(rival, found, named=named)))
        else:
            told.append(_told(scale, rival, found, verified))
    told.sort(key=lambda w: -w.evidence_nats)
    shown = (first, *[w for w in told if w.is_alias], *[w for w in told if not w.is_alias][:OTHERS])
    for each in shown:
        ledger.weigh(each.names, each.evidence_nats, each.why_not)
    return shown


def _of_one_search(added: Added, verified: Verified) -> tuple[WeighedSet, ...]:
    """The sets of a search that has them on one scale; the best one with its refusal, if it is not named."""
    best, *others = added.considered
    if verified.verdict in NAMED or not best.names:
        return added.considered
    others = [replace(w, is_alias=False) for w in others if w.names]
    refused = replace(best, why_not=_refusal(added, verified))
    return (WeighedSet(names=(), evidence_nats=0.0), refused, *others[:OTHERS])


def _unfinished(added: Added, verified: Verified, ledger: Ledger) -> tuple[WeighedSet, ...]:
    """The answer of an interrupted search, and the best others that it had weighed."""
    names = tuple(sorted(name_of(c) for c in added.chosen)) if verified.verdict in NAMED else ()
    nats = [w.evidence_nats for w in ledger.sets if w.names == names and w.why_not is None]
    first = WeighedSet(names=names, evidence_nats=nats[-1] if nats else 0.0)
    return (first, *_others_of_search(first, ledger, "but not tried to the end"))


def _others_of_search(first: WeighedSet, ledger: Ledger, more: str) -> Iterator[WeighedSet]:
    """The best sets of the search that do not contain the answer; `more` says why those with more evidence lost."""
    others = [w for w in ledger.best() if not set(w.names) >= set(first.names) or not first.names]
    for other in [w for w in others if w.names != first.names][:OTHERS]:
        yield replace(other, why_not=_by_evidence(other, first, more))


def _by_evidence(other: WeighedSet, first: WeighedSet, more: str) -> str:
    """How much more or less likely one set is than another, in words; `more` ends those of a more likely one."""
    less = first.evidence_nats - other.evidence_nats
    if less >= 0:
        return f"{number(less, ',.0f')} nats less likely"
    return f"{number(-less, ',.0f')} nats more likely, {more}"


def _less_likely(rival: WeighedSet, found: _Fit, *, named: bool) -> str:
    """By how much a set is less likely than the found one; of a found set that is not named, with its effects."""
    than = "" if named else f" than {set_text(found.weighed.names)}, which is not named either"
    less = found.weighed.evidence_nats - rival.evidence_nats
    return f"{number(less, ',.0f')} nats less likely{than}"


class _Scale:
    """The common scale of evidence.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    start : ModelState
        The model as given, of evidence 0.
    settings : Settings
        Options of the search.
    """

    def __init__(self, likelihood: Likelihood, start: ModelState, settings: Settings) -> None:
        frames, pixels = likelihood.evidence.shape
        self.likelihood, self.settings, self.start = likelihood, settings, start
        self.part: Part = (np.arange(frames), np.arange(pixels))
        self._given: float | None = None

    @property
    def given(self) -> float:
        """Log-likelihood of the model as given."""
        if self._given is None:
            self._given = self.value(self.start, (), self.part)
        return self._given

    def evidence(self, state: ModelState, chosen: Sequence[TriedEffect], explained: Explained | None) -> float:
        """Log evidence, nats, of fitted effects; `explained` has them in the linear model."""
        priced = frozenset() if explained is None else explained.names
        price = sum(c.price for c in chosen if name_of(c) not in priced)
        price += 0.0 if explained is None else explained.occam
        gain = self.value(state, chosen, self.part) - self.given
        for effect, hidden in with_hidden(state.effects, RememberedNoise):
            # Samples that remember are fewer by this factor, and gain by those before
            rho = hidden.coefficient(effect)
            mixture = self.likelihood.mixture(state)
            scores = self.likelihood.scores(state, self.part, self.settings.seed, mixture)
            gain *= (1 - rho) / (1 + rho)
            gain += memory_gain(self.likelihood, scores, mixture, self.part, rho)
        return gain - price

    def value(self, state: ModelState, chosen: Sequence[TriedEffect], part: Part) -> float:
        """Log-likelihood of a part; a pattern is integrated out, and the model is moved within its tolerance."""
        likelihood, tolerance = self.likelihood, self.settings.tolerance
        pattern = next((k for k, c in enumerate(chosen) if c.patterned), None)
        if pattern is None:
            return likelihood.value(settled_within(likelihood, state, chosen, part, tolerance), part)
        bare = tolerated(likelihood, without_pattern(state, pattern), part, tolerance)
        return worth(likelihood, bare, likelihood.mixture(bare), (part, part), patterned=True)


def _explained(added: Added, names: frozenset[Named]) -> Explained | None:
    """The effects of these names that summaries show, in the linear model; None if it has no such set."""
    own = frozenset(name for name in names if summed_up(name[0]))
    sets = () if added.sets is None else (added.sets.found, *added.sets.sets)
    return next((s for s in sets if s.names == own), None)


def _weighed(scale: _Scale, state: ModelState, chosen: Sequence[TriedEffect], explained: Explained | None) -> _Fit:
    names = tuple(sorted(name_of(c) for c in chosen))
    weighed = WeighedSet(names=names, evidence_nats=scale.evidence(state, chosen, explained))
    return _Fit(state=state, chosen=tuple(chosen), weighed=weighed)


def _rivals(scale: _Scale, added: Added, found: _Fit, ledger: Ledger, *, named: bool) -> Iterator["_Fit | WeighedSet"]:
    """The best sets by the summaries, and the found one with an effect exchanged.

    Sets that may be as likely as the found one are fitted. Of the others the search knows by how much they are less
    likely.
    """
    sets = () if added.sets is None else added.sets.sets
    own = frozenset(found.names)
    kept = frozenset(name for name in own if not summed_up(name[0]))
    evidence = 0.0 if added.sets is None else added.sets.found.evidence
    seen: set[frozenset[Named]] = {own, frozenset()}
    for explained in _worth_a_fit(sets, own - kept if named else None):
        names, less = explained.names | kept, evidence - explained.evidence
        if names in seen or ledger.ends():
            continue
        seen.add(names)
        if less <= _doubtful(evidence):
            fit = _of_explained(scale, added, explained)
            if fit is not None:
                yield fit
        else:
            yield _behind(scale, found, names, less, fit_part(scale.likelihood, scale.settings))
    for place, rivals in enumerate(added.rivals):
        mine = added.chosen[place]
        for other in [c for c in rivals if _may_take_the_place(c, mine, covered=bool(sets))][:_OF_A_ROUND]:
            names = own - {name_of(mine)} | {name_of(other)}
            if names in seen or name_of(other) in own or ledger.ends():
                continue
            seen.add(names)
            if mine.score - other.score <= _doubtful(mine.score):
                yield _exchanged(scale, added, place, other)
            else:
                test = scale.likelihood.evidence.part(fit=False, split=scale.settings.split)
                yield _behind(scale, found, names, mine.score - other.score, test)


def _doubtful(evidence: float) -> float:
    """Difference of evidence up to which sets are fitted again: the search's fits are no more exact."""
    return max(ALIAS_NATS, FAINT_SHARE * evidence)


def _behind(scale: _Scale, found: _Fit, names: frozenset[Named], less: float, part: Part) -> WeighedSet:
    """A set that is less likely than the found one by so many nats of the samples of a part."""
    nats = found.weighed.evidence_nats - of_all_samples(scale.likelihood, part, less)
    return WeighedSet(names=tuple(sorted(names)), evidence_nats=nats)


def _worth_a_fit(sets: Sequence[Explained], own: frozenset[Named] | None) -> list[Explained]:
    """The best sets by the summaries that do not contain the named one, each without effects that add nothing to it."""
    others = [s for s in sets if own is None or not s.names >= own]
    needed = []
    for each in others:  # best first
        less = (o for o in others if o.names < each.names and o.evidence > each.evidence - ALIAS_NATS)
        if next(less, None) is None:
            needed.append(each)
        if len(needed) == _OF_SUMMARIES:
            break
    return needed


def _of_explained(scale: _Scale, added: Added, explained: Explained) -> _Fit | None:
    """A set of the summaries, fitted to samples beside the effects that summaries do not show; None out of bounds."""
    likelihood, part = scale.likelihood, fit_part(scale.likelihood, scale.settings)
    kept, state = [c for c in added.chosen if not summed_up(c.kind)], apart(added.state)
    new = as_candidates(likelihood, state, explained, thinned(likelihood.evidence, part))
    if not new and explained.terms:
        return None
    chosen = [*kept, *new]
    state = replace(state, effects=(*state.effects, *(c.effect for c in new)))
    state, chosen = all_together(likelihood, state, chosen, part)
    return _weighed(scale, state, chosen, explained)


def _may_take_the_place(other: TriedEffect, own: TriedEffect, *, covered: bool) -> bool:
    """Whether another candidate of a round is fitted in place of the one that was added.

    The summaries have compared all pairs that they show. The value of a stuck pixel leaves no doubt.
    """
    if covered and summed_up(other.kind) and summed_up(own.kind):
        return False
    return not any(isinstance(c.effect.hidden, PixelValue) for c in (other, own))


def _exchanged(scale: _Scale, added: Added, place: int, other: TriedEffect) -> _Fit:
    """The found effects with one of them exchanged, all fitted again."""
    likelihood, part = scale.likelihood, fit_part(scale.likelihood, scale.settings)
    own, state = added.chosen[place], added.state
    if own.patterned:
        nothing = np.zeros_like(state.pixel_bias)
        state = replace(state, pixel_bias=nothing, pixel_variance=nothing)
    effects = (*state.effects[:place], other.effect, *state.effects[place + 1 :])
    chosen = [*added.chosen[:place], other, *added.chosen[place + 1 :]]
    state, chosen = refit(likelihood, replace(state, effects=effects), chosen, part)
    return _weighed(scale, state, chosen, _explained(added, frozenset(map(name_of, chosen))))


def _told(scale: _Scale, fit: _Fit, found: _Fit, verified: Verified) -> WeighedSet:
    """A set that was fitted again, with the reason why it is not the answer."""
    named, weighed = verified.verdict in NAMED, fit.weighed
    more = weighed.evidence_nats - found.weighed.evidence_nats
    if more < -ALIAS_NATS:
        return replace(weighed, why_not=_less_likely(weighed, found, named=named))
    near = named and more <= ALIAS_NATS
    why = next(_against(scale, fit, verified, near=near), None)
    if why is not None:
        return replace(weighed, why_not=why)
    if near and not fit.names < found.names:
        size = f"{number(abs(more), '.1f')} nats {'more' if more > 0 else 'less'} likely"
        return replace(weighed, why_not=f"cannot be told apart: {size}", is_alias=True)
    return replace(weighed, why_not=_beside(scale, fit, found, more))


def _against(scale: _Scale, fit: _Fit, verified: Verified, *, near: bool) -> Iterator[str]:
    """What speaks against a set that is about as likely as the answer, or more likely."""
    likelihood, settings = scale.likelihood, scale.settings
    said = [*implausible(fit.chosen), *refuted(likelihood, fit.chosen, settings.alpha)]
    yield from (f"{set_text([name_of(fit.chosen[c.number])])} {c.reason}" for c in said)
    if any(c.fitted is not None and c.fitted.at_a_bound for c in fit.chosen):
        yield AT_A_BOUND
    errors = standard_errors(numbers(likelihood, fit.state, fit.chosen, fit_part(likelihood, settings)))
    for k, effect in enumerate(fit.state.effects):
        if k in errors and absent(effect, errors[k]) > settings.alpha:
            yield f"the error of {set_text([name_of_effect(effect)])} is as large as its value"
    if not near:
        held = held_out(likelihood, settings)
        within = settled_within(likelihood, fit.state, fit.chosen, held, settings.tolerance)
        panel = compare(likelihood, within, held, seed=settings.seed)
        loud = disagreements(panel, settings.alpha)
        yield from (still(curve) for curve in loud if curve.size > inexact(curve, verified.before))


def still(curve: Curve) -> str:
    """What still differs, in words."""
    what = _STILL.get(curve.statistic, curve.statistic.replace("_", " "))
    over = "" if curve.axis == "all" else f" over {curve.axis.replace('_', ' ')}"
    return f"{what} still differs{over}"


def _beside(scale: _Scale, fit: _Fit, answer: _Fit, more: float) -> str:
    """Why a set is not the answer that explains as much or more, and against which nothing else speaks."""
    size = f"{number(abs(more), ',.0f')} nats {'more' if more > 0 else 'less'} likely"
    if fit.names < answer.names:
        return f"{size} without {set_text(sorted(answer.names - fit.names))}, which a statistic needs"
    own, others = (sum(c.parameters for c in f.chosen) for f in (answer, fit))
    if others > own:
        return f"{size}, with {counted(others - own, 'number')} more; without them nothing stands out"
    held = held_out(scale.likelihood, scale.settings)
    seen = [scale.value(f.state, f.chosen, held) - sum(c.price for c in f.chosen) for f in (answer, fit)]
    if seen[1] < seen[0]:
        return f"{size} on all samples, but less on those that no fit has seen"
    return f"{size}, but the search from it ends elsewhere"


def _refusal(added: Added, verified: Verified) -> str:
    """Why the effects of a search are not named."""
    found = verified.findings
    said = [f"{set_text([name_of(added.chosen[c.number])])} {c.reason}" for c in verified.against]
    said += ["there are too few samples"] if found.few else []
    said += [f"a smooth function of {found.law} fits better"] if found.law else []
    said += [f"the model's own {found.own.kind} fits better with other numbers"] if found.own is not None else []
    said += [AT_A_BOUND] if found.bound else []
    said += ["another memory than of one frame is left"] if found.echo else []
    said += ["its pattern is a smooth function of place"] if found.shaped else []
    said += [still(curve) for curve in found.open[:1]]
    said += ["ranges change in time" if found.contradicted else "its effects leave the statistics in which they show"]
    return said[0]
