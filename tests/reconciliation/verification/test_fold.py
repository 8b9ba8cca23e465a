"""A folded range axis, and biases of pixels in images of few pixels: a wall at a stated distance."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.measured_parts.walls import FRAMES, RATE_HZ, draw

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.likelihood.hidden_fits import fit_pattern
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.pixel_pattern import spreads_of
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verification.fold import fold
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects.phase_wrapping import PhaseWrapping
from tofmix.simulation.model import Model

SEED = 20261128
KINDS = ("range_offset", "surface_pose", "multipath", "phase_wrapping", "fixed_pattern", "excess_noise")


def case(number: int, *, wraps: bool) -> tuple[Model, Evidence]:
    """A case of the benchmark whose model wraps, or does not."""
    drawn = draw(SEED, number)
    turn = drawn.model.sensor.turn_mm("test")
    effects = (PhaseWrapping(unambiguous_range_mm=turn),) if wraps else ()
    model = replace(drawn.model, effects=effects)
    return model, make_evidence(model, drawn.range_mm, time_s=np.arange(FRAMES) / RATE_HZ)


def everything(evidence: Evidence) -> Any:  # noqa: ANN401
    frames, pixels = evidence.shape
    return np.arange(frames), np.arange(pixels)


@pytest.mark.parametrize("number", [1, 2, 5, 38])
def test_fold_is_found_whatever_the_biases_and_not_where_the_model_wraps(number: int) -> None:
    """Case 5 has a sigma of 2 mm under biases of 10: the fold alone is no better than random values."""
    for wraps in (False, True):
        likelihood = joint_likelihood([case(number, wraps=wraps)])
        found = fold(likelihood, likelihood.start(), everything(likelihood.evidence))
        assert (found is None) == wraps


def test_wall_that_stands_metres_nearer_than_the_model_before_the_turn_has_no_fold() -> None:
    model, evidence = case(2, wraps=False)
    turn = model.sensor.turn_mm("test")
    near = tuple(replace(s, center_mm=(0.0, 0.0, 0.8 * turn)) for s in model.surfaces)
    likelihood = joint_likelihood([(replace(model, surfaces=near), evidence)])
    assert fold(likelihood, likelihood.start(), everything(evidence)) is None


@pytest.mark.parametrize("wraps", [False, True])
def test_surfaces_whose_samples_lie_on_both_sides_of_the_fold_have_one_bias(wraps: bool) -> None:
    """The wall stands at the turn itself: an offset puts half of the samples at the other end of the axis."""
    model, _ = case(2, wraps=wraps)
    turn = model.sensor.turn_mm("test")
    at = tuple(replace(s, center_mm=(0.0, 0.0, turn)) for s in model.surfaces)
    rng = np.random.default_rng(3)
    there = replace(model, surfaces=at)
    mean = joint_likelihood([(there, case(2, wraps=wraps)[1])]).scene.mixture()
    true = (mean.of_main(mean.true_range) - 15.0 + rng.normal(0, 12.0, (FRAMES, 34))) % turn
    evidence = make_evidence(there, np.maximum(np.rint(true), 1).reshape(FRAMES, 1, 34).astype(np.float32))
    found = reconcile(there, evidence, Settings(kinds=KINDS)).as_dict()
    assert found["verdict"] == "explained"
    kinds = {e["kind"] for e in found["effects"]} - {"phase_wrapping"}
    assert kinds <= {"range_offset", "surface_pose"}
    (size,) = (abs(v) for e in found["effects"] for n, v in e["parameters"].items() if n in ("offset_mm", "shift_mm"))
    assert size == pytest.approx(15.0, abs=2.0)


@pytest.mark.parametrize("image", [(1, 8), (8, 1), (4, 4), (1, 24)])
def test_spread_of_biases_is_found_in_images_of_few_pixels(image: tuple[int, int]) -> None:
    model, _ = case(2, wraps=False)
    small = replace(model, sensor=replace(model.sensor, rows=image[0], cols=image[1]))
    rng = np.random.default_rng(7)
    pattern = rng.normal(0, 40.0, image)
    mixture = joint_likelihood([(small, make_evidence(small, np.full((FRAMES, *image), 9000.0)))]).scene.mixture()
    mean = mixture.of_main(mixture.mean).reshape(image)
    evidence = make_evidence(small, mean + pattern + rng.normal(0, 12.0, (FRAMES, *image)))
    likelihood = joint_likelihood([(small, evidence)])
    found = fit_pattern(likelihood, likelihood.mixture(likelihood.start()), likelihood.start(), everything(evidence))
    assert found is not None
    effect = found[0]
    whole = np.hypot(np.hypot(effect.pixel_sigma_mm, effect.column_sigma_mm), effect.row_sigma_mm)
    assert whole == pytest.approx(np.sqrt((pattern**2).mean()), rel=0.3)
    assert spreads_of(image) == (3 if min(image) > 1 else 1)
    if min(image) == 1:
        assert effect.column_sigma_mm == effect.row_sigma_mm == 0.0


def test_equal_pixels_have_no_spread_beyond_the_error_of_their_means() -> None:
    model, _ = case(2, wraps=False)
    mixture = joint_likelihood([case(2, wraps=False)]).scene.mixture()
    rng = np.random.default_rng(7)
    ranges = mixture.of_main(mixture.mean) + rng.normal(0, model.sensor.noise.sigma_mm[0], (FRAMES, 34))
    evidence = make_evidence(model, ranges.reshape(FRAMES, 1, 34))
    likelihood = joint_likelihood([(model, evidence)])
    start = likelihood.start()
    found = fit_pattern(likelihood, likelihood.mixture(start), start, everything(evidence))
    assert found is None or found[0].pixel_sigma_mm < model.sensor.noise.sigma_mm[0] / np.sqrt(FRAMES)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_offset_beside_biases_of_one_row_is_named_with_the_error_of_their_mean(number: int) -> None:
    """The bias of the only row is an offset, and the bias of a column is that of its pixel: no further numbers."""
    model, evidence = case(number, wraps=True)
    found = reconcile(model, evidence, Settings(kinds=KINDS)).as_dict()
    assert found["verdict"] == "explained"
    errors = {e["kind"]: e["stderr"] for e in found["effects"]}
    assert set(errors["fixed_pattern"]) == {"pixel_sigma_mm"}
    pixels = evidence.shape[1]
    assert errors["fixed_pattern"]["pixel_sigma_mm"] == pytest.approx(10.0 / np.sqrt(2 * pixels), rel=0.5)
    (error,) = (
        e.get("offset_mm", e.get("shift_mm")) for k, e in errors.items() if k in ("range_offset", "surface_pose")
    )
    assert error == pytest.approx(10.0 / np.sqrt(pixels), rel=0.5)
