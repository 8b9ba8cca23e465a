"""Effects in the presence of a fixed pattern: fitted to biases, and judged with its values integrated out.

A fixed pattern can imitate any static bias. An effect that is fitted without the pattern follows the columns and rows
of the pattern, and then has wrong numbers. So its numbers are fitted to the biases of all pixels by generalised least
squares, with the pattern and the noise as covariance.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scipy.stats import chi2

from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases, spreads_of, with_pattern
from tofmix.reconciliation.parameters.fits import Fitted, fit
from tofmix.reconciliation.search import links
from tofmix.reconciliation.search.name import PRICE_NATS, Trial, TriedEffect, tolerated
from tofmix.reconciliation.search.refit import refit
from tofmix.reconciliation.search.static_fits import StaticFits
from tofmix.simulation.effects.base import Effect, Target, with_hidden
from tofmix.simulation.effects.hidden import PatternSpreads, PixelBias

_EACH = 3  # alternations: of static effects and the model within its tolerance; of a drift and the other effects
_FAIR = 0.5  # least score, as a share of the best one, of an effect in time that is fitted with all others
_TRIED = 3  # best static candidates that are tried
_CLEAR_NATS, _CLEAR_SHARE = 10.0, 0.0001  # gain beyond that of the pattern, for an effect that is added before it


def worth(
    likelihood: Likelihood, state: ModelState, mixture: Mixture, parts: tuple[Part, Part], *, patterned: bool
) -> float:
    """Log-likelihood of held-out data, with a pattern of free spreads integrated out.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : ModelState
        A state without a pattern.
    mixture : Mixture
        Its prediction.
    parts : two of (frames, pixels)
        Fitting data and held-out data, of all pixels: laws of few numbers need no held-out pixels.
    patterned : bool
        Whether there is a pattern.
    """
    fit, test = parts
    bare = likelihood.value(state, test, mixture)
    if not patterned:
        return bare
    biases = pixel_biases(likelihood, mixture, state, test)
    seen = biases if fit is test else pixel_biases(likelihood, mixture, state, fit)
    pattern = links.fit_spreads(seen, likelihood.evidence.image)
    if pattern is None:
        return bare
    return bare + with_pattern(biases, likelihood.evidence.image, pattern[0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PatternFit:
    """The result of a round in the presence of a fixed pattern.

    Parameters
    ----------
    first : TriedEffect
        The best effect, with its numbers in the presence of the pattern.
    patterned : bool
        Whether the pattern still gains in the presence of the effect.
    """

    first: TriedEffect
    patterned: bool


def best_with_pattern(
    trial: Trial,
    chosen: Sequence[TriedEffect],
    found: Sequence[TriedEffect],
    parts: tuple[Part, Part],
    near: ModelState,
    alpha: float,
) -> PatternFit | None:
    """The effect that gains most in the presence of a fixed pattern; None if no gain is clear.

    Parameters
    ----------
    trial : Trial
        The round.
    chosen : sequence of TriedEffect
        The state's effects, in its order.
    found : sequence of TriedEffect
        Its candidates, a fixed pattern first.
    parts : two of (frames, pixels)
        Fitting data and held-out data, of all pixels.
    near : ModelState
        The model moved within its tolerance to where it fits best; an effect must gain more than it.
    alpha : float
        Level of the gain beyond the pattern, corrected for the number of candidates.

    References
    ----------
    Twice the gain of k numbers that are not needed has the chi-square of k (Wilks 1938, doi:10.1214/aoms/1177732360).
    """
    likelihood = trial.likelihood
    pattern, others = found[0], [c for c in found[1:] if c.fitted is not None]
    unseen = parts[1], parts[1]  # three spreads for all pixels, fitted to the held-out data: they favour no candidate
    nothing = worth(likelihood, trial.state, trial.mixture, unseen, patterned=False)
    about = links.fit_pattern(likelihood, trial.mixture, trial.state, parts[0])
    (effect, hidden), *_ = with_hidden((pattern.effect,), PixelBias)
    fits = _Fits(trial, chosen, parts[0], hidden.spreads(effect) if about is None else about[0])
    settled = fits.settled()
    alone, tolerable = (
        worth(likelihood, state, likelihood.mixture(state), unseen, patterned=True) for state in (settled, near)
    )
    tried: list[tuple[float, TriedEffect]] = []
    for other in _worth_a_look(others, fits):
        price = other.price
        chance = 0.5 * float(chi2.isf(alpha / len(found), max(other.parameters, 1)))
        needed = chance + _CLEAR_SHARE * max(alone - nothing, 0.0)
        mixture = likelihood.mixture(other.state)
        value = worth(likelihood, other.state, mixture, unseen, patterned=True)
        if value - alone > needed and value - price > tolerable:
            tried.append((value - price, other))
    if not tried:
        return None
    _, first = max(tried, key=lambda pair: pair[0])
    return PatternFit(first=first, patterned=_still_gains(trial, first, unseen))


def _still_gains(trial: Trial, other: TriedEffect, unseen: tuple[Part, Part]) -> bool:
    """Whether a pattern clearly gains in the presence of an effect, whose numbers are fitted for that."""
    likelihood = trial.likelihood
    mixture = likelihood.mixture(other.state)
    without, with_ = (
        worth(likelihood, other.state, mixture, unseen, patterned=patterned) for patterned in (False, True)
    )
    return with_ - without > spreads_of(likelihood.evidence.image) * PRICE_NATS + _CLEAR_NATS


def _worth_a_look(others: Sequence[TriedEffect], fits: "_Fits") -> list[TriedEffect]:
    """The static candidates that are best with a pattern, with their numbers there, and the best one without it.

    Of the other candidates, the best of each kind. In the presence of a pattern static candidates lose most of their
    gain, so a candidate with a small gain alone may be the best.
    """
    gaining = [c for c in others if c.gain > c.price + _CLEAR_NATS]
    moving = {c.kind: c for c in reversed(gaining) if not c.static}
    alone = [*[c for c in gaining if c.static][:1], *moving.values()]
    moved = [fits.beside(c) for c in others if c.static]
    moved.sort(key=lambda pair: PRICE_NATS * pair[1].parameters - pair[0])
    return [c for gain, c in moved[:_TRIED] if gain > c.price] + alone


def settled_within(
    likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], part: Part, tolerance: float
) -> ModelState:
    """The model moved within its tolerance to where it fits best, alternating with fits of the static effects.

    Numbers that were fitted to the model as given follow the errors of its poses. They may be off by more than the
    tolerance can correct.

    Parameters as of `tofmix.reconciliation.search.name.tolerated`, and `chosen`: the state's effects, in its order.
    """
    best = tolerated(likelihood, state, part, tolerance)
    fits = {k: c.fitted for k, c in enumerate(chosen) if c.fitted is not None and c.static}
    if tolerance <= 0 or not fits or state.pixel_bias.any():
        return best
    *before, last = fits
    value, near = likelihood.value(best, part), best
    for _ in range(_EACH):
        static = StaticFits(likelihood, near, likelihood.mixture(near), part)
        _, fitted, others = static.fitted(fits[last], {k: fits[k] for k in before}, place=last)
        fits = {**others, last: fitted}
        effects = tuple(fits[k].effect if k in fits else e for k, e in enumerate(state.effects))
        near = tolerated(likelihood, replace(state, effects=effects), part, tolerance)
        now = likelihood.value(near, part)
        if now <= value:
            break
        value, best = now, near
    return best


class _Fits:
    """Fits of candidates together with the static effects of the model, with or without a pattern."""

    def __init__(
        self, trial: Trial, chosen: Sequence[TriedEffect], part: Part, spreads: PatternSpreads | None = None
    ) -> None:
        self._state = trial.state
        self.old = {k: c.fitted for k, c in enumerate(chosen) if c.fitted is not None and c.static}
        self._fits = StaticFits(trial.likelihood, trial.state, trial.mixture, part, spreads)

    def beside(self, candidate: TriedEffect) -> tuple[float, TriedEffect]:
        """The gain of a candidate by the biases, and the candidate with its numbers, and the model's, of this fit."""
        if candidate.fitted is None:
            return -math.inf, candidate
        gain, fitted, others = self._fits.fitted(candidate.fitted, self.old)
        state = replace(candidate.state, effects=(*self._effects(others), fitted.effect))
        return gain, replace(candidate, effect=fitted.effect, fitted=fitted, state=state)

    def settled(self) -> ModelState:
        """The model with its static effects fitted again."""
        if not self.old:
            return self._state
        *before, last = self.old
        rest = {place: self.old[place] for place in before}
        _, fitted, others = self._fits.fitted(self.old[last], rest, place=last)
        return replace(self._state, effects=self._effects({**others, last: fitted}))

    def _effects(self, fits: Mapping[int, Fitted]) -> tuple[Effect, ...]:
        return tuple(fits[k].effect if k in fits else e for k, e in enumerate(self._state.effects))


