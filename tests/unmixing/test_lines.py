"""Narrow surfaces: pixels that are filled are found by what their neighbours see, and mixtures are not."""

import numpy as np
import pytest
from support.lock_in import SLATS, Direction, Scene, judge, made, slats

from tofmix.arrays import FloatArray
from tofmix.estimation.blocks.sequence import estimate_windows
from tofmix.layers import Layers
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of
from tofmix.unmixing.image import PhasorImage, make_image
from tofmix.unmixing.lines import Mixtures, find_lines
from tofmix.unmixing.phasors import phase_scale_mm
from tofmix.unmixing.seeds import find_seeds

SCALE = phase_scale_mm(20.0e6)
SHAPE = (16, 15)
NEAR_MM, FAR_MM = 2500.0, 4300.0


def _striped(shares: FloatArray, rng: np.random.Generator, *, is_upright: bool = True) -> PhasorImage:
    """Columns (or rows) of pixels in which a near surface has these shares, before a far one; 40 frames."""
    share = np.broadcast_to(shares, SHAPE) if is_upright else np.broadcast_to(shares, SHAPE[::-1]).T
    share = np.asarray(share)
    near = 2.0 * np.exp(1j * NEAR_MM / SCALE)
    z = share * near + (1.0 - share) * np.exp(1j * FAR_MM / SCALE)
    sigma, frames = 0.01, 40
    z = z + (rng.standard_normal(share.shape) + 1j * rng.standard_normal(share.shape)) * sigma / np.sqrt(frames)
    phasors = np.zeros((*share.shape, 7), np.float32)
    phasors[..., 0], phasors[..., 1] = z.real, z.imag
    phasors[..., 2] = phasors[..., 3] = sigma**2
    phasors[..., 5], phasors[..., 6] = frames, np.angle(z) < 0
    ways = beam_directions_of(Equiangular(fov_horizontal_deg=4.0, fov_vertical_deg=4.0), share.shape)
    return make_image(phasors, ways, scale_mm=SCALE, open_space=np.zeros(share.shape, bool))


def _found(image: PhasorImage) -> np.ndarray:
    return (find_lines(image, find_seeds(image)) >= 0).reshape(image.shape)


def _columns(*middle: float) -> FloatArray:
    """Shares of the near surface with these columns in the middle of the image."""
    out = np.zeros(SHAPE[1])
    start = SHAPE[1] // 2 - len(middle) // 2
    out[start : start + len(middle)] = middle
    return out


@pytest.mark.parametrize("is_upright", [True, False])
@pytest.mark.parametrize("middle", [(0.3, 1.0, 0.6), (0.3, 1.0, 1.0, 0.2)])
def test_pixels_between_mixtures_on_both_sides_are_of_one_surface(
    middle: tuple[float, ...], is_upright: bool, rng: np.random.Generator
) -> None:
    shares = _columns(*middle)
    if not is_upright:
        shares = np.append(shares, 0.0)
    found = _found(_striped(shares, rng, is_upright=is_upright))
    found = found if is_upright else found.T
    full, mixed = shares == 1.0, (shares > 0) & (shares < 1)
    assert found[:, full].mean() > 0.95
    assert not found[:, mixed].any()


@pytest.mark.parametrize("middle", [(0.7, 0.8), (0.9, 0.6), (0.5,)])
def test_mixtures_without_a_filled_pixel_between_them_are_no_surface(
    middle: tuple[float, ...], rng: np.random.Generator
) -> None:
    shares = _columns(*middle)
    found = _found(_striped(shares, rng))
    assert not found[:, shares > 0].any()


def test_blurred_edge_is_no_surface(rng: np.random.Generator) -> None:
    shares = np.repeat([1.0, 0.9, 0.5, 0.1, 0.0], [6, 1, 1, 1, 6])
    found = _found(_striped(shares, rng))
    assert not found[:, 7].any()


def test_neighbours_that_were_judged_to_be_mixtures_show_the_surface(rng: np.random.Generator) -> None:
    shares = _columns(0.01, 1.0, 0.5)  # 0.01 of the surface may be a slope of the wall
    image = _striped(shares, rng)
    seeds = find_seeds(image)
    assert not (find_lines(image, seeds).reshape(SHAPE) >= 0)[:, shares == 1.0].any()
    ends = np.array([NEAR_MM, FAR_MM, np.nan])
    share = np.broadcast_to(shares, SHAPE).ravel()
    mixtures = Mixtures(
        is_mixed=(share > 0) & (share < 1),
        range_mm=np.tile(ends, (image.count, 1)),
        range_variance=np.full((image.count, 3), 1.0),
        share=np.stack([share, 1.0 - share, np.full(image.count, np.nan)], axis=1),
        share_variance=np.full((image.count, 3), 1.0e-6),
    )
    found = (find_lines(image, seeds, mixtures) >= 0).reshape(SHAPE)
    assert found[:, shares == 1.0].mean() > 0.95
    assert not found[:, (shares > 0) & (shares < 1)].any()


def _estimated(scene: Scene) -> Layers:
    found = estimate_windows(scene.recording)
    return Layers(**{spec.name: getattr(found.layers, spec.name)[0] for spec in found.layers.fields})


@pytest.mark.parametrize("direction", ["vertical", "horizontal", "tilted"])
@pytest.mark.parametrize("width", [2.0, 2.5])
def test_both_surfaces_are_found_beside_slats_of_two_to_three_pixels(width: float, direction: Direction) -> None:
    scene = made(slats(np.random.default_rng([1, 5]), (width, width), direction), 1, view=SLATS, frames=40)
    judged = judge(scene, _estimated(scene))
    assert judged.asked > 500
    assert judged.found >= 0.95 * judged.asked
    assert judged.share_rms < 0.01
    assert judged.sure_false <= 0.02 * judged.sure
    assert judged.split <= 0.002 * judged.single


@pytest.mark.parametrize("seed", [1, 3])  # at both, slats that are not beside a mixed row may be one of its surfaces
def test_wall_is_found_in_gaps_narrower_than_the_slats(seed: int) -> None:
    scene = made(slats(np.random.default_rng([seed, 5]), (4.0, 4.0), "horizontal"), seed, view=SLATS, frames=40)
    judged = judge(scene, _estimated(scene))
    assert judged.asked > 400
    assert judged.found >= 0.98 * judged.asked
    assert judged.undecided <= 0.02 * judged.mixed
    assert judged.sure_false <= 0.01 * judged.sure
