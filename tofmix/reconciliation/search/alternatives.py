"""Other sets of effects that explain a recording as well as the found one, or better.

All sets of effects that move or widen samples are compared with the summaries of the fitting frames
(`tofmix.reconciliation.search.subsets`). A set with nearly the same evidence is an alias. From a set that is clearly
better, another search starts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.parameters.fits import fit
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.search.columns import Term, summed_up, terms
from tofmix.reconciliation.search.name import FAINT_SHARE, TriedEffect
from tofmix.reconciliation.search.search_state import Settings, fit_part, name_of
from tofmix.reconciliation.search.subsets import Explained, Subsets
from tofmix.reconciliation.search.summaries import summaries
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.search import Problem

ALIAS_NATS = 4.0
"""Difference of evidence that does not separate two sets: odds of 55 to 1."""

MOST_ALIASES = 3
"""Most aliases that are listed."""

_BETTER_NATS = 1.0  # evidence above the found set, from which a search starts from another set
_LARGEST = 3  # most effects of a set


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alternatives:
    """Sets of effects with their evidence.

    Parameters
    ----------
    found : Explained
        The found effects that move or widen samples.
    sets : tuple of Explained
        Others, best first.
    """

    found: Explained
    sets: tuple[Explained, ...]

    @property
    def aliases(self) -> tuple[Explained, ...]:
        """Sets with nearly the evidence of the found one, without larger sets that contain such a set.

        Subsets of the found set are left out, because without the rest the panel stood out.
        """
        least = max(self.found.evidence - ALIAS_NATS, 0.0)  # an alias must be better than no effect
        near = [s for s in self.sets if s.evidence > least]
        near = [s for s in near if not s.names > self.found.names and not s.names < self.found.names]
        return tuple(s for s in near if not any(o.names < s.names for o in near))[:MOST_ALIASES]

    @property
    def enough(self) -> Explained | None:
        """The best subset of the found set with nearly its evidence; None if all effects are needed."""
        parts = [s for s in self.sets if s.terms and s.names < self.found.names]
        near = [s for s in parts if s.evidence > self.found.evidence - ALIAS_NATS]
        return max(near, key=lambda s: (-s.numbers, s.evidence), default=None)

    def better(self, *, larger: bool) -> Explained | None:
        """The smallest set that is clearly better than the found one and nearly the best; None if there is none.

        Parameters
        ----------
        larger : bool
            Whether it may have more numbers than the found set.
        """
        sets = self._of_size(larger=larger)
        if not sets:
            return None
        top = max(s.evidence for s in sets)
        enough = [s for s in sets if s.evidence >= top - max(ALIAS_NATS, FAINT_SHARE * top)]
        least = min(s.numbers for s in enough)
        best = max((s for s in enough if s.numbers == least), key=lambda s: s.evidence)
        return best if best.evidence > self.found.evidence + _BETTER_NATS else None

    def best(self, *, larger: bool) -> Explained | None:
        """The set of most evidence, if it is clearly better than the found one; `larger` as for `better`."""
        best = max(self._of_size(larger=larger), key=lambda s: s.evidence, default=self.found)
        return best if best.evidence > self.found.evidence + _BETTER_NATS else None

    @property
    def simpler(self) -> Explained | None:
        """The set of most evidence of those with fewer numbers, if it is clearly better than the found one."""
        fewer = (s for s in self.sets if s.terms and s.numbers < self.found.numbers)
        best = max(fewer, key=lambda s: s.evidence, default=self.found)
        return best if best.evidence > self.found.evidence + _BETTER_NATS else None

    def _of_size(self, *, larger: bool) -> list[Explained]:
        return [s for s in self.sets if larger or s.numbers <= self.found.numbers]


def alternatives(
    likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], settings: Settings
) -> Alternatives | None:
    """Compare all sets of effects with the summaries of the fitting frames; None if no pixel can be used.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : State
        The model with the found effects.
    chosen : sequence of Candidate
        The found effects, in the order of the state.
    settings : Settings
        Options of the search; kinds that the model has are left out.
    """
    given = {(e.kind, getattr(e, "surface", "")) for e in likelihood.scene.effects}
    rest = apart(state)
    seen = summaries(likelihood, rest, fit_part(likelihood, settings))
    if not any(s.used.any() for s in seen):
        return None
    every = [t for t in terms(likelihood, rest, seen, settings.kinds) if t.name not in given]
    pattern = next((e for e in state.effects if isinstance(e, FixedPattern)), None)
    subsets = Subsets(seen, every, settings.tolerance, 0.0 if pattern is None else pattern.pixel_sigma_mm)
    names = {name_of(c) for c in chosen} & {t.name for t in every}
    sets = subsets.all_up_to(min(_LARGEST, max(settings.max_effects, 1)))
    found = next((s for s in sets if s.names == names), None) or best_of_names(subsets, every, names)
    return Alternatives(found=found, sets=tuple(s for s in sets if s.names != names and _plausible(s)))


def _plausible(found: Explained) -> bool:
    """Whether a real camera can have the numbers of a set's effects."""
    try:
        return all(t.make(c).plausible() for t, c in zip(found.terms, found.coefficients, strict=True))
    except ValueError:
        return False


