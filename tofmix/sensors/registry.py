"""The built-in cameras by name: one file and one line each."""

from importlib.resources import files

from tofmix.errors import BadInputError
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.profile_toml import parse_profile
from tofmix.toml_table import nearest

PROFILES: dict[str, str] = {"sr3000": "sr3000.toml", "sr4000": "sr4000.toml", "stoc": "stoc.toml"}


def load_profile(name: str) -> SensorProfile:
    """Read a built-in camera.

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
        If there is no camera of this name.
    """
    if name not in PROFILES:
        raise BadInputError(f'"{" ".join(name.split())}" is not a built-in sensor{nearest(name, PROFILES)}')
    text = (files("tofmix.sensors") / PROFILES[name]).read_text(encoding="utf-8")
    return parse_profile(text, source=PROFILES[name])
