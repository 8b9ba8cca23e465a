"""A model file's text into a `Model`. Every refusal is one line: file, table, key, value, remedy.

Reading the file itself is left to the caller, and the built-in models to
`tofmix.simulation.builtin`.
"""

import json
from typing import Any

from tofmix.sensors.sensor_file import sensor_of
from tofmix.simulation.model import Model, RecordingSettings, Surface
from tofmix.toml_table import TomlTable, parse_toml


def parse_model(text: str, *, source: str) -> Model:
    """Read a model.

    Parameters
    ----------
    text : str
        The TOML text.
    source : str
        The file's name, for messages.

    Returns
    -------
    Model
        The model; its `text` is `text`.

    Raises
    ------
    BadInputError
        If it is not TOML, has an unknown key, lacks one, has one of a wrong type or outside its bounds, or
        lists an effect.
    """
    root = parse_toml(text, source=source)
    root.refuse_unknown({"sensor", "recording", "surface", "effect"})
    _refuse_effects(root)
    sensor = sensor_of(root)
    surfaces = tuple(_read_surface(table, number) for number, table in enumerate(root.tables("surface"), 1))
    recording = _read_recording(root.table("recording"))
    try:
        return Model(sensor=sensor, surfaces=surfaces, recording=recording, text=text)
    except ValueError as error:
        raise root.error(_one_line(str(error)), "[[surface]]") from None


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _refuse_effects(root: TomlTable) -> None:
    for table in root.tables("effect"):
        kind = json.dumps(table.values.get("kind", "?"), default=str)
        raise table.error(
            f"kind {kind}: this version simulates equation (1) alone, without effects; take the [[effect]] tables out"
        )


def _read_surface(table: TomlTable, number: int) -> Surface:
    angles = ("yaw_deg", "pitch_deg", "reflectivity")
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
