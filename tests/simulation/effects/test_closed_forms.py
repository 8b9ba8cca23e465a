"""What effects do to a distribution, in closed form, from the model file to the stored values.

The effects' own tests hold each sample against its law. Here is what is left: no magnitude, patterns, lattices, edges.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import render_blocks

Floats = NDArray[np.float64]

ROWS, COLS, FRAMES, RATE_HZ = 20, 20, 250, 25.0
SIGMA_MM = {2000.0: 12.0, 3500.0: 30.0}  # in between, linear
SENSES = 4.5  # standard errors that a mean may be off: 7 in a million by chance, and the streams are fixed

WALLS = """
[sensor]
rows = 20
cols = 20
fov_horizontal_deg = 4.0
fov_vertical_deg = 4.0
range_min_mm = 500.0
range_max_mm = 7500.0
modulation_frequency_hz = 20.0e6
integration_time_ms = 1.2
outlier_probability = 0.0
[sensor.noise]
range_mm = [2000.0, 3500.0]
sigma_mm = [12.0, 30.0]
reference_integration_time_ms = 1.2
exponent = 0.5
[recording]
frame_rate_hz = 25.0
[[surface]]
name = "bright"
center_mm = [-1000.0, 0.0, 2000.0]
size_mm = [2000.0, 3000.0]
reflectivity = 0.8
[[surface]]
name = "dark"
center_mm = [1000.0, 0.0, 3500.0]
size_mm = [6000.0, 4000.0]
reflectivity = 0.2
"""
"""Columns 0 to 9 see the bright wall, 10 to 19 the dark one; no pixel sees both."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A recording and what it is of: off_mm (frame, row, col) is recorded less true range, NaN where invalid."""

    model: Model
    truth: Truth
    stored: NDArray[np.uint16]
    off_mm: Floats

    @property
    def sigma_mm(self) -> Floats:
        """Noise (row, col) of one sample, its rounding to whole mm included."""
        sigma = self.model.sensor.noise_at(1.2).sigma(self.truth.range_true[..., 0].astype(np.float64))
        return np.hypot(sigma, 12**-0.5)

    @property
    def amplitude(self) -> Floats:
        """Amplitude (row, col) of the pixels' light."""
        return self.truth.amplitude[..., 0].astype(np.float64)


def effect(kind: str, **parameters: float | str) -> str:
    """An [[effect]] table."""
    return "\n".join(["[[effect]]", f"kind = {kind!r}", *(f"{k} = {v!r}" for k, v in parameters.items()), ""])


def record(effects: str = "", *, scene: str = WALLS, frames: int = FRAMES, seed: int = 1) -> Recorded:
    """Simulate a scene with effects."""
    model = parse_model(scene + effects, source="test")
    truth = cast_scene(model)
    block = next(render_blocks(model, truth, n_frames=frames, seed=seed, block_frames=frames))
    valid = np.where(block.range_mm == 0, np.nan, block.range_mm.astype(np.float64))
    return Recorded(model=model, truth=truth, stored=block.range_mm, off_mm=valid - truth.range_true[..., 0])


NOTHING = [
    effect("range_offset", offset_mm=0.0),
    effect("surface_pose", surface="dark", shift_mm=0.0),
    effect("surface_offset", surface="dark", offset_mm=0.0),
    effect("motion", surface="dark", velocity_mm_s=0.0),
    effect("multipath", surface="dark", share=0.0, extra_path_mm=900.0),
    effect("scattering", share=0.0),
    effect("internal_reflection", amplitude=0.0, range_mm=20.0),
    effect("pixel_crosstalk", share=0.0),
    effect("flying_pixels", probability=0.0),
    effect("vignetting", corner_factor=1.0),
    effect("wiggling", amplitude_mm=0.0, phase_rad=1.0),
    effect("tap_mismatch", amplitude_1_mm=0.0, phase_1_rad=1.0),
    effect("temporal_correlation", coefficient=0.0),
    effect("interference", probability=0.0, sigma_mm=50.0),
    effect("interference", probability=0.5, sigma_mm=0.0),
    effect("saturation", full_well_amplitude=1e9),
    effect("phase_wrapping", unambiguous_range_mm=60_000.0),
    effect("amplitude_walk", scale_mm=0.0, reference_amplitude=100.0, exponent=1.0),
    effect("temperature_drift", amplitude_mm=0.0, time_constant_s=10.0),
    effect("smooth_pattern", radial_2_mm=0.0, across_mm=0.0),
    effect("fixed_pattern", pixel_sigma_mm=0.0, column_sigma_mm=0.0, row_sigma_mm=0.0),
    effect("excess_noise", factor=1.0),
    effect("near_return", share=0.0, range_mm=25.0, sigma_mm=5.0),
    effect("outliers", probability=0.0),
    effect("dropout", probability=0.0, threshold=0.0, threshold_noise=5.0),
    effect("stuck_pixels", share=0.0, value_mm=3.0),
    effect("quantisation", step_mm=0.0),
]


