"""Rays through the bench's lens, against OpenCV's formula by brute force and against the package's own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.lens import beams as brute_force

from blind.cases import draw_device, draw_lens
from blind.geometry import Lens, Surface, View, cast
from blind.reference import NoiseTable
from blind.scenes import draw_scene
from blind.write import model_text
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model_toml import parse_model

LENS = Lens(focal=(0.87, 1.1), off_center=(0.03, -0.02), radial=(-0.22, 0.05, -0.004))
VIEW = View(rows=18, cols=24, fov_horizontal_deg=1.0, fov_vertical_deg=1.0, range_max_mm=7000.0, lens=LENS)


def test_undistorted_radius_is_the_inverse_of_the_distorted_one() -> None:
    radius = np.linspace(0, 0.9, 50)
    np.testing.assert_allclose(LENS.undistorted(LENS.distorted(radius)), radius, atol=1e-12)


def test_drawn_lenses_image_the_whole_image_without_a_fold() -> None:
    for number in range(20):
        rng = np.random.default_rng(number)
        device = draw_device(3, number % 3)
        lens = draw_lens(device, rng)
        x, y = replace(device, lens=lens).view.places()
        imaged = 1.05 * np.hypot(x, y).max()  # the corner of the last pixel is within that
        radius = np.linspace(0, float(lens.undistorted(np.array(imaged))), 200)
        assert (np.diff(lens.distorted(radius)) > 0).all()
        assert lens.distorted(radius[-1:])[0] == pytest.approx(imaged, abs=1e-12)
        assert imaged / radius[-1] < 0.97  # a lens that distorts the corner by two pixels and more


def test_rays_and_solid_angles_equal_those_of_opencv() -> None:
    fx, fy, cx, cy = LENS.pixels(VIEW.rows, VIEW.cols)
    row, col = (a.ravel().astype(float) for a in np.indices((VIEW.rows, VIEW.cols)))
    k1, k2, k3 = LENS.radial
    wanted, solid = brute_force(row, col, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, 0.0, 0.0, k3))
    np.testing.assert_allclose(VIEW.direction(*VIEW.places()).T, wanted, atol=1e-9)
    wide, high = VIEW.cell_rad
    np.testing.assert_allclose(LENS.solid_angle(*VIEW.places()) * wide * high, solid, rtol=1e-6)
    azimuth, elevation = VIEW.angles()
    np.testing.assert_allclose(np.cos(azimuth) * np.cos(elevation), wanted[:, 2], atol=1e-9)


def test_same_lens_sees_the_same_scene_with_other_numbers_of_rows_and_columns() -> None:
    board = [Surface(name="board", center_mm=(200.0, 100.0, 2000.0), size_mm=(700.0, 500.0))]
    filled = [
        cast(board, replace(VIEW, rows=rows, cols=cols)).share.sum(axis=0).mean()
        for rows, cols in ((18, 24), (36, 48), (30, 30))
    ]
    np.testing.assert_allclose(filled, filled[0], atol=2e-4)


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
