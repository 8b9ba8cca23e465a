"""Flat segments part where the planes of neighbouring pixels disagree."""

import numpy as np
import pytest
from support.round_things import Thing, joined, rays_of, wall

from tofmix.unmixing.image import PhasorImage, make_image
from tofmix.unmixing.seeds import find_seeds, without_creases

pytestmark = pytest.mark.compiled("it fits 3,072 windows")

SCALE_MM = 1000.0
FRAMES = 100
LEFT, RIGHT = wall(3000, (0.5, 0.0, 0.87)), wall(3000, (-0.5, 0.0, 0.87))


def image_of(thing: Thing, noise: float = 0.002) -> PhasorImage:
    """Mean phasors of a thing, with noise relative to the light of a pixel at 1 m."""
    rays = rays_of(1)
    found = thing(rays)
    draw = np.random.default_rng(1)
    phasor = found.cosine * (1000.0 / found.range_mm) ** 2 * np.exp(1j * found.range_mm / SCALE_MM)
    sigma = noise / np.sqrt(FRAMES)
    phasor = phasor + sigma * (draw.standard_normal(phasor.shape) + 1j * draw.standard_normal(phasor.shape))
    size = np.full(phasor.shape, noise**2)
    parts = [phasor.real, phasor.imag, size, size, 0 * size, FRAMES + 0 * size, 0 * size]
    return make_image(
        np.stack(parts, axis=-1).astype(np.float32), rays, scale_mm=SCALE_MM, open_space=np.zeros(size.shape, bool)
    )


@pytest.mark.parametrize(("thing", "parts"), [(LEFT, 1), (joined(LEFT, RIGHT), 2)], ids=["wall", "two walls"])
def test_a_segment_parts_at_the_crease_of_two_walls_and_nowhere_else(thing: Thing, parts: int) -> None:
    image = image_of(thing)
    segment, origin = without_creases(image, find_seeds(image), np.zeros(image.count, np.int64), 5.0)
    sizes = np.bincount(segment[segment >= 0])
    assert (sizes > 0.4 * image.count).sum() == parts
    assert (segment >= 0).mean() > 0.9
    assert set(origin.tolist()) == {0}


def test_pixels_of_no_segment_stay_so_and_parts_know_their_segment() -> None:
    image = image_of(LEFT)
    given = np.where(np.arange(image.count) % image.shape[1] < 20, 3, -1)
    segment, origin = without_creases(image, find_seeds(image), given, 5.0)
    np.testing.assert_array_equal(segment >= 0, given >= 0)
    assert set(origin.tolist()) == {3}
