"""Planes of 1 / r: least squares beside NumPy's, seeds on planes and at edges, neighbours continued exactly."""

from collections.abc import Callable

import numpy as np
import pytest
from blind.geometry import Surface
from support.lock_in import FAMILIES, SLATS, SMALL, Scene, crease, made, one_wall, slats
from support.unmixing_twins import least_squares, local, surfaces_beside

from tofmix.compiled.plane import fit_plane
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import Projection, beam_directions_of
from tofmix.unmixing.image import PhasorImage, make_image
from tofmix.unmixing.labels import label
from tofmix.unmixing.lines import find_lines
from tofmix.unmixing.neighbours import find_neighbours
from tofmix.unmixing.phasors import mean_phasors, phase_scale_mm
from tofmix.unmixing.seeds import find_seeds, plane_vector
from tofmix.unmixing.surface_fit import Members

SCALE = phase_scale_mm(20.0e6)
OPTICS: list[Projection] = [
    Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0),
    Equiangular(fov_horizontal_deg=120.0, fov_vertical_deg=90.0),
    Pinhole(fx=20.0, fy=21.0, cx=9.0, cy=8.0, distortion=(-0.05, 0.01, 0.001, 0.0)),
]


def _plane_image(optics: Projection, plane: np.ndarray, sigma: float, rng: np.random.Generator) -> PhasorImage:
    """An image of one plane 1 / r = m . d of a Lambertian surface, 18 x 20 pixels, 30 frames."""
    ways = beam_directions_of(optics, (18, 20))
    near = ways @ plane
    z = 1.0e9 * near**3 * np.exp(1j / near / SCALE)
    noise = sigma / SCALE * np.abs(z)
    phasors = np.zeros((18, 20, 7), np.float32)
    error = (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)) * noise / np.sqrt(30)
    phasors[..., 0], phasors[..., 1] = (z + error).real, (z + error).imag
    phasors[..., 2] = phasors[..., 3] = noise**2
    phasors[..., 5] = 30
    phasors[..., 6] = np.rint((1.0 / near - SCALE * np.angle(z)) / (2 * np.pi * SCALE))
    return make_image(phasors, ways, scale_mm=SCALE, open_space=np.zeros((18, 20), bool))


def _scene_image(recorded: Scene) -> PhasorImage:
    """The image of a recording's mean phasors."""
    source = recorded.recording
    frames = slice(0, source.shape[0])
    phasors = mean_phasors(
        source.read_range(frames, slice(None)), source.read_amplitude(frames, slice(None)), source.sensor
    )
    optics = source.sensor.optics
    assert optics is not None
    return make_image(
        phasors,
        beam_directions_of(optics, source.shape[1:]),
        scale_mm=SCALE,
        open_space=np.zeros(source.shape[1:], bool),
    )


