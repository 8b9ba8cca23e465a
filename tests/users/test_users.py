"""The bench of users' scenes: what it draws, what its oracle knows, how it scores; and three cases of it."""

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import MAKE

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.exposure import predict
from users.cases import COLS, MAGNITUDES, ROWS, SCENES, Case, draw, recorded
from users.greedy import greedy_bic
from users.oracle import Known, known
from users.score import alternatives, score

SEED = 3


def case(scene: str, *hidden: Effect, rows: int = ROWS, cols: int = COLS) -> Case:
    """A case of a scene with these effects."""
    any_one = next(c for c in (draw(SEED, n) for n in range(200)) if c.scene == scene)
    given = replace(any_one.given, effects=(), sensor=replace(any_one.given.sensor, rows=rows, cols=cols))
    return replace(any_one, sort="effects", given=given, true=replace(given, effects=hidden), hidden=hidden)


def test_cases_do_not_depend_on_their_order_and_have_the_stated_shares() -> None:
    cases = [draw(SEED, n) for n in range(120)]
    assert draw(SEED, 77).name == cases[77].name
    sorts = [c.sort for c in cases]
    assert sorts.count("stranger") == 10
    assert sorts.count("none") + sorts.count("nearly") == 10
    assert sorts.count("pose") == 10
    counts = [len(c.hidden) for c in cases if c.sort == "effects"]
    assert (counts.count(1), counts.count(2), counts.count(3)) == (20, 60, 10)
    assert {c.scene for c in cases} == set(SCENES)
    assert {e.kind for c in cases for e in c.hidden} == set(MAGNITUDES)
    assert not any(e.kind == "multipath" and len(c.given.surfaces) == 1 for c in cases for e in c.hidden)


@pytest.mark.slow
def test_offset_and_pose_of_one_wall_are_aliases_and_of_a_wall_and_a_box_are_not() -> None:
    offset = MAKE["range_offset"](offset_mm=9.0)
    wall, both = known(case("wall", offset)), known(case("wall and box", offset))
    assert wall.traces == both.traces == ("range_offset",)
    assert ("surface_pose",) in wall.aliases
    assert ("surface_pose",) not in both.aliases
    # Over a small part of a turn, the crest of a sine of one period is an offset.
    assert set(both.aliases) <= {("tap_mismatch",), ("amplitude_walk",)}


@pytest.mark.slow
def test_noise_that_is_always_added_is_known_where_sigma_differs_and_is_a_factor_on_one_wall() -> None:
    always = MAKE["interference"](probability=1.0, sigma_mm=20.0)
    steps, wall = known(case("steps", always)), known(case("wall", always))
    assert steps.traces == wall.traces == ("interference",)
    assert ("excess_noise",) not in steps.aliases
    assert ("excess_noise",) in wall.aliases
    bursts = MAKE["interference"](probability=0.2, sigma_mm=80.0)
    assert known(case("wall", bursts)).identifiable


@pytest.mark.slow
def test_member_without_a_trace_is_not_part_of_the_truth() -> None:
    faint = MAKE["range_offset"](offset_mm=9.0), MAKE["pixel_crosstalk"](share=0.03)
    assert known(case("wall", *faint)).traces == ("range_offset",)  # no neighbours that see anything else
    assert known(case("steps", *faint)).traces == ("pixel_crosstalk", "range_offset")


def gap(verdict: str, *kinds: str, aliases: tuple[tuple[str, ...], ...] = ()) -> dict[str, Any]:
    effects = [{"kind": kind, "parameters": {}, "stderr": {}} for kind in kinds]
    return {"verdict": verdict, "effects": effects, "aliases": [{"kinds": list(a)} for a in aliases]}


def test_the_truth_is_right_a_false_name_wrong_and_silence_open() -> None:
    one = case("wall and box", MAKE["range_offset"](offset_mm=9.0))
    sure = Known(traces=("range_offset",), identifiable=True, aliases=())
    assert score(one, gap("explained", "range_offset"), sure).result == "right"
    assert score(one, gap("explained", "wiggling"), sure).result == "wrong"
    assert score(one, gap("partly_explained", "range_offset", "wiggling"), sure).result == "wrong"
    assert score(one, gap("unexplained"), sure).result == "open"


def test_an_alias_is_right_only_with_the_truth_among_at_most_four_alternatives() -> None:
    one = case("wall", MAKE["range_offset"](offset_mm=9.0))
    unsure = Known(traces=("range_offset",), identifiable=False, aliases=(("surface_pose",),))
    alone, listed = (
        gap("explained", "surface_pose"),
        gap("explained", "surface_pose", aliases=(("surface_pose", "range_offset", "wiggling"),)),
    )
    assert score(one, alone, unsure).result == "open"
    assert score(one, listed, unsure).result == "right"
    assert alternatives(listed) == [{"surface_pose"}, {"range_offset"}, {"wiggling"}]
    many = gap("explained", "surface_pose", aliases=(("surface_pose", "range_offset", "a", "b", "c"),))
    assert score(one, many, unsure).result == "open"


