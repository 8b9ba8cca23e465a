"""A model file's text into a `Model`. Every refusal is one line: file, table, key, value, remedy.

Reading the file itself is left to the caller, and the built-in models to
`tofmix.simulation.builtin`.
"""

import json
from typing import Any

from tofmix.sensors import camera_of_model
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.effects import EFFECTS, Effect, PixelMap
from tofmix.simulation.effects.parameter import Holds, Parameter
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface
from tofmix.toml_table import MapReader, TomlTable, nearest, parse_toml


def parse_model(text: str, *, source: str, read_map: MapReader | None = None) -> Model:
    """Read a model.

    Parameters
    ----------
    text : str
        The TOML text.
    source : str
        The file's name, for messages.
    read_map : callable, optional
        Reads the .npy files that effects and the noise name. Without it a model that names one is refused.

    Returns
    -------
    Model
        The model; its `text` is `text`.

    Raises
    ------
    BadInputError
        If it is not TOML, has an unknown key, lacks one, or has one of a wrong type or outside its bounds.
    """
    root = parse_toml(text, source=source)
    root.refuse_unknown({"sensor", "recording", "surface", "effect"})
    sensor = camera_of_model(root, read_map=read_map)
    surfaces = tuple(_read_surface(table, number) for number, table in enumerate(root.tables("surface"), 1))
    recording = _read_recording(root.table("recording"))
    effects = tuple(_read_effect(table, sensor, read_map) for table in root.tables("effect"))
    try:
        return Model(sensor=sensor, surfaces=surfaces, recording=recording, text=text, effects=effects)
    except ValueError as error:
        message = _one_line(str(error))
        raise root.error(message, "" if message.startswith(("[[effect]]", "[sensor")) else "[[surface]]") from None


def background_path(model: Model) -> str | None:
    """Where, relative to a model's file, its map of background shares is; None where it has none."""
    if not model.text:
        return None
    noise = parse_toml(model.text, source="").table("sensor").table("noise")
    return noise.text("background") if isinstance(noise.values.get("background"), str) else None


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _read_effect(table: TomlTable, sensor: CompleteCamera, read_map: MapReader | None) -> Effect:
    kind = table.text("kind")
    if kind not in EFFECTS:
        raise table.error(f"{json.dumps(kind)} is not an effect{nearest(kind, EFFECTS)}", "kind")
    parameters = EFFECTS[kind].parameters()
    table.refuse_unknown({"kind", *parameters})
    settings = {
        name: _read_parameter(table, parameter, sensor, read_map)
        for name, parameter in parameters.items()
        if name in table or parameter.required
    }
    try:
        return EFFECTS[kind](**settings)
    except ValueError as error:
        raise table.error(str(error)) from None


def _read_parameter(
    table: TomlTable, parameter: Parameter, sensor: CompleteCamera, read_map: MapReader | None
) -> float | str | PixelMap:
    if parameter.holds is Holds.NUMBER:
        return table.number(parameter.name)
    path = table.text(parameter.name)
    if parameter.holds is Holds.SURFACE:
        return path
    if read_map is None:
        raise table.error("a model without a file of its own has no maps beside it", parameter.name)
    try:
        return PixelMap(path, read_map(path, (sensor.rows, sensor.cols)))
    except ValueError as error:
        raise table.error(_one_line(str(error)), parameter.name) from None


def _read_surface(table: TomlTable, number: int) -> Surface:
    angles = ("yaw_deg", "pitch_deg", "roll_deg", "reflectivity")
    table.refuse_unknown({"name", "center_mm", "size_mm", *angles})
    settings: dict[str, Any] = {key: table.number(key) for key in angles if key in table}
    settings["name"] = table.text("name") if "name" in table else f"surface {number}"
    settings["center_mm"] = table.numbers("center_mm", 3)
    settings["size_mm"] = table.numbers("size_mm", 2)
    try:
        return Surface(**settings)
    except ValueError as error:
        raise table.error(str(error)) from None


def _read_recording(table: TomlTable) -> RecordingSettings:
    table.refuse_unknown({"frames", "frame_rate_hz", "seed"})
    settings: dict[str, Any] = {key: table.integer(key) for key in ("frames", "seed") if key in table}
    if "frame_rate_hz" in table:
        settings["frame_rate_hz"] = table.number("frame_rate_hz")
    try:
        return RecordingSettings(**settings)
    except ValueError as error:
        raise table.error(str(error)) from None
