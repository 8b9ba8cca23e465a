"""Noise by the angle of incidence, and of a second camera that is always on or beats: named, and told from a factor."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.recordings import MAKE, Record, reconciled

from tofmix.reconciliation.likelihood.beats import FrameNoise, beat_errors, fit_beat, overlaps
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.sensor import NoiseCurve
from tofmix.simulation.effects import Effect, PixelMap
from tofmix.simulation.effects.hidden import FrameChain
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

KINDS = ("excess_noise", "vignetting", "interference", "range_offset", "surface_pose")
STEEP = Surface(name="steep", center_mm=(-300.0, 0.0, 2600.0), size_mm=(9000.0, 7000.0), yaw_deg=50.0, reflectivity=0.8)
FACING = Surface(name="facing", center_mm=(0.0, 0.0, 2600.0), size_mm=(9000.0, 7000.0), reflectivity=0.8)


def named(model: Model, hidden: Effect, **settings: Any) -> list[tuple[Effect, dict[str, float]]]:  # noqa: ANN401
    found = reconciled(model, hidden, kinds=KINDS, **settings)
    assert found.verified.verdict == "explained"
    return [(n.effect, n.stderr) for n in found.named]


def within(found: float, wanted: float, error: float) -> bool:
    return bool(abs(found - wanted) < 3 * error)


@pytest.mark.slow
def test_noise_by_angle_of_a_steep_wall_is_named_with_its_exponent(small: Model) -> None:
    hidden: Any = MAKE["excess_noise"](factor=1.0, angle_exponent=0.8)
    ((effect, error),) = named(replace(small, surfaces=(STEEP,)), hidden)
    numbers = effect.numbers()
    assert effect.kind == "excess_noise"
    assert within(numbers["angle_exponent"], 0.8, error["angle_exponent"])
    assert within(numbers["factor"], 1.0, error["factor"])
    assert error["angle_exponent"] < 0.1


@pytest.mark.slow
def test_noise_that_is_added_to_one_sigma_is_a_factor_with_interference_as_an_alias(small: Model) -> None:
    """One sigma in the image: nothing tells a sum from a product, and more light is the commoner cause."""
    alike = replace(small.sensor, noise=NoiseCurve(np.array([500.0, 6000.0]), np.array([10.0, 10.0])))
    wall = replace(small, surfaces=(FACING,), sensor=alike)
    found = reconciled(wall, MAKE["interference"](probability=1.0, sigma_mm=20.0), kinds=KINDS)
    assert found.verified.verdict == "explained"
    assert [n.effect.kind for n in found.named] == ["excess_noise"]
    assert [(("excess_noise", ""),), (("interference", ""),)] in [list(alias.sets) for alias in found.aliases]


@pytest.mark.slow
@pytest.mark.parametrize(
    "hidden",
    [MAKE["interference"](probability=1.0, sigma_mm=20.0), MAKE["excess_noise"](factor=2.2)],
    ids=lambda e: e.kind,
)
def test_sum_is_told_from_product_before_one_facing_wall_if_sigma_is_a_fifth_more_in_corners(
    small: Model, hidden: Effect
) -> None:
    """The corners are farther: sigma is 9.8 to 12.0 mm, which a sum makes 22.3 to 23.3 mm and a product 22 to 26."""
    ((effect, _),) = named(replace(small, surfaces=(FACING,)), hidden)
    assert effect.kind == hidden.kind


@pytest.mark.slow
def test_beat_is_named_with_its_period(small: Model) -> None:
    hidden = MAKE["interference"](probability=0.6, sigma_mm=60.0, period_frames=23.0)
    ((effect, error),) = named(small, hidden)
    assert effect.kind == "interference"
    found: Any = effect
    assert within(found.period_frames, 23.0, error["period_frames"])
    assert within(found.probability, 0.6, error["probability"])
    assert within(found.sigma_mm, 60.0, error["sigma_mm"])
    assert error["period_frames"] < 0.5


def noise_of(model: Model, record: Record, *hidden: Effect) -> FrameNoise:
    evidence = record(*hidden)
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    everything = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    return FrameNoise(likelihood, likelihood.scene.mixture(), likelihood.start(), everything)


@pytest.mark.parametrize(
    "hidden",
    [
        (),
        (MAKE["interference"](probability=1.0, sigma_mm=25.0),),
        (MAKE["excess_noise"](factor=1.5),),
    ],
    ids=["none", "always", "factor"],
)
def test_frames_of_the_same_noise_have_no_beat(model: Model, record: Record, hidden: tuple[Effect, ...]) -> None:
    assert fit_beat(noise_of(model, record, *hidden)) is None


def test_beat_is_fitted_with_its_errors_and_overlaps(model: Model, record: Record) -> None:
    hidden = MAKE["interference"](probability=0.5, sigma_mm=50.0, period_frames=31.0)
    noise = noise_of(model, record, hidden)
    found, errors = beat_errors(noise, FrameChain(0.5, 50.0, 1.0, 31.0))
    wanted = (0.5, 50.0, 31.0)
    for value, true, error in zip((found[0], found[1], found[3]), wanted, errors, strict=True):
        assert within(value, true, error)
        assert 0 < error < 0.1 * true
    square = overlaps(noise, found)
    assert square.max() > 0.8
    assert (square == 0).mean() == pytest.approx(0.5, abs=0.1)
    true = noise.of_beat(FrameChain(0.5, 50.0, 1.0, 31.0), 0.0)
    fitted = fit_beat(noise)
    assert fitted is not None
    assert noise.of_beat(*fitted) > true - 1e-6


def test_curves_of_a_frame_are_its_log_likelihood_with_added_noise(model: Model, record: Record) -> None:
    """Between the sizes of the grid too, to a twentieth of a nat a frame."""
    evidence = record(MAKE["interference"](probability=0.4, sigma_mm=40.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    mixture, state = likelihood.scene.mixture(), likelihood.start()
    part = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    noise = FrameNoise(likelihood, mixture, state, part)
    added = np.random.default_rng(1).uniform(0, 150, evidence.shape[0])
    exact = likelihood.sums(mixture, state, part, variance=added**2).total
    assert noise.of(added[None])[0] == pytest.approx(exact, abs=0.05 * evidence.shape[0])


def lit_part(model: Model) -> np.ndarray:
    """A Gaussian left of and above the centre, by rows and columns: radii of 8 rows and 9 columns."""
    row, col = np.indices(model.sensor.shape)
    rows, cols = model.sensor.shape
    away = ((row - 0.4 * rows) / 8.0) ** 2 + ((col - 0.35 * cols) / 9.0) ** 2
    return np.asarray(np.exp(-0.5 * away), dtype=np.float32)


@pytest.mark.slow
def test_second_camera_that_is_always_on_in_a_part_of_the_image_is_named_there(small: Model) -> None:
    """Not as noise of the board behind the part. The truth is a map, the law that is found has a place and radii."""
    hidden = MAKE["interference"](probability=1.0, sigma_mm=25.0, map=PixelMap(path="part.npy", values=lit_part(small)))
    ((effect, error),) = named(small, hidden)
    rows, cols = small.sensor.shape
    half = 0.5 * np.hypot(rows - 1, cols - 1)
    wanted = {
        "sigma_mm": 25.0,
        "spot_across": (0.35 * cols - 0.5 * (cols - 1)) / half,
        "spot_down": (0.4 * rows - 0.5 * (rows - 1)) / half,
        "spot_radius_across": 9.0 / half,
        "spot_radius_down": 8.0 / half,
    }
    assert effect.kind == "interference"
    assert effect.numbers()["probability"] == 1
    for name, value in wanted.items():
        assert within(effect.numbers()[name], value, error[name]), name


@pytest.mark.slow
def test_sun_on_a_part_of_the_image_is_named_there(small: Model) -> None:
    factor = np.sqrt(1 + (2.5**2 - 1) * lit_part(small))
    hidden = MAKE["excess_noise"](factor=1.0, map=PixelMap(path="part.npy", values=factor.astype(np.float32)))
    ((effect, error),) = named(small, hidden)
    assert effect.kind == "excess_noise"
    assert within(effect.numbers()["factor"], 2.5, error["factor"])
    half = 0.5 * np.hypot(small.sensor.rows - 1, small.sensor.cols - 1)
    assert within(effect.numbers()["spot_radius_across"], 9.0 / half, error["spot_radius_across"])
