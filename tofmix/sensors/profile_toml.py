"""The ``[sensor]`` table of profiles and models, into a `SensorProfile` or a `CameraSheet`.

Use `read_sensor` for a model, whose keys may override a built-in camera, `read_sheet` where a camera is only
described, and `parse_profile` for a built-in camera's own file.
"""

from dataclasses import replace
from typing import Any

from tofmix.sensor import NoiseCurve
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.sheet import CameraSheet
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


def read_sheet(table: TomlTable, base: CameraSheet | None, *, more_keys: tuple[str, ...] = ()) -> CameraSheet:
    """Read ``[sensor]`` and ``[sensor.noise]``, none of whose keys is needed; they override `base`.

    Parameters
    ----------
    table : TomlTable
        The ``[sensor]`` table.
    base : CameraSheet or None
        What stands where a key is left out.
    more_keys : tuple of str
        Keys that the caller reads itself.

    Raises
    ------
    BadInputError
        If a key is unknown, of a wrong type or outside its bounds.
    """
    noise = table.table("noise")
    table.refuse_unknown({*_WHOLE, *_NUMBERS, *_MAY_BE_LEFT_OUT, "name", "noise", *more_keys})
    noise.refuse_unknown({*_NOISE_LISTS, *_NOISE_NUMBERS})
    settings: dict[str, Any] = {"name": _UNNAMED} if base is None else base.known()
    if "name" in table:
        settings["name"] = table.text("name")
    settings |= {key: table.integer(key) for key in _WHOLE if key in table}
    settings |= {key: table.number(key) for key in (*_NUMBERS, *_MAY_BE_LEFT_OUT) if key in table}
    settings |= {key: noise.number(key) for key in _NOISE_NUMBERS if key in noise}
    if any(key in noise for key in _NOISE_LISTS):
        settings["noise"] = _noise_curve(noise, settings.get("noise"))
    try:
        return CameraSheet(**settings)
    except ValueError as error:
        where = noise if str(error).startswith(("reference", "exponent", "noise curve")) else table
        raise where.error(str(error)) from None


def read_sensor(table: TomlTable, base: CameraSheet | None, *, more_keys: tuple[str, ...] = ()) -> SensorProfile:
    """Read ``[sensor]`` and ``[sensor.noise]`` of a camera that is simulated; their keys override `base`.

    Parameters
    ----------
    table, base, more_keys
        As for `read_sheet`.

    Raises
    ------
    BadInputError
        If a key is unknown, missing, of a wrong type or outside its bounds.
    """
    noise = table.table("noise")
    if base is None:
        _refuse_missing(table, noise)
    sheet = read_sheet(table, base, more_keys=more_keys)
    if lacking := sheet.missing():
        keys = ", ".join("noise.range_mm, noise.sigma_mm" if key == "noise" else key for key in lacking)
        raise table.error(f"missing {keys}; the profile of {sheet.name} does not know them: give them")
    return sheet.profile()


def _refuse_missing(table: TomlTable, noise: TomlTable) -> None:
    missing = [key for key in (*_WHOLE, *_NUMBERS) if key not in table]
    missing += [f"noise.{key}" for key in (*_NOISE_LISTS, *_NOISE_NUMBERS) if key not in noise]
    if missing:
        raise table.error(f'missing {", ".join(missing)}; give them, or profile = "sr3000" for what is left out')


def _noise_curve(noise: TomlTable, base: NoiseCurve | None) -> NoiseCurve:
    lists = {} if base is None else {"range_mm": base.range_mm, "sigma_mm": base.sigma_mm}
    given: dict[str, Any] = {key: noise.numbers(key) for key in _NOISE_LISTS if key in noise}
    if lacking := [key for key in _NOISE_LISTS if key not in lists | given]:
        raise noise.error(f"missing {lacking[0]}; range_mm and sigma_mm go together")
    try:
        return NoiseCurve(**(lists | given))
    except ValueError as error:
        raise noise.error(str(error).removeprefix("noise curve: ")) from None


def parse_profile(text: str, *, source: str) -> CameraSheet:
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
    sheet = read_sheet(root.table("sensor"), None)
    return replace(sheet, confirmed=about.boolean("confirmed"), sources=about.texts("sources"))
