"""Candidates that are refused where they stand for something else."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

KINDS = ("range_offset", "surface_pose", "multipath", "amplitude_walk", "temperature_drift", "excess_noise")


@pytest.mark.parametrize(
    ("factor", "kinds"),
    [
        pytest.param(1.6, ("multipath", "excess_noise", "temperature_drift"), id="noisier, few rivals"),
        pytest.param(1.6, KINDS, marks=pytest.mark.slow, id="noisier"),
        pytest.param(0.7, KINDS, marks=pytest.mark.slow, id="less noisy"),
    ],
)
@pytest.mark.slow
def test_surface_with_other_noise_has_no_second_path(small: Model, factor: float, kinds: tuple[str, ...]) -> None:
    """A second path of just one turn would change the noise of the surface and not its mean."""
    evidence = recorded(small)
    samples = evidence.samples.astype(np.float64)
    middle = np.median(samples, axis=0)
    own = np.abs(middle - np.median(middle)) < 0.25 * np.median(middle)
    other = np.where(own & (samples > 0), np.maximum(middle + factor * (samples - middle), 1), samples)
    result = reconcile(small, replace(evidence, samples=np.rint(other).astype(np.uint16)), Settings(kinds=kinds))
    assert "multipath" not in [n.effect.kind for n in result.named]
    assert "multipath" not in [c.kind for c in result.candidates[:1]]


@pytest.mark.parametrize(
    "kinds",
    [("range_offset", "amplitude_walk", "temperature_drift"), pytest.param(KINDS, marks=pytest.mark.slow)],
    ids=["few rivals", "all rivals"],
)
def test_wrong_given_offset_is_named_neither_drift_nor_walk(small: Model, kinds: tuple[str, ...]) -> None:
    """No second offset is tried if the model has one; a drift that ends at once could imitate it."""
    two = replace(small, surfaces=small.surfaces[1:])
    wrong = replace(two, effects=(MAKE["range_offset"](offset_mm=10.0),))
    result = reconcile(wrong, recorded(two, MAKE["range_offset"](offset_mm=18.0)), Settings(kinds=kinds))
    assert not {"temperature_drift", "amplitude_walk"} & {n.effect.kind for n in result.named}
    assert result.verified.verdict == "unexplained"
