"""Where a surface's plane is, by its ranges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.reconciliation.parameters.planes import measured_pose, range_slopes, ranges_to
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.surface import Surface

WALL = Surface(name="wall", center_mm=(150.0, -80.0, 2300.0), size_mm=(3000, 2000), yaw_deg=12.0, pitch_deg=-7.0)


def tilted(surface: Surface, shift_mm: float, *tilts_deg: float) -> Surface:
    return SurfacePose.tilted(surface, shift_mm, (tilts_deg[0], tilts_deg[1])).place(surface, 0.0)


def beams(n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(3)
    rays = np.stack([rng.uniform(-0.4, 0.4, n), rng.uniform(-0.3, 0.3, n), np.ones(n)], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


@given(yaw=st.floats(-60, 60), pitch=st.floats(-50, 50), x=st.floats(-500, 500), z=st.floats(800, 6000))
@pytest.mark.slow
def test_slopes_are_the_differences_of_ranges_to_moved_planes(yaw: float, pitch: float, x: float, z: float) -> None:
    surface = Surface(name="s", center_mm=(x, 0.0, z), size_mm=(100, 100), yaw_deg=yaw, pitch_deg=pitch, roll_deg=9.0)
    d = beams()
    d = d[(d @ surface.rotation()[:, 2]) > 0.2]
    found = range_slopes(surface, d)
    for k, (size, step) in enumerate(((0.01, (0.01, 0, 0)), (1e-4, (0, 1e-4, 0)), (1e-4, (0, 0, 1e-4)))):
        ahead, behind = (ranges_to(tilted(surface, *(sign * v for v in step)), d) for sign in (1, -1))
        assert found[:, k] == pytest.approx((ahead - behind) / (2 * size), rel=1e-4, abs=1e-3)


@given(
    shift=st.floats(-80, 80),
    about_u=st.floats(-5, 5),
    about_v=st.floats(-5, 5),
    strange=st.floats(0, 0.3),
)
def test_pose_of_a_plane_is_found_although_a_third_of_its_pixels_see_another_surface(
    shift: float, about_u: float, about_v: float, strange: float
) -> None:
    d = beams()
    there = tilted(WALL, shift, about_u, about_v)
    bias = ranges_to(there, d) - ranges_to(WALL, d)
    bias[: int(strange * len(bias))] += 700.0
    found = measured_pose(WALL, d, bias, np.full(len(d), 1.0))
    assert (found.shift_mm, *found.tilts_deg) == pytest.approx((shift, about_u, about_v), abs=0.05)


def test_noise_alone_gives_no_clear_tilt() -> None:
    rng = np.random.default_rng(5)
    d = beams()
    gains = [measured_pose(WALL, d, rng.normal(0, 2.0, len(d)), np.full(len(d), 0.25)).turn_nats for _ in range(60)]
    # Half of a chi-square of two degrees of freedom: mean 1, and 6 is passed once in 400
    assert 0.6 < np.mean(gains) < 1.5
    assert max(gains) < 7


def test_posed_surface_has_the_shift_and_the_added_angles() -> None:
    moved = SurfacePose(surface="wall", shift_mm=30.0, yaw_deg=2.0, pitch_deg=-1.0, roll_deg=0.5).place(WALL, 0.0)
    assert (moved.yaw_deg, moved.pitch_deg, moved.roll_deg) == (14.0, -8.0, 0.5)
    assert np.linalg.norm(np.array(moved.center_mm) - WALL.center_mm) == pytest.approx(30.0)
    assert SurfacePose(surface="wall", shift_mm=0.0).place(WALL, 0.0) == WALL
