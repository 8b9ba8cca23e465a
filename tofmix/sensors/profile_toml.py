"""The ``[sensor]`` table of profiles and models, into a `SensorProfile`.

Use `read_sensor` for a model, whose keys may override a built-in camera, and
`parse_profile` for a built-in camera's own file.
"""

from dataclasses import replace
from typing import Any

from tofmix.sensor import NoiseCurve
from tofmix.sensors.profile import SensorProfile
from tofmix.toml_table import TomlTable, parse_toml

_WHOLE = ("rows", "cols")
_NUMBERS = (
    "fov_horizontal_deg",
    "fov_vertical_deg",
    "range_min_mm",
    "range_max_mm",
    "integration_time_ms",
    "outlier_probability",
)
_MAY_BE_LEFT_OUT = ("modulation_frequency_hz", "default_integration_time_ms")  # a camera without phase has no frequency
_NOISE_LISTS = ("range_mm", "sigma_mm")
_NOISE_NUMBERS = ("reference_integration_time_ms", "exponent")
_UNNAMED = "unnamed"


def read_sensor(table: TomlTable, base: SensorProfile | None, *, more_keys: tuple[str, ...] = ()) -> SensorProfile:
    """Read ``[sensor]`` and ``[sensor.noise]``; their keys override `base`.

    Parameters
    ----------
    table : TomlTable
        The ``[sensor]`` table.
    base : SensorProfile or None
        What stands where a key is left out; None if every key must be given.
    more_keys : tuple of str
        Keys that the caller reads itself.

    Raises
    ------
    BadInputError
        If a key is unknown, missing, of a wrong type or outside its bounds.
    """
    noise = table.table("noise")
    table.refuse_unknown({*_WHOLE, *_NUMBERS, *_MAY_BE_LEFT_OUT, "name", "noise", *more_keys})
    noise.refuse_unknown({*_NOISE_LISTS, *_NOISE_NUMBERS})
    if base is None:
        _refuse_missing(table, noise)
    settings: dict[str, Any] = _settings(base)
    if "name" in table:
        settings["name"] = table.text("name")
    settings |= {key: table.integer(key) for key in _WHOLE if key in table}
    settings |= {key: table.number(key) for key in (*_NUMBERS, *_MAY_BE_LEFT_OUT) if key in table}
    settings |= {key: noise.number(key) for key in _NOISE_NUMBERS if key in noise}
    settings["noise"] = _noise_curve(noise, base)
    # Without a profile nobody has said what the camera integrates by default; the curve's own time is the best guess.
    settings.setdefault("default_integration_time_ms", settings["reference_integration_time_ms"])
    try:
        profile = SensorProfile(**settings)
        profile.sensor()  # the tau law may take sigma out of its bounds
    except ValueError as error:
        where = noise if str(error).startswith(("reference", "exponent", "noise curve")) else table
        raise where.error(str(error)) from None
    return profile


def _settings(base: SensorProfile | None) -> dict[str, Any]:
    if base is None:
        return {"name": _UNNAMED}
    keys = ("name", *_WHOLE, *_NUMBERS, *_MAY_BE_LEFT_OUT, *_NOISE_NUMBERS, "confirmed", "sources")
    return {key: getattr(base, key) for key in keys}


def _refuse_missing(table: TomlTable, noise: TomlTable) -> None:
    missing = [key for key in (*_WHOLE, *_NUMBERS) if key not in table]
    missing += [f"noise.{key}" for key in (*_NOISE_LISTS, *_NOISE_NUMBERS) if key not in noise]
    if missing:
        raise table.error(f'missing {", ".join(missing)}; give them, or profile = "sr3000" for what is left out')


def _noise_curve(noise: TomlTable, base: SensorProfile | None) -> NoiseCurve:
    lists = {} if base is None else {"range_mm": base.noise.range_mm, "sigma_mm": base.noise.sigma_mm}
    given: dict[str, Any] = {key: noise.numbers(key) for key in _NOISE_LISTS if key in noise}
    try:
        return NoiseCurve(**(lists | given))
    except ValueError as error:
        raise noise.error(str(error).removeprefix("noise curve: ")) from None


def parse_profile(text: str, *, source: str) -> SensorProfile:
    """Read a built-in camera's file: ``[about]`` and a ``[sensor]`` that gives every key.

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
    profile = read_sensor(root.table("sensor"), None)
    return replace(profile, confirmed=about.boolean("confirmed"), sources=about.texts("sources"))
