"""Units of length and of time, as files and people write them, and numbers that look like metres.

Units may stand at the ends of names.
"""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.recording.range_check import is_too_small
from tofmix.sensor import Sensor

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm of one unit."""

_LENGTHS_MM = UNITS_MM | {
    name: mm
    for mm, names in {
        1e-6: "nm",
        1e-3: "um µm μm micron",
        100.0: "dm",
        1e6: "km",
        25.4: "inch",
        304.8: "foot ft",
    }.items()
    for name in names.split()
}
"""mm of each unit that a file may name."""

_PREFIXES_MM = {"": 1000.0, "nano": 1e-6, "micro": 1e-3, "milli": 1.0, "centi": 10.0, "deci": 100.0, "kilo": 1e6}
_SPELT = {
    f"{prefix}{metre}": mm for prefix, mm in _PREFIXES_MM.items() for metre in ("meter", "metre", "meters", "metres")
}
_SPELT |= {"microns": 1e-3, "inches": 25.4, "feet": 304.8}


def unit_mm_of(text: str) -> float | None:
    """Length of the unit that a text names, mm; None if it is not known."""
    name = text.strip()
    return _LENGTHS_MM.get(name, _SPELT.get(name.lower()))


TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""s of one unit of time."""

_IN_NAME = re.compile(r"\w.*?[_\s./([-](mm|cm|m)[)\]]?$", re.DOTALL)


def unit_in_name(name: str) -> float | None:
    """Length of the unit that the name of an array or channel ends in, mm, as in ``range_m`` or ``depth [mm]``."""
    found = _IN_NAME.match(name.strip())
    return None if found is None else UNITS_MM[found[1]]


def refuse_metres(range_mm: NDArray[Any], sensor: Sensor, what: object) -> None:
    """Refuse ranges without a unit, taken as mm and not all NaN, if half of them are too small for mm."""
    median = float(np.nanmedian(range_mm))
    if is_too_small(median, sensor):
        raise BadInputError(
            f"{what}: no unit is given, and half of the values are below {median:.3g}, too small for mm;"
            " give --units m, or --units mm if mm is right"
        )
