"""Units of length as files and people write them."""

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
