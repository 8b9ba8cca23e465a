import math

import numpy as np
import pytest

from tofmix.mapping.grid import Pose


def test_a_level_camera_looks_along_x_with_y_to_its_left_and_z_up() -> None:
    right, down, forward = Pose().rotation().T
    np.testing.assert_allclose(forward, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(right, [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-15)


def test_yaw_turns_left_and_pitch_looks_down() -> None:
    np.testing.assert_allclose(Pose(yaw_deg=90).rotation()[:, 2], [0, 1, 0], atol=1e-15)
    forward = Pose(pitch_deg=30).rotation()[:, 2]
    np.testing.assert_allclose(forward, [math.sqrt(3) / 2, 0, -0.5], atol=1e-15)


@pytest.mark.parametrize("pitch", [-80.0, 0.0, 33.0])
@pytest.mark.parametrize("yaw", [-200.0, 0.0, 71.0])
def test_the_axes_are_right_handed_and_orthonormal(yaw: float, pitch: float) -> None:
    rotation = Pose(yaw_deg=yaw, pitch_deg=pitch).rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize(
    "bad", [{"x_mm": math.nan}, {"y_mm": 1e9}, {"yaw_deg": math.inf}, {"pitch_deg": 90.0}, {"pitch_deg": math.nan}]
)
def test_refusals_name_the_key(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        Pose(**bad)
