"""Mean phasors, planes of 1 / r, creases, narrow surfaces, and which surfaces stand beyond the fold."""

from collections.abc import Callable

import numpy as np
import pytest
from blind.geometry import Surface
from scipy import special
from support.lock_in import FAMILIES, SLATS, SMALL, Direction, Scene, crease, judge, made, one_wall, slats
from support.round_things import Thing, joined, rays_of, wall
from support.unmixing_twins import least_squares, local, surfaces_beside

from tofmix.arrays import BoolArray, FloatArray
from tofmix.compiled.plane import fit_plane
from tofmix.estimation.blocks.sequence import estimate_windows
from tofmix.layers import Layers
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import Projection, beam_directions_of
from tofmix.sensor import Sensor
from tofmix.unmixing.functions import logsumexp, ndtr
from tofmix.unmixing.image import FIELDS, PhasorImage, make_image, mean_phasors, phase_scale_mm
from tofmix.unmixing.labels import label
from tofmix.unmixing.lines import Mixtures, find_lines, is_bounded
from tofmix.unmixing.neighbours import find_neighbours
from tofmix.unmixing.seeds import find_seeds, plane_vector, without_creases
from tofmix.unmixing.surface_fit import Members
from tofmix.unmixing.unmix import unfolded

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


@pytest.mark.compiled("it fits 3,072 windows")
@pytest.mark.parametrize(("thing", "parts"), [(LEFT, 1), (joined(LEFT, RIGHT), 2)], ids=["wall", "two walls"])
def test_a_segment_parts_at_the_crease_of_two_walls_and_nowhere_else(thing: Thing, parts: int) -> None:
    image = image_of(thing)
    segment, origin = without_creases(image, find_seeds(image), np.zeros(image.count, np.int64), 5.0)
    sizes = np.bincount(segment[segment >= 0])
    assert (sizes > 0.4 * image.count).sum() == parts
    assert (segment >= 0).mean() > 0.9
    assert set(origin.tolist()) == {0}


@pytest.mark.compiled("it fits 3,072 windows")
def test_pixels_of_no_segment_stay_so_and_parts_know_their_segment() -> None:
    image = image_of(LEFT)
    given = np.where(np.arange(image.count) % image.shape[1] < 20, 3, -1)
    segment, origin = without_creases(image, find_seeds(image), given, 5.0)
    np.testing.assert_array_equal(segment >= 0, given >= 0)
    assert set(origin.tolist()) == {3}


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


@pytest.mark.parametrize("is_upright", [True, False])
@pytest.mark.parametrize(
    ("middle", "bounded"), [((0.6, 0.6), False), ((1.0, 1.0), False), ((1.0, 1.0, 0.4), True), ((0.3, 1.0, 1.0), True)]
)
def test_two_equal_lines_are_one_surface_only_if_a_pixel_beside_them_sees_some_of_it(
    middle: tuple[float, ...], bounded: bool, is_upright: bool, rng: np.random.Generator
) -> None:
    """A wire on the border of two columns, and a slat whose edges are both on borders of pixels, look the same."""
    shares = _columns(*middle)
    if not is_upright:
        shares = np.append(shares, 0.0)
    image = _striped(shares, rng, is_upright=is_upright)
    share = np.broadcast_to(shares, image.shape if is_upright else image.shape[::-1])
    share = share if is_upright else share.T
    nothing = np.full((image.count, 3), np.nan)
    mixtures = Mixtures(
        is_mixed=np.zeros(image.count, bool),
        range_mm=nothing,
        range_variance=nothing,
        share=nothing,
        share_variance=nothing,
    )
    mask: BoolArray = share == max(middle)
    found = is_bounded(image, find_seeds(image), mixtures, mask.ravel()).reshape(image.shape)
    assert not found[~mask].any()
    assert (found[mask].mean() > 0.95) if bounded else (found[mask].mean() < 0.05)


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


@pytest.mark.parametrize(("width", "direction"), [(2.0, "tilted"), (2.0, "horizontal"), (2.5, "vertical")])
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


CAMERA = Sensor(name="lock-in", modulation_frequency_hz=20.0e6, outlier_probability=1e-4)


def _drawn(
    rng: np.random.Generator, range_mm: float, frames: int = 60, pixels: int = 40
) -> tuple[np.ndarray, np.ndarray]:
    z = (
        100.0 * np.exp(1j * range_mm / SCALE)
        + rng.normal(0, 2, (frames, pixels))
        + 1j * rng.normal(0, 2, (frames, pixels))
    )
    turns = np.rint((range_mm - SCALE * np.angle(z)) / (2 * np.pi * SCALE))
    return SCALE * (np.angle(z) + 2 * np.pi * turns), np.abs(z)


