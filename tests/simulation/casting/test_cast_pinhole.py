"""Scenes through a pinhole: shares and ranges against brute-force rays, whole walls, edges, and moving surfaces."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import cast_twin, lens
from support.recordings import MAKE
from support.sizes import sized

from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import cell_nodes
from tofmix.sensors import CompleteCamera, load_profile
from tofmix.simulation.casting import cast_cells
from tofmix.simulation.casting.cast import MovingCaster, cast_scene
from tofmix.simulation.casting.scene import scene_arrays
from tofmix.simulation.effects.base import Context
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

Floats = NDArray[np.float64]
SHARE = 0.001  # the contract
P_R = 1.0e-4
LENS: dict[str, Any] = {"fx": 18.0, "fy": 17.0, "cx": 5.6, "cy": 3.9, "distortion": (-0.1, 0.02, 0.003, -0.002, 0.0)}
BOARDS = (
    Surface(name="right", center_mm=(200, 100, 2000), size_mm=(900, 700), yaw_deg=30, pitch_deg=10),
    Surface(name="left", center_mm=(-300, -200, 2500), size_mm=(900, 700), yaw_deg=-30, pitch_deg=10),
    Surface(name="wall", center_mm=(0, 0, 4000), size_mm=(3000, 3000)),
)

pytestmark = pytest.mark.usefixtures("kernel_casts")


def camera(**changes: Any) -> CompleteCamera:  # noqa: ANN401  keys of a pinhole
    """9 x 11 pixels of about 3 degrees each, through a lens."""
    return replace(load_profile("sr3000"), rows=9, cols=11, projection=Pinhole(**(LENS | changes)))


def brute_force(model: Model, row: int, col: int, side: int = 250) -> tuple[Floats, Floats]:
    """Shares (S,) of a pixel's solid angle, and mean ranges (S,), of side x side rays over the pixel's square."""
    pinhole = model.sensor.projection
    assert isinstance(pinhole, Pinhole)
    part = (np.arange(side) + 0.5) / side - 0.5
    down, across = np.meshgrid(row + part, col + part, indexing="ij")
    beam, weight = lens.beams(
        down, across, fx=pinhole.fx, fy=pinhole.fy, cx=pinhole.cx, cy=pinhole.cy, distortion=pinhole.distortion
    )
    ranges = [np.full((side, side), np.inf)]
    for surface in model.surfaces:
        u, v, n = surface.rotation().T
        center = np.array(surface.center_mm)
        with np.errstate(divide="ignore"):
            t = (center @ n) / (beam @ n)
        point = beam * t[..., np.newaxis] - center
        hit = (abs(point @ u) <= surface.size_mm[0] / 2) & (abs(point @ v) <= surface.size_mm[1] / 2)
        ranges.append(np.where(hit & (t > 0) & (t <= model.sensor.range_max_mm), t, np.inf))
    first, nearest = np.argmin(ranges, axis=0) - 1, np.min(ranges, axis=0)
    met = [weight[first == k].sum() for k in range(len(model.surfaces))]
    mean = [(weight * nearest)[first == k].sum() / met[k] if met[k] else np.nan for k in range(len(met))]
    return np.array(met) / weight.sum(), np.array(mean)


@pytest.mark.slow
def test_shares_and_ranges_agree_with_brute_force_rays() -> None:
    model = Model(sensor=camera(), surfaces=BOARDS)
    truth = cast_scene(model)
    pixels = [(row, col) for row in range(9) for col in range(11)]
    several = 0
    for row, col in pixels[:: sized(5, 9)]:
        share, ranges = np.zeros(3), np.full(3, np.nan)
        for layer in range(truth.n_modes[row, col]):
            k = truth.surface[row, col, layer]
            share[k], ranges[k] = truth.weight_true[row, col, layer] / (1 - P_R), truth.range_true[row, col, layer]
        expected_share, expected_range = brute_force(model, row, col)
        np.testing.assert_allclose(share, expected_share, atol=SHARE)
        seen = (share > 0.01) & (expected_share > 0.01)
        several += int(seen.sum() > 1)
        np.testing.assert_allclose(ranges[seen], expected_range[seen], atol=0.5)
        total = share.sum() + truth.weight_no_return[row, col] / (1 - P_R)
        assert total == pytest.approx(1.0, abs=1e-6)
    assert several >= 3


@pytest.mark.slow
def test_a_wall_square_to_the_axis_has_the_closed_form_range() -> None:
    """Without a lens, 8 x 8 rays a pixel: a wall at z has the range z / cos, averaged over the cell."""
    wall = Surface(name="wall", center_mm=(0, 0, 2000), size_mm=(9000, 9000))
    model = Model(sensor=camera(distortion=(), fx=100.0, fy=100.0), surfaces=(wall,))
    truth = cast_scene(model)
    row, col = np.mgrid[:9, :11]
    expected = 2000 * np.sqrt(1 + ((col - 5.6) / 100) ** 2 + ((row - 3.9) / 100) ** 2)
    np.testing.assert_allclose(truth.range_true[..., 0], expected, atol=0.03)
    assert (truth.n_modes == 1).all()
    np.testing.assert_array_equal(truth.weight_true[..., 0], np.float32(1 - P_R))


def test_an_edge_on_the_border_of_two_pixels_is_of_neither() -> None:
    """A pinhole images a vertical edge as a column's border: no share is lost to its neighbour."""
    sensor = camera(distortion=(), cx=5.0)
    edge = 2000 * (6.5 - 5.0) / 18.0
    board = Surface(name="board", center_mm=(edge - 5000, 0, 2000), size_mm=(10_000, 9000))
    truth = cast_scene(Model(sensor=sensor, surfaces=(board,)))
    np.testing.assert_array_equal(truth.n_modes, np.repeat([[1] * 7 + [0] * 4], 9, axis=0))


