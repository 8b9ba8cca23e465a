"""Units of time, units at the ends of names, and numbers that look like metres."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.length_units import UNITS_MM
from tofmix.io.recording.range_check import is_too_small
from tofmix.sensor import Sensor

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
