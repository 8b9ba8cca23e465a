"""Where searches of each kind start, and what they leave alone."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, Record

from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.parameters.fits import fit
from tofmix.reconciliation.parameters.profiles import numeric
from tofmix.reconciliation.parameters.searches import problems
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.base import Latent
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
    (problem,) = problems("temperature_drift", likelihood, likelihood.scene.mixture())
    for start in problem.starts:
        assert problem.make(np.array(start)).kind == "temperature_drift"


@pytest.mark.parametrize("kind", [kind for kind, effect in EFFECTS.items() if effect.latent is Latent.NONE])
def test_each_start_of_a_search_is_an_effect_that_the_camera_may_have(
    model: Model, lossy: Likelihood, kind: str
) -> None:
    found = problems(kind, lossy, lossy.scene.mixture())
    assert found or kind == "phase_wrapping"  # nothing is near the turn
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
    for kind in ("wiggling", "multipath", "phase_wrapping", "scattering"):
        assert problems(kind, likelihood, mixture) == []
    assert problems("range_offset", likelihood, mixture)


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
    assert found.value > lossy.value(lossy.start(), whole) + 1000


@pytest.mark.parametrize(
    ("kind", "values", "sound"),
    [
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
