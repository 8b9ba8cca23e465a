"""Shares by areas are those that beams count, and change evenly with a surface's place."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tofmix.optics.pinhole import Pinhole
from tofmix.sensors import CompleteCamera, load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.casting.polygon_cast import PolygonCaster
from tofmix.simulation.casting.polygon_kernel import MOST_IN_FRONT
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface
from tofmix.simulation.truth import Truth

pytestmark = pytest.mark.compiled("thousands of pixels are cut")

Floats = NDArray[np.float64]


def camera(**changes: object) -> CompleteCamera:
    """26 x 34 pixels of 0.6 degrees."""
    settings: dict[str, object] = {"rows": 26, "cols": 34, "fov_horizontal_deg": 20.4, "fov_vertical_deg": 15.6}
    return replace(load_profile("sr3000"), **(settings | changes))  # type: ignore[arg-type]


def dense(truth: Truth, surfaces: int) -> tuple[Floats, Floats]:
    """Shares (surface + 1, row, col), the last of no return, and ranges (surface, row, col), NaN where none is."""
    share = np.zeros((surfaces + 1, *truth.n_modes.shape))
    range_mm = np.full((surfaces, *truth.n_modes.shape), np.nan)
    share[-1] = truth.weight_no_return
    for layer in range(truth.range_true.shape[2]):
        for number in range(surfaces):
            here = truth.surface[..., layer] == number
            share[number][here] = truth.weight_true[..., layer][here]
            range_mm[number][here] = truth.range_true[..., layer][here]
    return share, range_mm


def boards(rng: np.random.Generator, count: int, size_mm: float = 500.0) -> tuple[Surface, ...]:
    """Boards that hide parts of each other, and cut through each other."""
    return tuple(
        Surface(
            name=f"board {k}",
            size_mm=(float(rng.uniform(0.3, 1) * size_mm), float(rng.uniform(0.3, 1) * size_mm)),
            center_mm=tuple(rng.uniform((-300, -200, 1500), (300, 200, 2200)).tolist()),
            yaw_deg=float(rng.normal(0, 25)),
            pitch_deg=float(rng.normal(0, 25)),
        )
        for k in range(count)
    )


def compare(model: Model, share: float, range_mm: float) -> None:
    """Hold the shares, and the ranges of what fills over 1 % of a pixel, of both casts against each other."""
    one, other = (dense(t, len(model.surfaces)) for t in (PolygonCaster(model.sensor).cast(model), cast_scene(model)))
    assert np.abs(one[0] - other[0]).max() < share
    seen = other[0][:-1] > 0.01
    assert np.abs(one[1] - other[1])[seen].max() < range_mm


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "optics", [None, Pinhole(fx=90.0, fy=90.0, cx=17.0, cy=12.0, distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))]
)
def test_shares_and_ranges_are_those_of_beams(seed: int, optics: Pinhole | None) -> None:
    sensor = camera() if optics is None else camera(projection=optics)
    model = Model(sensor=sensor, surfaces=boards(np.random.default_rng(seed), 4))
    compare(model, share=0.0015, range_mm=0.3)


def test_surfaces_that_share_a_plane_are_seen_in_the_models_order() -> None:
    first = Surface(name="first", center_mm=(0, 0, 2000), size_mm=(300, 300))
    second = replace(first, name="second", center_mm=(100, 0, 2000))
    for surfaces in ((first, second), (second, first)):
        compare(Model(sensor=camera(), surfaces=surfaces), share=0.001, range_mm=0.01)


def test_part_of_a_surface_beyond_the_range_is_not_seen() -> None:
    model = Model(
        sensor=camera(range_max_mm=2030.0),
        surfaces=(Surface(name="wall", center_mm=(0, 0, 2000), size_mm=(9000, 9000), yaw_deg=3.0),),
    )
    compare(model, share=0.0015, range_mm=0.1)


@pytest.mark.parametrize(("rows", "cols"), [(8, 8), (24, 1)])
def test_wide_pixels_are_cast_as_well(rows: int, cols: int) -> None:
    sensor = camera(rows=rows, cols=cols, fov_horizontal_deg=45.0, fov_vertical_deg=45.0)
    compare(Model(sensor=sensor, surfaces=boards(np.random.default_rng(1), 3, 1500.0)), share=0.0015, range_mm=0.3)


def test_more_surfaces_than_areas_are_worked_out_for_are_cast_by_beams() -> None:
    many = tuple(
        Surface(name=f"slat {k}", center_mm=(30.0 + 0.5 * k, 0, 1500 + 20 * k), size_mm=(60, 600))
        for k in range(MOST_IN_FRONT + 4)
    )
    model = Model(sensor=camera(), surfaces=many)
    compare(model, share=0.0015, range_mm=0.3)


def test_scene_without_surfaces_has_no_return() -> None:
    truth = PolygonCaster(camera()).cast(Model(sensor=camera()))
    assert not truth.n_modes.any()


def test_shares_change_evenly_with_the_place_of_a_surface() -> None:
    """A thousandth of a millimetre changes no share by more than its part of a pixel, and never by a beam's."""
    board = Surface(name="board", center_mm=(10, 5, 1500), size_mm=(200, 150), yaw_deg=3.0, pitch_deg=7.0)
    caster = PolygonCaster(camera())

    def shares(x: float) -> Floats:
        moved = replace(board, center_mm=(x, 5.0, 1500.0))
        return np.asarray(dense(caster.cast(Model(sensor=camera(), surfaces=(moved,))), 1)[0][0])

    here = [shares(10 + 0.001 * k) for k in range(12)]
    steps = np.abs(np.diff(here, axis=0))
    pixel_mm = 1500 * np.radians(0.6)
    assert 0.5 * 0.001 / pixel_mm < steps.max() < 1.5 * 0.001 / pixel_mm
