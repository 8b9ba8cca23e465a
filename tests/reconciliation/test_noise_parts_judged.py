"""Noise with a shape, widths and a background: reconcile judges with them, and finds what else is there."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.noise_parts import long_tailed, skewed, with_noise
from support.recordings import MAKE, recorded, simulated

from tofmix.errors import BadInputError
from tofmix.reconciliation.comparison.compare import disagreements
from tofmix.reconciliation.likelihood.hidden_states import begin
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.events import drawn_widths
from tofmix.simulation.model import Model

RIVALS = ("range_offset", "surface_pose", "excess_noise", "fixed_pattern", "outliers", "temperature_drift")
PARTS: dict[str, dict[str, Any]] = {
    "shape": {"shape": skewed()},
    "background": {"background": np.array(0.05)},
    "widths": {"width_spread": 0.2},
    "all": {"shape": skewed(), "background": np.array(0.05), "width_spread": 0.2},
    "all, strong": {
        "shape": long_tailed(),
        "background": np.linspace(0.0, 0.6, 252).reshape(14, 18),
        "width_spread": 0.4,
    },
}


def outcome(
    model: Model, real: Model, *hidden: Effect, seed: int = 5, kinds: tuple[str, ...] = RIVALS
) -> Reconciliation:
    """Hold a recording of one model, which has these effects, against another."""
    evidence = simulated(real, hidden, seed, real.recording.frames)
    return reconcile(model, evidence, Settings(kinds=kinds))


@pytest.mark.parametrize("name", PARTS)
def test_recording_agrees_with_a_model_that_has_its_noise(small: Model, name: str) -> None:
    has = with_noise(small, **PARTS[name])
    result = outcome(has, has)
    assert result.verified.verdict == "agree"
    assert result.verified.before.gap < 1.3  # noise alone gives 1
    assert result.verified.floor.gap < 1.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "real", "statistics"),
    [
        ({}, PARTS["shape"], {"skew"}),
        pytest.param(PARTS["shape"], {}, {"skew"}),
        pytest.param({}, PARTS["widths"], {"spread_pattern"}),
        pytest.param(PARTS["widths"], {"width_spread": 0.4}, {"widths"}),
        (PARTS["widths"], {}, {"widths"}),
        pytest.param(PARTS["all"], PARTS["all"] | {"shape": None}, {"skew"}),
    ],
)
def test_model_with_other_noise_does_not_agree(
    small: Model, model: dict[str, Any], real: dict[str, Any], statistics: set[str]
) -> None:
    result = outcome(with_noise(small, **model), with_noise(small, **real))
    assert result.verified.verdict == "unexplained"
    loud = {curve.statistic for curve in disagreements(result.verified.before, 0.01)}
    assert statistics <= loud


def test_background_that_the_model_lacks_is_named_as_outliers(small: Model) -> None:
    result = outcome(small, with_noise(small, **PARTS["background"]))
    assert result.verified.verdict == "explained"
    (named,) = result.named
    assert named.effect.kind == "outliers"
    assert named.parameters["probability"] == pytest.approx(0.05, abs=4 * named.stderr["probability"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        (MAKE["range_offset"](offset_mm=8.0), "offset_mm"),
        (MAKE["interference"](probability=0.3, sigma_mm=30.0, burst_frames=3.0), "sigma_mm"),
        (MAKE["outliers"](probability=0.03), "probability"),
    ],
    ids=lambda value: getattr(value, "kind", value),
)
def test_effect_with_all_noise_parts_is_found_with_its_number(small: Model, hidden: Effect, name: str) -> None:
    has = with_noise(small, **PARTS["all"])
    result = outcome(has, has, hidden, kinds=(*RIVALS, "interference"))
    assert result.verified.verdict == "explained"
    (named,) = result.named
    assert named.effect.kind == hidden.kind
    assert named.parameters[name] == pytest.approx(getattr(hidden, name), abs=4 * named.stderr[name])


@pytest.mark.parametrize("name", ["widths", "all, strong"])
def test_widths_are_found_with_their_errors(small: Model, name: str) -> None:
    has = with_noise(small, **PARTS[name])
    likelihood = joint_likelihood(((has, recorded(has, seed=9)),))
    state = begin(likelihood, fit_part(likelihood, Settings(kinds=RIVALS))[0], 0.1)
    drawn = drawn_widths(has.sensor, seed=9)
    assert drawn is not None
    true = np.log(drawn)
    off = (state.log_width[0] - true) / state.log_width_error[0]
    assert abs(off.mean()) < 4 / np.sqrt(off.size)
    assert off.std() == pytest.approx(1.0, abs=0.15)  # a standard error is 0.045
    assert state.log_width_error.max() <= 1.01 * has.sensor.noise.width_spread
    assert np.corrcoef(state.log_width[0], true)[0, 1] > 0.8


def test_background_with_a_memory_is_refused(small: Model) -> None:
    has = replace(with_noise(small, **PARTS["background"]), effects=(MAKE["temporal_correlation"](coefficient=0.5),))
    with pytest.raises(BadInputError, match=r"background of .* beside temporal_correlation"):
        reconcile(has, recorded(small), Settings(kinds=RIVALS))


def test_shape_with_a_memory_agrees(small: Model) -> None:
    has = replace(with_noise(small, **PARTS["shape"]), effects=(MAKE["temporal_correlation"](coefficient=0.5),))
    assert outcome(has, has, *has.effects, kinds=("range_offset", "temporal_correlation")).verified.verdict == "agree"
