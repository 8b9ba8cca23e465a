"""Effects that move ranges and leave sigma: the same samples, moved by the closed form, frame by frame."""

from typing import Any

import numpy as np
import pytest
from support.effect_bench import Bench, Floats, Recorded, effect

from tofmix.circle import unambiguous_range_mm
from tofmix.simulation.effects import PixelMap

TURN = unambiguous_range_mm(20e6)
ROUNDING = 1.0  # two samples, each rounded to 1 mm
MAP = np.random.default_rng(0).normal(0, 30, (6, 40)).astype(np.float32)


def moved(bench: Bench, plain_wall: Recorded, kind: str, **parameters: object) -> tuple[Floats, Recorded]:
    """How far each sample moved, and the recording."""
    other = bench.wall(effect(kind, **parameters))
    np.testing.assert_array_equal(other.amplitude, plain_wall.amplitude)
    return other.range_mm - plain_wall.range_mm, other


@pytest.mark.parametrize("offset", [0.0, 17.0, -250.0])
def test_offset_moves_every_range(bench: Bench, plain_wall: Recorded, offset: float) -> None:
    np.testing.assert_array_equal(moved(bench, plain_wall, "range_offset", offset_mm=offset)[0], offset)


@pytest.mark.parametrize("amplitude", [0.0, 12.0, 60.0])
@pytest.mark.parametrize("phase", [0.0, 2.0])
def test_wiggling_swings_four_times_a_turn(bench: Bench, plain_wall: Recorded, amplitude: float, phase: float) -> None:
    bias, plain = moved(bench, plain_wall, "wiggling", amplitude_mm=amplitude, phase_rad=phase)
    expected = amplitude * np.sin(2 * np.pi * plain.true_mm / (TURN / 4) + phase)
    np.testing.assert_allclose(bias, np.broadcast_to(expected, bias.shape), atol=ROUNDING)
    assert np.ptp(plain.true_mm) > TURN / 2  # two periods are seen


def test_harmonics_are_further_sines_of_the_range_before_any_bias(bench: Bench, plain_wall: Recorded) -> None:
    sines = ((8.0, 20.0, 1.9), (12.0, 9.0, -0.4))
    bias, plain = moved(bench, plain_wall, "wiggling", amplitude_mm=30.0, phase_rad=0.5, harmonics=sines)
    turns = plain.true_mm / TURN
    expected = sum(mm * np.sin(2 * np.pi * p * turns + rad) for p, mm, rad in ((4.0, 30.0, 0.5), *sines))
    np.testing.assert_allclose(bias, np.broadcast_to(expected, bias.shape), atol=ROUNDING)


def test_unequal_taps_swing_once_and_twice_a_turn(bench: Bench, plain_wall: Recorded) -> None:
    numbers = {"amplitude_1_mm": 40.0, "phase_1_rad": 1.0, "amplitude_2_mm": 20.0, "phase_2_rad": -0.5}
    bias, plain = moved(bench, plain_wall, "tap_mismatch", **numbers)
    turn = 2 * np.pi * plain.true_mm / TURN
    expected = 40 * np.sin(turn + 1.0) + 20 * np.sin(2 * turn - 0.5)
    np.testing.assert_allclose(bias, np.broadcast_to(expected, bias.shape), atol=ROUNDING)


