"""Bounds of a model's parts, and the sense of its rotations."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tofmix.sensors import CompleteCamera
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

BOARD = Surface(name="board", center_mm=(0, 0, 2000), size_mm=(500, 400))


@pytest.mark.parametrize(
    ("yaw", "pitch", "u", "v", "n"),
    [
        (0, 0, (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        (90, 0, (0, 0, -1), (0, 1, 0), (1, 0, 0)),  # right-handed about y: z turns to x, x to -z
        (0, 90, (1, 0, 0), (0, 0, 1), (0, -1, 0)),  # right-handed about x: y turns to z, z to -y
        (90, 90, (0, 1, 0), (0, 0, 1), (1, 0, 0)),  # yaw first: u lies along -z, which pitch turns to y
    ],
)
def test_rotation_is_yaw_about_y_then_pitch_about_x(
    yaw: float, pitch: float, u: tuple[int, ...], v: tuple[int, ...], n: tuple[int, ...]
) -> None:
    np.testing.assert_allclose(replace(BOARD, yaw_deg=yaw, pitch_deg=pitch).rotation().T, [u, v, n], atol=1e-15)


def test_rotation_is_orthonormal_and_keeps_handedness() -> None:
    rotation = replace(BOARD, yaw_deg=33, pitch_deg=-71).rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size_mm": (0.0, 1.0)}, "size_mm: "),
        ({"size_mm": (1.0, float("nan"))}, "size_mm: "),
        ({"size_mm": (1.0, 1e300)}, "size_mm: "),
        ({"center_mm": (0.0, 0.0, float("inf"))}, "center_mm: "),
        ({"yaw_deg": float("nan")}, "yaw_deg: nan is not finite"),
        ({"pitch_deg": float("inf")}, "pitch_deg: "),
        ({"reflectivity": 1.01}, "reflectivity: 1.01 is not in"),
        ({"reflectivity": float("nan")}, "reflectivity: "),
        ({"name": ""}, "name: "),
    ],
)
def test_surface_refuses_values_out_of_bounds(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        replace(BOARD, **change)


@pytest.mark.parametrize("change", [{"frames": 0}, {"seed": -1}, {"frame_rate_hz": 0.0}, {"frame_rate_hz": np.inf}])
def test_recording_settings_refuse_values_out_of_bounds(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))}: "):
        RecordingSettings(**change)


def test_model_refuses_two_surfaces_of_one_name(sensor: CompleteCamera) -> None:
    with pytest.raises(ValueError, match='surfaces 1 and 2 are both named "board"'):
        Model(sensor=sensor, surfaces=(BOARD, BOARD))
