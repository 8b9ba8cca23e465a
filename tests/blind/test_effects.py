"""Each mechanism's equivalent, held against what the camera itself does."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from blind import effects as fx
from blind.camera import Device, Mechanism, Recording, record
from blind.effects import Effect, Place
from blind.geometry import Array, Surface, cast
from blind.scenes import TARGET
from blind.strangers import STRANGERS, make_stranger
from blind.strength import KINDS, UNITS, make

DEVICE = Device(
    name="test camera", rows=24, cols=32, frames=150, noise_linear=1.0, noise_square=0.6, outlier_probability=0.0
)
SCENE = [
    Surface(name=TARGET, center_mm=(-450.0, 0.0, 2200.0), size_mm=(1500.0, 1500.0), yaw_deg=45.0, reflectivity=0.7),
    Surface(name="near", center_mm=(500.0, -100.0, 1300.0), size_mm=(450.0, 500.0), reflectivity=0.9),
    Surface(name="wall", center_mm=(0.0, 0.0, 4500.0), size_mm=(20000.0, 20000.0), yaw_deg=5.0, reflectivity=0.5),
]
BEAMS = cast(SCENE, DEVICE.view)
PLACE = Place(device=DEVICE, surfaces=SCENE, beams=BEAMS)
MAIN = ((BEAMS.share[0] == 1) & (BEAMS.nothing == 0)).reshape(24, 32)  # pixels of one surface
RANGE = BEAMS.range_mm[0].reshape(24, 32)
SURFACE = BEAMS.surface[0].reshape(24, 32)
SIGMA = DEVICE.design_sigma(RANGE)
AMPLITUDE = (
    DEVICE.amplitude(BEAMS.range_mm[0], np.array([0.7, 0.9, 0.5])[BEAMS.surface[0]] * BEAMS.cosine[0])
    * DEVICE.amplitude_unit
).reshape(24, 32)


def pair(mechanism: Mechanism, seed: int = 3) -> tuple[Recording, Recording]:
    """A recording with the mechanism, and one without from the same seed."""
    return record(DEVICE, SCENE, (mechanism,), seed=seed), plain(seed)


@cache
def plain(seed: int) -> Recording:
    """A recording without any mechanism."""
    return record(DEVICE, SCENE, (), seed=seed)


def bias(mechanism: Mechanism) -> Array:
    """Mean change of range (row, col); the same noise is in both recordings, so that it nearly cancels."""
    with_it, without = pair(mechanism)
    return np.asarray((with_it.range_mm - without.range_mm).mean(axis=0))


def _offset(p: dict[str, float]) -> Array:
    return np.full(RANGE.shape, p["offset_mm"])


def _wave(p: dict[str, float]) -> Array:
    turn = 2 * math.pi * RANGE / DEVICE.unambiguous_mm
    bias = p["amplitude_mm"] * np.sin(4 * turn + p["phase_rad"])
    if "harmonics" in p:
        periods, mm, rad = np.array(p["harmonics"])[0]
        bias += mm * np.sin(periods * turn + rad)
    return np.asarray(bias)


def _taps(p: dict[str, float]) -> Array:
    turn = 2 * math.pi * RANGE / DEVICE.unambiguous_mm
    once = p["amplitude_1_mm"] * np.sin(turn + p["phase_1_rad"])
    return np.asarray(once + p["amplitude_2_mm"] * np.sin(2 * turn + p["phase_2_rad"]))


def _walk(p: dict[str, float]) -> Array:
    return np.asarray(
        p["scale_mm"] * (p["reference_amplitude"] / (AMPLITUDE + p["saturation_amplitude"])) ** p["exponent"]
    )


def _drift(p: dict[str, float]) -> Array:
    t = np.arange(DEVICE.frames) / DEVICE.frame_rate_hz
    bias = p["amplitude_mm"] * -np.expm1(-t / p["time_constant_s"])
    if "amplitude_2_mm" in p:
        bias += p["amplitude_2_mm"] * -np.expm1(-t / p["time_constant_2_s"])
    return np.full(RANGE.shape, bias.mean())


def _turned(change: Array) -> Array:
    """Range bias where z becomes z times `change`."""
    return np.asarray(DEVICE.unambiguous_mm / (2 * math.pi) * np.angle(change))


def _stray(p: dict[str, float]) -> Array:
    reflectivity = np.array([0.7, 0.9, 0.5])
    z = DEVICE.amplitude(BEAMS.range_mm, reflectivity[BEAMS.surface] * BEAMS.cosine) * DEVICE.phasor(BEAMS.range_mm)
    veil = np.where(BEAMS.share > 0, BEAMS.share * z, 0).sum(axis=0).mean()
    return _turned(1 + p["share"] * veil / z[0]).reshape(24, 32)


def _bounce(p: dict[str, float]) -> Array:
    turn = np.exp(1j * math.pi * p["extra_path_mm"] / DEVICE.unambiguous_mm)
    return np.where(SURFACE == 0, _turned(1 + p["share"] * turn), 0.0)


def _wax(p: dict[str, float]) -> Array:
    return np.where(SURFACE == 0, p["offset_mm"], 0.0)


def _glare(p: dict[str, float]) -> Array:
    window = p["amplitude"] * np.exp(2j * math.pi * p["range_mm"] / DEVICE.unambiguous_mm)
    return _turned(1 + window / (AMPLITUDE * DEVICE.phasor(RANGE)))


@pytest.mark.parametrize(
    ("mechanism", "law"),
    [
        (fx.CableDelay(delay_ps=80.0), _offset),
        (fx.Harmonics(third=0.01, third_phase=1.0, fifth=0.003, fifth_phase=2.5), _wave),
        (
            fx.Harmonics(third=0.01, third_phase=1.0, fifth=0.003, fifth_phase=2.5, ninth=0.004, ninth_phase=2.0),
            _wave,
        ),
        (fx.UnequalTaps(gain=0.01, common=0.004 + 0.003j, clock_rad=0.7), _taps),
        (fx.UnequalTaps(gain=0.0, common=-0.006j, clock_rad=2.0), _taps),
        (fx.ChargeLag(late_mm=60.0, knee_amplitude=15.0), _walk),
        (fx.ChargeLag(late_mm=30.0, knee_amplitude=200.0), _walk),
        (fx.WarmUp(delay_mm_per_kelvin=0.8, rise_kelvin=15.0, time_constant_s=2.0), _drift),
        (
            fx.WarmUp(
                delay_mm_per_kelvin=1.6, rise_kelvin=15.0, time_constant_s=2.0, chip_mm=-7.0, chip_time_constant_s=0.3
            ),
            _drift,
        ),
        (fx.StrayLight(share=0.01), _stray),
        (fx.SecondBounce(surface=TARGET, share=0.04, extra_path_mm=1500.0), _bounce),
        (fx.WindowGlare(glare_electrons=12_000.0, way_mm=60.0), _glare),
        (fx.WaxBoard(surface=TARGET, depth_mm=35.0), _wax),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_bias_of_a_mechanism_is_that_of_its_equivalent(
    mechanism: Effect, law: Callable[[dict[str, float]], Array]
) -> None:
    """Within 4 % of the largest bias, and what the noise leaves; in units of sigma, as samples know them."""
    seen, wanted = bias(mechanism)[MAIN] / SIGMA[MAIN], law(mechanism.equivalent(PLACE))[MAIN] / SIGMA[MAIN]
    assert np.abs(wanted * SIGMA[MAIN]).max() > 3
    noise = 0.5 / math.sqrt(DEVICE.frames) / SIGMA[MAIN] + 0.02  # rounding, and noise that the mechanism turns
    assert (np.abs(seen - wanted) < 0.04 * np.abs(wanted).max() + 4 * noise).all()
    wanted, seen = wanted * SIGMA[MAIN], seen * SIGMA[MAIN]
    assert np.ptp(wanted) < 1e-9 or np.corrcoef(seen, wanted)[0, 1] > 0.97


def test_delay_of_each_pixel_is_that_of_the_map() -> None:
    lines = fx.DelayLines(pixel_mm=5.0, column_mm=2.0, row_mm=1.0, wafer=4)
    np.testing.assert_allclose(bias(lines)[MAIN], lines.map(DEVICE)[MAIN], atol=0.25)


@pytest.mark.parametrize("along", ["across", "down"])
def test_delay_of_a_clock_line_is_the_polynomial_of_its_equivalent(along: str) -> None:
    line = fx.FeedLine(rc_mm=40.0, along=along)
    of = line.equivalent(PLACE)
    x, y = np.meshgrid(np.arange(32) - 15.5, np.arange(24) - 11.5)
    place = (x if along == "across" else y) / np.hypot(15.5, 11.5)
    law = of[f"{along}_mm"] * place + of[f"{along}_2_mm"] * place**2
    np.testing.assert_allclose(bias(line)[MAIN], law[MAIN], atol=0.3)


def test_moved_board_changes_ranges_as_its_pose_says() -> None:
    moved = fx.MisplacedBoard(surface="wall", shift_mm=40.0)
    far = (SURFACE == 2) & MAIN
    wanted = 40.0 / BEAMS.cosine[0].reshape(24, 32)
    np.testing.assert_allclose(bias(moved)[far], wanted[far], atol=0.6)
    assert np.abs(bias(moved)[(SURFACE == 1) & MAIN]).max() < 0.05


def test_moving_board_is_where_its_velocity_takes_it() -> None:
    mechanism = fx.MovingBoard(surface="wall", velocity_mm_s=20.0)
    with_it, without = pair(mechanism)
    far = (SURFACE == 2) & MAIN
    last = (with_it.range_mm - without.range_mm)[-20:].mean(axis=0)[far]
    time = (DEVICE.frames - 10.5) / DEVICE.frame_rate_hz
    np.testing.assert_allclose(last.mean(), (20.0 * time / BEAMS.cosine[0].reshape(24, 32)[far]).mean(), atol=4.0)


def _ratio(mechanism: Mechanism) -> Array:
    with_it, without = pair(mechanism)
    return np.asarray(with_it.range_mm.std(axis=0) / without.range_mm.std(axis=0))


def test_ambient_light_multiplies_the_noise() -> None:
    mechanism = fx.AmbientLight(times=2.0)
    factor = mechanism.equivalent(PLACE)["factor"]
    assert np.median(_ratio(mechanism)[MAIN]) == pytest.approx(factor, rel=0.02)


def test_room_light_at_angles_divides_the_noise_by_the_cosine_of_incidence() -> None:
    """The target is turned by 45 degrees."""
    mechanism = fx.RoomAtAngles()
    cosine = BEAMS.cosine[0].reshape(24, 32)[MAIN]
    of = mechanism.equivalent(PLACE)
    wanted = of["factor"] * cosine ** -of["angle_exponent"]
    assert wanted.max() > 1.6
    assert wanted.min() < 1.1
    ratio = _ratio(mechanism)[MAIN] / wanted
    assert np.median(ratio) == pytest.approx(1.0, rel=0.02)
    assert np.median(ratio[wanted > 1.3]) == pytest.approx(1.0, rel=0.02)
    assert np.abs(bias(mechanism)[MAIN] / SIGMA[MAIN]).max() < 0.6  # noise alone


def test_falling_illumination_divides_amplitude_and_multiplies_noise() -> None:
    mechanism = fx.FallingIllumination(power=3.0)
    cosine = mechanism.axis_cosine(DEVICE).reshape(24, 32)
    assert mechanism.equivalent(PLACE)["corner_factor"] == pytest.approx(cosine.min() ** -3.0)
    assert np.median(_ratio(mechanism)[MAIN] * cosine[MAIN] ** 3) == pytest.approx(1.0, rel=0.02)
    with_it, without = pair(mechanism)
    ratio = with_it.amplitude.mean(axis=0) / without.amplitude.mean(axis=0)
    np.testing.assert_allclose(ratio[MAIN], cosine[MAIN] ** 3, rtol=0.02)


def test_second_camera_adds_its_noise_in_bursts() -> None:
    mechanism = fx.SecondCamera(strength=0.02, share_of_frames=0.3, burst_frames=5)
    on = mechanism.bursts(DEVICE.frames, 3)
    added = mechanism.equivalent(PLACE)["sigma_mm"]
    with_it, without = pair(mechanism)
    change = (with_it.range_mm - without.range_mm)[:, MAIN]
    assert change[on].std() == pytest.approx(added, rel=0.03)
    assert np.abs(change[~on]).max() < 2
    many = np.concatenate([mechanism.bursts(4000, seed) for seed in range(5)])
    assert many.mean() == pytest.approx(0.3, abs=0.03)
    lengths = np.diff(np.flatnonzero(np.diff(np.concatenate([[False], many, [False]]).astype(int))))[::2]
    assert lengths.mean() == pytest.approx(5, abs=2.0)  # bursts may touch


def test_noise_with_memory_keeps_its_spread() -> None:
    with_it, without = pair(fx.Memory(coefficient=0.5))
    score = (with_it.range_mm - with_it.range_mm.mean(0))[:, MAIN] / SIGMA[MAIN]
    lag = (score[1:] * score[:-1]).mean() / (score**2).mean()
    assert lag == pytest.approx(0.5 - 1.5 / DEVICE.frames, abs=0.02)
    assert with_it.range_mm.std(0)[MAIN].mean() == pytest.approx(without.range_mm.std(0)[MAIN].mean(), rel=0.02)


def test_whole_beams_lie_between_their_surfaces() -> None:
    mixed = np.flatnonzero(((BEAMS.share > 0).sum(axis=0) == 2) & (BEAMS.share.max(axis=0) < 0.7))
    assert mixed.size > 5
    samples = record(DEVICE, SCENE, (fx.WholeBeam(probability=1.0),), seed=3).range_mm.reshape(DEVICE.frames, -1)
    gloss = np.array([0.7, 0.9, 0.5])[BEAMS.surface] * BEAMS.cosine
    z = DEVICE.amplitude(BEAMS.range_mm, gloss) * DEVICE.phasor(BEAMS.range_mm)
    total = np.where(BEAMS.share > 0, BEAMS.share * z, 0).sum(axis=0)
    wanted = np.mod(np.angle(total), 2 * math.pi) * DEVICE.unambiguous_mm / (2 * math.pi)
    sigma = float(DEVICE.design_sigma(5000.0))
    np.testing.assert_allclose(np.median(samples, axis=0)[mixed], wanted[mixed], atol=4 * sigma / math.sqrt(150))


def test_leaking_pixels_mix_phasors_with_their_neighbours() -> None:
    leak = fx.LeakyPixels(share=0.03)
    z = (AMPLITUDE * DEVICE.phasor(RANGE))[None]
    wide = np.pad(z, ((0, 0), (1, 1), (1, 1)), mode="edge")
    near = wide[:, :-2, 1:-1] + wide[:, 2:, 1:-1] + wide[:, 1:-1, :-2] + wide[:, 1:-1, 2:]
    assert np.abs(leak.mixed(z) - (1 - 4 * 0.03) * z - 0.03 * near).max() < 1e-4 * np.abs(z).max()
    pure = MAIN & np.pad(MAIN, 1, mode="edge")[2:, 1:-1] & np.pad(MAIN, 1, mode="edge")[:-2, 1:-1]
    pure &= np.pad(MAIN, 1, mode="edge")[1:-1, 2:] & np.pad(MAIN, 1, mode="edge")[1:-1, :-2]
    wanted = _turned(leak.mixed(z)[0] / z[0])
    np.testing.assert_allclose(bias(leak)[pure], wanted[pure], atol=1.2)


def test_coarse_phases_are_multiples_of_their_step() -> None:
    mechanism = fx.CoarsePhase(levels=512)
    step = mechanism.equivalent(PLACE)["step_mm"]
    samples = record(DEVICE, SCENE, (mechanism,), seed=3).range_mm
    np.testing.assert_array_equal(samples, np.rint(np.rint(samples / step) * step))


def test_one_frequency_folds_what_lies_beyond_a_turn() -> None:
    device = replace(DEVICE, rows=8, cols=8, frames=40, range_max_mm=11000.0)
    wall = [Surface(name="wall", center_mm=(0.0, 0.0, 8200.0), size_mm=(40000.0, 40000.0))]
    plain, folded = (record(device, wall, m, seed=2).range_mm for m in ((), (fx.OneFrequency(),)))
    np.testing.assert_allclose(folded, np.mod(plain, device.unambiguous_mm), atol=1.01)
    assert folded.max() < device.unambiguous_mm


@pytest.mark.parametrize("kind", ["dropout", "saturation", "outliers", "stuck_pixels"])
def test_share_of_lost_or_wild_samples_is_the_strength(kind: str) -> None:
    share = 0.03
    for seed in range(3):  # dropout comes by packets, by a comparator, or by both
        mechanism = make(kind, share, np.random.default_rng(seed), PLACE)
        samples = record(DEVICE, SCENE, (mechanism,), seed=3).range_mm
        if kind in ("dropout", "saturation"):
            seen = np.isnan(samples).mean()
        elif kind == "stuck_pixels":
            value = mechanism.equivalent(PLACE)["value_mm"]
            seen = (samples == value).all(axis=0).mean()
            assert seen == pytest.approx(mechanism.equivalent(PLACE)["share"])
        else:
            seen = (np.abs(samples - RANGE) > 8 * SIGMA)[:, MAIN].mean()
        assert seen == pytest.approx(share, rel=0.35)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_a_mechanism_and_a_unit(kind: str) -> None:
    mechanism = make(kind, 0.3 if kind != "quantisation" else 2.0, np.random.default_rng(1), PLACE)
    assert mechanism.kind == kind
    assert mechanism.equivalent(PLACE)
    assert UNITS[kind]


@pytest.mark.parametrize("name", STRANGERS)
def test_each_stranger_changes_the_recording(name: str) -> None:
    stranger = make_stranger(name, 5)
    assert stranger.axes
    with_it, without = pair(stranger)
    differ = ~((with_it.range_mm == without.range_mm) | (np.isnan(with_it.range_mm) & np.isnan(without.range_mm)))
    assert differ.mean() > 0.003