def with_the_others(trial: Trial, chosen: Sequence[TriedEffect], found: Sequence[TriedEffect]) -> list[TriedEffect]:
    """The candidates, best first, scored together with effects of the model that may have absorbed a part of them.

    An added effect may have absorbed a part of a candidate: a pose, a part of an offset; a drift, a part of any static
    effect. With its numbers fixed, a wrong candidate that does not act on this surface would be better.

    Parameters
    ----------
    trial : Trial
        The round.
    chosen : sequence of TriedEffect
        The state's effects, in its order.
    found : sequence of TriedEffect
        This round's candidates.
    """
    likelihood, state = trial.likelihood, trial.state
    if state.pixel_bias.any():
        return list(found)
    fits = _Fits(trial, chosen, trial.fit_part)
    out = []
    for candidate in found:
        better = candidate
        if fits.old and candidate.fitted is not None and candidate.static:
            moved = fits.beside(candidate)[1]
            gain = likelihood.value(moved.state, trial.test_part) - trial.base
            better = replace(moved, gain=gain) if gain > candidate.gain else candidate
        out.append(better)
    fair = max((_FAIR * c.score for c in found[:1]), default=0.0)
    static = sorted((c for c in out if c.static and c.score > 0), key=lambda c: -c.score)[:_TRIED]
    worthy = [c for c in out if c in static or (c.effect.target is Target.TREND and c.score > fair)]
    return sorted((together(trial, chosen, c) if c in worthy else c for c in out), key=lambda c: -c.score)


