"""Amplitudes and temperatures steer parameters: towards the truth where they know better, and not where they do not."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE
from support.simplex import fit

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.likelihood.side_information import (
    amplitude_information,
    as_bright_as_seen,
    log_ratios,
    warm_up_information,
)
from tofmix.reconciliation.parameters.fits import Numbers
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.parameters.standard_errors import numeric, standard_errors
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks

FRAMES = 80


def recorded(
    model: Model, *effects: Effect, like: Model | None = None, gain: float = 1.0, warm: bool = False
) -> Evidence:
    """A simulated recording with amplitudes, times a gain, and temperatures; held against `like`."""
    real = replace(model, effects=effects)
    (block,) = render_blocks(real, cast_scene(real), n_frames=FRAMES, seed=5, block_frames=FRAMES)
    range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
    degrees = 24.0 + 8.0 * -np.expm1(-block.time_s / 25.0) if warm else None
    return make_evidence(
        like or model, range_mm, time_s=block.time_s, amplitude=gain * block.amplitude, temperature_c=degrees
    )


def _ranges_alone(evidence: Evidence) -> Evidence:
    return replace(evidence, amplitude=None, temperature_c=None)


def _only(result: Reconciliation, kind: str) -> tuple[dict[str, float], dict[str, float]]:
    (named,) = result.named
    assert named.effect.kind == kind
    return numeric(named.effect), named.stderr


def test_amplitudes_make_share_and_path_of_multipath_certain(model: Model) -> None:
    evidence = recorded(model, MAKE["multipath"](surface="middle", share=0.03, extra_path_mm=1400.0), gain=7.5)
    part = evidence.part(fit=True, split="frames")
    found, errors = [], []
    for known in (evidence, _ranges_alone(evidence)):
        likelihood = joint_likelihood([(model, known)])
        start = likelihood.start()
        search = problems("multipath", likelihood, likelihood.scene.mixture())[1]  # of the second surface
        fitted = fit(search, likelihood, start, part)
        found.append(numeric(fitted.effect))
        state = replace(start, effects=(fitted.effect,))
        errors.append(standard_errors(Numbers(likelihood=likelihood, state=state, fits={0: fitted}, part=part))[0])
    for name, wanted in (("share", 0.03), ("extra_path_mm", 1400.0)):
        assert abs(found[0][name] - wanted) < 4 * errors[0][name]
        assert errors[0][name] < 0.12 * wanted  # of Student's law with 3 degrees: half its width at 2 nats, over 2
        assert abs(found[1][name] - wanted) > 0.2 * wanted  # noise alone hardly determines the part in phase


def test_wrong_amplitudes_of_the_model_hardly_change_the_likelihood(model: Model) -> None:
    wrong = {"near": 1.0, "middle": 1.2, "wall": 0.8}
    surfaces = tuple(replace(s, reflectivity=s.reflectivity * wrong[s.name]) for s in model.surfaces)
    rough = replace(model, surfaces=surfaces)
    side_information = amplitude_information(_ratios(rough, recorded(model, like=rough)), 7500.0)
    none, much = (MAKE["multipath"](surface="middle", share=f, extra_path_mm=7000.0) for f in (1e-4, 0.05))
    (middle,) = (w for w in side_information if w.surface == "middle")
    assert abs(middle.log_density(much) - middle.log_density(none)) < 1.0  # nats
    exact = amplitude_information(_ratios(model, recorded(model)), 7500.0)
    (middle,) = (w for w in exact if w.surface == "middle")
    assert middle.log_density(much) - middle.log_density(none) < -5.0


def _ratios(model: Model, evidence: Evidence) -> dict[str, float]:
    return log_ratios(model, evidence, Scene(model, evidence.time_s).mixture())


@pytest.mark.slow
def test_amplitude_walk_acts_on_recorded_amplitudes(model: Model) -> None:
    darker = tuple(replace(s, reflectivity=0.5 * s.reflectivity) if s.name == "wall" else s for s in model.surfaces)
    hidden = MAKE["amplitude_walk"](scale_mm=12.0, reference_amplitude=60.0, exponent=1.0)
    evidence = recorded(replace(model, surfaces=darker), hidden, like=model)
    settings = Settings(kinds=("amplitude_walk",), tolerance=0.0)
    with_amplitudes = reconcile(model, evidence, settings)
    found, _ = _only(with_amplitudes, "amplitude_walk")
    seen = 1000 * 0.3 / 1.2 / 4.2**2, 1000 * 0.9 / 1.2 / 1.4**2  # of the wall and of the near board, about
    for amplitude in seen:
        bias = found["scale_mm"] * (found["reference_amplitude"] / amplitude) ** found["exponent"]
        assert bias == pytest.approx(12.0 * 60.0 / amplitude, rel=0.07)
    blind = reconcile(model, _ranges_alone(evidence), settings)
    assert blind.verified.after.gap > 1.5 * with_amplitudes.verified.after.gap


def test_factors_of_brightness_change_amplitudes_and_no_range(model: Model) -> None:
    evidence = recorded(model)
    bright = as_bright_as_seen(model, {"near": 0.0, "middle": 0.5, "wall": -0.1})
    was, now = (Scene(m, evidence.time_s).mixture() for m in (model, bright))
    np.testing.assert_array_equal(was.mean, now.mean)
    np.testing.assert_array_equal(was.sigma, now.sigma)
    factor = np.array([1.0, np.exp(0.5), np.exp(-0.1), 1.0])[was.surface]
    np.testing.assert_allclose(now.amplitude, was.amplitude * factor)


def test_temperature_of_a_warm_up_gives_its_time_constant(model: Model) -> None:
    side_information = warm_up_information(recorded(model, warm=True))
    assert side_information is not None
    assert side_information.time_constant_s == pytest.approx(25.0, rel=0.01)


@pytest.mark.parametrize("law", ["constant", "steps", "noise"])
def test_temperature_without_a_warm_up_is_not_used(model: Model, rng: np.random.Generator, law: str) -> None:
    degrees = {
        "constant": np.full(FRAMES, 31.0),
        "steps": 30.0 + 4.0 * (np.arange(FRAMES) // 10 % 2),
        "noise": 30.0 + rng.normal(size=FRAMES),
    }[law]
    evidence = replace(recorded(model), temperature_c=degrees)
    assert warm_up_information(evidence) is None
    assert not [w for w in joint_likelihood([(model, evidence)]).side_information if hasattr(w, "time_constant_s")]
