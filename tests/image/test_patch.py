"""Patches of smooth surfaces and masks of pixels."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from support.round_things import Thing, cylinder, ellipsoid, rays_of, sphere, wall

from tofmix.image.light import with_light
from tofmix.image.patch import STATE, TangentFrame, bend_term, fit_patches, meet
from tofmix.image.scales import UNKNOWN, learn_scales, may_bend
from tofmix.image.segments import (
    View,
    components,
    count_around,
    grid_of_places,
    lattice_of_places,
    members_around,
    near,
    segments_of,
    sum_around,
)

SIZE, FOCAL = 24, 75.0


def seen(thing: Thing, noise_mm: float, seed: int = 1) -> View:
    """The middle of the image, each pixel seen along its middle ray."""
    ways = rays_of(1)[12 : 12 + SIZE, 20 : 20 + SIZE]
    t, cosine = thing(ways)
    right, below = np.gradient(ways, axis=1), np.gradient(ways, axis=0)
    hit = np.isfinite(t)
    draw = np.random.default_rng(seed)
    range_mm = np.where(hit, t + noise_mm * draw.standard_normal(t.shape), 1.0)
    light = np.where(hit, np.log(np.maximum(cosine, 1e-9)) - 2.0 * np.log(range_mm), 0.0)
    flat = [part.reshape(-1, 3) for part in (ways, right, below)]
    return View(
        shape=(SIZE, SIZE),
        scale_mm=1192.8,
        valid=hit.ravel(),
        range_mm=range_mm.ravel(),
        range_variance=np.full(SIZE * SIZE, noise_mm**2),
        log_amplitude=light.ravel(),
        amplitude_variance=np.full(SIZE * SIZE, (noise_mm / 1192.8) ** 2),
        pattern_variance=0.0,
        texture_variance=0.0,
        direction=flat[0],
        right=flat[1],
        below=flat[2],
        pitch=np.full(SIZE * SIZE, 1.0 / FOCAL),
    )


def one_state(*numbers: float) -> tuple[TangentFrame, NDArray[np.float64]]:
    frame = TangentFrame(*(np.array([part]) for part in ((0.0, 0.0, 2000.0), (1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0))))
    return frame, np.array([[(*numbers, *np.zeros(STATE - len(numbers)))]])


@pytest.mark.compiled("rays meet patches in a kernel")
@pytest.mark.parametrize("radius", [150.0, 400.0])
def test_rays_meet_a_patch_of_equal_curvatures_where_they_meet_the_sphere(radius: float) -> None:
    frame, state = one_state(0, 0, 0, -1 / radius, 0, -1 / radius)
    centre = np.array([0.0, 0.0, 2000.0 + radius])
    rays = np.random.default_rng(2).normal([0, 0, 1], [0.04, 0.04, 0], (200, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = rays @ centre
    inside = along**2 - (centre @ centre - radius**2)
    expected = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), np.nan)
    normal = (rays * expected[:, np.newaxis] - centre) / radius
    range_mm, cosine = (part[0, 0] for part in meet(frame, state, rays[np.newaxis]))
    assert 0 < np.isnan(expected).sum() < 200 or radius > 300
    np.testing.assert_allclose(range_mm, expected, rtol=1e-9)
    np.testing.assert_allclose(cosine, np.abs((normal * rays).sum(axis=1)), rtol=1e-6)


@pytest.mark.compiled("rays meet patches in a kernel")
def test_rays_meet_an_ellipsoid_where_the_patch_has_its_quadric() -> None:
    wide, deep = 300.0, 150.0  # half axes across and along the view: curvature deep / wide^2, and e = 1 / deep - g
    bend = -deep / wide**2
    frame, state = one_state(0, 0, 0, bend, 0, bend, 0, 0, -1.0 / deep - bend)
    rays = np.random.default_rng(2).normal([0, 0, 1], [0.06, 0.06, 0], (200, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    expected = ellipsoid((0.0, 0.0, 2000.0 + deep), (wide, wide, deep))(rays)
    seen = np.isfinite(expected.range_mm)
    range_mm, cosine = (part[0, 0] for part in meet(frame, state, rays[np.newaxis]))
    assert 0 < seen.sum() < 200
    np.testing.assert_allclose(range_mm, np.where(seen, expected.range_mm, np.nan), rtol=1e-9)
    np.testing.assert_allclose(cosine[seen], expected.cosine[seen], rtol=1e-6)


@pytest.mark.compiled("rays meet patches in a kernel")
def test_rays_meet_any_quadric_at_its_zeros_and_by_its_gradient() -> None:
    numbers = (5.0, 0.1, -0.2, -4e-3, 1e-3, -3e-3, 6e-4, -4e-4, -1e-3)
    frame, state = one_state(*numbers)
    rays = np.random.default_rng(3).normal([0, 0, 1], [0.03, 0.03, 0], (50, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    range_mm, cosine = (part[0, 0] for part in meet(frame, state, rays[np.newaxis]))
    g = bend_term(*(np.array(k) for k in numbers[3:6])) + numbers[8]

    def height_left(points: NDArray[np.float64]) -> NDArray[np.float64]:
        u, v, h = ((points - frame.origin) @ part[0] for part in frame[1:])
        a, b, c, k11, k12, k22, p, q, _ = numbers
        bent = 0.5 * (k11 * u * u + 2 * k12 * u * v + k22 * v * v) + h * (p * u + q * v) + 0.5 * g * h * h
        return np.asarray(h - a - b * u - c * v - bent)

    points = range_mm[:, np.newaxis] * rays
    assert np.isfinite(range_mm).all()
    np.testing.assert_allclose(height_left(points), 0.0, atol=1e-9)
    slope = np.stack([(height_left(points + step) - height_left(points - step)) / 2.0 for step in np.eye(3)], axis=-1)
    facing = np.abs((slope * rays).sum(axis=1)) / np.linalg.norm(slope, axis=1)
    np.testing.assert_allclose(cosine, facing, rtol=1e-6)


@pytest.mark.compiled("rays meet patches in a kernel")
@pytest.mark.parametrize(
    "thing",
    [wall(2000, (0.4, 0.1, 0.9)), sphere((20, 10, 1800), 260), cylinder(30, 1800, 220)],
    ids=("plane", "sphere", "cylinder"),
)
def test_prediction_of_a_pixel_at_the_rim_is_as_far_off_as_it_says(thing: Thing) -> None:
    exact, noisy = seen(thing, 0.0), seen(thing, 2.0)
    segment = np.where(exact.valid, 0, -1)
    scales = learn_scales(noisy, segment, np.array([0]), 4)
    rows, cols = np.divmod(np.flatnonzero(exact.valid), SIZE)
    middle = (np.hypot(rows - 12, cols - 12) < 6) & ((rows + cols) % 3 == 0)
    at = np.flatnonzero(exact.valid)[middle]
    members = members_around(noisy.shape, segment, at, np.zeros(at.size, np.int64), 4)
    members = np.where(members % SIZE < (at % SIZE)[:, np.newaxis], members, -1)  # those on one side
    fitted = fit_patches(noisy, at, members, scales.bend[[0] * at.size], scales.third[[0] * at.size])
    spread = np.linalg.cholesky(fitted.covariance)
    draws = fitted.state[:, np.newaxis] + np.einsum(
        "nij,sj->nsi", spread, np.random.default_rng(1).normal(size=(200, STATE))
    )
    range_mm = meet(fitted.frame, draws, exact.direction[at][:, np.newaxis])[0][..., 0]
    off = (np.nanmean(range_mm, axis=1) - exact.range_mm[at]) / np.nanstd(range_mm, axis=1)
    assert (np.abs(off) < 2.5).mean() > 0.85
    assert np.median(np.nanstd(range_mm, axis=1)) < 15.0


@pytest.mark.compiled("rays meet patches in a kernel")
@pytest.mark.parametrize(
    ("thing", "bends"), [(wall(2000, (0.3, 0.2, 0.9)), False), (sphere((20, 10, 1800), 260), True)]
)
def test_a_surface_bends_only_where_its_pixels_say_so(thing: Thing, bends: bool) -> None:
    view = seen(thing, 2.0)
    segment = segments_of(view)
    largest = np.array([0])
    assert may_bend(view, segment, largest, 4)[0].tolist() == [bends]
    assert learn_scales(view, segment, largest, 4).is_flat().tolist() == [not bends]


@pytest.mark.compiled("rays meet patches in a kernel")
def test_a_step_of_range_or_light_parts_segments() -> None:
    view = seen(wall(2000), 1.0)
    right = np.arange(SIZE * SIZE) % SIZE >= SIZE // 2
    nearer = view._replace(range_mm=np.where(right, view.range_mm - 200.0, view.range_mm))
    darker = view._replace(log_amplitude=np.where(right, view.log_amplitude - 1.0, view.log_amplitude))
    assert segments_of(view).max() == 0
    for parted in (nearer, darker):
        segment = segments_of(parted)
        assert len({*segment[right].tolist()} - {-1}) == 1
        assert not ({*segment[right].tolist()} & {*segment[~right].tolist()}) - {-1}


@pytest.mark.compiled("rays meet patches in a kernel")
def test_a_plane_is_one_segment_however_steep() -> None:
    view = seen(wall(3000, (0.0, 1.0, 0.3)), 1.0)  # from 65 to 82 degrees of incidence, steps of 9 % from row to row
    inner = np.full((SIZE, SIZE), fill_value=False)
    inner[1:-1, 1:-1] = True
    assert not segments_of(view)[inner.ravel()].any()


@pytest.mark.compiled("rays meet patches in a kernel")
def test_places_of_a_lattice_share_no_row_or_column_and_fill_the_pixel() -> None:
    places = lattice_of_places(64, 27)
    for axis in (0, 1):
        np.testing.assert_allclose(np.sort(places[:, axis]), (np.arange(64) + 0.5) / 64 - 0.5)
    coarse = {tuple(part) for part in np.floor(places * 4).astype(int).tolist()}
    assert len(coarse) == 16
    np.testing.assert_allclose(grid_of_places(2), [[-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25], [0.25, 0.25]])


@pytest.mark.compiled("rays meet patches in a kernel")
def test_light_of_two_columns_is_fitted_where_their_curvature_is_open() -> None:
    view = seen(cylinder(30, 4000, 220), 1.0)
    segment = np.where(view.valid & (np.abs(np.arange(SIZE * SIZE) % SIZE - 12.5) < 1), 0, -1)
    at = np.array([12 * SIZE + 11, 12 * SIZE + 14])
    members = members_around(view.shape, segment, at, np.zeros(2, np.int64), 4)
    bend, third = (np.full(2, scale) for scale in UNKNOWN)
    assert with_light(view, at, fit_patches(view, at, members, bend, third)).fitted.all()


@pytest.mark.compiled("rays meet patches in a kernel")
@pytest.mark.parametrize(("radius", "least"), [(150.0, 20), (100.0, 6)])
def test_a_sphere_of_a_few_pixels_is_a_segment(radius: float, least: int) -> None:
    view = seen(sphere((10, 10, 2000), radius), 0.7)
    segment = segments_of(view)
    assert (segment >= 0).sum() >= least
    assert segment.max() == 0


@pytest.mark.compiled("rays meet patches in a kernel")
def test_three_columns_of_pixels_are_told_from_a_board_under_noise_by_one_direction_of_bending() -> None:
    for thing, is_flat in ((cylinder(30, 1800, 90), False), (wall(1800), True)):
        view = seen(thing, 4.0)
        cols = np.arange(SIZE * SIZE) % SIZE
        segment = np.where(view.valid & (cols >= 11) & (cols <= 13), 0, -1)
        scales = learn_scales(view, segment, np.array([0]), 4)
        assert (segment == 0).sum() == 3 * SIZE
        assert scales.is_known()[0]
        assert scales.is_flat()[0] == is_flat


def test_components_are_scipys_in_their_order(rng: np.random.Generator) -> None:
    for edges in (0, 30, 200, 2000):
        one, other = rng.integers(0, 300, (2, edges))
        graph = coo_array((np.ones(edges, np.int8), (one, other)), shape=(300, 300))
        np.testing.assert_array_equal(components(one, other, 300), connected_components(graph, directed=False)[1])
    chain = rng.permutation(3000)
    assert not components(chain[:-1], chain[1:], 3000).any()


@pytest.mark.parametrize("reach", [0, 1, 3, 20])
def test_counts_and_neighbourhoods_are_scipys_also_at_the_border(reach: int, rng: np.random.Generator) -> None:
    square = np.ones((2 * reach + 1, 2 * reach + 1))
    for shape in ((12, 17), (1, 5), (3, 1)):
        mask = rng.random(shape) < 0.1
        counted = ndimage.convolve(mask.astype(np.int64), square.astype(np.int64), mode="constant")
        np.testing.assert_array_equal(count_around(mask, reach), counted)
        values = rng.standard_normal(shape)
        np.testing.assert_allclose(
            sum_around(values, reach), ndimage.convolve(values, square, mode="constant"), atol=1e-9
        )
        np.testing.assert_array_equal(near(mask, reach), ndimage.binary_dilation(mask, square.astype(bool)))
