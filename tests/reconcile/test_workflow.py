"""Effects that the simulator hides are named; a right model is left alone; what no effect is, gets no name."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconcile.add import Settings
from tofmix.reconcile.evidence import Evidence
from tofmix.reconcile.localise import localise
from tofmix.reconcile.name import KINDS
from tofmix.reconcile.profiles import numeric
from tofmix.reconcile.workflow import Reconciliation, reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

HIDDEN: tuple[tuple[str, dict[str, Any]], ...] = (
    ("range_offset", {"offset_mm": 15.0}),
    ("wiggling", {"amplitude_mm": 15.0, "phase_rad": 0.7}),
    ("temporal_correlation", {"coefficient": 0.3}),
    ("interference", {"probability": 0.25, "sigma_mm": 30.0, "burst_frames": 5.0}),
    ("dropout", {"probability": 0.05}),
    ("surface_pose", {"surface": "middle", "shift_mm": 20.0}),
    ("quantisation", {"step_mm": 9.0}),
    ("excess_noise", {"factor": 1.4}),
)


@pytest.mark.parametrize(("kind", "parameters"), HIDDEN, ids=[kind for kind, _ in HIDDEN])
def test_a_hidden_effect_is_named(model: Model, record: Record, kind: str, parameters: dict[str, Any]) -> None:
    result = reconcile(model, record(MAKE[kind](**parameters)), Settings(kinds=_few(kind)))
    assert result.verified.verdict == "explained"
    assert [n.effect.kind for n in result.named] == [kind]
    found, errors = numeric(result.named[0].effect), result.named[0].stderr
    for name, value in parameters.items():
        if isinstance(value, float) and name != "burst_frames":
            assert abs(found[name] - value) < max(0.05 * abs(value), 4 * errors[name])
    assert result.verified.closed is not None
    assert result.verified.closed > 0.85


def _few(kind: str) -> tuple[str, ...]:
    """The kind and quick rivals."""
    rivals = {kind, "range_offset", "surface_pose", "excess_noise", "outliers", "temporal_correlation", "fixed_pattern"}
    return tuple(k for k in KINDS if k in rivals)


def test_a_right_model_is_left_alone(model: Model, record: Record) -> None:
    result = reconcile(model, record(), Settings(kinds=KINDS))
    assert result.verified.verdict == "agree"
    assert result.named == ()
    assert result.as_dict()["gap"]["before"] == pytest.approx(1.0, abs=0.25)


def test_a_model_within_its_tolerance_is_left_alone(model: Model, record: Record) -> None:
    nearly = tuple(replace(s, reflectivity=s.reflectivity * 1.04) for s in model.surfaces)
    off = tuple(MAKE["surface_pose"](surface=s.name, shift_mm=d) for s, d in zip(nearly, (0.4, -0.7, 1.5), strict=True))
    result = reconcile(replace(model, surfaces=nearly), record(*off), Settings(kinds=KINDS))
    assert result.verified.verdict == "agree"


def test_what_no_effect_is_gets_no_name_but_a_place(model: Model, record: Record) -> None:
    evidence = record()
    jitter = np.random.default_rng(8).normal(size=len(evidence.samples)) * 6.0
    shaken = np.rint(evidence.samples + jitter[:, None]).astype(np.uint16)
    result = reconcile(model, replace(evidence, samples=shaken), Settings(kinds=_few("temperature_drift")))
    assert result.verified.verdict == "unexplained"
    assert result.named == ()
    assert result.where[0].axis == "frame"


def test_a_shift_is_told_in_mm_where_many_pixels_see_nothing(
    in_the_open: Callable[[Effect], tuple[Model, Evidence]],
) -> None:
    """Empty pixels are in the bins of rows and columns too; their sigma is none that a shift is seen by."""
    result = reconcile(*in_the_open(MAKE["range_offset"](offset_mm=6.0)), Settings(kinds=("range_offset",)))
    shifts = [p for p in localise(result.verified.before, 0.01) if p.statistic == "bias" and p.unit == "mm"]
    assert {"row", "col"} & {p.axis for p in shifts}
    assert all(p.size == pytest.approx(6.0, rel=0.15) for p in shifts)


def test_the_same_seed_gives_the_same_outcome(model: Model, record: Record) -> None:
    evidence = record(MAKE["outliers"](probability=0.02))

    def run() -> dict[str, Any]:
        result: Reconciliation = reconcile(model, evidence, Settings(kinds=("outliers", "excess_noise")))
        return result.as_dict()

    assert run() == run()
