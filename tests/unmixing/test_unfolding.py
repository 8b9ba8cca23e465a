"""Which surfaces stand beyond the fold: near ones stay, far ones get a turn, whether they cross the fold or not."""

import numpy as np
import pytest

from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of
from tofmix.unmixing.image import PhasorImage, make_image
from tofmix.unmixing.unmix import unfolded

LENGTH = 5000.0
SCALE = LENGTH / (2.0 * np.pi)


def _folded(range_mm: np.ndarray, rng: np.random.Generator) -> PhasorImage:
    """Mean phasors of Lambertian surfaces at ranges (row, col), 0.3 % noise, their ranges folded."""
    ways = beam_directions_of(Equiangular(fov_horizontal_deg=12.0, fov_vertical_deg=9.0), range_mm.shape)
    noise = 0.003 * (rng.normal(size=range_mm.shape) + 1j * rng.normal(size=range_mm.shape))
    z = 1.0e9 / range_mm**3 * np.exp(1j * range_mm / SCALE) * (1.0 + noise)
    phasors = np.zeros((*range_mm.shape, 7), np.float32)
    phasors[..., 0], phasors[..., 1], phasors[..., 5] = z.real, z.imag, 30
    phasors[..., 2] = phasors[..., 3] = 30 * (0.003 * np.abs(z)) ** 2
    phasors[..., 6] = np.angle(z) < 0
    return make_image(phasors, ways, scale_mm=SCALE, open_space=np.zeros(range_mm.shape, bool))


@pytest.mark.parametrize(
    ("ahead", "slope"),
    [
        (700.0, 0.3),
        (1500.0, 0.3),
        (3000.0, 0.3),
        (4950.0, 0.3),
        (5200.0, 0.3),
        (5600.0, 0.8),
        (1000.0, 0.0),
        (5100.0, 0.0),
    ],
)
def test_unfolding_restores_the_ranges_of_a_folded_plane(ahead: float, slope: float, rng: np.random.Generator) -> None:
    ways = beam_directions_of(Equiangular(fov_horizontal_deg=12.0, fov_vertical_deg=9.0), (36, 48))
    range_mm = 1.0 / (ways @ np.array([slope / ahead, 0.1 * slope / ahead, 1.0 / ahead]))
    image = _folded(range_mm, rng)
    np.testing.assert_allclose(unfolded(image, LENGTH).reshape(36, 48), range_mm, rtol=0.05)


def test_near_board_stays_before_a_wall_beyond_the_fold(rng: np.random.Generator) -> None:
    ways = beam_directions_of(Equiangular(fov_horizontal_deg=12.0, fov_vertical_deg=9.0), (36, 48))
    range_mm = 5150.0 / (ways @ np.array([0.1, 0.0, 1.0]))
    range_mm[10:26, 12:30] = 900.0 / ways[10:26, 12:30, 2]
    found = unfolded(_folded(range_mm, rng), LENGTH).reshape(36, 48)
    np.testing.assert_allclose(found, range_mm, rtol=0.05)