LARGE = WALLS.replace("rows = 20", "rows = 50").replace("cols = 20", "cols = 50")


@pytest.mark.parametrize(
    ("pixel", "column", "row"), [(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10), (20, 14, 9), (3, 8, 2)]
)
def test_fixed_pattern_has_its_three_spreads_and_does_not_change(pixel: float, column: float, row: float) -> None:
    """Variance of pixels, columns and rows, each cleared of the ones below it, in the manner of a two-way table."""
    text = effect("fixed_pattern", pixel_sigma_mm=pixel, column_sigma_mm=column, row_sigma_mm=row)
    run = record(text, scene=LARGE)
    first, second = run.off_mm[: FRAMES // 2].mean(axis=0), run.off_mm[FRAMES // 2 :].mean(axis=0)
    spread = run.sigma_mm * np.sqrt(4 / FRAMES)
    assert abs(np.mean(((first - second) / spread) ** 2) - 1) < SENSES * np.sqrt(2 / first.size)
    mean = (first + second) / 2
    by_column, by_row = mean.mean(axis=0), mean.mean(axis=1)
    rest = mean - by_column - by_row[:, np.newaxis] + mean.mean()
    noise = float(np.mean(run.sigma_mm**2)) / FRAMES
    n = len(by_row)
    assert_variance(rest.ravel(), pixel**2 + noise, (n - 1) ** 2)
    assert_variance(by_column - mean.mean(), column**2 + (pixel**2 + noise) / n, n - 1)
    assert_variance(by_row - mean.mean(), row**2 + (pixel**2 + noise) / n, n - 1)


def assert_variance(values: Floats, expected: float, degrees: int) -> None:
    statistic = float((values**2).sum() / expected)
    assert min(stats.chi2.cdf(statistic, degrees), stats.chi2.sf(statistic, degrees)) > 1e-5


@pytest.mark.parametrize("step_mm", [0.0, 2.0, 7.3, 29.28, 150.0])
def test_quantised_ranges_have_the_normal_distributions_share_on_each_step(step_mm: float) -> None:
    """Chi-square over the lattice, each pixel with its own mean; means and variances follow."""
    run = record(effect("quantisation", step_mm=step_mm))
    step = step_mm or 1.0
    k = np.rint(run.stored / step)
    np.testing.assert_array_equal(np.rint(k * step), run.stored)
    lattice = np.arange(k.min() - 1, k.max() + 2)
    edges = ((lattice - 0.5) * step)[:, np.newaxis, np.newaxis]
    mean, sigma = run.truth.range_true[..., 0].astype(np.float64), np.sqrt(run.sigma_mm**2 - 1 / 12)
    expected = FRAMES * np.diff(stats.norm.cdf((edges - mean) / sigma), axis=0).sum(axis=(1, 2))
    found = np.array([(k == value).sum() for value in lattice[:-1]])
    enough = expected > 10
    statistic = ((found - expected)[enough] ** 2 / expected[enough]).sum()
    assert stats.chi2.sf(statistic, enough.sum()) > 1e-4
    assert found[~enough].sum() <= expected[~enough].sum() + 5 * np.sqrt(expected[~enough].sum()) + 5


@pytest.mark.slow
@pytest.mark.parametrize("velocity_mm_s", [0.0, 100.0, -150.0])
def test_the_edge_of_a_moving_board_moves_over_the_pixels(velocity_mm_s: float) -> None:
    """The right edge of a board that faces the camera is at the azimuth of x / z(t)."""
    scene = WALLS.replace("[-1000.0, 0.0, 2000.0]", "[-1040.0, 0.0, 2000.0]")  # its right edge at x = -40
    frames = 150
    run = record(effect("motion", surface="bright", velocity_mm_s=velocity_mm_s), scene=scene, frames=frames)
    z = 2000.0 + velocity_mm_s * np.arange(frames) / RATE_HZ
    edge = np.clip(np.arctan(-40.0 / z) / np.radians(4.0 / COLS) + COLS / 2, 0.0, COLS)  # it may leave the image
    near = (run.stored < (z + 3500.0)[:, np.newaxis, np.newaxis] / 2).sum(axis=(1, 2)) / ROWS
    # x / z is the same at every elevation; a sample is of the board or not, and shares are right to 0.001
    off = near - edge
    part = edge % 1
    spread = np.sqrt(np.sum(part * (1 - part)) / ROWS)
    assert abs(off.sum()) < SENSES * spread + 0.001 * frames
    if velocity_mm_s:
        assert np.ptp(edge) > 1.2  # it crosses pixels