def test_fit_is_weighted_least_squares_with_a_prior(rng: np.random.Generator) -> None:
    x, y, values = rng.normal(size=(3, 5, 12))
    weights, slope = rng.uniform(0.2, 3.0, (5, 12)), np.array([0.0, 0.0, 1.0, 5.0, 50.0])
    for k in range(5):
        coefficients, covariance, residuals = np.empty(3), np.empty((3, 3)), np.empty(12)
        fit_plane(x[k], y[k], values[k], weights[k], slope[k], np.empty((4, 3)), coefficients, covariance, residuals)
        expected = least_squares(x[k], y[k], values[k], weights[k], slope[k])
        np.testing.assert_allclose(coefficients, expected[0], rtol=1e-8)
        np.testing.assert_allclose(covariance, expected[1], rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(residuals, expected[2], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("optics", OPTICS)
def test_a_plane_is_affine_in_local_coordinates_on_any_grid(optics: Projection, rng: np.random.Generator) -> None:
    plane = np.array([1.0e-4, -0.5e-4, 4.0e-4])
    image = _plane_image(optics, plane, 0.01, rng)
    for pixel in rng.choice(image.count, 20):
        others = np.arange(image.count)[np.abs(np.arange(image.count) - pixel) < 45]
        cosine, x, y = np.transpose([local(image, pixel, other) for other in others])
        exact = image.directions[others] @ plane / cosine
        coefficients, _, residuals = least_squares(x, y, exact, np.ones(len(others)), 0.0)
        assert np.abs(residuals).max() < 1e-12
        np.testing.assert_allclose(plane_vector(image, np.array([pixel]), coefficients[None])[0], plane, atol=1e-10)


def test_seeds_have_the_planes_of_least_squares(rng: np.random.Generator) -> None:
    image = _plane_image(OPTICS[2], np.array([1.0e-4, -0.5e-4, 4.0e-4]), 20.0, rng)
    seeds = find_seeds(image)
    for pixel in np.flatnonzero(seeds.has_plane)[::7]:
        middle = int(seeds.middle[pixel])
        others = middle + (image.shape[1] * np.arange(-1, 2)[:, None] + np.arange(-1, 2)).ravel()
        cosine, x, y = np.transpose([local(image, middle, int(other)) for other in others])
        coefficients, _, _ = least_squares(x, y, 1.0 / image.range_mm[others] / cosine, np.ones(9), 0.0)
        expected = plane_vector(image, np.array([middle]), coefficients[None])[0]
        np.testing.assert_allclose(seeds.plane[pixel], expected, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("family", ["boards", "pickets", "random boards", "slats"])
def test_neighbouring_surfaces_equal_those_of_the_twin(family: str, rng: np.random.Generator) -> None:
    if family == "slats":
        image = _scene_image(made(slats(rng, (1.5, 3.0), "vertical"), 5, view=SLATS))
        assert (find_lines(image, find_seeds(image)) >= 0).sum() > 500
    else:
        image = _scene_image(made(FAMILIES[family](rng), 5, view=SMALL))
    seeds = find_seeds(image)
    drawn = rng.random((4, image.count)) < 0.9
    members = Members(
        is_member=image.valid & drawn[0],
        has_plane=seeds.has_plane & drawn[1],
        has_light=drawn[2],
        is_known=drawn[3],
        is_trusted=rng.random(image.count) < 0.5,
        is_fresh=rng.random(image.count) < 0.3,
        plane=seeds.plane,
        middle=seeds.middle,
        line=find_lines(image, seeds),
    )
    doubtful = np.flatnonzero(image.valid & ~seeds.certain)
    pixels = np.concatenate([rng.choice(doubtful, 30), [0, image.count - 1]])
    found = find_neighbours(image, pixels, members, seeds)
    exact = dict.fromkeys(found._fields, 0.0) | {"row": 1e-12, "col": 1e-12}  # a mean of whole numbers may be 0
    for at, pixel in enumerate(pixels):
        expected = surfaces_beside(image, int(pixel), members, seeds)
        assert found.found[at].sum() == len(expected)
        for number, surface in enumerate(expected):
            for name, value in surface.items():
                own = getattr(found, name)[at, number]
                np.testing.assert_allclose(
                    own, value, rtol=1e-6, atol=1e-9 * np.abs(value).max() + exact[name], err_msg=name
                )


@pytest.mark.parametrize("optics", OPTICS)
def test_all_pixels_of_a_plane_are_certain_and_nothing_is_added_to_their_noise(
    optics: Projection, rng: np.random.Generator
) -> None:
    image = _plane_image(optics, np.array([1.0e-4, -0.5e-4, 4.0e-4]), 20.0, rng)
    seeds = find_seeds(image)
    assert seeds.certain.mean() > 0.98
    assert np.sqrt(seeds.pattern_variance) < 0.5 * 20.0 / np.sqrt(30)
    assert label(image).is_surface.all()


def test_column_of_mixed_pixels_is_not_taken_for_a_slope(rng: np.random.Generator) -> None:
    image = _plane_image(OPTICS[0], np.array([0.0, 0.0, 1.0 / 6100.0]), 160.0, rng)  # 30 mm with 30 frames
    step = np.exp(-700.0j / SCALE) * (6100.0 / 5400.0) ** 2  # a wall that stands 700 mm nearer
    share = np.repeat([1.0, 0.25, 0.0], [10, 1, 9])[np.newaxis].repeat(18, 0).ravel()
    image.phasor = image.phasor * (share * step + 1.0 - share)
    image.range_mm = image.range_mm + SCALE * np.angle(share * step + 1.0 - share)
    image.__post_init__()
    certain = find_seeds(image).certain.reshape(18, 20)
    assert certain[:, 10].mean() < 0.3
    assert certain[:, :10].mean() > 0.85
    assert certain[:, 11:].mean() > 0.85
    sees_one = label(image).is_surface.reshape(18, 20)
    assert sees_one[:, 10].mean() < 0.3
    assert np.delete(sees_one, 10, axis=1).mean() > 0.98


def test_fixed_pattern_and_texture_are_measured(rng: np.random.Generator) -> None:
    image = _plane_image(OPTICS[0], np.array([0.0, 0.0, 4.0e-4]), 5.0, rng)
    pattern, texture = rng.normal(0, 8.0, image.count), rng.normal(0, 0.1, image.count)
    image.phasor = image.phasor * np.exp(1j * pattern / SCALE + texture)
    image.range_mm = image.range_mm + pattern
    image.__post_init__()
    seeds = find_seeds(image)
    assert np.sqrt(seeds.pattern_variance) == pytest.approx(8.0, rel=0.15)
    assert np.sqrt(seeds.texture_variance) == pytest.approx(0.1, rel=0.15)
    assert seeds.certain.mean() > 0.95


@pytest.mark.parametrize("scene", [one_wall, crease])
def test_slanted_walls_and_creases_stay_one_surface(
    scene: Callable[[np.random.Generator], list[Surface]], rng: np.random.Generator
) -> None:
    image = _scene_image(made(scene(rng), 3, view=SMALL))
    assert label(image).is_surface.mean() > 0.998
