"""Units of length as files and people write them, and numbers that look like metres."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.recording.range_check import is_too_small
from tofmix.sensor import Sensor

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm of one unit."""

_SPELT = {
    "millimeter": "mm", "millimetre": "mm", "millimeters": "mm", "millimetres": "mm",
    "centimeter": "cm", "centimetre": "cm", "centimeters": "cm", "centimetres": "cm",
    "meter": "m", "metre": "m", "meters": "m", "metres": "m",
}  # fmt: skip


def unit_mm_of(text: str) -> float | None:
    """Length of the unit that a text names, mm; None if it is not known."""
    name = text.strip()
    return UNITS_MM.get(_SPELT.get(name.lower(), name))


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