@pytest.mark.parametrize(("scale", "exponent"), [(0.0, 1.0), (10.0, 1.0), (-8.0, 0.5), (20.0, 0.0)])
def test_walk_is_a_power_of_the_amplitude(bench: Bench, plain_wall: Recorded, scale: float, exponent: float) -> None:
    parameters = {"scale_mm": scale, "reference_amplitude": 100.0, "exponent": exponent}
    bias, plain = moved(bench, plain_wall, "amplitude_walk", **parameters)
    expected = scale * (100.0 / plain.true_amplitude) ** exponent
    np.testing.assert_allclose(bias, np.broadcast_to(expected, bias.shape), atol=ROUNDING)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_saturating_walk_is_a_power_of_a_larger_amplitude(bench: Bench, plain_wall: Recorded, exponent: float) -> None:
    numbers = {"scale_mm": 20.0, "reference_amplitude": 100.0, "exponent": exponent, "saturation_amplitude": 80.0}
    bias, plain = moved(bench, plain_wall, "amplitude_walk", **numbers)
    expected = 20.0 * (100.0 / (plain.true_amplitude + 80.0)) ** exponent
    np.testing.assert_allclose(bias, np.broadcast_to(expected, bias.shape), atol=ROUNDING)


def test_walk_of_no_amplitude_is_bounded(bench: Bench) -> None:
    walk = effect("amplitude_walk", scale_mm=5.0, reference_amplitude=100.0, exponent=4.0)
    assert (bench.wall(walk, integration_time_ms=1e-9, exponent=0.0).stored == 65_534).all()


@pytest.mark.parametrize("amplitude", [0.0, 40.0, -15.0])
def test_drift_settles_exponentially(bench: Bench, plain_wall: Recorded, amplitude: float) -> None:
    bias, _ = moved(bench, plain_wall, "temperature_drift", amplitude_mm=amplitude, time_constant_s=0.7)
    time = np.arange(len(bias)) / 10.0
    expected = amplitude * (1 - np.exp(-time / 0.7))
    np.testing.assert_allclose(bias, np.broadcast_to(expected[:, np.newaxis], bias.shape), atol=ROUNDING)


def test_a_map_moves_each_pixel_by_its_value(bench: Bench, plain_wall: Recorded) -> None:
    bias, _ = moved(bench, plain_wall, "fixed_pattern", map=PixelMap("", MAP))
    np.testing.assert_allclose(bias, np.broadcast_to(MAP.ravel(), bias.shape), atol=ROUNDING)


@pytest.mark.parametrize("sigma", [0.0, 5.0, 40.0])
@pytest.mark.parametrize("part", ["pixel", "column", "row"])
def test_a_pattern_is_drawn_with_its_spread(bench: Bench, part: str, sigma: float) -> None:
    """Each part alone, 100 columns and rows of a sensor without noise to speak of."""
    one = effect("fixed_pattern", **{f"{part}_sigma_mm": sigma})
    wide: dict[str, Any] = {"rows": 100, "cols": 100, "exponent": 9.0, "reference_integration_time_ms": 0.12}
    moved = bench.wall(one, frames=1, **wide).range_mm - bench.wall(frames=1, **wide).range_mm
    image = moved.reshape(100, 100)
    drawn = {"pixel": image, "column": image.mean(axis=0), "row": image.mean(axis=1)}[part]
    residual = image - {"pixel": image, "column": drawn, "row": drawn[:, np.newaxis]}[part]
    assert abs(residual).max() <= ROUNDING
    tolerance = 4 * sigma / (2 * drawn.size) ** 0.5 + 0.3 * (part == "pixel")
    assert drawn.std() == pytest.approx(sigma, abs=tolerance + 0.05)


@pytest.mark.parametrize("kind", ["range_offset", "wiggling", "temperature_drift"])
def test_no_return_and_random_values_stay_as_they_are(bench: Bench, kind: str) -> None:
    parameters: dict[str, Any] = {
        "range_offset": {"offset_mm": 500},
        "wiggling": {"amplitude_mm": 500, "phase_rad": 1},
        "temperature_drift": {"amplitude_mm": 500, "time_constant_s": 1e-3},
    }
    plain, other = bench.boards(), bench.boards(effect(kind, **parameters[kind]))
    dark = plain.amplitude == 0
    assert dark.any()
    np.testing.assert_array_equal(other.stored[dark], plain.stored[dark])
    assert (other.stored[1:] != plain.stored[1:])[~dark[1:]].mean() > 0.9
