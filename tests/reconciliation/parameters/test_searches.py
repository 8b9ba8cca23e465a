"""Where searches of each kind start, and what they leave alone."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, Record
from support.simplex import fit

from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.base import Latent
from tofmix.simulation.effects.internal_reflection import stray_phasor
from tofmix.simulation.effects.search import EFFECT_NATS
from tofmix.simulation.model import Model


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
    whole, by_angle = problems("excess_noise", one, one.scene.mixture())
    assert whole.make(np.array(whole.starts[0])) == MAKE["excess_noise"](factor=0.9)
    assert by_angle.make(np.array(by_angle.starts[1])) == MAKE["excess_noise"](factor=1.0, angle_exponent=1.0)
    assert (by_angle.form, by_angle.price_nats) == ("by angle", EFFECT_NATS)


def test_losses_are_not_searched_for_where_no_sample_is_lost(model: Model, record: Record) -> None:
    evidence = record()
    evidence.samples[evidence.samples == 0] = 1000
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    for kind in ("dropout", "saturation"):
        assert problems(kind, likelihood, likelihood.scene.mixture()) == []


def test_amplitude_walk_is_not_searched_for_before_dark_surfaces(model: Model, record: Record) -> None:
    dark = replace(model, surfaces=tuple(replace(s, reflectivity=0.0) for s in model.surfaces))
    evidence = record()
    likelihood = Likelihood(evidence, Scene(dark, evidence.time_s))
    assert problems("amplitude_walk", likelihood, likelihood.scene.mixture()) == []


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
    assert found["sigma_mm"] == pytest.approx(5.0 * 0.6745, rel=0.2)  # half of them are within the probable error


def test_near_return_is_not_searched_for_without_samples_before_the_scene(model: Model, record: Record) -> None:
    evidence = record()
    evidence.samples[evidence.samples < 300] = 0
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    assert problems("near_return", likelihood, likelihood.scene.mixture()) == []


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
