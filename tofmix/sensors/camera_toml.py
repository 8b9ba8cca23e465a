"""The table ``[sensor]`` of a TOML file, into a camera; and a noise curve as the table ``[sensor.noise]``.

`read_camera` and `read_complete` read a table whose keys may override a camera; `tofmix.sensors` finds that
camera. Use `camera_toml` where a camera is written into a model, and `noise_toml` where a curve is printed to be
pasted, or written into a model.
"""

import textwrap
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.noise_shape import NoiseShape
from tofmix.optics.projection import (
    DEFAULT_PROJECTION,
    PROJECTIONS,
    Projection,
    list_keys,
    make_projection,
    number_keys,
    projection_values,
)
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensor_schema import (
    CURVE_LISTS,
    LAW_LISTS,
    LAW_NUMBERS,
    NOT_NEEDED,
    NUMBERS,
    RARE_SENSOR_NUMBERS,
    SHAPE_LISTS,
    VIEW_NUMBERS,
    ShareLaw,
    measurement_of,
    share_law_of,
)
from tofmix.sensors.camera import Camera, CompleteCamera
from tofmix.toml_table import MapReader, TomlTable, nearest, toml_string

T = TypeVar("T")

_TABLE_NUMBERS = tuple(key for key in NUMBERS if key not in (*LAW_NUMBERS, *RARE_SENSOR_NUMBERS))
"""Keys of ``[sensor]`` that hold a number."""

_NEEDED = tuple(key for key in _TABLE_NUMBERS if key not in NOT_NEEDED)
"""Those of them that a camera without a profile needs."""

_NOISE_PARTS = (*SHAPE_LISTS, "width_spread", "background")
"""Keys of the shape, widths and background of a noise curve."""

_INHERITED = ("shape", "width_spread", "background")
"""Their fields in a `NoiseCurve`, which a base camera hands on."""

_UNNAMED = "unnamed"
_DIGITS = ".6g"  # a millionth of a sigma is below what any recording shows


