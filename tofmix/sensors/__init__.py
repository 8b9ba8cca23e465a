"""Cameras: the types `Camera` and `CompleteCamera`, their TOML files, and the built-in ones, one file a camera.

Use `load_profile` where a user names a camera (``--noise sr3000``, ``profile = "sr3000"``). A recording carries its own
`tofmix.sensor.Sensor`; do not look a camera up here to read one.
"""

from tofmix.sensors.camera import UNKNOWN, Camera, CompleteCamera
from tofmix.sensors.registry import (
    PROFILES,
    camera_of_model,
    load_camera,
    load_profile,
    noise_of_profile,
    parse_camera,
    parse_profile,
    profile_text,
    profiles_with_noise,
)

__all__ = [
    "PROFILES",
    "UNKNOWN",
    "Camera",
    "CompleteCamera",
    "camera_of_model",
    "load_camera",
    "load_profile",
    "noise_of_profile",
    "parse_camera",
    "parse_profile",
    "profile_text",
    "profiles_with_noise",
]
