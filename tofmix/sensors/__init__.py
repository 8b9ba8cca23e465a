"""Cameras: the types `Camera` and `CompleteCamera`, their TOML files, and the built-in ones, one file a camera.

Use `load_profile` where a user names a camera (``--noise sr3000``, ``profile = "sr3000"``). A recording carries its own
`tofmix.sensor.Sensor`; do not look a camera up here to read one.

The built-in cameras by name, one file and one line each; and the camera that a file describes.

A file is a model, another camera's file, or a built-in camera's own; its text is read elsewhere.
"""

from dataclasses import replace
from functools import cache
from importlib.resources import files

from tofmix.errors import BadInputError
from tofmix.sensor import NoiseCurve
from tofmix.sensors.camera import UNKNOWN, Camera, CompleteCamera
from tofmix.sensors.camera_toml import read_camera, read_complete
from tofmix.toml_table import MapReader, TomlTable, nearest, parse_toml

PROFILES: dict[str, str] = {
    "sr3000": "sr3000.toml",
    "sr4000": "sr4000.toml",
    "stoc": "stoc.toml",
    "kinect-v2": "kinect_v2.toml",
    "azure-kinect-nfov": "azure_kinect_nfov.toml",
    "azure-kinect-nfov-binned": "azure_kinect_nfov_binned.toml",
    "azure-kinect-wfov": "azure_kinect_wfov.toml",
    "azure-kinect-wfov-binned": "azure_kinect_wfov_binned.toml",
    "pico-flexx": "pico_flexx.toml",
    "l515": "l515.toml",
    "vl53l0x": "vl53l0x.toml",
    "vl53l1x": "vl53l1x.toml",
    "vl53l5cx": "vl53l5cx.toml",
    "vl53l8cx": "vl53l8cx.toml",
    "tmf8828": "tmf8828.toml",
    "tmf8829": "tmf8829.toml",
}


def load_camera(name: str) -> Camera:
    """Read the data of a built-in camera.

    Parameters
    ----------
    name : str
        A key of `PROFILES`.

    Returns
    -------
    Camera
        The camera at its default integration time.

    Raises
    ------
    BadInputError
        If there is no camera of this name.
    """
    if name not in PROFILES:
        raise BadInputError(f'"{" ".join(name.split())}" is not a built-in sensor{nearest(name, PROFILES)}')
    return parse_profile(profile_text(name), source=PROFILES[name])


def profile_text(name: str) -> str:
    """Text of a built-in camera's file; `name` is a key of `PROFILES`."""
    return (files("tofmix.sensors") / PROFILES[name]).read_text(encoding="utf-8")


def load_profile(name: str) -> CompleteCamera:
    """Read a built-in camera of which all is known that a simulation needs.

    Parameters
    ----------
    name : str
        A key of `PROFILES`.

    Returns
    -------
    CompleteCamera
        The camera at its default integration time.

    Raises
    ------
    BadInputError
        If there is no camera of this name, or something of it is not known.
    """
    try:
        return load_camera(name).complete()
    except ValueError as error:
        raise BadInputError(f"profile {name}: {error}") from None


@cache
def profiles_with_noise() -> tuple[str, ...]:
    """Names of the cameras whose profile has a noise curve."""
    return tuple(name for name in PROFILES if load_camera(name).noise is not None)


def noise_of_profile(name: str, integration_time_ms: float | None) -> tuple[NoiseCurve, str | None]:
    """Noise curve of a built-in camera at a recording's integration time.

    Parameters
    ----------
    name : str
        A key of `PROFILES`.
    integration_time_ms : float or None
        Of the recording; None for the camera's default.

    Returns
    -------
    curve : NoiseCurve
        sigma(r), mm.
    doubt : str or None
        A sentence if the default integration time was used.

    Raises
    ------
    BadInputError
        If there is no camera of this name.
    ValueError
        If its noise is not known.
    """
    camera = load_camera(name)
    if camera.noise is None:
        raise ValueError(
            f"the noise of {camera.name} is not known; auto measures it,"
            f" {', '.join(profiles_with_noise())} have a curve"
        )
    own_ms = camera.complete().integration_time_ms
    doubt = None
    if integration_time_ms is None:
        doubt = f"sensor: no integration_time_ms; the curve of {name} is taken at its default, {own_ms:g} ms"
    return camera.noise_at(integration_time_ms or own_ms), doubt


def parse_profile(text: str, *, source: str) -> Camera:
    """Read a built-in camera's file: ``[about]`` and a ``[sensor]`` with the keys that are known.

    Parameters
    ----------
    text : str
        The file's text.
    source : str
        Its name, for messages.

    Raises
    ------
    BadInputError
        If it is not TOML or not such a file.
    """
    root = parse_toml(text, source=source)
    root.refuse_unknown({"about", "sensor"})
    about = root.table("about")
    about.refuse_unknown({"confirmed", "sources"})
    if "sensor" not in root:
        raise root.error("no table [sensor], so no camera")
    camera = read_camera(root.table("sensor"), None)
    return replace(camera, confirmed=about.boolean("confirmed"), sources=about.texts("sources"))


def camera_of_model(root: TomlTable, *, read_map: MapReader | None = None) -> CompleteCamera:
    """Read the table ``[sensor]``, whose key ``profile`` names a built-in camera that its other keys override.

    `read_map` is as for `read_camera`.

    Raises
    ------
    BadInputError
        If a key is unknown, missing, of a wrong type or outside its bounds.
    """
    table = root.table("sensor")
    return read_complete(table, _base_of(table), more_keys=("profile",), read_map=read_map)


def _base_of(table: TomlTable) -> Camera | None:
    if "profile" not in table:
        return None
    name = table.text("profile")
    try:
        return load_camera(name)
    except BadInputError as error:
        raise table.error(str(error), "profile") from None


def parse_camera(text: str, *, source: str, read_map: MapReader | None = None) -> Camera:
    """Read the camera of a TOML file; other tables of a model than ``[sensor]`` are ignored.

    Parameters
    ----------
    text : str
        The file's text.
    source : str
        Its name, for messages.
    read_map : callable, optional
        As for `read_camera`.

    Raises
    ------
    BadInputError
        If it is not TOML or holds no camera.
    """
    root = parse_toml(text, source=source)
    if "sensor" not in root:
        raise root.error("no table [sensor], so no camera")
    table = root.table("sensor")
    return read_camera(table, _base_of(table), more_keys=("profile",), read_map=read_map)


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
