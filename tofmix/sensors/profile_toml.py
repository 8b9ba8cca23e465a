"""The ``[sensor]`` table of profiles and models, into a `SensorProfile` or a `CameraSheet`.

Use `read_sensor` for a model, whose keys may override a built-in camera, `read_sheet` where a camera is only
described, and `parse_profile` for a built-in camera's own file.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.measurement import Measurement, measurement_of
from tofmix.noise_shape import NoiseShape
from tofmix.optics.projection import (
    DEFAULT_PROJECTION,
    PROJECTIONS,
    Projection,
    list_keys,
    make_projection,
    number_keys,
)
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.sheet import VIEW_KEYS, CameraSheet
from tofmix.share_law import ShareLaw, share_law_of
from tofmix.toml_table import MapReader, TomlTable, nearest, parse_toml

_WHOLE = ("rows", "cols")
_NUMBERS = (
    *VIEW_KEYS,
    "range_min_mm",
    "range_max_mm",
    "integration_time_ms",
    "outlier_probability",
)
_MAY_BE_LEFT_OUT = ("modulation_frequency_hz", "default_integration_time_ms")  # a camera without phase has no frequency
_NOISE_LISTS = ("range_mm", "sigma_mm")
_LAW = {"reference_amplitude": "reference", "amplitude": "amplitude", "amplitude_factor": "factor"}
"""Keys of an `AmplitudeLaw` and its fields; they go together."""

_SHAPE = {"shape_z": "z", "shape_density": "density"}
"""Keys of a `NoiseShape` and its fields; they go together."""

_NOISE_PARTS = (*_SHAPE, "width_spread", "background")
"""Keys of the shape, widths and background of a noise curve."""

_INHERITED = ("shape", "width_spread", "background")
"""Their fields in a `NoiseCurve`, which a base camera hands on."""

_NOISE_NUMBERS = ("reference_integration_time_ms", "exponent")
_UNNAMED = "unnamed"


def read_sheet(
    table: TomlTable, base: CameraSheet | None, *, more_keys: tuple[str, ...] = (), read_map: MapReader | None = None
) -> CameraSheet:
    """Read ``[sensor]`` and ``[sensor.noise]``, none of whose keys is needed; they override `base`.

    Parameters
    ----------
    table : TomlTable
        The ``[sensor]`` table.
    base : CameraSheet or None
        Values of keys that are left out.
    more_keys : tuple of str
        Keys that the caller reads itself.
    read_map : callable, optional
        Reads the .npy file that `background` may name. Without it a table that names one is refused.

    Raises
    ------
    BadInputError
        If a key is unknown, of a wrong type or outside its bounds.
    """
    noise = table.table("noise")
    optics = {"projection", *_optics_keys()}
    table.refuse_unknown(
        {
            *_WHOLE,
            *_NUMBERS,
            *_MAY_BE_LEFT_OUT,
            "name",
            "measurement",
            "share_law",
            "noise",
            "valid_status",
            *optics,
            *more_keys,
        }
    )
    noise.refuse_unknown({*_NOISE_LISTS, *_LAW, *_NOISE_PARTS, *_NOISE_NUMBERS})
    settings: dict[str, Any] = {"name": _UNNAMED} if base is None else base.known()
    if "name" in table:
        settings["name"] = table.text("name")
    if "measurement" in table:
        settings["measurement"] = _measurement(table)
    if "share_law" in table:
        settings["share_law"] = _share_law(table)
    settings |= {key: table.integer(key) for key in _WHOLE if key in table}
    settings |= {key: table.number(key) for key in (*_NUMBERS, *_MAY_BE_LEFT_OUT) if key in table}
    settings |= {key: noise.number(key) for key in _NOISE_NUMBERS if key in noise}
    if "valid_status" in table:
        settings["valid_status"] = _codes(table)
    if any(key in noise for key in (*_NOISE_LISTS, *_LAW, *_NOISE_PARTS)):
        rows, cols = settings.get("rows"), settings.get("cols")
        image = None if rows is None or cols is None else (rows, cols)
        settings["noise"] = _noise_curve(noise, settings.get("noise"), _background(noise, image, read_map))
    settings["projection"] = _projection(table, base)
    if settings["projection"] is not None:
        settings |= dict.fromkeys(VIEW_KEYS)  # it says where the pixels look; a field of view beside it says nothing
    try:
        return CameraSheet(**settings)
    except ValueError as error:
        where = noise if str(error).startswith(("reference", "exponent", "noise curve", "background")) else table
        raise where.error(str(error)) from None


def _measurement(table: TomlTable) -> Measurement:
    try:
        return measurement_of(table.text("measurement"))
    except ValueError as error:
        raise table.error(str(error)) from None


def _share_law(table: TomlTable) -> ShareLaw:
    try:
        return share_law_of(table.text("share_law"))
    except ValueError as error:
        raise table.error(str(error)) from None


def _codes(table: TomlTable) -> tuple[int, ...]:
    codes = table.numbers("valid_status")
    if any(code != int(code) for code in codes):
        raise table.error("expected whole numbers", "valid_status")
    return tuple(int(code) for code in codes)


def read_sensor(
    table: TomlTable, base: CameraSheet | None, *, more_keys: tuple[str, ...] = (), read_map: MapReader | None = None
) -> SensorProfile:
    """Read ``[sensor]`` and ``[sensor.noise]`` of a camera that is simulated; their keys override `base`.

    Parameters
    ----------
    table, base, more_keys, read_map
        As for `read_sheet`.

    Raises
    ------
    BadInputError
        If a key is unknown, missing, of a wrong type or outside its bounds.
    """
    noise = table.table("noise")
    if base is None:
        _refuse_missing(table, noise, seen=_projection(table, None) is not None)
    if "share_law" in table and _share_law(table) is not ShareLaw.AREA:
        raise table.error("samples are simulated by area alone; leave the key out", "share_law")
    sheet = read_sheet(table, base, more_keys=more_keys, read_map=read_map)
    if lacking := sheet.missing():
        keys = ", ".join("noise.range_mm, noise.sigma_mm" if key == "noise" else key for key in lacking)
        raise table.error(f"missing {keys}; the profile of {sheet.name} lacks them: give them")
    return sheet.profile()


def _optics_keys() -> tuple[str, ...]:
    """Keys of all projections but the default one."""
    others = [name for name in PROJECTIONS if name != DEFAULT_PROJECTION]
    return tuple(key for name in others for key in (*number_keys(name), *list_keys(name)))


def _projection(table: TomlTable, base: CameraSheet | None) -> Projection | None:
    """The projection; None for equal angles over the field of view."""
    before = None if base is None else base.projection
    name = DEFAULT_PROJECTION if before is None else before.name
    if "projection" in table:
        name = table.text("projection")
    if name not in PROJECTIONS:
        raise table.error(f'"{name}" is not a projection{nearest(name, PROJECTIONS)}', "projection")
    own = () if name == DEFAULT_PROJECTION else (*number_keys(name), *list_keys(name))
    for key in _optics_keys():
        if key in table and key not in own:
            others = " or ".join(f'"{n}"' for n in PROJECTIONS if key in (*number_keys(n), *list_keys(n)))
            raise table.error(f"does not belong to the projection {name}; add projection = {others}", key)
    if name == DEFAULT_PROJECTION:
        return None
    values: dict[str, float | tuple[float, ...]] = {}
    if before is not None and before.name == name:
        values |= {key: getattr(before, key) for key in own}
    values |= {key: table.number(key) for key in number_keys(name) if key in table}
    values |= {key: table.numbers(key) for key in list_keys(name) if key in table}
    try:
        return make_projection(name, values)
    except ValueError as error:
        raise table.error(str(error)) from None


def _refuse_missing(table: TomlTable, noise: TomlTable, *, seen: bool) -> None:
    """Refuse a table that leaves out a key; the field of view is not needed where the optics are `seen` without."""
    missing = [key for key in (*_WHOLE, *_NUMBERS) if key not in table and not (seen and key in VIEW_KEYS)]
    missing += [f"noise.{key}" for key in (*_NOISE_LISTS, *_NOISE_NUMBERS) if key not in noise]
    if missing:
        raise table.error(f'missing {", ".join(missing)}; give them, or profile = "sr3000" for what is left out')


def _noise_curve(noise: TomlTable, base: NoiseCurve | None, background: FloatArray | None) -> NoiseCurve:
    lists = {} if base is None else {"range_mm": base.range_mm, "sigma_mm": base.sigma_mm}
    given: dict[str, Any] = {key: noise.numbers(key) for key in _NOISE_LISTS if key in noise}
    if lacking := [key for key in _NOISE_LISTS if key not in lists | given]:
        raise noise.error(f"missing {lacking[0]}; range_mm and sigma_mm go together")
    parts: dict[str, Any] = {} if base is None else {key: getattr(base, key) for key in _INHERITED}
    if "width_spread" in noise:
        parts["width_spread"] = noise.number("width_spread")
    if background is not None:
        parts["background"] = background
    try:
        parts |= _shape(noise)
        return NoiseCurve(**(lists | given), law=_amplitude_law(noise, base), **parts)
    except ValueError as error:
        raise noise.error(str(error).removeprefix("noise curve: ").removeprefix("noise shape: ")) from None


def _shape(noise: TomlTable) -> dict[str, NoiseShape]:
    """The shape of the error under its field's name; empty without one."""
    present = [key for key in _SHAPE if key in noise]
    if not present:
        return {}
    if len(present) < len(_SHAPE):
        raise noise.error(f"{present[0]} alone; {' and '.join(_SHAPE)} go together")
    try:
        return {"shape": NoiseShape(**{name: np.array(noise.numbers(key)) for key, name in _SHAPE.items()})}
    except ValueError as error:
        raise noise.error(str(error).removeprefix("noise shape: "), " and ".join(_SHAPE)) from None


