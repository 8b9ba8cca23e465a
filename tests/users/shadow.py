"""A score by held-out blocks, beside the search of `reconcile`: which sets of effects predict unseen pixels.

The summaries of a recording (`tofmix.reconciliation.search.summaries`) are cut into blocks of 8 x 8 pixels by a tenth
of the time, on a checkerboard. The score of a set is the logarithm of the predictive density of each block by itself,
given the blocks of the other colour at the other tenths, all coefficients and errors of the model integrated out. One
set beats another if it gains over 4 nats and over z standard errors of the paired difference, z the normal quantile of
0.01 over the number of sets that were looked at. Smooth laws that no effect is are members of sets.

Use it to find out whether such a score names what is hidden. It needs cases whose effects move or widen samples; what
acts otherwise must be in the model.

References
----------
Vehtari, Gelman and Gabry (2017), Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC,
for the paired difference and its standard error. https://doi.org/10.1007/s11222-016-9696-4
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.search.alternatives import Explained, Subsets, model_errors
from tofmix.reconciliation.search.columns import Column, Term
from tofmix.reconciliation.search.summaries import PixelSummary
from tofmix.simulation.effects import Effect

SIDE = 8
"""Pixels along a side of a block."""

LEAST_NATS, LEVEL = 4.0, 0.01
FINALISTS = 12
"""Sets that are scored by blocks, the best by their evidence."""

_WIDER = 0.2  # standard deviation of a smooth law of the logarithm of the noise's width
_KNOTS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scored:
    """A set of effects and laws with what it gains in each block, nats (block,), over no effect."""

    names: frozenset[tuple[str, str]]
    laws: tuple[str, ...]
    blocks: FloatArray

    @property
    def total(self) -> float:
        """Its score."""
        return float(self.blocks.sum())


class Shadow:
    """Scores sets on one recording.

    `summary`: of the recording, about the model as given.
    `terms`: effects that may be in a set.
    `tolerance`: of the model.
    `exact`: the hidden effects, each as one column that has its law as it is.
    """

    def __init__(
        self, summary: PixelSummary, terms: Sequence[Term], tolerance: float, exact: Sequence[Term] = ()
    ) -> None:
        self.subsets = Subsets([summary], terms, tolerance)
        self.laws = list(unnamed(summary))
        members = [*terms, *self.laws, *exact]
        columns = [c for term in members for c in term.columns]
        errors = list(model_errors([summary], tolerance))
        starts = np.cumsum([0, *(len(t.columns) for t in members)])
        self._of = {id(t): np.arange(a, b) for t, a, b in zip(members, starts[:-1], starts[1:], strict=True)}
        self._errors = np.arange(len(columns), len(columns) + len(errors))
        self._blocks = _blocks(summary, [*columns, *errors])

    def scored(self, terms: Sequence[Term]) -> Scored:
        """The score of some effects and laws."""
        at = np.concatenate([*(self._of[id(t)] for t in terms), self._errors]).astype(np.int64)
        nothing = self._errors
        gained = self._blocks.density(at) - self._blocks.density(nothing)
        return Scored(
            names=frozenset(t.name for t in terms if t not in self.laws),
            laws=tuple(t.kind for t in terms if t in self.laws),
            blocks=gained,
        )

    def finalists(self, also: Sequence[frozenset[tuple[str, str]]] = ()) -> tuple[list[Scored], int]:
        """The best sets by evidence, those of some names, and none, alone and with laws; and how many there were."""
        every = self.subsets.all_up_to(3)
        chosen: list[Explained] = every[:FINALISTS]
        chosen += [e for e in every if (not e.terms or e.names in also) and e not in chosen]
        out = [self.scored(e.terms) for e in chosen]
        out += [self.scored((*e.terms, law)) for e in (*chosen[:2], *chosen[FINALISTS:]) for law in self.laws]
        return out, len(every) * (1 + len(self.laws))


def beats(one: Scored, other: Scored, count: int) -> bool:
    """Whether one set beats another, of so many that were looked at."""
    gained = one.blocks - other.blocks
    error = math.sqrt(gained.size) * float(gained.std())
    return float(gained.sum()) > max(LEAST_NATS, float(norm.isf(LEVEL / count)) * error)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Products of columns in each block (block, n, n), pulls (block, n), and each block's fold: tenth by two, colour.

    All in units of the priors. Blocks of widths are of no tenth, -1.
    """

    gram: FloatArray
    pull: FloatArray
    half: IntArray
    colour: IntArray

    def density(self, at: IntArray) -> FloatArray:
        """Logarithm of each block's predictive density (block,) by some columns, but for what all sets share."""
        out = np.zeros(len(self.half))
        gram, pull = self.gram[:, at][:, :, at], self.pull[:, at]
        for half in (0, 1):
            for colour in (0, 1):
                fit = (self.colour != colour) & ((self.half == 1 - half) | (self.half < 0))
                test = (self.colour == colour) & ((self.half == half) | ((self.half < 0) & (half == 0)))
                known, pulled = np.eye(at.size) + gram[fit].sum(axis=0), pull[fit].sum(axis=0)
                out[test] = _evidence(known + gram[test], pulled + pull[test]) - _evidence(known[None], pulled[None])
        return out


