"""Built-in cameras: the data of each, in one TOML file a camera.

Use `load_profile` where a user names a camera (``--noise sr3000``, ``profile =
"sr3000"``). A recording carries its own `tofmix.sensor.Sensor`; do not look a
camera up here to read one.
"""

from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.registry import (
    PROFILES,
    load_profile,
    load_sheet,
    noise_of_profile,
    profile_text,
    profiles_with_noise,
)
from tofmix.sensors.sheet import CameraSheet

__all__ = [
    "PROFILES",
    "CameraSheet",
    "SensorProfile",
    "load_profile",
    "load_sheet",
    "noise_of_profile",
    "profile_text",
    "profiles_with_noise",
]
