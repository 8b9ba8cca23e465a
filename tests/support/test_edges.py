"""The judges of edges, held against closed forms and against the caster of tests/blind."""

import numpy as np
import pytest
from blind.geometry import View, cast

from support.edge_rivals import reach_of_area, youngs_points
from support.edges import (
    camera,
    counted,
    drawn,
    judge_parts,
    judge_places,
    mixed,
    wrong_parts,
)
from support.lock_in import two_boards
from support.plates import Plate, Scene, half_plane, scene

TINY = View(rows=16, cols=20, fov_horizontal_deg=5.34, fov_vertical_deg=4.3, range_max_mm=7000.0)


@pytest.fixture(scope="module")
def half() -> Scene:
    return scene(half_plane(np.random.default_rng(4), TINY), TINY)


def test_shares_of_a_half_plane_are_the_areas_behind_its_edge(half: Scene) -> None:
    row, col = np.nonzero(mixed(half, 100))
    plate = half.plates[0]
    step = 1e-3
    away = plate.edge_distance(TINY, row, col)
    slope = np.stack(
        [
            (plate.edge_distance(TINY, row + step, col) - away) / step,
            (plate.edge_distance(TINY, row, col + step) - away) / step,
        ],
        axis=-1,
    )
    share = half.truth.share[0, row, col]
    slope /= np.linalg.norm(slope, axis=-1, keepdims=True)
    np.testing.assert_allclose(reach_of_area(slope, share), -away, atol=3e-3)


def test_shares_and_ranges_of_rectangles_are_those_of_the_other_caster() -> None:
    view = View(rows=24, cols=30, fov_horizontal_deg=16.0, fov_vertical_deg=13.0, range_max_mm=7000.0)
    surfaces = two_boards(np.random.default_rng(1))
    one = scene([Plate.of(surface) for surface in surfaces], view)
    beams = cast(surfaces, view)
    for k in range(len(surfaces)):
        share = np.where(beams.surface == k, beams.share, 0.0).sum(axis=0).reshape(24, 30)
        np.testing.assert_allclose(one.truth.share[k], share, atol=4e-3)
        ranges = np.where(beams.surface == k, beams.range_mm, 0.0).sum(axis=0).reshape(24, 30)
        both = (share > 0.02) & (one.truth.share[k] > 0.02)
        np.testing.assert_allclose(one.truth.range_mm[k][both], ranges[both], rtol=2e-3)


def test_truth_is_judged_without_a_fault_and_a_wall_alone_by_the_nearer_shares(half: Scene) -> None:
    assert judge_parts(half, half.truth.part_range_mm, 100).mean == 0.0
    far = np.full_like(half.truth.part_range_mm, 4500.0)
    there = mixed(half, 100)
    expected = half.truth.share[0][there]
    np.testing.assert_allclose(wrong_parts(half, far, 100)[there], expected, atol=0.08)
    assert judge_parts(half, far, 100).mean == pytest.approx(expected.mean(), abs=0.01)
    nothing = judge_parts(half, np.full_like(far, np.nan), 100)
    assert (nothing.mean, nothing.none) == (1.0, 1.0)
    assert judge_parts(half, far, 100).none == 0.0


def test_points_of_a_true_edge_are_on_it_and_moved_ones_off_by_as_much(half: Scene) -> None:
    row, col = youngs_points(half, counted(half, 1_000_000, 1))
    near = judge_places(half, 100, row, col)
    assert near.rms < 0.03
    assert near.covered == 1.0
    off = half.plates[0].edge_distance(TINY, row, col)
    assert judge_places(half, 100, row, col, np.full(len(row), near.rms)).z_rms == pytest.approx(1.0)
    assert near.rms == pytest.approx(float(np.sqrt(np.mean(off**2))))


@pytest.mark.parametrize("q", [0.0, 1.0])
def test_drawn_samples_have_the_shares_or_the_phasor_sum_of_the_truth(half: Scene, q: float) -> None:
    recording = drawn(half, 3000, 3, q=q)
    samples = recording.read_range(slice(0, 3000), slice(0, 16))
    truth = half.truth
    row, col = np.unravel_index(np.abs(truth.share[0] - 0.4).argmin(), truth.share[0].shape)
    share, (near, far) = truth.share[0, row, col], truth.range_mm[:, row, col]
    pixel = samples[:, row, col]
    assert recording.has_amplitude == (q > 0)
    if q == 0:
        assert (pixel < 0.5 * (near + far)).mean() == pytest.approx(share, abs=0.04)
        sigma = float(np.asarray(camera().noise.sigma(near)))  # type: ignore[union-attr]  # it has one
        assert pixel[pixel < 0.5 * (near + far)].std() == pytest.approx(sigma, rel=0.1)
    else:
        light = recording.read_amplitude(slice(0, 3000), slice(0, 16))[:, row, col]
        gloss = [plate.reflectivity * truth.cosine[k, row, col] for k, plate in enumerate(half.plates)]
        turn = 2 * np.pi * 2 * 20e6 / 299_792_458_000.0
        expected = sum(
            w * 1000.0 * g * (1000.0 / r) ** 2 * np.exp(1j * turn * r)
            for w, g, r in ((share, gloss[0], near), (1 - share, gloss[1], far))
        )
        assert np.mean(light * np.exp(1j * turn * pixel)) == pytest.approx(expected, rel=0.01)
