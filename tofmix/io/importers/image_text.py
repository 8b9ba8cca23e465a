"""The text of a range image: what `tofmix export`, ImageJ and writers of OME-XML state there of its counts.

The form of our own is that of `tofmix.io.exporters.image.RangeImage.description`.

References
----------
ImageJ's ``FileInfo``: ``cf=0`` is a straight line, whose value is ``c0 + c1 * count`` in ``vunit``. OME's data model
has no unit of the counts: a channel's name may end in it, or an annotation have the key ``unit``.
"""

import math
import re
from typing import NamedTuple
from xml.etree import ElementTree as ET

from tofmix.errors import BadInputError
from tofmix.io.importers.base import DepthAxis
from tofmix.io.importers.units import unit_in_name
from tofmix.io.length_units import unit_mm_of

_COUNT = re.compile(r"1 count = ([0-9.eE+-]+) (mm|cm|m)\b")
_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_STRAIGHT_LINE = "0"  # ImageJ's number of this function


class Stated(NamedTuple):
    """Fields of a `FrameSource` that a text states; no unit where it does not say."""

    unit_mm: float | None
    depth_axis: DepthAxis
    scale_factor: float = 1.0
    add_offset: float = 0.0

    def words(self) -> str:
        """A count in words."""
        if self.unit_mm is None and (self.scale_factor, self.add_offset) == (1.0, 0.0):
            return f"no unit, along {self.depth_axis}"
        offset = f" + {self.add_offset:g}" if self.add_offset else ""
        unit = "units" if self.unit_mm is None else f"x {self.unit_mm:g} mm"
        return f"{self.scale_factor:g}{offset} {unit}, along {self.depth_axis}"


def stated_in(text: str | None, channel: str = "") -> Stated:
    """Read the text of an image, and the name of its channel."""
    text = text or ""
    found = _COUNT.search(text)
    try:
        unit_mm = None if found is None else float(found[1]) * _UNITS_MM[found[2]]
    except ValueError:
        unit_mm = None
    if unit_mm is not None:
        return Stated(unit_mm, "ray" if "radial range" in text else "z")
    if text.startswith("ImageJ="):
        return _of_imagej(imagej_keys(text))
    root = ome_root(text)
    if root is not None:
        return Stated(unit_in_name(channel) or _annotated_unit_mm(root), "z")
    return Stated(None, "z")


def check_stated(stated: Stated, first: Stated, what: object, of_first: object, *, unit_given: bool) -> None:
    """Refuse an image whose text states other numbers than that of the first one.

    A given unit takes the place of the stated ones.
    """
    if unit_given:
        stated, first = stated._replace(unit_mm=None), first._replace(unit_mm=None)
    if stated != first:
        raise BadInputError(
            f"{what}: its text states {stated.words()}, that of {of_first} {first.words()}; import images of one scale"
            " at a time"
        )


def imagej_keys(text: str) -> dict[str, str]:
    """Keys of ImageJ's text, one a line."""
    return {key.strip(): value.strip() for key, _, value in (line.partition("=") for line in text.splitlines())}


def _of_imagej(keys: dict[str, str]) -> Stated:
    unit_mm = unit_mm_of(keys.get("vunit", ""))
    try:
        factor, offset = float(keys.get("c1", "1")), float(keys.get("c0", "0"))
    except ValueError:
        return Stated(unit_mm, "z")
    usable = keys.get("cf") == _STRAIGHT_LINE and math.isfinite(factor) and factor > 0 and math.isfinite(offset)
    return Stated(unit_mm, "z", factor, offset) if usable and unit_mm is not None else Stated(unit_mm, "z")


def ome_root(text: str) -> ET.Element | None:
    """OME-XML of an image's text; None where it has none."""
    if "<OME" not in text:
        return None
    try:
        return ET.fromstring(text)  # noqa: S314  tifffile read it; entities of its own are refused by expat
    except ET.ParseError:
        return None


def tag(item: ET.Element) -> str:
    """Name of an element, without its namespace."""
    return item.tag.rpartition("}")[2]


def _annotated_unit_mm(root: ET.Element) -> float | None:
    for item in root.iter():
        if tag(item) == "M" and (item.get("K") or "").strip().lower() in ("unit", "units"):
            return unit_mm_of(item.text or "")
    return None
