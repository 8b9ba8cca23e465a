"""The camera that a file describes: a model, or a TOML file with a ``[sensor]`` table alone.

Use it where a user names a camera by file; `load_sheet` has the built-in ones.
"""

from tofmix.errors import BadInputError
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.profile_toml import read_sensor, read_sheet
from tofmix.sensors.registry import load_sheet
from tofmix.sensors.sheet import CameraSheet
from tofmix.toml_table import MapReader, TomlTable, parse_toml


def sensor_of(root: TomlTable, *, read_map: MapReader | None = None) -> SensorProfile:
    """Read the table ``[sensor]``, whose key ``profile`` names a built-in camera that its other keys override.

    `read_map` is as for `read_sheet`.

    Raises
    ------
    BadInputError
        If a key is unknown, missing, of a wrong type or outside its bounds.
    """
    table = root.table("sensor")
    return read_sensor(table, _base_of(table), more_keys=("profile",), read_map=read_map)


def _base_of(table: TomlTable) -> CameraSheet | None:
    if "profile" not in table:
        return None
    name = table.text("profile")
    try:
        return load_sheet(name)
    except BadInputError as error:
        raise table.error(str(error), "profile") from None


def parse_sensor(text: str, *, source: str, read_map: MapReader | None = None) -> CameraSheet:
    """Read the camera of a TOML file; other tables of a model than ``[sensor]`` are ignored.

    Parameters
    ----------
    text : str
        The file's text.
    source : str
        Its name, for messages.
    read_map : callable, optional
        As for `read_sheet`.

    Raises
    ------
    BadInputError
        If it is not TOML or holds no camera.
    """
    root = parse_toml(text, source=source)
    if "sensor" not in root:
        raise root.error("no table [sensor], so no camera")
    table = root.table("sensor")
    return read_sheet(table, _base_of(table), more_keys=("profile",), read_map=read_map)