def best_of_names(subsets: Subsets, every: Sequence[Term], names: set[tuple[str, str]]) -> Explained:
    """The best set of these names, where a law has several choices: values of a parameter, or tilts beside a shift.

    It begins with most numbers for each effect. Each choice is then made again given the others, until none changes.
    The numbers of effects have joint errors: a pose may need its tilts only beside those of another effect.
    """
    choices = [[k for k, t in enumerate(every) if t.name == name] for name in sorted(names)]
    taken = [max(own, key=lambda k: len(every[k].columns)) for own in choices]
    best = subsets.explained(taken)
    before = -math.inf
    while best.evidence > before:
        before = best.evidence
        for place, own in enumerate(choices):
            for k in own:
                other = [*taken[:place], k, *taken[place + 1 :]]
                found = subsets.explained(other)
                if found.evidence > best.evidence:
                    taken, best = other, found
    return best


def apart(state: ModelState) -> ModelState:
    """The state without effects that summaries show, and without a pattern's map, which contains all static biases."""
    kept = tuple(e for e in state.effects if not summed_up(e.kind))
    if any(isinstance(e, FixedPattern) for e in state.effects):
        nothing = np.zeros_like(state.pixel_bias)
        state = replace(state, pixel_bias=nothing, pixel_variance=nothing)
    return replace(state, effects=kept)


def as_candidates(likelihood: Likelihood, state: ModelState, found: Explained, part: Part) -> list[TriedEffect]:
    """The effects of a set as candidates of the search, each fitted to the samples with the others present.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : State
        The model without the set.
    found : Explained
        The set, with its numbers from the summaries.
    part : (frames, pixels)
        Data of the fits.

    Returns
    -------
    list of Candidate
        Their gains are 0, because they are not known yet. Empty if the numbers of an effect are not possible.
    """
    try:
        effects = [t.make(c) for t, c in zip(found.terms, found.coefficients, strict=True)]
    except ValueError:
        return []
    out: list[TriedEffect] = []
    for k, term in enumerate(found.terms):
        others = (*(c.effect for c in out), *effects[k + 1 :])
        beside = replace(state, effects=(*state.effects, *others))
        problem = _problem(likelihood, beside, term)
        if problem is None:
            return []
        fitted = fit(problem, likelihood, beside, part)
        if not np.isfinite(fitted.value) or fitted.at_a_bound:
            return []
        out.append(
            TriedEffect(effect=fitted.effect, gain=0.0, parameters=problem.parameters, state=state, fitted=fitted)
        )
    return out


def _problem(likelihood: Likelihood, state: ModelState, term: Term) -> Problem | None:
    """The search of a term's kind for its surface; of several, the one with the same number of numbers."""
    own = []
    for problem in problems(term.kind, likelihood, likelihood.mixture(state)):
        effect = problem.make(np.array(problem.starts[0]))
        if getattr(effect, "surface", "") == term.surface:
            own.append(problem)
    return min(own, key=lambda p: abs(p.parameters - len(term.columns)), default=None)
