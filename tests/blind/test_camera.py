from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, kstwo

from blind.calibrate import calibrated, flat_field
from blind.camera import Device, record
from blind.cases import draw_lens, in_room_light
from blind.geometry import Array, cast
from blind.reference import amplitudes, uniforms
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
    [(DEVICE, "open_hall"), (PINHOLE, "open_hall"), (ROOM, "stairs")],
    ids=["ordinary", "pinhole", "room light"],
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


def test_noise_of_a_board_depends_on_its_range_alone() -> None:
    """The contract's sigma depends on the range alone; the ambient light is such that the taps' noise does too."""
    noise = calibrated(DEVICE)
    for k, away in enumerate((700.0, 2500.0, 6000.0)):
        spread = flat_field(DEVICE, away, 40_000, seed=50 + k).std()
        assert spread == pytest.approx(float(noise.sigma(np.array(away))), rel=4 / np.sqrt(2 * 40_000))
        assert spread == pytest.approx(float(DEVICE.design_sigma(away)), rel=0.03)


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
