from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, kstwo

from blind.calibrate import calibrated, flat_field
from blind.camera import Device, record
from blind.cases import DEVICES, draw_device, draw_lens, in_room_light
from blind.geometry import Array, Surface, cast
from blind.reference import amplitudes, scores, uniforms
from blind.scenes import draw_scene

DEVICE = Device(name="test camera", rows=40, cols=52, frames=120)
ROOM = in_room_light(DEVICE, sigma_mm=32.0)
PINHOLE = replace(DEVICE, lens=draw_lens(DEVICE, np.random.default_rng(4)))


def _ks_pvalues(u: Array) -> Array:
    """Kolmogorov-Smirnov p-values (pixel,) of uniforms (frame, pixel), exact."""
    n = len(u)
    u = np.sort(u, axis=0)
    steps = np.arange(n + 1)[:, None] / n
    distance = np.maximum(steps[1:] - u, u - steps[:-1]).max(axis=0)
    p: Array = kstwo.sf(distance, n)
    return p


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "family"),
    [(DEVICE, "open_hall"), (PINHOLE, "open_hall"), (ROOM, "dark_and_bright"), (ROOM, "stairs")],
    ids=["ordinary", "pinhole", "room light", "room light on stairs"],
)
def test_samples_of_each_pixel_follow_equation_1_without_effects(device: Device, family: str) -> None:
    """Per-pixel KS tests over 2080 pixels, mixed ones and open space included: their p-values are uniform."""
    surfaces = draw_scene(family, [3], device.view).surfaces
    beams = cast(surfaces, device.view)
    assert ((beams.share > 0).sum(axis=0) > 1).sum() > 50
    short = replace(device, frames=80)
    samples = record(short, surfaces, seed=7).range_mm.reshape(short.frames, -1).astype(float)
    amplitude = amplitudes(beams, device, surfaces)
    u = uniforms(samples, beams, device, calibrated(device), np.random.default_rng(1), amplitude)
    p = _ks_pvalues(u)
    assert p.size >= 2000
    assert kstest(p, "uniform").pvalue > 0.01
    assert p.min() > 0.01 / p.size


@pytest.mark.slow
def test_moments_are_those_of_equation_1_without_effects() -> None:
    surfaces = draw_scene("near_far", [5], DEVICE.view).surfaces
    samples = record(DEVICE, surfaces, seed=8).range_mm.reshape(DEVICE.frames, -1).astype(float)
    noise = calibrated(DEVICE)
    score = scores(samples, cast(surfaces, DEVICE.view), DEVICE, noise, np.random.default_rng(1))
    n = score.size
    for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((score**power).mean() - mean) < 4 * np.sqrt(variance / n)


def test_noise_of_a_board_depends_on_its_range_alone() -> None:
    """The contract's sigma depends on the range alone; the ambient light is such that the taps' noise does too."""
    noise = calibrated(DEVICE)
    for k, away in enumerate((700.0, 2500.0, 6000.0)):
        spread = flat_field(DEVICE, away, 40_000, seed=50 + k).std()
        assert spread == pytest.approx(float(noise.sigma(np.array(away))), rel=4 / np.sqrt(2 * 40_000))
        assert spread == pytest.approx(float(DEVICE.design_sigma(away)), rel=0.03)


@pytest.mark.parametrize("far", [False, True])
def test_phase_noise_is_below_a_fifth_of_a_radian(*, far: bool) -> None:
    for number in range(DEVICES):
        device = draw_device(1, number, far=far)
        sigma = float(device.design_sigma(device.range_max_mm))
        assert sigma * 2 * np.pi / device.unambiguous_mm < 0.2


def test_same_seed_gives_the_same_recording_and_another_another() -> None:
    small = replace(DEVICE, rows=8, cols=10, frames=20)
    surfaces = draw_scene("boards", [1], small.view).surfaces
    one, two, other = (record(small, surfaces, seed=s).range_mm for s in (1, 1, 2))
    assert (one == two).all()
    assert (one != other).mean() > 0.5


def test_under_room_light_dark_boards_are_noisier_than_bright_ones_at_the_same_place() -> None:
    noise = calibrated(ROOM)
    for k, away in enumerate((1500.0, 2500.0, 4000.0)):
        spread = {gloss: flat_field(ROOM, away, 40_000, seed=60 + k, gloss=gloss).std() for gloss in (0.12, 0.85)}
        assert spread[0.12] / spread[0.85] == pytest.approx(0.85 / 0.12, rel=0.05)  # as the inverse amplitude
        for gloss, measured in spread.items():
            amplitude = ROOM.amplitude(np.array(away), np.array(gloss)) * ROOM.amplitude_unit
            said = float(noise.sigma(np.array(away), amplitude))
            assert measured == pytest.approx(said, rel=4 / np.sqrt(2 * 40_000))


def test_under_room_light_the_noise_is_a_function_of_the_amplitude_alone() -> None:
    """So a model file can hold it: near and dark is as noisy as far and bright."""
    near, far = 2000.0, 4000.0
    spread = [flat_field(ROOM, near, 40_000, 71, gloss=0.2).std(), flat_field(ROOM, far, 40_000, 72, gloss=0.8).std()]
    assert spread[0] == pytest.approx(spread[1], rel=6 / np.sqrt(2 * 40_000))


def test_noise_by_amplitude_is_measured_to_a_quarter_of_a_percent() -> None:
    noise = calibrated(ROOM)
    for away in (900.0, 2000.0, 3500.0, 5000.0):
        for gloss in (0.15, 0.4, 0.9):
            amplitude = ROOM.amplitude(np.array(away), np.array(gloss)) * ROOM.amplitude_unit
            designed = float(ROOM.sigma(np.array(away), np.array(gloss)))
            if designed * 2 * np.pi / ROOM.unambiguous_mm < 0.05:  # below the arc's own part
                assert float(noise.sigma(np.array(away), amplitude)) == pytest.approx(designed, rel=2.5e-3)


def test_open_space_under_room_light_is_as_noisy_as_the_curve_says_at_the_end_of_the_range() -> None:
    board = [Surface(name="board", center_mm=(0.0, 0.0, 2000.0), size_mm=(300.0, 300.0))]
    device = replace(ROOM, frames=40)
    recording = record(device, board, seed=5).range_mm.reshape(40, -1)
    empty = recording[:, cast(board, device.view).nothing == 1]
    middle = empty[np.abs(empty - device.range_max_mm) < 1000]
    wanted = float(calibrated(ROOM).sigma(np.array(device.range_max_mm)))
    assert middle.std() == pytest.approx(wanted, rel=0.01)
