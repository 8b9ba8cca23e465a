"""Optional parts of laws: named where they are hidden, and left out of recordings of the plain law."""

import numpy as np
import pytest
from support.recordings import MAKE, reconciled, recorded

from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.words import effect_tables, effect_text
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.temperature_drift import two_terms
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model

WAVE = {"amplitude_mm": 15.0, "phase_rad": 0.7}
DRIFT = {"amplitude_mm": 30.0, "time_constant_s": 3.0}
WALK = {"scale_mm": 30.0, "reference_amplitude": 100.0, "exponent": 1.0}
PARTS: dict[str, tuple[Effect, Effect, str]] = {
    "wiggling": (
        MAKE["wiggling"](**WAVE),
        MAKE["wiggling"](**WAVE, harmonics=((8.0, 9.0, 1.9),)),
        "harmonic_8_mm",
    ),
    "tap_mismatch": (
        MAKE["tap_mismatch"](amplitude_2_mm=15.0, phase_2_rad=0.7),
        MAKE["tap_mismatch"](amplitude_1_mm=20.0, phase_1_rad=2.5, amplitude_2_mm=15.0, phase_2_rad=0.7),
        "amplitude_1_mm",
    ),
    "temperature_drift": (
        MAKE["temperature_drift"](**DRIFT),
        MAKE["temperature_drift"](**DRIFT, amplitude_2_mm=-20.0, time_constant_2_s=0.4),
        "amplitude_2_mm",
    ),
}


@pytest.mark.parametrize("kind", PARTS)
def test_optional_part_is_named_where_it_is_hidden(small: Model, kind: str) -> None:
    _, hidden, part = PARTS[kind]
    (found,) = reconciled(small, hidden, kinds=(kind, "range_offset")).named
    assert found.effect.kind == kind
    error = found.stderr[part]
    assert abs(found.effect.numbers()[part] - hidden.numbers()[part]) < 4 * error
    assert error < 0.3 * abs(hidden.numbers()[part])


@pytest.mark.parametrize("kind", PARTS)
def test_plain_law_is_named_without_the_part(small: Model, kind: str) -> None:
    plain, _, part = PARTS[kind]
    (found,) = reconciled(small, plain, kinds=(kind, "range_offset")).named
    assert found.effect.kind == kind
    assert part not in found.stderr
    assert not found.effect.numbers().get(part)


def test_harmonics_are_in_the_sentence_and_in_the_model_that_is_written(small: Model) -> None:
    result = reconciled(small, PARTS["wiggling"][1], kinds=("wiggling",))
    (found,) = result.named
    assert "harmonic_8_mm" in effect_text(found, result)
    text = '[sensor]\nprofile = "sr3000"\n[[surface]]\ncenter_mm = [0, 0, 3000]\nsize_mm = [900, 900]\n'
    (again,) = parse_model(text + effect_tables(result), source="m").effects
    assert again.numbers() == pytest.approx(found.effect.numbers(), rel=1e-6)


def test_two_terms_of_a_course_in_time_are_near_the_true_ones() -> None:
    t = np.linspace(0, 100, 200)
    bias = 5 + 14 * -np.expm1(-t / 40) - 8 * -np.expm1(-t / 3)
    slow_mm, slow_s, fast_mm, fast_s = two_terms(t, bias, (0.5, 1000.0))[0]
    assert 10 < slow_mm < 20
    assert 20 < slow_s < 80
    assert -12 < fast_mm < -5
    assert 1.5 < fast_s < 6


@pytest.mark.parametrize("ratio", [1e-3, 1e3])
def test_saturation_far_from_all_amplitudes_is_another_effect(small: Model, ratio: float) -> None:
    evidence = recorded(small, MAKE["amplitude_walk"](**WALK))
    likelihood = Likelihood(evidence, Scene(small, evidence.time_s))
    _, saturating = problems("amplitude_walk", likelihood, likelihood.scene.mixture())
    assert saturating.other is not None
    assert saturating.other(np.array([0.5, 1.0, np.log(ratio)]))
    assert not saturating.other(np.array([0.5, 1.0, 0.0]))
