"""Other sets of effects that explain a recording as well as the found one, or better.

All sets of effects that move or widen samples are compared with the summaries of the fitting frames
(`tofmix.reconciliation.search.alternatives`). From a set that is clearly better, another search starts. The best are
fitted to samples in the end (`tofmix.reconciliation.verification.considered`); those with nearly the same evidence then
are aliases.

Which sets of effects explain the summaries of a recording, and which of them cannot be separated.

The evidence of a set is its marginal likelihood. Its coefficients have declared priors and are integrated out. So are
the errors of any model: poses, tilts and noise scale within the tolerance, and a smooth discrepancy of each surface.
Everything is linear and Gaussian, so hundreds of sets take some ten milliseconds.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, product

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.parameters.fits import fit
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.search.columns import Column, Term, summed_up, terms
from tofmix.reconciliation.search.name import FAINT_SHARE, TriedEffect
from tofmix.reconciliation.search.search_state import Settings, fit_part, name_of
from tofmix.reconciliation.search.summaries import PixelSummary, summaries, surfaces_of
from tofmix.simulation.effects.base import with_hidden
from tofmix.simulation.effects.hidden import PixelBias
from tofmix.simulation.effects.search import Problem

_SMOOTH = 3  # functions along each side of a surface
DISCREPANCY = 0.25  # of the tolerance: prior of a tilt, and of a smooth error of a surface's ranges
_MOST = 12_000  # most sets that are compared, 0.1 ms each: those of three effects where two surfaces are seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explained:
    """A set of effects and its evidence.

    Parameters
    ----------
    terms : tuple of Term
        The set.
    evidence : float
        Logarithm of its marginal likelihood, over that without any effect, nats.
    coefficients : tuple of (coefficient,) float64
        Coefficients of each term, given the data.
    occam : float
        By how much the evidence is below the gain of the best coefficients: what their priors and errors cost, nats.
    """

    terms: tuple[Term, ...]
    evidence: float
    coefficients: tuple[FloatArray, ...]
    occam: float = 0.0

    @property
    def names(self) -> frozenset[tuple[str, str]]:
        """Kinds and surfaces."""
        return frozenset(t.name for t in self.terms)

    @property
    def numbers(self) -> int:
        """How many coefficients the set has."""
        return sum(len(t.columns) for t in self.terms)


class Subsets:
    """The evidence of sets of terms, from products that are computed once.

    Parameters
    ----------
    seen : sequence of Summary
        Of the recordings.
    terms : sequence of Term
        Effects that may be in a set.
    tolerance : float
        Accepted error of the model: of poses, in sigma; of sigma, a tenth of it.
    pixel_sigma_mm : float
        Standard deviation of a pixel's own bias, where the model has a pattern.
    """

    def __init__(
        self, seen: Sequence[PixelSummary], terms: Sequence[Term], tolerance: float, pixel_sigma_mm: float = 0.0
    ) -> None:
        self.terms = tuple(terms)
        own = [c for t in terms for c in t.columns]
        taken = [*own, *model_errors(seen, tolerance)]
        prior = np.array([c.prior for c in taken])
        gram, pull = _products(seen, taken, pixel_sigma_mm)
        gram, pull = gram * prior[:, None] * prior, pull * prior  # in units of the priors
        n = len(own)
        rest = np.eye(len(taken) - n) + gram[n:, n:]
        solved = np.linalg.solve(rest, np.column_stack([gram[n:, :n], pull[n:]])) if len(taken) > n else None
        if solved is not None:  # errors of any model are integrated out
            gram, pull = gram[:n, :n] - gram[:n, n:] @ solved[:, :n], pull[:n] - gram[:n, n:] @ solved[:, n]
        self._gram, self._pull, self._prior = gram, pull, prior[:n]
        starts = np.cumsum([0, *(len(t.columns) for t in terms)])
        self._of: list[IntArray] = [np.arange(a, b) for a, b in pairwise(starts)]

    def explained(self, numbers: Sequence[int]) -> Explained:
        """The set of the terms with these numbers.

        References
        ----------
        MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28: the evidence of a linear model.
        """
        chosen = tuple(self.terms[k] for k in numbers)
        at = np.concatenate([self._of[k] for k in numbers]) if len(numbers) else np.zeros(0, dtype=np.int64)
        root = np.linalg.cholesky(np.eye(at.size) + self._gram[np.ix_(at, at)])
        half = np.linalg.solve(root, self._pull[at])
        best = np.linalg.solve(root.T, half)  # in units of the priors
        volume = float(np.log(np.diag(root)).sum()) + sum(math.log(t.choices) + t.price_nats for t in chosen)
        found = best * self._prior[at]
        cuts = np.cumsum([self._of[k].size for k in numbers])[:-1]
        return Explained(
            terms=chosen,
            evidence=0.5 * float(half @ half) - volume,
            coefficients=tuple(np.split(found, cuts)) if chosen else (),
            occam=0.5 * float(best @ best) + volume,
        )

    def all_up_to(self, size: int) -> list[Explained]:
        """All sets of at most `size` effects, each kind and surface once; one a combination of names, best first."""
        best: dict[frozenset[tuple[str, str]], Explained] = {}
        for numbers in self._sets(size):
            one = self.explained(numbers)
            if one.names not in best or one.evidence > best[one.names].evidence:
                best[one.names] = one
        return sorted(best.values(), key=lambda e: -e.evidence)

    def _sets(self, size: int) -> Iterator[tuple[int, ...]]:
        of: dict[tuple[str, str], list[int]] = {}
        for k, term in enumerate(self.terms):
            of.setdefault(term.name, []).append(k)
        count = 0
        for most in range(size + 1):
            count += sum(math.prod(map(len, own)) for own in combinations(of.values(), most))
            if count > _MOST:
                return
            for own in combinations(of.values(), most):
                yield from product(*own)


def _products(
    seen: Sequence[PixelSummary], columns: Sequence[Column], pixel_sigma_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Products (n, n) of columns with each other, and (n,) with the data, weighted by the information of each cell."""
    n = len(columns)
    gram, pull = np.zeros((n, n)), np.zeros(n)
    for number, s in enumerate(seen):
        used = s.used
        space = np.stack([c.bias_mm[number][used] for c in columns], axis=1)
        width = np.stack([c.width[number][used] for c in columns], axis=1)
        profile = np.stack([c.profile[number] for c in columns], axis=1)
        moving = np.flatnonzero((space != 0).any(axis=0))
        widening = np.flatnonzero((width != 0).any(axis=0))
        across, told = np.zeros((used.sum(), moving.size)), np.zeros(used.sum())
        for information, bias, now in zip(s.bias_information[:, used], s.bias_mm[:, used], profile, strict=True):
            weighed = space[:, moving] * information[:, None] * now[moving]
            gram[np.ix_(moving, moving)] += (space[:, moving] * now[moving]).T @ weighed
            pull[moving] += weighed.T @ bias
            across += weighed
            told += information * bias
        own = pixel_sigma_mm**2 + s.own_variance[used]
        if own.any():  # a pixel's own bias, common to all tenths, is integrated out
            share = own / (1.0 + own * s.bias_information[:, used].sum(axis=0))
            gram[np.ix_(moving, moving)] -= across.T @ (across * share[:, None])
            pull[moving] -= across.T @ (share * told)
        weighed = width[:, widening] * s.width_information[used][:, None]
        gram[np.ix_(widening, widening)] += width[:, widening].T @ weighed
        pull[widening] += weighed.T @ s.width[used]
    return gram, pull


