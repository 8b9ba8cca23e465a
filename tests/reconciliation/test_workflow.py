"""Effects that the simulator hides are named; a right model is left alone; what no effect is, gets no name."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.localise import localise
from tofmix.reconciliation.name import KINDS
from tofmix.reconciliation.profiles import numeric
from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.prediction import predict

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
    assert ("between samples 1" in headline(result)) == (kind == "temporal_correlation")
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


def test_a_drift_is_found_before_a_pause(model: Model, record: Record) -> None:
    """A minute and a half after 6 s, in which it came to its end."""
    evidence = record(MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=1.0))
    paused = replace(evidence, time_s=evidence.time_s + np.where(evidence.time_s > 6.0, 98.0, 0.0))
    result = reconcile(model, paused, Settings(kinds=("temperature_drift", "range_offset", "motion")))
    (drift,) = result.named
    assert drift.effect.kind == "temperature_drift"
    assert abs(drift.parameters["time_constant_s"] - 1.0) < 4 * drift.stderr["time_constant_s"]


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
    assert "None of the known effects explains it" in headline(result)


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


def test_a_pattern_and_what_it_could_stand_for_are_told_apart(model: Model, record: Record) -> None:
    """A pattern can take up any static bias: the law that gains beside it has the precedence, and both are named."""
    hidden = (
        MAKE["fixed_pattern"](pixel_sigma_mm=10.0, column_sigma_mm=3.0, row_sigma_mm=3.0),
        MAKE["wiggling"](amplitude_mm=20.0, phase_rad=0.7),
    )
    result = reconcile(model, record(*hidden), Settings(kinds=("fixed_pattern", "wiggling", "range_offset")))
    assert result.verified.verdict == "explained"
    assert {n.effect.kind for n in result.named} == {"fixed_pattern", "wiggling"}
    (swing,) = (numeric(n.effect) for n in result.named if n.effect.kind == "wiggling")
    assert 10.0 < swing["amplitude_mm"] < 25.0  # of 20: the pattern has a part of it
    assert swing["phase_rad"] == pytest.approx(0.7, abs=0.6)
    assert result.verified.closed is not None
    assert result.verified.closed > 0.85


def test_light_that_is_too_much_is_found_at_its_amplitude(model: Model, record: Record) -> None:
    brightest = predict(model, cast_scene(model)).amplitude.max()
    hidden = MAKE["saturation"](full_well_amplitude=0.6 * float(brightest))
    result = reconcile(model, record(hidden), Settings(kinds=("saturation", "dropout", "outliers")))
    assert [n.effect.kind for n in result.named] == ["saturation"]
    found = numeric(result.named[0].effect)["full_well_amplitude"]
    assert found == pytest.approx(0.6 * brightest, rel=0.25)  # few pixels are near it


@pytest.mark.parametrize("split", ["frames", "pixels"])
def test_pixels_or_frames_alone_can_be_held_out(model: Model, record: Record, split: str) -> None:
    settings = Settings(kinds=("range_offset", "outliers"), split=split)
    result = reconcile(model, record(MAKE["range_offset"](offset_mm=12.0)), settings)
    assert [n.effect.kind for n in result.named] == ["range_offset"]
    assert abs(result.named[0].parameters["offset_mm"] - 12.0) < 4 * result.named[0].stderr["offset_mm"]
