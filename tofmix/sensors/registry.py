"""The built-in cameras by name: one file and one line each."""

from functools import cache
from importlib.resources import files

from tofmix.errors import BadInputError
from tofmix.sensor import NoiseCurve
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.profile_toml import parse_profile
from tofmix.sensors.sheet import CameraSheet
from tofmix.toml_table import nearest

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


def load_sheet(name: str) -> CameraSheet:
    """Read the data of a built-in camera.

    Parameters
    ----------
    name : str
        A key of `PROFILES`.

    Returns
    -------
    CameraSheet
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


def load_profile(name: str) -> SensorProfile:
    """Read a built-in camera of which all is known that a simulation needs.

    Parameters
    ----------
    name : str
        A key of `PROFILES`.

    Returns
    -------
    SensorProfile
        The camera at its default integration time.

    Raises
    ------
    BadInputError
        If there is no camera of this name, or something of it is not known.
    """
    try:
        return load_sheet(name).profile()
    except ValueError as error:
        raise BadInputError(f"profile {name}: {error}") from None


@cache
def profiles_with_noise() -> tuple[str, ...]:
    """Names of the cameras whose profile has a noise curve."""
    return tuple(name for name in PROFILES if load_sheet(name).noise is not None)


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
    sheet = load_sheet(name)
    if sheet.noise is None:
        raise ValueError(
            f"the noise of {sheet.name} is not known; auto measures it, {', '.join(profiles_with_noise())} have a curve"
        )
    profile = sheet.profile()
    doubt = None
    if integration_time_ms is None:
        default = f"{profile.integration_time_ms:g} ms"
        doubt = f"sensor: no integration_time_ms; the curve of {name} is taken at its default, {default}"
    return profile.noise_at(integration_time_ms or profile.integration_time_ms), doubt
