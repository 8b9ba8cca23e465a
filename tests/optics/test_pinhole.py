"""The pinhole against a lens by brute force: round trips, the fold, ends of the image, and refusals."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import lens

from tofmix.optics.pinhole import Distortion, Pinhole

WIDE: dict[str, Any] = {"fx": 125.7, "fy": 138.3, "cx": 87.2, "cy": 70.9}
LENSES = [
    (),
    (-0.1, 0.0, 0.0, 0.0),
    (-0.28, 0.07, 0.001, -0.002, -0.01),
    (0.2, -0.05, -0.0015, 0.001, 0.02),
    (0.6, -2.9, -2.7e-4, 1.9e-4, 1.67, 0.48, -2.7, 1.59),  # the rational model, as of an Azure Kinect's kind
]


@pytest.mark.parametrize("distortion", LENSES)
def test_rays_agree_with_the_lens_by_brute_force(distortion: tuple[float, ...]) -> None:
    rng = np.random.default_rng(3)
    row, col = rng.uniform(-0.5, 143.5, 500), rng.uniform(-0.5, 175.5, 500)
    rays = Pinhole(**WIDE, distortion=distortion).rays(row, col, shape=(144, 176))
    expected, _ = lens.beams(row, col, **WIDE, distortion=distortion)
    np.testing.assert_allclose(rays / np.linalg.norm(rays, axis=1, keepdims=True), expected, atol=1e-12)


@pytest.mark.parametrize("distortion", LENSES)
def test_pixels_of_rays_are_where_the_rays_are_from(distortion: tuple[float, ...]) -> None:
    pinhole = Pinhole(**WIDE, distortion=distortion)
    row, col = np.meshgrid(np.linspace(-0.5, 143.5, 31), np.linspace(-0.5, 175.5, 31), indexing="ij")
    rays = pinhole.rays(row, col, shape=(144, 176))
    for length in (1.0, 2500.0):
        back = pinhole.pixels(length * rays, shape=(144, 176))
        np.testing.assert_allclose(back, (row, col), atol=1e-8)


coefficient = st.floats(-0.3, 0.3)
small = st.floats(-0.005, 0.005)


@given(
    k=st.tuples(coefficient, coefficient, small, small, coefficient, coefficient, coefficient, coefficient),
    radius=st.floats(0, 1.5),
    angle=st.floats(0, 7),
)
def test_undistorting_gives_a_place_that_is_imaged_there_or_none(
    k: tuple[float, ...], radius: float, angle: float
) -> None:
    """Whatever the lens: either NaN, or the formula leads back to the place, from this side of the fold."""
    distortion = Distortion(k)
    to = np.array([radius * math.cos(angle)]), np.array([radius * math.sin(angle)])
    x, y = distortion.undo(*to)
    if np.isfinite(x[0]):
        np.testing.assert_allclose(lens.distorted(x, y, k), to, atol=1e-9)
        assert math.hypot(x[0], y[0]) < distortion.fold_radius()


@pytest.mark.parametrize(
    ("k", "radius"),
    [
        ((), math.inf),
        ((0.1, 0.0, 0.0, 0.0), math.inf),
        ((-0.1, 0.0, 0.0, 0.0), math.sqrt(1 / 0.3)),  # d/dr (r - 0.1 r^3) = 0
        ((0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0), 2.0),  # a pole at 1 - r^2 / 4 = 0
        ((0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0), 1.0),  # d/dr r / (1 + r^2) = 0
        ((1e-300, 0.0, 0.0, 0.0, -1e-300), math.inf),
    ],
)
def test_fold_radius_is_where_the_formula_turns(k: tuple[float, ...], radius: float) -> None:
    assert Distortion(k).fold_radius() == pytest.approx(min(radius, 1000.0), rel=1e-9)


def test_fold_is_that_of_a_fine_scan() -> None:
    rng = np.random.default_rng(5)
    r = np.linspace(0, 3, 100_001)
    for k in rng.uniform(-0.4, 0.4, (25, 8)) * [1, 1, 0, 0, 1, 1, 1, 1]:
        imaged = lens.distorted(r, np.zeros_like(r), tuple(k))[0]
        turns = np.flatnonzero(np.diff(imaged) <= 0)
        expected = r[turns[0]] if turns.size else math.inf
        assert min(Distortion(tuple(k)).fold_radius(), 3.0) == pytest.approx(min(expected, 3.0), abs=6e-5)


def test_an_image_that_reaches_the_fold_is_refused_with_the_angle() -> None:
    folding = Pinhole(**(WIDE | {"fx": 60.0, "fy": 60.0}), distortion=(-0.25, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"^distortion: it folds.* 49\.1 degrees off the axis.* row -0\.5, column"):
        folding.check((144, 176))
    Pinhole(fx=60.0, fy=60.0, cx=19.5, cy=19.5, distortion=(-0.25, 0.0, 0.0, 0.0)).check((40, 40))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"fx": 0.0}, r"^fx: 0 is not a finite number above 0"),
        ({"fy": -2.0}, r"^fy: -2 is not"),
        ({"fy": math.inf}, r"^fy: inf is not"),
        ({"cx": math.nan}, r"^cx: nan is not a finite number$"),
        ({"distortion": (0.1,)}, r"^distortion: 1 numbers; expected OpenCV's k1 k2 p1 p2"),
        ({"distortion": (0.1,) * 14}, r"^distortion: 14 numbers"),
        ({"distortion": (0.1, math.nan, 0.0, 0.0)}, r"^distortion: .*nan.*: not all are finite"),
    ],
)
def test_numbers_that_no_camera_has_are_refused(change: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Pinhole(**(WIDE | change))


@pytest.mark.parametrize("focal", [1e-300, 1e-5])
def test_a_pinhole_of_180_degrees_is_refused(focal: float) -> None:
    with pytest.raises(ValueError, match=r"^fx, fy: a pinhole images up to 89\.94 degrees"):
        Pinhole(fx=focal, fy=focal, cx=1.0, cy=1.0).check((3, 3))


def test_directions_behind_the_camera_and_beyond_the_fold_have_no_pixel() -> None:
    pinhole = Pinhole(**WIDE, distortion=(-0.1, 0.0, 0.0, 0.0))
    directions = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [1.9, 0.0, 1.0], [1.8, 0.0, 1.0]])
    row, col = pinhole.pixels(directions, shape=(144, 176))
    np.testing.assert_array_equal(np.isnan(row), [True, True, True, False])
    np.testing.assert_array_equal(np.isnan(col), np.isnan(row))


def test_words_name_the_field_of_view() -> None:
    focal = 88.0 / math.tan(math.radians(35.0)), 72.0 / math.tan(math.radians(27.5))
    pinhole = Pinhole(fx=focal[0], fy=focal[1], cx=87.5, cy=71.5)
    assert pinhole.words((144, 176)) == "70.0 x 55.0 degrees of a pinhole"
