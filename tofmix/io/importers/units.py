"""Units of length as files and people write them, and numbers that look like metres."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.recording.range_check import is_too_small
from tofmix.sensor import Sensor

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm of one unit."""

TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""s of one unit of time."""

_LENGTHS_MM = {
    **UNITS_MM, "nm": 1e-6, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "dm": 100.0, "km": 1e6,
    "inch": 25.4, "foot": 304.8, "ft": 304.8,
}  # fmt: skip
"""mm of each unit that a file may name."""

_PREFIXES_MM = {"": 1000.0, "nano": 1e-6, "micro": 1e-3, "milli": 1.0, "centi": 10.0, "deci": 100.0, "kilo": 1e6}
_SPELT = {
    f"{prefix}{metre}": mm
    for prefix, mm in _PREFIXES_MM.items()
    for metre in ("meter", "metre", "meters", "metres")
}  # fmt: skip
_SPELT |= {"microns": 1e-3, "inches": 25.4, "feet": 304.8}


def unit_mm_of(text: str) -> float | None:
    """Length of the unit that a text names, mm; None if it is not known."""
    name = text.strip()
    return _LENGTHS_MM.get(name, _SPELT.get(name.lower()))


_IN_NAME = re.compile(r"\w.*?[_\s./([-](mm|cm|m)[)\]]?$", re.DOTALL)


def unit_in_name(name: str) -> float | None:
    """Length of the unit that the name of an array or channel ends in, mm, as in ``range_m`` or ``depth [mm]``."""
    found = _IN_NAME.match(name.strip())
    return None if found is None else UNITS_MM[found[1]]


def refuse_metres(range_mm: NDArray[Any], sensor: Sensor, what: object) -> None:
    """Refuse ranges without a unit if they are too small for mm.

    Parameters
    ----------
    range_mm : array of float
        Ranges, taken as mm; NaN where invalid, but not everywhere.
    sensor : Sensor
        For its shortest range.
    what : object
        The source, for messages.

    Raises
    ------
    BadInputError
        If their median is below 50, or below a tenth of `range_min_mm`.
    """
    median = float(np.nanmedian(range_mm))
    if is_too_small(median, sensor):
        raise BadInputError(
            f"{what}: no unit is given, and half of the values are below {median:.3g}, too small for mm;"
            " give --units m, or --units mm if mm is right"
        )