def test_mean_and_covariance_are_those_of_numpy(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    found = mean_phasors(ranges, light, CAMERA)
    z = light * np.exp(1j * ranges / SCALE)
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], z.mean(axis=0), atol=1e-3)
    for pixel in range(z.shape[1]):
        expected = np.cov(z[:, pixel].real, z[:, pixel].imag)
        np.testing.assert_allclose(found[pixel, 2:5], [expected[0, 0], expected[1, 1], expected[0, 1]], atol=2e-2)
    np.testing.assert_array_equal(found[:, FIELDS.index("samples")], 60)


@pytest.mark.parametrize("range_mm", [300.0, 3700.0, 7300.0, 9000.0, 16000.0])
def test_range_of_the_mean_is_on_the_turn_of_the_samples(rng: np.random.Generator, range_mm: float) -> None:
    found = mean_phasors(*_drawn(rng, range_mm), CAMERA)
    back = SCALE * (np.angle(found[:, 0] + 1j * found[:, 1]) + 2 * np.pi * found[:, 6])
    np.testing.assert_allclose(back, range_mm, atol=20.0)


def test_one_outlier_is_left_out_and_a_second_surface_is_not(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    wild, several = ranges.copy(), ranges.copy()
    wild[7] = 5800.0
    several[:15] = 4000.0
    np.testing.assert_array_equal(mean_phasors(wild, light, CAMERA)[:, 5], 59)
    clean, found = (
        mean_phasors(np.delete(ranges, 7, 0), np.delete(light, 7, 0), CAMERA),
        mean_phasors(wild, light, CAMERA),
    )
    np.testing.assert_allclose(found[:, :2], clean[:, :2], rtol=1e-5)
    np.testing.assert_array_equal(mean_phasors(several, light, CAMERA)[:, 5], 60)


def test_samples_without_range_or_amplitude_are_skipped(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    gaps, dark = ranges.copy(), light.copy()
    gaps[::3], dark[1::3] = np.nan, np.nan
    np.testing.assert_allclose(
        mean_phasors(gaps, dark, CAMERA), mean_phasors(ranges[2::3], light[2::3], CAMERA), rtol=1e-5
    )
    np.testing.assert_array_equal(mean_phasors(np.full((5, 3), np.nan), np.ones((5, 3)), CAMERA), 0.0)


def test_pixels_do_not_depend_on_each_other(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    ranges[3, ::2] = 6000.0
    together = mean_phasors(ranges, light, CAMERA)
    alone = np.concatenate([mean_phasors(ranges[:, [k]], light[:, [k]], CAMERA) for k in range(ranges.shape[1])])
    np.testing.assert_array_equal(together, alone)


def test_an_unknown_frequency_is_refused() -> None:
    with pytest.raises(ValueError, match="modulation frequency"):
        mean_phasors(np.ones((3, 2)), np.ones((3, 2)), Sensor(name="direct"))


def test_probabilities_of_a_gaussian_are_scipys_to_the_last_digits() -> None:
    x = np.concatenate([np.linspace(-40.0, 40.0, 40001), np.geomspace(1e-300, 1e3, 5000), [np.inf, -np.inf, 0.0]])
    np.testing.assert_allclose(ndtr(x), special.ndtr(x), rtol=4e-15, atol=1e-300)
    np.testing.assert_allclose(ndtr(-x), special.ndtr(-x), rtol=4e-15, atol=1e-300)
    assert np.isnan(ndtr(np.array([np.nan]))[0])


def test_sums_of_exponentials_are_scipys_also_where_a_term_or_all_are_none(rng: np.random.Generator) -> None:
    logs = rng.normal(0.0, 300.0, (5, 1000))
    logs[rng.random(logs.shape) < 0.3] = -np.inf
    logs[:, 0] = -np.inf
    np.testing.assert_allclose(logsumexp(logs), special.logsumexp(logs, axis=0), rtol=1e-14)


LENGTH = 5000.0
SCALE_UNFOLDING = LENGTH / (2.0 * np.pi)


def _folded(range_mm: np.ndarray, rng: np.random.Generator) -> PhasorImage:
    """Mean phasors of Lambertian surfaces at ranges (row, col), 0.3 % noise, their ranges folded."""
    ways = beam_directions_of(Equiangular(fov_horizontal_deg=12.0, fov_vertical_deg=9.0), range_mm.shape)
    noise = 0.003 * (rng.normal(size=range_mm.shape) + 1j * rng.normal(size=range_mm.shape))
    z = 1.0e9 / range_mm**3 * np.exp(1j * range_mm / SCALE_UNFOLDING) * (1.0 + noise)
    phasors = np.zeros((*range_mm.shape, 7), np.float32)
    phasors[..., 0], phasors[..., 1], phasors[..., 5] = z.real, z.imag, 30
    phasors[..., 2] = phasors[..., 3] = 30 * (0.003 * np.abs(z)) ** 2
    phasors[..., 6] = np.angle(z) < 0
    return make_image(phasors, ways, scale_mm=SCALE_UNFOLDING, open_space=np.zeros(range_mm.shape, bool))


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
