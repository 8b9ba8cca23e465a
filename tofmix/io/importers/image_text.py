"""The text of a range image: what `tofmix export` writes there of its counts.

The form is that of `tofmix.io.exporters.image.RangeImage.description`.
"""

import re
from typing import NamedTuple

from tofmix.io.importers.base import DepthAxis

_COUNT = re.compile(r"1 count = ([0-9.eE+-]+) (mm|cm|m)\b")
_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


class Stated(NamedTuple):
    """mm of one count, None where the text does not say, and the direction of the depths."""

    unit_mm: float | None
    depth_axis: DepthAxis


def stated_in(text: str | None) -> Stated:
    """Read the text of an image."""
    found = _COUNT.search(text or "")
    try:
        unit_mm = None if found is None else float(found[1]) * _UNITS_MM[found[2]]
    except ValueError:
        unit_mm = None
    return Stated(unit_mm, "ray" if unit_mm is not None and "radial range" in (text or "") else "z")
