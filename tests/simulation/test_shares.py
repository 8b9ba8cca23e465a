"""Area shares against polygons, in every pixel that an edge crosses: the boards' edges and corners, oblique ones too.

Boards are clipped against each other in the plane z = 1, where edges are straight, then mapped to azimuth and elevation
edge by edge, and clipped to the pixel. What is left of the polygon's area is the share.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tofmix.optics.equiangular import Equiangular
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

pytestmark = pytest.mark.usefixtures("kernel_casts")

Floats = NDArray[np.float64]
MakeModel = Callable[..., Model]
SHARE = 0.001  # the contract
P_R = 1.0e-4
PARTS = 100  # pieces of an edge; what a chord cuts off its arc is far below the margin


def corners(surface: Surface) -> Floats:
    """A board's outline in the plane z = 1."""
    yaw, pitch = np.radians(surface.yaw_deg), np.radians(surface.pitch_deg)
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    flat = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2 * [*surface.size_mm, 0]
    points = flat @ (about_x @ about_y).T + surface.center_mm
    assert (points[:, 2] > 0).all()
    return np.asarray(points[:, :2] / points[:, 2:])


def clip(polygon: Floats, normal: Floats, offset: float) -> Floats:
    """The part of a polygon where ``normal . p <= offset`` (Sutherland and Hodgman)."""
    if not len(polygon):
        return polygon
    height = polygon @ normal - offset
    kept = []
    for (p, h), (q, g) in pairwise([*zip(polygon, height, strict=True), (polygon[0], height[0])]):
        if h <= 0:
            kept.append(p)
        if (h < 0 < g) or (g < 0 < h):
            kept.append(p + (q - p) * (h / (h - g)))
    return np.array(kept).reshape(-1, 2)


def common(one: Floats, convex: Floats) -> Floats:
    """What two polygons have in common."""
    for p, q in pairwise([*convex, convex[0]]):
        edge = q - p
        outward = np.array([edge[1], -edge[0]])
        inside = convex.mean(axis=0)
        if outward @ (inside - p) > 0:
            outward = -outward
        one = clip(one, outward, float(outward @ p))
    return one


def in_angles(polygon: Floats) -> Floats:
    """Azimuth and elevation along a polygon of the plane z = 1."""
    if not len(polygon):
        return polygon
    t = np.arange(PARTS)[:, np.newaxis] / PARTS
    x, y = np.concatenate([p + (q - p) * t for p, q in pairwise([*polygon, polygon[0]])]).T
    azimuth = np.arctan(x)
    return np.stack([azimuth, np.arctan(y * np.cos(azimuth))], axis=1)


def shares(model: Model, polygon: Floats, where: NDArray[np.bool_] | None = None) -> Floats:
    """Share of each pixel (row, col) that a polygon of the plane z = 1 covers; 0 outside `where`."""
    s = model.sensor
    assert isinstance(s.optics, Equiangular)
    size = np.array(s.optics.pixel_size_rad(s.shape))
    pixels = in_angles(polygon) / size + [s.cols / 2, s.rows / 2]  # pixel (row, col) is [col, col + 1] x [row, row + 1]
    out = np.zeros((s.rows, s.cols))
    for row in range(s.rows):
        band = clip(clip(pixels, np.array([0.0, -1.0]), -row), np.array([0.0, 1.0]), row + 1)
        for col in range(s.cols) if where is None else np.flatnonzero(where[row]).tolist():
            x, y = clip(clip(band, np.array([-1.0, 0.0]), -col), np.array([1.0, 0.0]), col + 1).T
            out[row, col] = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    return out


def found(truth: Truth, surface: int) -> Floats:
    """Area share of a surface in each pixel."""
    weight = np.where(truth.surface == surface, truth.weight_true, 0.0).sum(axis=2)
    return np.asarray(weight / (1 - P_R), dtype=np.float64)


def random_board(rng: np.random.Generator, name: str, z: float, half: float) -> Surface:
    return Surface(
        name=name,
        center_mm=(rng.uniform(-half, half), rng.uniform(-half, half), z),
        size_mm=(rng.uniform(half, 3 * half), rng.uniform(half, 3 * half)),
        yaw_deg=rng.uniform(-50, 50),
        pitch_deg=rng.uniform(-50, 50),
    )


@pytest.mark.parametrize("seed", range(6))
def test_every_pixel_of_two_oblique_boards_has_the_polygons_share(make_model: MakeModel, seed: int) -> None:
    """9 x 11 pixels of the SR-3000; the far board is seen where the near one is not."""
    rng = np.random.default_rng(seed)
    near, far = random_board(rng, "near", 1500.0, 30.0), random_board(rng, "far", 2500.0, 45.0)
    model = make_model(far, near)
    truth = cast_scene(model)
    outline = {board.name: corners(board) for board in (near, far)}
    expected_near = shares(model, outline["near"])
    hidden = shares(model, common(outline["far"], outline["near"]))
    expected_far = shares(model, outline["far"]) - hidden
    edge = (expected_near > 0) & (expected_near < 1)
    assert edge.sum() > 5
    np.testing.assert_allclose(found(truth, 1), expected_near, atol=SHARE)
    np.testing.assert_allclose(found(truth, 0), expected_far, atol=SHARE)
    nothing = truth.weight_no_return / (1 - P_R)
    np.testing.assert_allclose(nothing, 1 - expected_near - expected_far, atol=SHARE)


@pytest.mark.compiled("25,344 pixels")
@pytest.mark.slow
def test_shares_of_the_whole_image_at_the_edges_of_the_papers_boards(three_boards: tuple[Model, Truth]) -> None:
    """Every pixel of the built-in scene that an edge crosses, and all around them."""
    model, truth = three_boards
    near, middle, far = (corners(surface) for surface in model.surfaces)
    edge = ndimage.binary_dilation(truth.n_modes + (truth.weight_no_return > 0) > 1, iterations=1)
    expected_near, expected_middle = shares(model, near, edge), shares(model, middle, edge)
    assert not len(common(middle, near))  # they stand apart, a strip of the far one between them
    hidden = shares(model, common(far, near), edge) + shares(model, common(far, middle), edge)
    expected_far = shares(model, far, edge) - hidden
    for surface, expected in enumerate((expected_near, expected_middle, expected_far)):
        np.testing.assert_allclose(found(truth, surface)[edge], expected[edge], atol=SHARE)
    mixed = (expected_near > 0) & (expected_middle > 0) & (expected_far > SHARE)
    assert mixed.sum() > 40


def test_the_polygons_are_right_where_the_share_is_known(make_model: MakeModel) -> None:
    """A board from the middle of pixel 5 on, and a half that runs through its corners."""
    model = make_model()
    pixel = np.radians(47.0 / 176)
    right = np.array([[0.0, -1.0], [0.2, -1.0], [0.2, 1.0], [0.0, 1.0]])
    np.testing.assert_allclose(shares(model, right)[:, 5], 0.5, atol=1e-9)
    assert shares(model, right)[:, 6:].min() == pytest.approx(1)
    corner = np.tan(pixel / 2)
    up = np.tan(np.radians(39.0 / 144) / 2) / np.cos(pixel / 2)
    triangle = np.array([[-corner, -up], [corner, -up], [corner, up]])
    assert shares(model, triangle)[4, 5] == pytest.approx(0.5, abs=1e-4)