@pytest.mark.parametrize("width_mm", [0.3, 3.0])
def test_a_wire_thinner_than_any_grid_is_not_missed(width_mm: float) -> None:
    wire = Surface(name="wire", center_mm=(150.0, 0, 2000), size_mm=(width_mm, 3000), yaw_deg=0)
    truth = cast_scene(Model(sensor=camera(), surfaces=(wire, BOARDS[2])))
    found = np.where(truth.surface == 0, truth.weight_true, 0.0).sum(axis=(1, 2))
    assert (found > 0.3 * width_mm / 2000 * 18).all()
    np.testing.assert_allclose(found, width_mm / 2000 * 18, rtol=0.5)


def test_the_kernel_agrees_with_its_twin() -> None:
    model = Model(sensor=camera(), surfaces=BOARDS)
    scene = scene_arrays(model)
    for row in (0, 4, 7):
        nodes = cell_nodes(model.sensor.optics, row, (9, 11))
        wanted = np.ones(11, dtype=np.bool_)
        wanted[3] = False
        kernel, twin = np.zeros((11, 3, 3)), np.zeros((11, 3, 3))
        cast_cells.cast_cells(nodes, scene, wanted, kernel)
        cast_twin.cast_cells(nodes, scene, wanted, twin)
        np.testing.assert_allclose(kernel[..., 0], twin[..., 0], atol=0.01)
        assert not kernel[3].any()


def test_moving_surfaces_are_cast_as_still_ones_at_their_places() -> None:
    effect = MAKE["motion"](surface="right", velocity_mm_s=300.0)
    model = Model(sensor=camera(), surfaces=BOARDS, effects=(effect,), recording=RecordingSettings(frames=3))
    caster = MovingCaster(model)
    for time_s in sized((0.0, 0.7), (0.7,)):
        still = cast_scene(replace(model, surfaces=model.placed(time_s), effects=())).padded(caster.layers)
        moved = caster.cast(time_s)
        np.testing.assert_array_equal(moved.range_true, still.range_true)
        np.testing.assert_array_equal(moved.weight_true, still.weight_true)


def test_vignetting_follows_the_angle_off_the_axis() -> None:
    """The pixel in the farthest corner has the factor; the axis may lie anywhere in the image."""
    sensor = camera()
    context = Context(sensor=sensor, surfaces=(), seed=1)
    light = MAKE["vignetting"](corner_factor=3.0).prepare(context, 1).reshape(9, 11)
    row, col = np.mgrid[:9, :11].astype(float)
    cosine = lens.beams(row, col, **LENS)[0][..., 2]
    assert light.min() == pytest.approx(1 / 3)
    np.testing.assert_allclose(light, cosine ** (-np.log(3.0) / np.log(cosine.min())), rtol=1e-9)
    assert np.unravel_index(light.argmax(), light.shape) == (4, 6)
