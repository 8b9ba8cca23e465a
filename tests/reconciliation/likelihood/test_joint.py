"""Several recordings of one camera: they add up, share what is the camera's, and tell apart what one cannot."""

from dataclasses import replace

import numpy as np
import pytest
from support.reconcile_errors import scene
from support.recordings import MAKE, recorded

from tofmix.errors import BadInputError
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import Recording, check_camera, joint_likelihood, tell_apart, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, Part
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.words import summary_lines
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@pytest.fixture(scope="module")
def model() -> Model:
    """Two boards and a slanted wall before a camera of 14 x 18 pixels, 60 frames."""
    return scene(rows=14, cols=18, frames=60)


@pytest.fixture(scope="module")
def other(model: Model) -> Model:
    """Another scene before the same camera: one surface of the same name, elsewhere, and one of its own."""
    surfaces = (
        Surface(name="wall", center_mm=(0.0, 0.0, 3200.0), size_mm=(20000.0, 20000.0), yaw_deg=-25.0),
        Surface(name="box", center_mm=(200.0, 0.0, 1900.0), size_mm=(800.0, 800.0), reflectivity=0.5),
    )
    return replace(model, surfaces=surfaces)


def board(model: Model, distance_mm: float) -> Model:
    """The camera before one board that faces it and fills the image."""
    return replace(model, surfaces=(Surface(name="board", center_mm=(0, 0, distance_mm), size_mm=(9000.0, 9000.0)),))


@pytest.mark.parametrize(
    "effects",
    [
        (MAKE["wiggling"](amplitude_mm=9.0, phase_rad=1.0), MAKE["dropout"](probability=0.1)),
        (MAKE["motion"](surface="middle", velocity_mm_s=4.0), MAKE["flying_pixels"](probability=0.2)),
        (MAKE["temperature_drift"](amplitude_mm=9.0, time_constant_s=3.0), MAKE["phase_wrapping"]()),
        (MAKE["interference"](probability=0.2, sigma_mm=30.0, burst_frames=4.0),),
    ],
    ids=lambda effects: effects[0].kind,
)
def test_log_likelihood_of_two_recordings_is_the_sum_of_both(
    model: Model, other: Model, effects: tuple[Effect, ...]
) -> None:
    pairs: list[Recording] = [(model, recorded(model)), (other, recorded(other, frames=83, seed=6))]
    joint = joint_likelihood(pairs)
    found = joint.value(replace(joint.start(), effects=effects), _whole(joint.evidence))
    alone = [Likelihood(e, Scene(m, e.time_s)) for m, e in pairs]
    wanted = [a.value(replace(a.start(), effects=effects), _whole(a.evidence)) for a in alone]
    assert found == pytest.approx(sum(wanted), rel=1e-12)


def _whole(evidence: Evidence) -> Part:
    return np.arange(evidence.shape[0]), np.arange(evidence.shape[1])


def test_view_of_the_joint_likelihood_is_the_recording_by_itself(model: Model, other: Model) -> None:
    pairs: list[Recording] = [(model, recorded(model)), (other, recorded(other, frames=83, seed=6))]
    joint = joint_likelihood(pairs)
    held = joint.evidence.part(fit=False)
    motion = (MAKE["motion"](surface="box", velocity_mm_s=4.0),)
    seen = list(views(joint, joint.scene.mixture(motion), held))
    assert [view.number for view in seen] == [0, 1]
    for view, (m, evidence) in zip(seen, pairs, strict=True):
        own = Scene(m, evidence.time_s).mixture(motion)
        np.testing.assert_array_equal(view.evidence.samples, evidence.samples)
        np.testing.assert_array_equal(view.part[0], evidence.part(fit=False)[0])
        np.testing.assert_array_equal(view.mixture.key, own.key)
        np.testing.assert_array_equal(view.mixture.of_main(view.mixture.mean), own.of_main(own.mean))
        np.testing.assert_array_equal(joint.evidence.samples[view.part_of_all[0]], evidence.samples[view.part[0]])


def _kinds(result: Reconciliation) -> list[str]:
    return [n.effect.kind for n in result.named]


@pytest.mark.slow
def test_second_distance_separates_an_offset_from_a_pose(model: Model) -> None:
    near, far = board(model, 1500.0), board(model, 3000.0)
    hidden = MAKE["range_offset"](offset_mm=1.5)
    first, second = recorded(near, hidden), recorded(far, hidden, seed=6)
    settings = Settings(kinds=("range_offset", "surface_pose"), tolerance=0.0)
    single = reconcile(near, first, settings)
    alone = single.as_dict()
    assert any("cannot separate range_offset from surface_pose" in line for line in summary_lines(single))
    assert {kind for group in alone["aliases"] for kind in group["kinds"]} == {"range_offset", "surface_pose"}
    both = reconcile(near, first, settings, also=[(far, second)])
    assert _kinds(both) == ["range_offset"]
    assert both.as_dict()["aliases"] == []
    assert abs(numeric(both.named[0].effect)["offset_mm"] - 1.5) < 4 * both.named[0].stderr["offset_mm"]


@pytest.mark.slow
def test_pixel_is_stuck_where_both_recordings_hold_the_same_value(model: Model, other: Model) -> None:
    pairs = [(model, recorded(model)), (other, recorded(other, seed=6))]
    for _, evidence in pairs:
        evidence.samples[:, 41] = 1234
    result = reconcile(*pairs[0], Settings(kinds=("stuck_pixels", "outliers", "fixed_pattern")), also=pairs[1:])
    assert _kinds(result) == ["stuck_pixels"]
    assert result.named[0].recordings == (0, 1)
    pairs[1][1].samples[:, 41] = 1300  # two values are no stuck pixel
    result = reconcile(*pairs[0], Settings(kinds=("stuck_pixels",)), also=pairs[1:])
    assert _kinds(result) == []


def test_different_surfaces_of_one_name_in_two_scenes_get_a_number(model: Model, other: Model) -> None:
    shared = replace(other, surfaces=(model.surfaces[0], *other.surfaces))
    names = [[s.name for s in m.surfaces] for m in tell_apart([model, shared])]
    assert names == [["near", "middle", "wall"], ["near", "wall (2)", "box"]]


def test_recording_of_another_camera_is_refused(model: Model, other: Model) -> None:
    check_camera([model, replace(other, sensor=replace(other.sensor, integration_time_ms=2.0))])
    with pytest.raises(BadInputError, match=r"range_max_mm.*reconcile this one by itself"):
        check_camera([model, replace(other, sensor=replace(other.sensor, range_max_mm=6000.0))])
    noise = replace(other.sensor.noise, sigma_mm=other.sensor.noise.sigma_mm * 1.1)
    with pytest.raises(BadInputError, match="noise"):
        check_camera([model, replace(other, sensor=replace(other.sensor, noise=noise))])