def test_agree_is_right_without_effects_and_no_name_is_right_for_a_stranger() -> None:
    cases = [draw(SEED, n) for n in range(40)]
    plain = next(c for c in cases if c.sort in ("none", "nearly"))
    strange = next(c for c in cases if c.sort == "stranger")
    assert score(plain, gap("agree"), None).result == "right"
    assert score(strange, gap("unexplained"), None).result == "right"
    assert score(strange, gap("partly_explained", "wiggling"), None).result == "wrong"


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    "hidden",
    [
        (MAKE["scattering"](share=0.02), MAKE["range_offset"](offset_mm=6.0)),
        (MAKE["temporal_correlation"](coefficient=0.4), MAKE["outliers"](probability=0.02)),
    ],
    ids=lambda hidden: "+".join(e.kind for e in hidden),
)
def test_reconcile_is_right_on_a_wall_and_a_box(hidden: tuple[Effect, ...]) -> None:
    one = case("wall and box", *hidden, rows=32, cols=40)
    evidence = make_evidence(one.given, recorded(one), time_s=np.arange(120) / 25.0)
    found = reconcile(one.given, evidence, Settings(kinds=KINDS)).as_dict()
    assert score(one, found, known(one)).result == "right", found["effects"]


@pytest.mark.slow
@pytest.mark.long
def test_noise_and_offset_of_one_wall_are_never_a_second_path_alone() -> None:
    one = case("wall", MAKE["excess_noise"](factor=1.3), MAKE["range_offset"](offset_mm=12.0), rows=32, cols=40)
    found = reconcile(one.given, make_evidence(one.given, recorded(one)), Settings(kinds=KINDS)).as_dict()
    assert [e["kind"] for e in found["effects"]] != ["multipath"]
    assert score(one, found, known(one)).result == "right", found["effects"]


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("number", [58, 182])
def test_cases_with_a_false_name_at_32ff9fc_have_none(number: int) -> None:
    """By a place that no pixel sees, and by numbers of sets that were counted in two ways."""
    one = draw(20261124, number)
    evidence = make_evidence(one.given, recorded(one), time_s=np.arange(120) / 25.0)
    found = reconcile(one.given, evidence, Settings(kinds=KINDS)).as_dict()
    assert score(one, found, known(one) if one.hidden else None).result != "wrong", found["effects"]


@pytest.mark.parametrize("scene", ["corner", "slanted"])
def test_a_nearly_right_model_moves_ranges_by_a_tenth_of_sigma_where_they_are_seen(scene: str) -> None:
    one = next(c for c in (draw(20261124, n) for n in range(10, 600, 12)) if (c.scene, c.sort) == (scene, "nearly"))
    before, after = predict(one.given), predict(replace(one.true, effects=()))
    main = before.weight.argmax(axis=0)[None]
    seen = [np.take_along_axis(of, main, axis=0)[0] for of in (before.range_mm, after.range_mm, before.sigma_mm)]
    assert np.median(np.abs(seen[1] - seen[0]) / seen[2]) == pytest.approx(0.1, abs=0.01)


@pytest.mark.slow
def test_greedy_bic_names_a_clear_offset_with_its_error_and_nothing_where_nothing_is_hidden() -> None:
    settings = Settings(kinds=("range_offset", "excess_noise", "outliers"))
    for hidden in ((), (MAKE["range_offset"](offset_mm=9.0),)):
        one = case("wall and box", *hidden, rows=32, cols=40)
        evidence = make_evidence(one.given, recorded(one), time_s=np.arange(120) / 25.0)
        found = greedy_bic(one.given, evidence, settings)
        assert [e["kind"] for e in found["effects"]] == [e.kind for e in hidden]
        assert score(one, found, known(one) if hidden else None).result == "right"


def test_bench_prints_the_peer_for_cases_that_both_have_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    summary = importlib.import_module("user_scenes").summary
    line = {"scene": "wall", "sort": "effects", "kinds": ["outliers"], "identifiable": True, "told_apart": []}
    done = [
        line | {"number": k, "name": str(k), "result": result, "verdict": "", "why": "", "seconds": 2.0}
        for k, result in enumerate(("right", "open", "right"))
    ]
    peer = [{"number": k, "result": result, "seconds": 4.0} for k, result in enumerate(("wrong", "right"))]
    assert "BIC" not in "\n".join(summary(done))
    assert "| all | 2 | 1 | 0 | 1 | 2.0 | 1 | 1 | 0 | 4.0 |" in list(summary(done, peer))
