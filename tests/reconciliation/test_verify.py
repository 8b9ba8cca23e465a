"""The verdict is of the models as they are: no trace of poses that were tried, none of pixels that see nothing."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconciliation.add import Added, ways
from tofmix.reconciliation.compare import compare
from tofmix.reconciliation.likelihood import Likelihood
from tofmix.reconciliation.mixture import Scene
from tofmix.reconciliation.name import KINDS
from tofmix.reconciliation.panel import Curve
from tofmix.reconciliation.verify import _goes_on, verify
from tofmix.reconciliation.way import Settings, held_out
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

SETTINGS = Settings(kinds=KINDS)


def test_a_pose_that_was_tried_leaves_no_trace_in_the_gaps(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    start = likelihood.start()
    panel = compare(likelihood, start, held_out(likelihood, SETTINGS), seed=SETTINGS.seed)
    added = Added(state=start, chosen=(), first=(), aliases=(), panel=panel)
    straight = verify(likelihood, added, SETTINGS)
    likelihood.scene.anchor((MAKE["surface_pose"](surface="near", shift_mm=200.0),))
    after_a_trial = verify(likelihood, added, SETTINGS)
    assert after_a_trial.before.gap == straight.before.gap
    assert after_a_trial.floor.gap == straight.floor.gap


def test_the_tolerance_brings_no_chance_of_other_frames_along(model: Model, record: Record) -> None:
    evidence, other = record(seed=5), record(seed=6)
    samples = np.where(evidence.fit_frames[:, None], other.samples, evidence.samples)
    panels = []
    for one in (evidence, replace(evidence, samples=samples)):
        (added,) = ways(Likelihood(one, Scene(model, one.time_s)), replace(SETTINGS, max_effects=0))
        panels.append({c.name: c.chi2 for c in added.panel.curves})
    assert panels[0] == panels[1]


@pytest.mark.parametrize("frame_rate_hz", [4.0, 10.0])
def test_the_floor_is_simulated_as_fast_as_was_recorded(model: Model, record: Record, frame_rate_hz: float) -> None:
    """The model file may say another rate than the recording's 10 Hz, which is what counts."""
    drift = MAKE["temperature_drift"](amplitude_mm=20.0, time_constant_s=2.0)
    other = replace(model, recording=replace(model.recording, frame_rate_hz=frame_rate_hz))
    result = reconcile(other, record(drift), Settings(kinds=("temperature_drift", "range_offset")))
    assert [n.effect.kind for n in result.named] == ["temperature_drift"]
    assert result.verified.floor.gap < 1.3
    assert result.verified.closed is not None
    assert result.verified.closed < 1.05


def test_a_change_in_time_that_no_law_has_leaves_a_drift_a_part_of_the_explanation(
    model: Model, record: Record
) -> None:
    evidence = record(MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=2.0))
    ripple = np.rint(2.5 * np.sin(0.9 * evidence.time_s)).astype(np.int64)
    moved = np.where(evidence.samples > 0, evidence.samples + ripple[:, None], 0).astype(np.uint16)
    result = reconcile(
        model, replace(evidence, samples=moved), Settings(kinds=("temperature_drift", "range_offset", "motion"))
    )
    assert result.verified.verdict != "explained"
    assert result.where[0].axis in ("time", "frame")


def test_a_pattern_that_grows_is_a_pattern_in_part(model: Model, record: Record, rng: np.random.Generator) -> None:
    """What is left of each pixel changes slowly: one frame is like the next, and no bias stays."""
    evidence = record()
    growing = evidence.time_s[:, None] / evidence.time_s[-1] * rng.normal(0.0, 8.0, evidence.shape[1])
    moved = np.where(evidence.samples > 0, np.rint(evidence.samples + growing), 0).astype(np.uint16)
    kinds = ("fixed_pattern", "interference", "temporal_correlation", "temperature_drift")
    result = reconcile(model, replace(evidence, samples=moved), Settings(kinds=kinds))
    assert result.verified.verdict in ("partly_explained", "unexplained")
    assert {n.effect.kind for n in result.named} <= {"fixed_pattern"}


def test_a_model_whose_own_simulation_is_far_from_it_explains_nothing(
    model: Model, record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    evidence = record(MAKE["range_offset"](offset_mm=8.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    (added, *_) = ways(likelihood, SETTINGS)
    assert verify(likelihood, added, SETTINGS).verdict == "explained"
    far = record(MAKE["range_offset"](offset_mm=80.0))
    other = Likelihood(far, Scene(model, far.time_s))
    panel = compare(other, other.start(), held_out(other, SETTINGS), seed=1)
    monkeypatch.setattr("tofmix.reconciliation.verify._floor", lambda *_: panel)
    assert verify(likelihood, added, SETTINGS).verdict == "unexplained"


@pytest.mark.parametrize(
    ("left", "goes_on"),
    [
        ({"memory": 80.0}, True),
        ({"memory": 80.0, "bias": 60.0}, True),
        ({"memory": 60.0, "pattern": 80.0}, False),  # one frame is like the next as a bias stays
        ({"memory": 4.0}, False),  # too little of what was gained
        ({"pattern": 80.0}, False),
    ],
)
def test_what_makes_a_frame_like_the_next_changes_unless_it_is_a_bias(
    left: dict[str, float], goes_on: bool, model: Model, record: Record
) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    floor = compare(likelihood, likelihood.start(), held_out(likelihood, SETTINGS), seed=1)
    loud = [_curve(statistic, z) for statistic, z in left.items()]
    assert _goes_on(likelihood.start(), loud, floor, 2000.0) == goes_on
    remembers = replace(likelihood.start(), effects=(MAKE["temporal_correlation"](coefficient=0.5),))
    assert not _goes_on(remembers, loud, floor, 2000.0)


def _curve(statistic: str, nats: float) -> Curve:
    """A curve of one bin that is left with so many nats."""
    axis = {"memory": "frame"}.get(statistic, "all")
    one = np.ones(1)
    return Curve(
        statistic=statistic, axis=axis, lower=one, upper=one, value=np.sqrt(2 * nats + one), variance=one, unit="",
        scale_mm=0 * one,
    )  # fmt: skip
