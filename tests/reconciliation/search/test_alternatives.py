"""Which other set of effects a search begins with, and how many numbers each of its effects has."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.recordings import recorded

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.search import alternatives
from tofmix.reconciliation.search.alternatives import Alternatives, Explained, as_candidates, best_of_names
from tofmix.reconciliation.search.columns import Column, Term
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.search import Problem
from tofmix.simulation.model import Model


def a_set(evidence: float, *kinds: str) -> Explained:
    """A set of kinds with one number each."""
    nothing = (np.zeros(1),)
    column = Column(bias_mm=nothing, profile=nothing, width=nothing, prior=1.0)
    terms = tuple(Term(kind=k, surface="", columns=(column,), make=lambda _: RangeOffset(offset_mm=1.0)) for k in kinds)
    return Explained(terms=terms, evidence=evidence, coefficients=())


FOUND = a_set(2525.4, "multipath", "vignetting")
SMALL, LARGE = a_set(2529.1, "vignetting"), a_set(2540.0, "range_offset", "vignetting", "wiggling")
BEST = a_set(2530.8, "range_offset", "vignetting")


def test_better_is_the_smallest_set_and_best_has_most_evidence() -> None:
    sets = Alternatives(found=FOUND, sets=(LARGE, BEST, SMALL))
    assert sets.better(larger=False) is SMALL
    assert sets.best(larger=False) is BEST
    assert sets.best(larger=True) is LARGE


def test_best_is_none_if_no_set_is_clearly_better() -> None:
    assert Alternatives(found=BEST, sets=(FOUND, SMALL)).best(larger=True) is None
    assert Alternatives(found=BEST, sets=()).best(larger=True) is None


def a_term(name: str, numbers: int) -> Term:
    """A pose of a surface with so many numbers."""
    nothing = (np.zeros(1),)
    column = Column(bias_mm=nothing, profile=nothing, width=nothing, prior=1.0)
    return Term(
        kind="surface_pose", surface=name, columns=(column,) * numbers, make=lambda _: RangeOffset(offset_mm=1.0)
    )


class Tabled:
    """Evidence of sets of terms from a table of their numbers; a set that the table lacks has none."""

    def __init__(self, every: Sequence[Term], table: dict[tuple[int, ...], float]) -> None:
        self.every, self.table = every, table

    def explained(self, numbers: Sequence[int]) -> Explained:
        terms = tuple(self.every[k] for k in numbers)
        return Explained(terms=terms, evidence=self.table.get(tuple(sorted(numbers)), 0.0), coefficients=())


def test_number_of_a_pose_is_chosen_given_those_of_poses_that_come_after_it() -> None:
    every = [a_term("floor", 1), a_term("floor", 3), a_term("wall", 1), a_term("wall", 3)]
    # The floor alone needs its tilts, but not beside the tilts of the wall
    table = {(0,): 5.0, (1,): 9.0, (0, 2): 20.0, (1, 2): 30.0, (0, 3): 42.0, (1, 3): 29.0}
    subsets: Any = Tabled(every, table)
    found = best_of_names(subsets, every, {t.name for t in every})
    assert [len(t.columns) for t in found.terms] == [1, 3]


def test_search_whose_start_is_out_of_bounds_is_left_out(small: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a short recording, the second term of a drift may begin beyond its bounds."""

    def make(x: FloatArray) -> RangeOffset:
        return RangeOffset(offset_mm=float(x[0]))

    beyond, right = (Problem(make=make, starts=((start,),), steps=(1.0,)) for start in (math.inf, 3.0))
    monkeypatch.setattr(alternatives, "problems", lambda *_: (beyond, right))
    likelihood = joint_likelihood([(small, recorded(small, RangeOffset(offset_mm=9.0)))])
    found = a_set(10.0, "range_offset")
    found = replace(found, coefficients=(np.array([9.0]),))
    (only,) = as_candidates(likelihood, likelihood.start(), found, likelihood.evidence.part(fit=True))
    assert only.effect.numbers()["offset_mm"] == pytest.approx(9.0, abs=1.0)
