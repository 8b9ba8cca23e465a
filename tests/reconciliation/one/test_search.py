"""The search: its closing step, its aliases, and what it finds."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.recordings import MAKE, recorded
from support.search_tasks import MakeTask

from tofmix.reconciliation.found import Ledger
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.proposals import Columns
from tofmix.reconciliation.one.search import FoundSets, Proposers, closed, search
from tofmix.reconciliation.settings import Settings
from tofmix.simulation.model import Model

KINDS = ("range_offset", "amplitude_walk", "wiggling", "excess_noise", "temperature_drift", "fixed_pattern")


@pytest.mark.parametrize(
    ("lead", "kinds", "is_implausible", "stands"),
    [
        (10.0, ("b",), True, True),
        (3.0, ("b",), True, False),  # as likely
        (10.0, ("b", "c", "d"), True, False),  # of more members
        (10.0, ("b",), False, False),  # ends as another effect
    ],
)
def test_a_set_that_no_camera_has_stands_if_it_is_clearly_more_likely_than_all_that_one_may_have(
    lead: float, kinds: tuple[str, ...], is_implausible: bool, stands: bool
) -> None:
    nothing, named, beyond = _set(0.0), _set(116.0, "a", "e", score=100.0), _set(110.0, *kinds, score=-math.inf)
    beyond.refused, beyond.is_implausible, beyond.score_anyhow = "would need b 5", is_implausible, 101.0 + lead
    task: Any = None
    found = FoundSets(task, lambda _: None, Ledger(), {s.keys: s for s in (nothing, named, beyond)})
    assert (found.answer is beyond) is stands
    assert found.best_named is named


def test_parts_of_a_set_have_nine_tenths_of_its_evidence_and_the_best_is_the_first() -> None:
    """If the best part does not stand the tests, the next one may."""
    sets = [_set(0.0), _set(950.0, "a"), _set(500.0, "b"), _set(970.0, "a", "b"), _set(990.0, "a", "c", named=False)]
    whole = _set(1000.0, "a", "b", "c")
    task: Any = None
    found = FoundSets(task, lambda _: None, Ledger(), {s.keys: s for s in (*sets, whole)})
    assert [sorted(s.names) for s in found.most_of(whole, frozenset({("c", "")}))] == [
        [("a", ""), ("b", "")],
        [("a", "")],
    ]
    assert [sorted(s.names) for s in found.most_of(whole, frozenset({("b", "")}))] == [[("a", "")]]
    assert not found.most_of(whole, frozenset({("a", "")}))


def test_closing_step_finds_the_neighbour_that_is_better(make_task: MakeTask) -> None:
    task = make_task(KINDS, MAKE["range_offset"](offset_mm=6.0), MAKE["excess_noise"](factor=1.5))
    null = FittedSet.without_effects(task).fit()
    known = Proposers(Columns.of(task))
    wrong = next(p for p in known.about(null).sets(1) if p.names == {("temperature_drift", "")})
    found = FoundSets(task, lambda _: None, Ledger(), {frozenset(): null, wrong.keys: wrong.build().fit()})
    closed(found, known)
    assert {kind for kind, _ in found.best.names} == {"range_offset", "excess_noise"}


def _set(evidence: float, *kinds: str, score: float | None = None, named: bool = True) -> Any:  # noqa: ANN401
    names = frozenset((kind, "") for kind in kinds)
    own = evidence - 8 * len(kinds) if score is None else score
    x = np.zeros(0)
    return SimpleNamespace(names=names, keys=names, evidence=evidence, score=own, named=named, laws=(), x=x, refused="")


def test_aliases_are_within_four_nats_and_neither_part_nor_extension() -> None:
    best = _set(100.0, "a", "b")
    table = [
        best,
        _set(97.0, "c"),
        _set(98.0, "a", "d"),
        _set(95.9, "e"),  # too unlikely
        _set(99.0, "a"),  # a part
        _set(103.0, "a", "b", "f"),  # an extension
        _set(99.5, "c", "g"),  # an extension of an alias
        _set(99.0, "h", score=-math.inf),  # cannot be
        _set(99.9, "unnamed", named=False),
    ]
    task: Any = None
    found = FoundSets(task, lambda _: None, Ledger(), {s.names: s for s in table})
    assert [sorted(k for k, _ in s.names) for s in found.aliases(best)] == [["a", "d"], ["c"]]


@pytest.mark.parametrize(("lead", "axis"), [(3.0, None), (5.0, "range")])
def test_a_smooth_law_stands_if_it_is_four_nats_better(lead: float, axis: str | None) -> None:
    law = _set(0.0, "unnamed", score=100.0 + lead, named=False)
    named = _set(0.0, "a", score=100.0)
    law.laws = (SimpleNamespace(named=False, surface="range"),)
    task: Any = None
    found = FoundSets(task, lambda _: None, Ledger(), {s.keys: s for s in (named, law)})
    assert found.law == axis
    assert found.best_named.score == 100.0


@pytest.mark.parametrize(
    "hidden",
    [
        (),
        (MAKE["range_offset"](offset_mm=8.0), MAKE["excess_noise"](factor=1.4)),
        (MAKE["temperature_drift"](amplitude_mm=15.0, time_constant_s=1.0), MAKE["outliers"](probability=0.02)),
        (MAKE["fixed_pattern"](pixel_sigma_mm=8.0, column_sigma_mm=5.0, row_sigma_mm=5.0),),
        (MAKE["quantisation"](step_mm=30.0), MAKE["range_offset"](offset_mm=8.0)),
    ],
    ids=lambda hidden: "+".join(e.kind for e in hidden) or "nothing",
)
def test_hidden_effects_are_found(small: Model, hidden: Any) -> None:  # noqa: ANN401
    kinds = (*KINDS, "outliers", "quantisation", "temporal_correlation", "interference", "dropout")
    found = search(joint_likelihood([(small, recorded(small, *hidden))]), Settings(kinds=kinds))
    assert {kind for kind, _ in found.best.names} == {e.kind for e in hidden}


def test_work_of_each_step_adds_up_and_each_fit_is_weighed(make_task: MakeTask) -> None:
    task = make_task(("range_offset", "excess_noise"), MAKE["range_offset"](offset_mm=6.0))
    shares: list[float] = []
    ledger = Ledger()
    found = search(task.likelihood, task.settings, shares.append, ledger)
    named = [s for s in found.table.values() if s.named and s.keys and math.isfinite(s.evidence)]
    assert {w.names for w in ledger.sets} == {tuple(s.names) for s in named}
    assert sum(shares) == pytest.approx(round(sum(shares)))
    assert ledger.best()[0].names == (("range_offset", ""),)


def test_search_that_is_stopped_ends_with_the_sets_of_before(make_task: MakeTask) -> None:
    task = make_task(("range_offset", "excess_noise"), MAKE["range_offset"](offset_mm=6.0))
    ledger = Ledger(is_stopped=lambda: bool(ledger.sets))
    found = search(task.likelihood, task.settings, ledger=ledger)
    assert len(ledger.sets) == 1
    assert not ledger.is_complete
    assert len(found.table) == 2  # that without effects too


def test_memory_under_wide_steps_has_its_true_coefficient(small: Model) -> None:
    hidden = MAKE["quantisation"](step_mm=56.0), MAKE["temporal_correlation"](coefficient=0.3)
    kinds = ("quantisation", "temporal_correlation", "fixed_pattern", "range_offset", "excess_noise")
    best = search(joint_likelihood([(small, recorded(small, *hidden))]), Settings(kinds=kinds)).best
    assert {kind for kind, _ in best.names} == {e.kind for e in hidden}
    memory = next(e for e in best.linked if e.kind == "temporal_correlation")
    assert memory.numbers()["coefficient"] == pytest.approx(0.3, abs=0.05)


@pytest.mark.slow
def test_noise_within_the_tolerance_is_not_named_and_more_is(small: Model) -> None:
    near = small.surfaces[1].name
    kinds = ("wiggling", "excess_noise", "range_offset")
    wiggling = MAKE["wiggling"](amplitude_mm=15.0)
    for factor, of_noise in ((1.012, set()), (1.5, {near})):
        hidden = wiggling, MAKE["excess_noise"](factor=factor, surface=near)
        found = search(joint_likelihood([(small, recorded(small, *hidden))]), Settings(kinds=kinds)).best
        assert {s for kind, s in found.names if kind == "excess_noise"} == of_noise


def test_of_even_sets_the_one_of_fewer_numbers_is_named() -> None:
    def of(score: float, numbers: int) -> Any:  # noqa: ANN401  what `best_named` looks at
        return SimpleNamespace(score=score, named=True, x=np.zeros(numbers))

    walk, offset, other = of(-10.0, 2), of(-10.05, 1), of(-10.3, 0)
    table = {frozenset({(str(k), "", 0)}): s for k, s in enumerate((walk, offset, other))}
    task: Any = None
    found = FoundSets(task, lambda _: None, Ledger(), table)
    assert found.best_named is offset
