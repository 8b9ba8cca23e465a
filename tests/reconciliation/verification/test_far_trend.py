"""A change of ranges in time beyond the reach of scores is placed in mm; nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.verification.verify import far_trends
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

ALPHA = 0.01


def likelihood_of(model: Model, evidence: Evidence) -> Likelihood:
    return Likelihood(evidence, Scene(model, evidence.time_s))


def nearer(evidence: Evidence, mm_a_frame: float) -> Evidence:
    """Each frame so much nearer than the one before."""
    moved = evidence.samples - mm_a_frame * np.arange(len(evidence.samples))[:, None]
    return replace(evidence, samples=np.where(evidence.samples > 0, np.maximum(np.rint(moved), 1), 0).astype(np.uint16))


def test_flight_is_placed_with_its_length(small: Model) -> None:
    evidence = nearer(recorded(small), 10.0)
    likelihood = likelihood_of(small, evidence)
    (place,) = far_trends(likelihood, likelihood.start(), ALPHA)
    assert (place.axis, place.statistic, place.unit) == ("time", "trend", "mm")
    assert place.size == pytest.approx(-10.0 * 0.9 * len(evidence.samples), rel=0.1)  # between medians of tenths
    assert place.interval[0] < 0.1 * evidence.time_s[-1] < 0.9 * evidence.time_s[-1] < place.interval[1]


@pytest.mark.parametrize("hidden", [(), (MAKE["temperature_drift"](amplitude_mm=10.0, time_constant_s=2.0),)], ids=str)
def test_recording_that_scores_can_show_has_no_far_trend(small: Model, hidden: tuple[object, ...]) -> None:
    likelihood = likelihood_of(small, recorded(small, *hidden))  # type: ignore[arg-type]
    assert far_trends(likelihood, likelihood.start(), ALPHA) == []


def test_drift_over_coarse_cells_that_the_model_has_is_no_far_trend(small: Model) -> None:
    """Medians of values on a grid jump by a whole step, where the ranges cross into the next cell."""
    near = replace(small, surfaces=small.surfaces[:1])
    drift = MAKE["temperature_drift"](amplitude_mm=30.0, time_constant_s=1.0)
    step = MAKE["quantisation"](step_mm=25.0)
    likelihood = likelihood_of(near, recorded(near, drift, step))
    right = replace(likelihood.start(), effects=(drift, step))
    assert far_trends(likelihood, right, ALPHA) == []


@pytest.mark.parametrize(
    "change",
    [
        MAKE["motion"](surface="wall", velocity_mm_s=-200.0),
        MAKE["temperature_drift"](amplitude_mm=-400.0, time_constant_s=1.0),
    ],
    ids=lambda e: e.kind,
)
def test_large_change_in_time_that_the_model_has_is_no_far_trend(small: Model, change: Effect) -> None:
    wall = replace(small, surfaces=small.surfaces[-1:])
    wall = replace(wall, surfaces=(replace(wall.surfaces[0], name="wall"),))
    likelihood = likelihood_of(wall, recorded(wall, change))
    assert far_trends(likelihood, likelihood.start(), ALPHA)
    assert far_trends(likelihood, replace(likelihood.start(), effects=(change,)), ALPHA) == []
