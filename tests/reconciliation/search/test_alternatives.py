"""Which other set of effects a search begins with."""

import numpy as np

from tofmix.reconciliation.search.alternatives import Alternatives
from tofmix.reconciliation.search.columns import Column, Term
from tofmix.reconciliation.search.subsets import Explained
from tofmix.simulation.effects.range_offset import RangeOffset


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
