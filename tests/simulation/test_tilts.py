"""Tilts about a surface's own axes, against SciPy's rotations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tofmix.simulation.surface import Surface, angle_changes, tilts_to

ANGLE = st.floats(-180, 180)
TILT = st.floats(-15, 15)


def surface(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Surface:
    return Surface(
        name="s",
        center_mm=(0.0, 0.0, 2000.0),
        size_mm=(1000.0, 1000.0),
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        roll_deg=roll_deg,
    )


def turned(one: Surface, changes: tuple[float, float, float]) -> Surface:
    yaw, pitch, roll = changes
    return surface(one.yaw_deg + yaw, one.pitch_deg + pitch, one.roll_deg + roll)


def is_regular(yaw_deg: float, pitch_deg: float) -> bool:
    """Whether yaw and one more angle tilt the surface about two axes that are not nearly one."""
    yaw, pitch = math.radians(yaw_deg), math.radians(pitch_deg)
    return max(abs(math.cos(yaw)), abs(math.cos(pitch) * math.sin(yaw))) > 0.5


@given(yaw=ANGLE, pitch=ANGLE, roll=ANGLE)
def test_rotation_is_by_yaw_then_pitch_then_roll_about_the_sensors_axes(yaw: float, pitch: float, roll: float) -> None:
    expected = Rotation.from_euler("yxz", [yaw, pitch, roll], degrees=True).as_matrix()
    np.testing.assert_allclose(surface(yaw, pitch, roll).rotation(), expected, atol=1e-12)


@given(yaw=ANGLE, pitch=ANGLE, roll=ANGLE, about_u=TILT, about_v=TILT)
def test_changed_angles_turn_the_normal_as_the_tilt_does(
    yaw: float, pitch: float, roll: float, about_u: float, about_v: float
) -> None:
    one = surface(yaw, pitch, roll)
    if not is_regular(yaw, pitch):
        return
    tilt = Rotation.from_rotvec([about_u, about_v, 0.0], degrees=True).as_matrix()
    expected = one.rotation() @ tilt[:, 2]
    found = turned(one, angle_changes(one, (about_u, about_v))).rotation()[:, 2]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(tilts_to(one, expected), (about_u, about_v), atol=1e-6)


@pytest.mark.parametrize(
    ("own", "tilts", "changes"),
    [
        ((0.0, 0.0, 0.0), (0.8, 0.0), (0.0, 0.8, 0.0)),  # a board that faces the camera
        ((0.0, 0.0, 0.0), (0.0, 0.8), (0.8, 0.0, 0.0)),
        ((90.0, 0.0, 0.0), (0.0, 0.8), (0.8, 0.0, 0.0)),  # a side wall
        ((90.0, 0.0, 0.0), (0.8, 0.0), (0.0, 0.0, -0.8)),
        ((90.0, 40.0, 0.0), (0.0, 0.8), (0.8, 0.0, 0.0)),
        ((0.0, 90.0, 0.0), (0.8, 0.0), (0.0, 0.8, 0.0)),  # a floor
        ((0.0, 90.0, 0.0), (0.0, 0.8), (0.8, 0.0, 0.0)),
    ],
)
def test_walls_boards_and_floors_change_one_angle_for_a_tilt_about_one_axis(
    own: tuple[float, float, float], tilts: tuple[float, float], changes: tuple[float, float, float]
) -> None:
    assert angle_changes(surface(*own), tilts) == pytest.approx(changes, abs=1e-9)


def test_a_tilt_that_the_angles_cannot_make_is_refused() -> None:
    with pytest.raises(ValueError, match="one axis alone"):
        angle_changes(surface(90.0, 90.0, 0.0), (0.8, 0.0))
    with pytest.raises(ValueError, match="above 60"):
        angle_changes(surface(0.0, 0.0, 0.0), (50.0, 50.0))
