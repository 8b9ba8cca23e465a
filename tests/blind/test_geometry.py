"""The bench's own caster and lens: shares, ranges and rays, against closed forms, OpenCV and the package."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.lens import beams as brute_force

from blind.cases import draw_device, draw_lens
from blind.geometry import Lens, Surface, View, cast, first_hit
from blind.reference import NoiseTable
from blind.scenes import FAMILIES, TARGET, draw_scene
from blind.write import model_text
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model_toml import parse_model

VIEW = View(rows=12, cols=16, fov_horizontal_deg=40.0, fov_vertical_deg=30.0, range_max_mm=7000.0)


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


LENS = Lens(focal=(0.87, 1.1), off_center=(0.03, -0.02), radial=(-0.22, 0.05, -0.004))
VIEW_LENS = View(rows=18, cols=24, fov_horizontal_deg=1.0, fov_vertical_deg=1.0, range_max_mm=7000.0, lens=LENS)


def test_rays_and_solid_angles_equal_those_of_opencv() -> None:
    fx, fy, cx, cy = LENS.pixels(VIEW_LENS.rows, VIEW_LENS.cols)
    row, col = (a.ravel().astype(float) for a in np.indices((VIEW_LENS.rows, VIEW_LENS.cols)))
    k1, k2, k3 = LENS.radial
    wanted, solid = brute_force(row, col, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, 0.0, 0.0, k3))
    np.testing.assert_allclose(VIEW_LENS.direction(*VIEW_LENS.places()).T, wanted, atol=1e-9)
    wide, high = VIEW_LENS.cell_rad
    np.testing.assert_allclose(LENS.solid_angle(*VIEW_LENS.places()) * wide * high, solid, rtol=1e-6)
    azimuth, elevation = VIEW_LENS.angles()
    np.testing.assert_allclose(np.cos(azimuth) * np.cos(elevation), wanted[:, 2], atol=1e-9)


@pytest.mark.parametrize("family", ["boards", "corridor"])
def test_package_and_bench_cast_the_same_scene_through_a_lens(family: str, tmp_path: Path) -> None:
    device = replace(draw_device(5, 1), rows=24, cols=32, range_max_mm=7000.0, outlier_probability=0.0)
    device = replace(device, lens=draw_lens(device, np.random.default_rng(2)))
    surfaces = draw_scene(family, [4], device.view).surfaces
    beams = cast(surfaces, device.view)
    noise = NoiseTable(range_mm=np.array([300.0, 7000.0]), sigma_mm=np.array([2.0, 50.0]))
    text = model_text(device, surfaces, noise)
    truth = cast_scene(parse_model(text, source=str(tmp_path / "model.toml")))
    nothing = truth.weight_no_return.ravel()
    np.testing.assert_allclose(beams.nothing, nothing, atol=2e-3)
    mean = [np.nansum(truth.weight_true * truth.range_true, axis=2).ravel(), (beams.share * beams.range_mm).sum(axis=0)]
    full = nothing < 0.5
    np.testing.assert_allclose(mean[1][full], mean[0][full], atol=8.0)
    assert np.median(np.abs(mean[1] - mean[0])[full]) < 0.15