def _background(noise: TomlTable, image: tuple[int, int] | None, read_map: MapReader | None) -> FloatArray | None:
    """The share of uniform background, of all pixels () or of each (row, col); None where the key is left out."""
    if "background" not in noise:
        return None
    if not isinstance(noise.values["background"], str):
        return np.array(noise.number("background"))
    path = noise.text("background")
    if read_map is None:
        raise noise.error("a camera without a file has no folder for a map; give a number", "background")
    try:
        return read_map(path, image).astype(np.float64)
    except ValueError as error:
        raise noise.error(" ".join(str(error).split()), "background") from None


def _amplitude_law(noise: TomlTable, base: NoiseCurve | None) -> AmplitudeLaw | None:
    """Law of amplitude of the noise at the reference integration time; None without one."""
    before = None if base is None or base.law is None else base.law
    given = {key: noise.numbers(key) for key in _LAW if key in noise}
    if before is not None:
        given = {key: tuple(getattr(before, name).tolist()) for key, name in _LAW.items()} | given
    if not given:
        return None
    if lacking := [key for key in _LAW if key not in given]:
        raise noise.error(f"missing {lacking[0]}; {', '.join(_LAW)} go together")
    return AmplitudeLaw(**{name: np.array(given[key]) for key, name in _LAW.items()})


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