def _evidence(precision: FloatArray, pull: FloatArray) -> FloatArray:
    """Half of h' P^-1 h less half of log |P|, for each (.., n, n) and (.., n)."""
    root = np.linalg.cholesky(precision)
    half = np.linalg.solve(root, pull[..., None])[..., 0]
    diagonal = np.diagonal(root, axis1=-2, axis2=-1)
    return np.asarray(0.5 * (half**2).sum(axis=-1) - np.log(diagonal).sum(axis=-1))


def _blocks(s: PixelSummary, columns: Sequence[Column]) -> _Blocks:
    rows, cols = s.view.evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    tile = row // SIDE * (cols // SIDE + 1) + col // SIDE
    prior = np.array([c.prior for c in columns])
    space = np.stack([c.bias_mm[0] for c in columns], axis=1) * prior
    width = np.stack([c.width[0] for c in columns], axis=1) * prior
    profile = np.stack([c.profile[0] for c in columns], axis=1)
    found: list[tuple[FloatArray, FloatArray, int, int]] = []
    for number in np.unique(tile[s.used]):
        own = s.used & (tile == number)
        colour = int((row[own][0] // SIDE + col[own][0] // SIDE) % 2)
        for tenth, (information, bias) in enumerate(zip(s.bias_information, s.bias_mm, strict=True)):
            law = space[own] * profile[tenth]
            weighed = law * information[own, None]
            found.append((law.T @ weighed, weighed.T @ bias[own], tenth % 2, colour))
        weighed = width[own] * s.width_information[own, None]
        found.append((width[own].T @ weighed, weighed.T @ s.width[own], -1, colour))
    gram, pull, half, colour_ = zip(*found, strict=True)
    return _Blocks(np.stack(gram), np.stack(pull), np.array(half), np.array(colour_))


def unnamed(s: PixelSummary) -> Iterator[Term]:
    """Smooth laws that no effect is: of range, of place, of time, and of the noise over the image."""
    m = s.view.mixture
    rows, cols = s.view.evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    u, v = 2 * col / max(cols - 1, 1) - 1, 2 * row / max(rows - 1, 1) - 1
    sigma = float(np.median(m.of_main(m.sigma)[s.used]))
    range_mm = m.of_main(m.true_range)
    low, high = range_mm[s.used].min(), range_mm[s.used].max()
    r = 2 * (range_mm - low) / max(high - low, 1.0) - 1
    still = np.ones(s.elapsed_s.size)
    yield _law("a law of range", s.used, [(power, still) for power in (np.ones_like(r), r, r**2)], sigma)
    yield _law(
        "a law of place", s.used, [(power, still) for power in (np.ones_like(u), u, v, u**2, u * v, v**2)], sigma
    )
    yield _law("a law of time", s.used, [(np.ones_like(u), tenth) for tenth in np.eye(s.elapsed_s.size)], sigma)
    knots = np.linspace(-1, 1, _KNOTS)
    hats = [np.clip(1 - np.abs(u - a), 0, None) * np.clip(1 - np.abs(v - b), 0, None) for a in knots for b in knots]
    yield _law("a law of noise over the image", s.used, [(h, still) for h in hats], _WIDER, wide=True)


def _law(
    name: str, used: BoolArray, columns: Sequence[tuple[FloatArray, FloatArray]], prior: float, *, wide: bool = False
) -> Term:
    def column(law: FloatArray, profile: FloatArray) -> Column:
        here, nothing = np.where(used, law, 0.0), np.zeros(used.size)
        moved, wider = (nothing, here) if wide else (here, nothing)
        return Column(bias_mm=(moved,), profile=(profile,), width=(wider,), prior=prior)

    def none(_: FloatArray) -> Effect:
        raise ValueError(f"{name} is no effect")

    return Term(kind=name, surface="", columns=tuple(column(*c) for c in columns), make=none)
