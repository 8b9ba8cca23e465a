"""The sets beside the answer: their order, their evidence, why they are not the answer, and which are its aliases."""

from dataclasses import replace

import pytest
from support.recordings import MAKE, reconciled, recorded

from tofmix.reconciliation.found import ALIAS_NATS, WeighedSet
from tofmix.reconciliation.verification.considered import aliases
from tofmix.reconciliation.workflow import Reconciliation
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

STATIC = ("range_offset", "surface_pose", "wiggling", "amplitude_walk", "excess_noise")


def board(model: Model) -> Model:
    """The camera before one board that faces it and fills the image."""
    return replace(model, surfaces=(Surface(name="board", center_mm=(0, 0, 1500.0), size_mm=(9000.0, 9000.0)),))


def found(model: Model, *hidden: Effect, kinds: tuple[str, ...] = STATIC) -> Reconciliation:
    result = reconciled(model, *hidden, kinds=kinds)
    assert result.verified.verdict == "explained"
    return result


def test_named_set_is_first_and_the_others_say_why_they_lost(small: Model) -> None:
    result = found(small, MAKE["range_offset"](offset_mm=30.0))
    first, *others = result.considered
    assert first.names == (("range_offset", ""),)
    assert first.why_not is None
    assert first.evidence_nats > 100
    assert others
    assert all(not set(w.names) >= set(first.names) for w in others)
    assert [w.evidence_nats for w in others] == sorted((w.evidence_nats for w in others), reverse=True)
    less = [round(first.evidence_nats - w.evidence_nats) for w in others]
    assert [w.why_not for w in others] == [f"{nats:,} nats less likely" for nats in less]
    assert result.aliases == ()  # the best of the others is far behind


def test_evidence_is_less_than_the_gain_of_all_samples_since_poses_may_be_wrong_too(small: Model) -> None:
    """The model as given may have errors of its poses, which take a part of an offset."""
    result = found(small, MAKE["range_offset"](offset_mm=30.0))
    evidence = recorded(small, MAKE["range_offset"](offset_mm=30.0))
    gain = result.named[0].heldout_gain_nats / 0.25  # a half of the frames, a half of the pixels
    assert evidence.part(fit=False)[0].size * 2 == pytest.approx(evidence.shape[0], rel=0.1)
    assert 100 < result.considered[0].evidence_nats < gain


def test_offset_of_one_board_has_its_pose_as_alias_with_the_surface(small: Model) -> None:
    result = found(board(small), MAKE["range_offset"](offset_mm=3.0), kinds=("range_offset", "surface_pose"))
    (alias,) = result.as_dict()["aliases"]
    assert sorted(alias["kinds"]) == ["range_offset", "surface_pose"]
    assert {"kind": "surface_pose", "surface": "board"} in [e for of in alias["effects"] for e in of]
    assert abs(alias["gains"][0] - alias["gains"][1]) <= ALIAS_NATS
    listed = [c["why_not"] for c in result.as_dict()["considered"]]
    assert listed[0] is None
    assert listed[1].startswith("cannot be told apart: ")


def weighed(nats: float, *kinds: str, why_not: str | None = None) -> WeighedSet:
    return WeighedSet(names=tuple((kind, "") for kind in kinds), evidence_nats=nats, why_not=why_not)


def test_effects_that_a_set_shares_with_the_answer_are_left_out_of_the_alias() -> None:
    first = weighed(100.0, "a", "b")
    other = replace(weighed(98.0, "b", "c", why_not="cannot be told apart: 2.0 nats less likely"), is_alias=True)
    (alias,) = aliases((first, other, weighed(99.0, "d", why_not="a number is at its bound")), named=True)
    assert alias.sets == ((("a", ""),), (("c", ""),))
    assert alias.gains == (100.0, 98.0)
