"""Candidates that are refused where they stand for something else."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

KINDS = ("range_offset", "surface_pose", "multipath", "amplitude_walk", "temperature_drift", "excess_noise")


@pytest.mark.parametrize("factor", [1.6, 0.7])
def test_a_surface_that_is_noisier_has_no_second_path(model: Model, record: Record, factor: float) -> None:
    """A path of just one turn more, across the first, would dim the surface and not move it."""
    evidence = record()
    samples = evidence.samples.astype(np.float64)
    middle = np.median(samples, axis=0)
    own = np.abs(middle - np.median(middle)) < 0.25 * np.median(middle)
    noisier = np.where(own & (samples > 0), np.maximum(middle + factor * (samples - middle), 1), samples)
    result = reconcile(model, replace(evidence, samples=np.rint(noisier).astype(np.uint16)), Settings(kinds=KINDS))
    assert "multipath" not in [n.effect.kind for n in result.named]
    assert "multipath" not in [c.kind for c in result.candidates[:1]]


def test_an_offset_that_is_given_wrong_is_no_drift_and_no_walk(model: Model, record: Record) -> None:
    """Another offset is not tried where the model has one; a drift that is over at once would stand for it."""
    hidden = MAKE["range_offset"](offset_mm=18.0)
    wrong = replace(model, effects=(MAKE["range_offset"](offset_mm=10.0),))
    evidence = record(hidden, of=model)
    result = reconcile(wrong, evidence, Settings(kinds=KINDS))
    assert not {"temperature_drift", "amplitude_walk"} & {n.effect.kind for n in result.named}
    assert result.verified.verdict == "unexplained"