def together(trial: Trial, chosen: Sequence[TriedEffect], candidate: TriedEffect) -> TriedEffect:
    """A candidate fitted together with all effects of the model, if one of two changes in time and the other is static.

    A drift is partly static, and so is a motion. The one that was fitted first has absorbed the static part of the
    other.

    Parameters
    ----------
    trial : Trial
        The round.
    chosen : sequence of TriedEffect
        The state's effects, in its order.
    candidate : TriedEffect
        One of this round.
    """
    if candidate.fitted is None or not any(c.fitted is not None and _share(c, candidate) for c in chosen):
        return candidate
    likelihood, best, now = trial.likelihood, candidate, [*chosen, candidate]
    for _ in range(_EACH):
        state, now = refit(likelihood, replace(trial.state, effects=tuple(c.effect for c in now)), now, trial.fit_part)
        gain = likelihood.value(state, trial.test_part) - trial.base
        if gain > best.gain:
            best = replace(now[-1], state=state, gain=gain, others=tuple(now[:-1]))
        several = next((k for k, c in enumerate(now) if c.effect.several_optima), None)
        if several is None:
            break
        now[several] = _begun_anew(trial, now, several)
    return best


def _begun_anew(trial: Trial, now: Sequence[TriedEffect], number: int) -> TriedEffect:
    """One of the candidates, searched for again from all its starts, in the presence of the others."""
    old = now[number]
    if old.fitted is None:
        return old
    rest = replace(trial.state, effects=tuple(c.effect for k, c in enumerate(now) if k != number))
    fitted = fit(old.fitted.problem, trial.likelihood, rest, trial.fit_part)
    return replace(old, effect=fitted.effect, fitted=fitted)


def _share(old: TriedEffect, new: TriedEffect) -> bool:
    """Whether one of two effects is static and the other partly; if one of a surface came first, of the same surface.

    An effect that changes in time is partly static.
    """
    trends = [c.effect.target is Target.TREND for c in (old, new)]
    surface = getattr(old.effect, "surface", None)
    if trends[0] and surface is not None:
        return new.static and surface == getattr(new.effect, "surface", None)
    return (trends[0] and new.static) or (old.static and trends[1])
