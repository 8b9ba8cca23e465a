"""Where searches of each kind start, and what they leave alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.recordings import MAKE, Record
from support.simplex import fit

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene, plane_distance
from tofmix.reconciliation.parameters.searches import measured_pose, problems, range_slopes, ranges_to
from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.base import Latent
from tofmix.simulation.effects.internal_reflection import stray_phasor
from tofmix.simulation.effects.motion import Motion
from tofmix.simulation.effects.search import EFFECT_NATS
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@pytest.fixture(scope="module")
def lossy(model: Model, record: Record) -> Likelihood:
    """A recording in which samples are lost and some far ones folded, so that every kind has something to look for."""
    evidence = record(MAKE["dropout"](probability=0.05))
    return Likelihood(evidence, Scene(model, evidence.time_s))


@pytest.mark.parametrize("frames", [20, 25, 30])
def test_drift_has_starts_in_few_frames(model: Model, record: Record, frames: int) -> None:
    whole = record()
    few = replace(
        whole, samples=whole.samples[:frames], time_s=whole.time_s[:frames], fit_frames=whole.fit_frames[:frames]
    )
    likelihood = Likelihood(few, Scene(model, few.time_s))
    for problem in problems("temperature_drift", likelihood, likelihood.scene.mixture()):
        assert problem.starts
        for start in problem.starts:
            assert problem.make(np.array(start)).kind == "temperature_drift"


def test_motion_starts_at_the_speed_of_pixels_that_go_on_seeing_the_surface(model: Model) -> None:
    """Six of ten pixels see another surface from some time on, so that medians tell no speed."""
    wall = replace(model.surfaces[-1], size_mm=(9e4, 9e4))
    alone = replace(model, surfaces=(wall,), sensor=replace(model.sensor, rows=8, cols=8))
    time_s, rng = 0.5 + np.arange(60) / 10, np.random.default_rng(3)
    blank = make_evidence(alone, np.full((60, 8, 8), 1000.0), time_s=time_s)
    mixture = Scene(alone, blank.time_s).mixture()
    mean, sigma = mixture.of_main(mixture.mean), mixture.of_main(mixture.sigma)
    ranges = mean * (1.0 + 300.0 * blank.time_s[:, None] / 2500.0) + sigma * rng.standard_normal((60, 64))
    leaves = rng.permutation(64)[:38]
    since = rng.uniform(0.0, 3.0, 38)
    ranges[:, leaves] = np.where(blank.time_s[:, None] > since, rng.uniform(800.0, 1300.0, 38), ranges[:, leaves])
    evidence = make_evidence(alone, ranges.reshape(60, 8, 8), time_s=time_s)
    likelihood = Likelihood(evidence, Scene(alone, evidence.time_s))
    (problem,) = problems("motion", likelihood, likelihood.scene.mixture())
    distance = plane_distance(wall)
    found = problem.make(np.array(problem.starts[-1]))
    assert problem.shown
    assert isinstance(found, Motion)
    assert found.velocity_mm_s == pytest.approx(distance * 300.0 / 2500.0, rel=0.03)


@pytest.mark.parametrize("kind", [kind for kind, effect in EFFECTS.items() if effect.latent is Latent.NONE])
def test_each_start_of_a_search_is_an_effect_that_the_camera_may_have(
    model: Model, lossy: Likelihood, kind: str
) -> None:
    found = problems(kind, lossy, lossy.scene.mixture())
    assert found or kind in ("phase_wrapping", "near_return")  # nothing is near the turn, or before the scene
    for problem in found:
        assert problem.starts
        for start in problem.starts:
            effect = problem.make(np.array(start))
            assert effect.kind == kind
            effect.check(model.sensor, lossy.scene.names)
            assert len(problem.steps) == len(start)


def test_effects_of_the_phase_are_not_searched_for_without_a_modulation_frequency(model: Model, record: Record) -> None:
    evidence = record()
    sensor = replace(model.sensor, modulation_frequency_hz=None)
    likelihood = Likelihood(evidence, Scene(replace(model, sensor=sensor), evidence.time_s))
    mixture = likelihood.scene.mixture()
    for kind in ("wiggling", "multipath", "phase_wrapping", "scattering", "internal_reflection"):
        assert problems(kind, likelihood, mixture) == []
    assert problems("range_offset", likelihood, mixture)


def test_noise_of_one_surface_is_searched_for_where_there_are_several(model: Model, record: Record) -> None:
    evidence = record()
    several = Likelihood(evidence, Scene(model, evidence.time_s))
    found = [p.make(np.array(p.starts[0])) for p in problems("excess_noise", several, several.scene.mixture())]
    assert {getattr(e, "surface", None) for e in found} == {"", *several.scene.names}
    one = Likelihood(evidence, Scene(replace(model, surfaces=model.surfaces[-1:]), evidence.time_s))
    whole, by_angle, *_of_a_spot = problems("excess_noise", one, one.scene.mixture())
    assert whole.make(np.array(whole.starts[0])) == MAKE["excess_noise"](factor=0.9)
    assert by_angle.make(np.array(by_angle.starts[1])) == MAKE["excess_noise"](factor=1.0, angle_exponent=1.0)
    assert (by_angle.form, by_angle.price_nats) == ("by angle", EFFECT_NATS)


def test_fitted_dropout_is_the_share_that_is_lost(lossy: Likelihood) -> None:
    by_chance, _ = problems("dropout", lossy, lossy.scene.mixture())
    whole = np.arange(lossy.evidence.shape[0]), np.arange(lossy.evidence.shape[1])
    found = fit(by_chance, lossy, lossy.start(), whole)
    assert numeric(found.effect)["probability"] == pytest.approx(0.05, abs=0.003)
    lost = replace(lossy.start(), effects=(found.effect,))
    assert lossy.value(lost, whole) > lossy.value(lossy.start(), whole) + 1000


@pytest.mark.parametrize("size", [1.0, 6.0])
@pytest.mark.parametrize("at_mm", [20.0, 140.0])
def test_phasor_that_was_added_to_every_pixel_is_recovered_from_ranges(size: float, at_mm: float) -> None:
    """To second order in its share of the light, and to 4 standard errors of the least squares."""
    rng, turn = np.random.default_rng(5), 7494.8
    range_mm, amplitude, sigma = rng.uniform(800, 5000, 3000), rng.uniform(200, 900, 3000), rng.uniform(1, 8, 3000)
    wave = np.exp(2j * np.pi * range_mm / turn)
    added = size * np.exp(2j * np.pi * at_mm / turn)
    moved = np.angle(1 + added / (amplitude * wave)) * turn / (2 * np.pi) + sigma * rng.standard_normal(3000)
    moved[::7] = np.nan
    found = stray_phasor(range_mm, amplitude, moved, sigma, turn)
    error = 2 * np.pi / turn * np.median(amplitude * sigma) * np.sqrt(2 / 2500)
    assert abs(found - added) < 4 * error + 2 * size**2 / amplitude.min()


def test_no_phasor_is_found_without_amplitudes_or_phase() -> None:
    ones = np.ones(9)
    assert stray_phasor(ones, 0 * ones, ones, ones, 7494.8) == 0
    assert stray_phasor(ones, ones, np.full(9, np.nan), ones, 7494.8) == 0
    assert stray_phasor(ones, ones, ones, ones, np.nan) == 0


def test_search_for_a_near_return_starts_at_its_samples(model: Model, record: Record) -> None:
    evidence = record(MAKE["near_return"](share=0.06, range_mm=25.0, sigma_mm=5.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    (problem,) = problems("near_return", likelihood, likelihood.scene.mixture())
    (start,) = problem.starts
    found = numeric(problem.make(np.array(start)))
    assert found["share"] == pytest.approx(0.06, rel=0.15)
    assert found["range_mm"] == pytest.approx(25.0, abs=1.0)
    assert found["sigma_mm"] == pytest.approx(5.0, rel=0.2)


@pytest.mark.parametrize(
    ("kind", "values", "sound"),
    [
        ("internal_reflection", {"amplitude": 12.0, "range_mm": 140.0}, True),
        ("internal_reflection", {"amplitude": 12.0, "range_mm": 2000.0}, False),
        ("near_return", {"share": 0.06, "range_mm": 25.0, "sigma_mm": 5.0}, True),
        ("near_return", {"share": 0.06, "range_mm": 900.0, "sigma_mm": 5.0}, False),
        ("surface_pose", {"surface": "near", "shift_mm": 900.0}, True),
        ("surface_pose", {"surface": "near", "shift_mm": -2500.0}, False),
        ("multipath", {"surface": "near", "share": 0.1, "extra_path_mm": 4000.0}, True),
        ("multipath", {"surface": "near", "share": 0.1, "extra_path_mm": 14_900.0}, False),
        ("multipath", {"surface": "near", "share": 0.5, "extra_path_mm": 7495.0}, False),
        ("range_offset", {"offset_mm": 5000.0}, False),
        ("range_offset", {"offset_mm": -300.0}, True),
        ("excess_noise", {"factor": 5.0}, True),
        ("excess_noise", {"factor": 37.0}, False),
    ],
)
def test_pose_of_metres_path_of_a_turn_and_noise_of_many_sigma_are_not_plausible(
    kind: str, values: dict[str, float | str], sound: bool
) -> None:
    assert MAKE[kind](**values).plausible() is sound


def test_implausible_vector_of_a_search_counts_as_another_effect(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    pose = problems("surface_pose", likelihood, likelihood.scene.mixture())[0]
    assert pose.other is not None
    near, far = (np.array([shift / pose.make(np.ones(1)).shift_mm]) for shift in (50.0, 4000.0))  # type: ignore[attr-defined]
    assert (pose.other(near), pose.other(far)) == (False, True)


WALL = Surface(name="wall", center_mm=(150.0, -80.0, 2300.0), size_mm=(3000, 2000), yaw_deg=12.0, pitch_deg=-7.0)


def tilted(surface: Surface, shift_mm: float, *tilts_deg: float) -> Surface:
    return SurfacePose.tilted(surface, shift_mm, (tilts_deg[0], tilts_deg[1])).place(surface, 0.0)


def beams(n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(3)
    rays = np.stack([rng.uniform(-0.4, 0.4, n), rng.uniform(-0.3, 0.3, n), np.ones(n)], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


@given(yaw=st.floats(-60, 60), pitch=st.floats(-50, 50), x=st.floats(-500, 500), z=st.floats(800, 6000))
@pytest.mark.slow
def test_slopes_are_the_differences_of_ranges_to_moved_planes(yaw: float, pitch: float, x: float, z: float) -> None:
    surface = Surface(name="s", center_mm=(x, 0.0, z), size_mm=(100, 100), yaw_deg=yaw, pitch_deg=pitch, roll_deg=9.0)
    d = beams()
    d = d[(d @ surface.rotation()[:, 2]) > 0.2]
    found = range_slopes(surface, d)
    for k, (size, step) in enumerate(((0.01, (0.01, 0, 0)), (1e-4, (0, 1e-4, 0)), (1e-4, (0, 0, 1e-4)))):
        ahead, behind = (ranges_to(tilted(surface, *(sign * v for v in step)), d) for sign in (1, -1))
        assert found[:, k] == pytest.approx((ahead - behind) / (2 * size), rel=1e-4, abs=1e-3)


@given(
    shift=st.floats(-80, 80),
    about_u=st.floats(-5, 5),
    about_v=st.floats(-5, 5),
    strange=st.floats(0, 0.3),
)
def test_pose_of_a_plane_is_found_although_a_third_of_its_pixels_see_another_surface(
    shift: float, about_u: float, about_v: float, strange: float
) -> None:
    d = beams()
    there = tilted(WALL, shift, about_u, about_v)
    bias = ranges_to(there, d) - ranges_to(WALL, d)
    bias[: int(strange * len(bias))] += 700.0
    found = measured_pose(WALL, d, bias, np.full(len(d), 1.0))
    assert (found.shift_mm, *found.tilts_deg) == pytest.approx((shift, about_u, about_v), abs=0.05)


def test_posed_surface_has_the_shift_and_the_added_angles() -> None:
    moved = SurfacePose(surface="wall", shift_mm=30.0, yaw_deg=2.0, pitch_deg=-1.0, roll_deg=0.5).place(WALL, 0.0)
    assert (moved.yaw_deg, moved.pitch_deg, moved.roll_deg) == (14.0, -8.0, 0.5)
    assert np.linalg.norm(np.array(moved.center_mm) - WALL.center_mm) == pytest.approx(30.0)
    assert SurfacePose(surface="wall", shift_mm=0.0).place(WALL, 0.0) == WALL