def read_camera(
    table: TomlTable, base: Camera | None, *, more_keys: tuple[str, ...] = (), read_map: MapReader | None = None
) -> Camera:
    """Read ``[sensor]`` and ``[sensor.noise]``, none of whose keys is needed; they override `base`.

    Parameters
    ----------
    table : TomlTable
        The ``[sensor]`` table.
    base : Camera or None
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
    texts: dict[str, Callable[[str], object]] = {"measurement": measurement_of, "share_law": share_law_of}
    optics = {"projection", *_optics_keys()}
    table.refuse_unknown({*_TABLE_NUMBERS, "name", *texts, "noise", "valid_status", *optics, *more_keys})
    noise.refuse_unknown({*CURVE_LISTS, *LAW_LISTS, *_NOISE_PARTS, *LAW_NUMBERS})
    settings: dict[str, Any] = {"name": _UNNAMED} if base is None else base.known()
    if "name" in table:
        settings["name"] = table.text("name")
    settings |= {key: _meaning(table, key, of_text) for key, of_text in texts.items() if key in table}
    settings |= {key: _number(table, key) for key in _TABLE_NUMBERS if key in table}
    settings |= {key: noise.number(key) for key in LAW_NUMBERS if key in noise}
    if "valid_status" in table:
        settings["valid_status"] = _codes(table)
    if any(key in noise for key in (*CURVE_LISTS, *LAW_LISTS, *_NOISE_PARTS)):
        rows, cols = settings.get("rows"), settings.get("cols")
        image = None if rows is None or cols is None else (rows, cols)
        settings["noise"] = _noise_curve(noise, settings.get("noise"), _background(noise, image, read_map))
    settings["projection"] = _projection(table, base)
    if settings["projection"] is not None:
        settings |= dict.fromkeys(VIEW_NUMBERS)  # it says where the pixels look; a field of view beside it says nothing
    try:
        return Camera(**settings)
    except ValueError as error:
        where = noise if str(error).startswith(("reference", "exponent", "noise curve", "background")) else table
        raise where.error(str(error)) from None


def _number(table: TomlTable, key: str) -> float:
    return table.integer(key) if NUMBERS[key].is_whole else table.number(key)


def _meaning(table: TomlTable, key: str, of_text: Callable[[str], T]) -> T:
    """The value that a text stands for."""
    try:
        return of_text(table.text(key))
    except ValueError as error:
        raise table.error(str(error)) from None


def _codes(table: TomlTable) -> tuple[int, ...]:
    codes = table.numbers("valid_status")
    if any(code != int(code) for code in codes):
        raise table.error("expected whole numbers", "valid_status")
    return tuple(int(code) for code in codes)


def read_complete(
    table: TomlTable, base: Camera | None, *, more_keys: tuple[str, ...] = (), read_map: MapReader | None = None
) -> CompleteCamera:
    """Read ``[sensor]`` and ``[sensor.noise]`` of a camera that is simulated; their keys override `base`.

    Parameters
    ----------
    table, base, more_keys, read_map
        As for `read_camera`.

    Raises
    ------
    BadInputError
        If a key is unknown, missing, of a wrong type or outside its bounds.
    """
    noise = table.table("noise")
    if base is None:
        _refuse_missing(table, noise, seen=_projection(table, None) is not None)
    if "share_law" in table and _meaning(table, "share_law", share_law_of) is not ShareLaw.AREA:
        raise table.error("samples are simulated by area alone; leave the key out", "share_law")
    camera = read_camera(table, base, more_keys=more_keys, read_map=read_map)
    if lacking := camera.missing():
        keys = ", ".join("noise.range_mm, noise.sigma_mm" if key == "noise" else key for key in lacking)
        raise table.error(f"missing {keys}; the profile of {camera.name} lacks them: give them")
    return camera.complete()


def _optics_keys() -> tuple[str, ...]:
    """Keys of all projections but the default one."""
    others = [name for name in PROJECTIONS if name != DEFAULT_PROJECTION]
    return tuple(key for name in others for key in (*number_keys(name), *list_keys(name)))


def _projection(table: TomlTable, base: Camera | None) -> Projection | None:
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
    missing = [key for key in _NEEDED if key not in table and not (seen and key in VIEW_NUMBERS)]
    missing += [f"noise.{key}" for key in (*CURVE_LISTS, *LAW_NUMBERS) if key not in noise]
    if missing:
        raise table.error(f'missing {", ".join(missing)}; give them, or profile = "sr3000" for what is left out')


def _noise_curve(noise: TomlTable, base: NoiseCurve | None, background: FloatArray | None) -> NoiseCurve:
    lists = {} if base is None else {"range_mm": base.range_mm, "sigma_mm": base.sigma_mm}
    given: dict[str, Any] = {key: noise.numbers(key) for key in CURVE_LISTS if key in noise}
    if lacking := [key for key in CURVE_LISTS if key not in lists | given]:
        raise noise.error(f"missing {', '.join(lacking)}; range_mm and sigma_mm go together")
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
    present = [key for key in SHAPE_LISTS if key in noise]
    if not present:
        return {}
    if len(present) < len(SHAPE_LISTS):
        raise noise.error(f"{present[0]} alone; {' and '.join(SHAPE_LISTS)} go together")
    try:
        return {"shape": NoiseShape(**{name: np.array(noise.numbers(key)) for key, name in SHAPE_LISTS.items()})}
    except ValueError as error:
        raise noise.error(str(error).removeprefix("noise shape: "), " and ".join(SHAPE_LISTS)) from None


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
    given = {key: noise.numbers(key) for key in LAW_LISTS if key in noise}
    if before is not None:
        given = {key: tuple(getattr(before, name).tolist()) for key, name in LAW_LISTS.items()} | given
    if not given:
        return None
    if lacking := [key for key in LAW_LISTS if key not in given]:
        raise noise.error(f"missing {', '.join(lacking)}; {', '.join(LAW_LISTS)} go together")
    return AmplitudeLaw(**{name: np.array(given[key]) for key, name in LAW_LISTS.items()})


def camera_toml(camera: CompleteCamera, *, background: str | None = None) -> str:
    """The tables ``[sensor]`` and ``[sensor.noise]`` of a camera, ending in a newline; `read_complete` reads them.

    Parameters
    ----------
    camera : CompleteCamera
        The camera.
    background : str, optional
        As of `noise_toml`.
    """
    lines = ["[sensor]", f"name = {toml_string(camera.name)}"]
    lines += [] if camera.measurement is None else [f'measurement = "{camera.measurement.value}"']
    numbers = {key: value for key in _TABLE_NUMBERS if (value := getattr(camera, key, None)) is not None}
    if camera.projection is not None:
        numbers = {key: value for key, value in numbers.items() if key not in VIEW_NUMBERS}
    lines += [f"{key} = {int(value) if NUMBERS[key].is_whole else float(value)!r}" for key, value in numbers.items()]
    if camera.projection is not None:
        lines.append(f'projection = "{camera.projection.name}"')
        lines += [f"{key} = {_exact(value)}" for key, value in projection_values(camera.projection).items()]
    noise = noise_toml(
        camera.noise,
        integration_time_ms=camera.reference_integration_time_ms,
        exponent=camera.exponent,
        background=background,
    )
    return "\n".join([*lines, "", noise])


def _exact(value: float | tuple[float, ...]) -> str:
    """A number or a list of numbers, with all digits."""
    if isinstance(value, tuple):
        return f"[{', '.join(repr(float(number)) for number in value)}]"
    return repr(float(value))


def noise_toml(
    curve: NoiseCurve, *, integration_time_ms: float | None, exponent: float = 0.5, background: str | None = None
) -> str:
    """The table ``[sensor.noise]`` of a curve, ending in a newline; long lists are on several lines.

    Parameters
    ----------
    curve : NoiseCurve
        Sigma (mm) at some ranges (mm), and its further parts.
    integration_time_ms : float or None
        The integration time of one sample at which the curve holds, ms; None if it is not known: the table then leaves
        it out.
    exponent : float
        That of the law of the integration time.
    background : str, optional
        Path of the .npy file with the map of background shares, relative to the model's folder. Without it one share
        is written for all pixels, the mean of a map.
    """
    lines = ["[sensor.noise]", *(_list(key, getattr(curve, key)) for key in CURVE_LISTS)]
    if integration_time_ms is not None:
        lines += [f"reference_integration_time_ms = {integration_time_ms!r}", f"exponent = {exponent!r}"]
    if curve.law is not None:
        lines += [_list(key, getattr(curve.law, name)) for key, name in LAW_LISTS.items()]
    if curve.shape is not None:
        lines += [_list(key, getattr(curve.shape, name)) for key, name in SHAPE_LISTS.items()]
    lines.append(f"width_spread = {_shown(curve.width_spread)}")
    if background is not None:
        lines.append(f'background = "{background}"')
    elif curve.background is not None:
        lines.append(f"background = {_shown(float(curve.background.mean()))}")
    return "\n".join(lines) + "\n"


def _list(key: str, values: Iterable[float], *, width: int = 120) -> str:
    """A key and its list, on lines of at most `width` characters: `parse_toml` refuses very long lines."""
    text = f"{key} = [{', '.join(_shown(v) for v in values)}]"
    return textwrap.fill(text, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)


def _shown(value: float) -> str:
    return repr(float(format(float(value), _DIGITS)))
