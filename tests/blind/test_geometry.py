import math

import numpy as np
import pytest

from blind.geometry import Surface, View, cast, direction, first_hit
from blind.scenes import FAMILIES, TARGET, draw_scene
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model_toml import parse_model

VIEW = View(rows=12, cols=16, fov_horizontal_deg=40.0, fov_vertical_deg=30.0, range_max_mm=7000.0)


def test_share_beside_an_upright_edge_is_exact() -> None:
    """A board from x = 100 mm to far right, across all rows: its share is where atan(100 / z) cuts the cell."""
    board = Surface(name="board", center_mm=(5100.0, 0.0, 2000.0), size_mm=(10000.0, 10000.0))
    beams = cast([board], VIEW)
    wide = math.radians(40.0) / 16
    left = (np.arange(16) - 8) * wide
    exact = np.clip((left + wide - math.atan(0.05)) / wide, 0, 1)
    np.testing.assert_allclose(beams.share.sum(axis=0).reshape(12, 16), np.tile(exact, (12, 1)), atol=1e-3)


def test_shares_and_ranges_are_those_of_many_thin_beams(rng: np.random.Generator) -> None:
    surfaces = [
        Surface(name="a", center_mm=(-150, 80, 1500), size_mm=(500, 400), yaw_deg=20, pitch_deg=-15),
        Surface(name="b", center_mm=(300, -100, 2500), size_mm=(1500, 1200), yaw_deg=-35, pitch_deg=8),
    ]
    beams = cast(surfaces, VIEW)
    azimuth, elevation = VIEW.angles()
    wide, high = VIEW.cell_rad
    n = 20_000
    pixel = 5 * 16 + 6  # an edge of each crosses it
    number, away, _ = first_hit(
        surfaces, azimuth[pixel] + wide * (rng.random(n) - 0.5), elevation[pixel] + high * (rng.random(n) - 0.5), 7000.0
    )
    for k in range(2):
        layer = np.flatnonzero(beams.surface[:, pixel] == k)
        share = beams.share[layer, pixel].sum()
        assert share == pytest.approx((number == k).mean(), abs=4 * math.sqrt(0.25 / n))
        if share > 0.05:
            assert beams.range_mm[layer, pixel][0] == pytest.approx(away[number == k].mean(), abs=1.0)


def test_azimuth_and_elevation_give_the_documented_directions() -> None:
    np.testing.assert_allclose(direction(np.array(0.3), np.array(0.0)), [math.sin(0.3), 0, math.cos(0.3)])
    np.testing.assert_allclose(direction(np.array(0.0), np.array(0.2)), [0, math.sin(0.2), math.cos(0.2)])


@pytest.mark.parametrize("family", ["boards", "corridor", "room"])
def test_package_and_bench_cast_the_same_scene(family: str) -> None:
    """Two casts that share no code: shares within 0.001 of each other's error, ranges within a tenth of a mm."""
    view = View(rows=24, cols=32, fov_horizontal_deg=60.0, fov_vertical_deg=45.0, range_max_mm=7000.0)
    surfaces = draw_scene(family, [4], view).surfaces
    beams = cast(surfaces, view)
    tables = "".join(
        f'[[surface]]\nname = "{s.name}"\ncenter_mm = {[float(x) for x in s.center_mm]}\n'
        f"size_mm = {[float(x) for x in s.size_mm]}\nyaw_deg = {float(s.yaw_deg)}\npitch_deg = {float(s.pitch_deg)}\n"
        for s in surfaces
    )
    head = '[sensor]\nprofile = "sr3000"\nrows = 24\ncols = 32\nfov_horizontal_deg = 60.0\nfov_vertical_deg = 45.0\n'
    truth = cast_scene(parse_model(f"{head}range_max_mm = 7000.0\noutlier_probability = 0.0\n{tables}", source="test"))
    nothing = truth.weight_no_return.ravel()
    np.testing.assert_allclose(beams.nothing, nothing, atol=2e-3)
    mean = [np.nansum(truth.weight_true * truth.range_true, axis=2).ravel(), (beams.share * beams.range_mm).sum(axis=0)]
    full = nothing < 0.5
    np.testing.assert_allclose(mean[1][full], mean[0][full], atol=8.0)  # 0.002 of a share between boards 4 m apart
    assert np.median(np.abs(mean[1] - mean[0])[full]) < 0.1


@pytest.mark.slow
def test_scene_of_each_family_shows_its_target_and_follows_its_seed() -> None:
    assert len(FAMILIES) >= 8
    for family in FAMILIES:
        view = View(rows=12, cols=16, fov_horizontal_deg=58.0, fov_vertical_deg=46.0, range_max_mm=11200.0)
        surfaces = draw_scene(family, [9], view).surfaces
        assert TARGET in [s.name for s in surfaces]
        assert draw_scene(family, [9], view).surfaces == surfaces
        assert draw_scene(family, [10], view).surfaces != surfaces
