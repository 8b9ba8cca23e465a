"""Light of one bounce between surfaces: form factors in closed form, patches by brute force, and models with it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.effect_bench import effect

from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of
from tofmix.sensors import load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects.bounce import one_bounce, sees
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import model_text, parse_model
from tofmix.simulation.surface import Surface

Floats = NDArray[np.float64]

OPTICS, SHAPE = Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0), (12, 16)
TURN_MM = 7494.8
BACK = Surface(name="back", center_mm=(0, 0, 3300), size_mm=(5000, 4000))
TABLE = Surface(name="table", center_mm=(0, 600, 2300), size_mm=(2400, 2000), pitch_deg=-90)
SIDE = Surface(name="side", center_mm=(850, 0, 2500), size_mm=(2600, 2400), yaw_deg=-90)
BOARD = Surface(name="board", center_mm=(-600, 100, 2300), size_mm=(700, 500), yaw_deg=120, pitch_deg=15, roll_deg=20)
PAIRS = [(BACK, TABLE), (TABLE, BACK), (BACK, SIDE), (SIDE, BACK), (TABLE, SIDE), (SIDE, BOARD)]


def towards_camera(surface: Surface) -> Floats:
    normal = surface.rotation()[:, 2]
    return -normal if normal @ np.array(surface.center_mm) > 0 else normal


def by_patches(surface: Surface, source: Surface, n: int = 150, *, lamp: bool = False) -> NDArray[np.complex128]:
    """The sum over n x n patches of the source, pixel by pixel; NaN where the pixel does not see the surface.

    With `lamp`, each patch has the light of a lamp at the camera, over that of the point.
    """
    place = (np.arange(n) + 0.5) / n - 0.5
    u, v = np.meshgrid(place * source.size_mm[0], place * source.size_mm[1], indexing="ij")
    axes = source.rotation()
    patches = (np.array(source.center_mm) + u[..., None] * axes[:, 0] + v[..., None] * axes[:, 1]).reshape(-1, 3)
    area = source.size_mm[0] * source.size_mm[1] / n**2
    here, there, center = towards_camera(surface), towards_camera(source), np.array(surface.center_mm)
    out = np.full(math.prod(SHAPE), np.nan, dtype=np.complex128)
    for pixel, beam in enumerate(beam_directions_of(OPTICS, SHAPE).reshape(-1, 3)):
        if beam @ here > -1e-9:
            continue
        point = beam * (here @ center) / (beam @ here)
        if (abs((point - center) @ surface.rotation()[:, :2]) > 0.5 * np.array(surface.size_mm)).any():
            continue
        way = patches - point
        length = np.linalg.norm(way, axis=1)
        factor = np.maximum(way @ here, 0) * np.maximum(-(way @ there), 0) / (np.pi * length**4) * area
        if lamp:
            lit = np.abs(patches @ there) / np.linalg.norm(patches, axis=1) ** 3
            factor = factor * lit / (abs(point @ here) / np.linalg.norm(point) ** 3)
        extra = np.linalg.norm(patches, axis=1) + length - np.linalg.norm(point)
        out[pixel] = (factor * np.exp(1j * np.pi * extra / TURN_MM)).sum()
    return out


@pytest.mark.parametrize("lamp", [False, True], ids=["even light", "lamp"])
@pytest.mark.parametrize(("surface", "source"), PAIRS, ids=lambda s: s.name)
def test_bounce_is_the_sum_over_patches_of_the_source(surface: Surface, source: Surface, lamp: bool) -> None:
    """Within 1 % of the largest, but for pixels within some patches of the seam, which patches are too coarse for."""
    found = one_bounce(surface, source, OPTICS, SHAPE, TURN_MM, float(lamp))
    wanted = by_patches(surface, source, lamp=lamp)
    seen = np.isfinite(wanted)
    assert seen.any()
    largest = abs(wanted[seen]).max()
    error = abs(found - wanted)[seen]
    assert largest > 0.005
    assert np.quantile(error, 0.9) <= 1e-2 * largest
    assert error.max() <= 0.1 * largest


def test_form_factor_of_a_long_wall_is_that_of_its_angle() -> None:
    """Of an endless strip of height h, at a right angle, from distance a: (1 - a / sqrt(a^2 + h^2)) / 2."""
    floor = Surface(name="floor", center_mm=(0, 900, 4000), size_mm=(1e6, 4000), pitch_deg=-90)
    wall = Surface(name="wall", center_mm=(0, -100, 6000), size_mm=(1e6, 2000))
    beams = beam_directions_of(OPTICS, SHAPE).reshape(-1, 3)
    points = beams * (900 / np.where(beams[:, 1] > 0.15, beams[:, 1], np.nan))[:, None]
    away = 6000 - points[:, 2]
    use = np.isfinite(away) & (away > 50) & (away < 3900)
    assert use.sum() > 20
    found = one_bounce(floor, wall, OPTICS, SHAPE, 1e12)  # so long a turn that there is no phase
    np.testing.assert_allclose(found[use].real, 0.5 * (1 - away / np.hypot(away, 2000))[use], rtol=1e-3)
    np.testing.assert_allclose(found[use].imag, 0, atol=1e-6)


def test_surfaces_of_an_outer_corner_do_not_see_each_other() -> None:
    left = Surface(name="left", center_mm=(-1100, 0, 2400), size_mm=(3000, 3600), yaw_deg=50)
    right = Surface(name="right", center_mm=(1100, 0, 2400), size_mm=(3000, 3600), yaw_deg=-50)
    assert not sees(left, right)
    np.testing.assert_array_equal(one_bounce(left, right, OPTICS, SHAPE, TURN_MM), 0)
    assert sees(replace(left, yaw_deg=-50), replace(right, yaw_deg=50))


def corner(*effects: object) -> Model:
    sensor = replace(load_profile("sr3000"), rows=SHAPE[0], cols=SHAPE[1])
    return Model(sensor=sensor, surfaces=(BACK, TABLE), effects=effects)  # type: ignore[arg-type]


def test_bounce_changes_range_amplitude_and_noise_of_its_surface_alone() -> None:
    lit = effect("multipath", surface="back", share=0.6, from_="table")
    plain, other = predict(corner()), predict(corner(lit))
    light = 1 + 0.6 * one_bounce(BACK, TABLE, OPTICS, SHAPE, plain.turn_mm)
    of = plain.surface == 0
    wanted = np.where(of, plain.turn_mm / (2 * np.pi) * np.angle(light), 0.0)
    np.testing.assert_allclose(other.range_mm - plain.range_mm, wanted, atol=1e-6)
    assert wanted.max() > 30
    np.testing.assert_allclose(other.amplitude, plain.amplitude * np.where(of, abs(light), 1.0))
    np.testing.assert_allclose(other.sigma_mm, plain.sigma_mm / np.where(of, abs(light), 1.0))


def test_bounce_follows_the_pose_of_its_source() -> None:
    lit = effect("multipath", surface="back", share=0.6, from_="table")
    lower = effect("surface_pose", surface="table", shift_mm=-150.0)
    moved = corner(lower, lit)
    (_, table) = moved.placed(0.0)
    assert table != TABLE
    light = 1 + 0.6 * one_bounce(BACK, table, OPTICS, SHAPE, TURN_MM)
    truth = cast_scene(moved)
    plain, other = predict(replace(moved, effects=(lower,)), truth), predict(moved, truth)
    wanted = np.where(plain.surface == 0, plain.turn_mm / (2 * np.pi) * np.angle(light), 0.0)
    np.testing.assert_allclose(other.range_mm - plain.range_mm, wanted, atol=0.05)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "extra_path_mm: it is missing; give it, or the surface from which the light comes"),
        ({"extra_path_mm": 900.0, "from_": "table"}, "extra_path_mm: it is there beside from; give it, or"),
        ({"from_": "back"}, 'from: "back" is the surface itself'),
        ({"from_": "tabel"}, 'from: "tabel" is not a surface of this model'),
    ],
    ids=["neither", "both", "itself", "unknown"],
)
def test_bounce_without_one_source_is_refused(values: dict[str, float | str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        corner(effect("multipath", surface="back", share=0.1, **values))


def test_bounce_is_read_from_a_model_file_and_written() -> None:
    lit = effect("multipath", surface="back", share=0.25, from_="table")
    model = corner(lit)
    text = model_text(model.sensor, model.surfaces, model.recording, model.effects)
    assert 'from = "table"' in text
    assert parse_model(text, source="m").effects == (lit,)
    assert lit.explain().startswith('"back" is also lit by one bounce from "table": 25 % more light')