def model_errors(seen: Sequence[PixelSummary], tolerance: float) -> Iterator[Column]:
    """Errors of any model: position and tilt of each surface, scale of the noise, smooth errors of a surface."""
    if tolerance <= 0:
        return
    for number, s in enumerate(seen):
        rows, cols = s.view.evidence.image
        row, col = np.divmod(np.arange(rows * cols), cols)
        sigma = s.view.mixture.of_main(s.view.mixture.sigma)

        def alone(bias: FloatArray, prior: float, *, width: FloatArray | None = None, at: int = number) -> Column:
            nothing = [np.zeros(o.used.size) for o in seen]
            moved, wider = list(nothing), list(nothing)
            moved[at] = bias
            wider[at] = nothing[at] if width is None else width
            profile = tuple(np.ones(o.elapsed_s.size) for o in seen)
            return Column(bias_mm=tuple(moved), profile=profile, width=tuple(wider), prior=prior)

        error = math.hypot(0.1 * tolerance, s.common_log_width)
        yield alone(np.zeros(s.used.size), error, width=s.used.astype(np.float64))
        if s.common_variance > 0:
            yield alone(np.where(s.used, sigma, 0.0), math.sqrt(s.common_variance))
        for _, own in surfaces_of(s):
            error = tolerance * float(np.median(sigma[own]))
            u, v = across_surface(col, own), across_surface(row, own)
            yield alone(own.astype(np.float64), error)
            for smooth in (u, v, *hats(u, v)):
                yield alone(np.where(own, smooth, 0.0), DISCREPANCY * error)


def across_surface(place: IntArray, own: BoolArray) -> FloatArray:
    """Coordinates (pixel,) that run from -1 to 1 over a surface."""
    low, high = float(place[own].min()), float(place[own].max())
    return np.asarray(2 * (place - low) / max(high - low, 1.0) - 1)


def hats(u: FloatArray, v: FloatArray) -> Iterator[FloatArray]:
    """Products (pixel,) of linear splines over -1 to 1 in both directions."""
    knots = np.linspace(-1, 1, _SMOOTH)
    width = 2 / (_SMOOTH - 1)
    for a in knots:
        for b in knots:
            yield np.clip(1 - np.abs(u - a) / width, 0, None) * np.clip(1 - np.abs(v - b) / width, 0, None)


ALIAS_NATS = 4.0
"""Difference of evidence that does not separate two sets: odds of 55 to 1."""

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
    state : ModelState
        The model with the found effects.
    chosen : sequence of TriedEffect
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
    spreads = [hidden.spreads(e) for e, hidden in with_hidden(state.effects, PixelBias)]
    subsets = Subsets(seen, every, settings.tolerance, spreads[0].pixel_sigma_mm if spreads else 0.0)
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
    if any(with_hidden(state.effects, PixelBias)):
        state = state.unpatterned
    return replace(state, effects=kept)


def as_candidates(likelihood: Likelihood, state: ModelState, found: Explained, part: Part) -> list[TriedEffect]:
    """The effects of a set as candidates of the search, each fitted to the samples with the others present.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        The model without the set.
    found : Explained
        The set, with its numbers from the summaries.
    part : (frames, pixels)
        Data of the fits.

    Returns
    -------
    list of TriedEffect
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
    """The search of a term's kind for its surface; of several, the one of its form or as many numbers."""
    own = []
    for problem in problems(term.kind, likelihood, likelihood.mixture(state)):
        try:
            effect = problem.make(np.array(problem.starts[0]))
        except ValueError:  # the start is out of the effect's bounds, as in `candidates`
            continue
        if getattr(effect, "surface", "") == term.surface:
            own.append(problem)
    return min(own, key=lambda p: (p.form != term.form, abs(p.parameters - term.searched)), default=None)
