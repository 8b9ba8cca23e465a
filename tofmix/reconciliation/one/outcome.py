"""The best set of a search as the verdict, the aliases and the report need it.

The numbers are fitted once more, to the fitting frames alone, so that the check of the verdict uses frames that no fit
has seen. A member that leaves a statistic open in which it must show is taken out.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tofmix.reconciliation.comparison.compare import Compared, compare
from tofmix.reconciliation.ledger import Ledger, WeighedSet, name_of_effect
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.memory import memory_gain
from tofmix.reconciliation.likelihood.pixel_pattern import marginal_pattern, pixel_biases
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.search import FoundSets, search
from tofmix.reconciliation.one.static_errors import StaticErrors
from tofmix.reconciliation.parameters.fits import Fitted, Numbers
from tofmix.reconciliation.search import links
from tofmix.reconciliation.search.add import Added, covered
from tofmix.reconciliation.search.name import TriedEffect
from tofmix.reconciliation.search.pattern_fits import settled_within
from tofmix.reconciliation.search.refit import latent_states, settle, without
from tofmix.reconciliation.search.search_state import Settings, fit_part, held_out
from tofmix.reconciliation.verification.verify import Verified, verify
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.hidden import PixelBias, PixelValue, RememberedNoise

OTHERS = 3
"""Most sets beside the best one and its aliases of which the reason is given."""


def named(
    likelihood: Likelihood,
    settings: Settings,
    tick: Callable[[float], None] = lambda _: None,
    ledger: Ledger | None = None,
) -> tuple[Added, Verified]:
    """Search, and judge the best set.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    settings : Settings
        Options.
    tick, ledger
        As of `tofmix.reconciliation.one.search.search`.
    """
    found = search(likelihood, settings, tick, ledger)
    best = found.best_named
    added = as_added(found, best)
    verified = verify(likelihood, added, settings)
    if verified.verdict != "unexplained" or found.law is not None:
        return added, verified
    open_ = {name_of_effect(added.chosen[k].effect) for k in verified.findings.unsigned}
    rest = frozenset(name for name in best.names if name not in open_)
    less = max((s for s in found.table.values() if s.names == rest), key=lambda s: s.score, default=None)
    if not open_ or not rest or less is None or not np.isfinite(less.score):
        return added, verified
    other = as_added(found, less)
    judged = verify(likelihood, other, settings)
    return (added, verified) if judged.verdict == "unexplained" else (other, judged)


def as_added(found: FoundSets, best: FittedSet) -> Added:
    """A fitted set as the outcome of a search, with numbers from the fitting frames."""
    state, chosen = refitted(best)
    return Added(
        state=state,
        chosen=chosen,
        first=_singles(found),
        panel=_panel(best, state, chosen),
        considered=considered(found, best),
        law=found.law,
        laws_tried=True,
    )


def refitted(s: FittedSet) -> tuple[ModelState, tuple[TriedEffect, ...]]:
    """The state of a set by the fitting frames alone, and its effects with their held-out gains."""
    task = s.task
    like, part = task.likelihood, fit_part(task.likelihood, task.settings)
    pattern: tuple[Effect, ...] = ()
    if s.pattern is not None:
        kind, spreads = s.pattern
        if not isinstance(kind.hidden, PixelBias):
            raise TypeError(f"{kind.kind} has no bias of a pixel")
        pattern = (kind.hidden.made(kind, spreads),)
    bare = replace(s.state(), log_width=task.null.log_width)  # the model's own error of widths is no part of it
    members = s.members()
    state = replace(bare, effects=(*members, *s.linked, *pattern))
    if not state.effects:
        return latent_states(like, replace(state, effects=()), part[0]), ()
    fits = {
        k: Fitted(effect=effect, vector=x, problem=law.problem, value=0.0)
        for k, (effect, law, x) in enumerate(zip(members, s.laws, s.parts(s.x), strict=True))
    }
    state = latent_states(like, state, part[0])
    searched = {k: f for k, f in fits.items() if f.problem.steps}
    last = settle(Numbers(likelihood=like, state=state, fits=searched, part=part))
    fits |= last.fits
    chosen = tuple(
        TriedEffect(
            effect=effect,
            gain=_gain(s, last.state, number),
            parameters=_parameters(effect, fits.get(number)),
            state=last.state,
            fitted=fits.get(number),
        )
        for number, effect in enumerate(last.state.effects)
    )
    return last.state, chosen


def _parameters(effect: Effect, fitted: Fitted | None) -> int:
    if fitted is not None:
        return fitted.problem.parameters
    hidden = effect.hidden
    return max(len(hidden.numbers), 1) if hidden is not None else 1


def _gain(s: FittedSet, state: ModelState, number: int) -> float:
    """What an effect gains on held-out data, nats, in the presence of the others."""
    like, settings = s.task.likelihood, s.task.settings
    test = like.evidence.part(fit=False, split=settings.split)
    effect, rest = state.effects[number], without(state, number)
    hidden = effect.hidden
    if isinstance(hidden, PixelValue):
        out = np.flatnonzero(~state.working)
        part = test[0], np.intersect1d(test[1], out) if np.intersect1d(test[1], out).size else out
        freed = replace(rest, stuck_mm=np.full_like(rest.stuck_mm, np.nan))
        before = like.sums(like.mixture(freed), freed, part).total
        return float(-before - links.VALUE_NATS * part[1].size)
    if isinstance(hidden, PixelBias):
        nothing = np.zeros_like(state.pixel_bias)
        bare = replace(rest, pixel_bias=nothing, pixel_variance=nothing)
        biases = pixel_biases(like, like.mixture(bare), bare, test)
        return marginal_pattern(biases, like.evidence.image, hidden.spreads(effect))[0]
    if isinstance(hidden, RememberedNoise):
        mixture = like.mixture(state)
        z = like.scores(state, s.task.part, settings.seed, mixture)
        return memory_gain(like, z, mixture, test, hidden.coefficient(effect))
    return like.value(state, test) - like.value(rest, test)


def _panel(best: FittedSet, state: ModelState, chosen: Sequence[TriedEffect]) -> Compared:
    """Panel of the model, moved within its tolerance to where it fits the held-out frames best."""
    task = best.task
    like, settings = task.likelihood, task.settings
    held = held_out(like, settings)
    return compare(like, _moved(best, state, chosen), covered(like, state, held), seed=settings.seed)


def _moved(best: FittedSet, state: ModelState, chosen: Sequence[TriedEffect]) -> ModelState:
    task = best.task
    like, settings = task.likelihood, task.settings
    held = held_out(like, settings)
    if len(task.recordings) > 1:  # a state has one bias of a pixel, and each recording its own errors of poses
        return settled_within(like, state, chosen, held, settings.tolerance)
    near = state
    if best.about is not None and not task.width_variance.any():  # where pixels have widths, these are in the state
        error = best.about.model_log_width(like.mixture(best.state()))
        near = replace(state, log_width=state.log_width + error)
    found = pixel_biases(like, like.mixture(near), near, held)
    known = np.where(task.lit, found.information, 0.0)  # a measured scene's own errors are taken off already
    own = state.pixel_variance if state.errors is None else np.zeros_like(state.pixel_variance)
    errors = StaticErrors.of(task.low, known, like.evidence.image, more_variance=own)
    return replace(near, pixel_bias=near.pixel_bias + errors.of_model(found.bias[None])[0])


def _singles(found: FoundSets) -> tuple[TriedEffect, ...]:
    """The fitted sets of one named effect, the largest gain first: its gain on held-out data over the model as given.

    Of a hidden state it is the evidence, times the share of the samples that are held out.
    """
    nothing, task = found.table[frozenset()], found.task
    like = task.likelihood
    test = like.evidence.part(fit=False, split=task.settings.split)
    share = test[0].size * test[1].size / (task.part[0].size * task.part[1].size)
    given = like.value(nothing.state(), test)
    out = []
    for s in found.table.values():
        if len(s.keys) != 1 or not s.named or not np.isfinite(s.evidence):
            continue
        if s.laws:
            (effect,), gain = s.members(), like.value(s.state(), test) - given
        else:
            effect, gain = _only_hidden(s), share * (s.evidence - nothing.evidence)
        out.append(TriedEffect(effect=effect, gain=gain, parameters=max(s.x.size, 1), state=nothing.state()))
    return tuple(sorted(out, key=lambda c: -c.gain))


def _only_hidden(s: FittedSet) -> Effect:
    """The one effect of a set, which has a hidden state."""
    if s.pattern is None:
        return s.linked[0]
    kind, spreads = s.pattern
    return kind.hidden.made(kind, spreads) if kind.hidden is not None else kind()


def considered(found: FoundSets, best: FittedSet) -> tuple[WeighedSet, ...]:
    """The best set, its aliases, and the best others, each with the reason why it is not the answer."""
    nothing = found.table[frozenset()].evidence
    near = found.aliases(best)

    def of(s: FittedSet, why_not: str | None, *, is_alias: bool = False) -> WeighedSet:
        nats = s.evidence - nothing
        return WeighedSet(names=tuple(sorted(s.names)), evidence_nats=nats, why_not=why_not, is_alias=is_alias)

    seen = {best.names, *(s.names for s in near)}
    others = []
    fitted = (s for s in found.table.values() if s.named and np.isfinite(s.evidence))
    for s in sorted(fitted, key=lambda s: -s.evidence):
        if s.names not in seen and not s.names > best.names:
            seen.add(s.names)
            others.append(s)
    alike = "cannot be told apart"
    return (
        of(best, None),
        *(of(s, f"{alike}: {_less(s.evidence - best.evidence)}", is_alias=True) for s in near),
        *(of(s, s.refused or _why(s, best, found.task.price_nats)) for s in others[:OTHERS]),
    )


def _why(s: FittedSet, best: FittedSet, price_nats: float) -> str:
    more = len(s.keys) - len(best.keys)
    if s.evidence > best.evidence and more > 0:
        return (
            f"{s.evidence - best.evidence:.0f} nats more likely, by {more} more, at a price of {more * price_nats:.0f}"
        )
    return _less(s.evidence - best.evidence)


def _less(nats: float) -> str:
    size = f"{abs(nats):.1f}" if abs(nats) < 10 else f"{abs(nats):,.0f}"  # noqa: PLR2004  two digits are enough
    return f"{size} nats {'more' if nats > 0 else 'less'} likely"
