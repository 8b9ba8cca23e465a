"""Candidates that are refused where they stand for something else."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.search.name import tolerated
from tofmix.reconciliation.search.search_state import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.sensors import load_profile
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

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


def test_tolerated_shift_moves_the_seen_ranges_by_the_tolerance(model: Model) -> None:
    """A wall whose plane's foot, where the noise is less, is far from the pixels that see it."""
    wall = Surface(name="wall", center_mm=(0, 0, 3000), size_mm=(9000.0, 7000.0), yaw_deg=40.0)
    slanted = replace(model, sensor=replace(load_profile("sr4000"), rows=20, cols=24), surfaces=(wall,))
    likelihood = joint_likelihood([(slanted, recorded(slanted))])
    (sigma,) = likelihood.scene.sigma_of_place
    m = likelihood.scene.mixture()
    foot = float(likelihood.scene.distance[0])
    assert sigma == pytest.approx(float(np.median(m.of_main(m.sigma) * foot / m.of_main(m.mean))), rel=0.01)
    hidden = MAKE["surface_pose"](surface="wall", shift_mm=0.11 * sigma)
    likelihood = joint_likelihood([(slanted, recorded(slanted, hidden))])
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    near = tolerated(likelihood, likelihood.start(), whole, 0.1)
    shift = next(e.shift_mm for e in near.effects if isinstance(e, SurfacePose))
    assert abs(shift - 0.11 * sigma) < 3 * sigma / np.sqrt(whole[0].size * whole[1].size)


def test_sigma_of_place_is_the_median_of_the_recordings_that_show_the_surface(model: Model) -> None:
    parts = replace(model, surfaces=model.surfaces[:2]), replace(model, surfaces=model.surfaces[1:])
    joined = joint_likelihood([(part, recorded(part)) for part in parts]).scene
    single = [dict(zip(s.names, s.sigma_of_place, strict=True)) for s in joined.members]
    first, shared, last = (s.name for s in model.surfaces)
    wanted = [single[0][first], np.median([single[0][shared], single[1][shared]]), single[1][last]]
    assert joined.sigma_of_place == pytest.approx(np.array(wanted))
