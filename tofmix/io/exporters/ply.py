"""Points as binary PLY. A header of text and the packed records: no library is needed."""

from collections.abc import Callable

from tofmix.io.atomic.storage import AtomicFile
from tofmix.points import PointSource
from tofmix.version import __version__

TYPES = {"<f4": "float", "|u1": "uchar", "<u2": "ushort", "<u4": "uint", "<i4": "int"}
"""Names of types in the format."""


def write(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None]) -> int:
    """Write the points as ``element vertex``, little-endian; comments name the units."""
    count = points.count()
    lines = ["ply", "format binary_little_endian 1.0", f"comment {title}", f"comment written by tofmix {__version__}"]
    lines += [f"comment {spec.name}: {spec.long_name} ({spec.units})" for spec in points.fields]
    lines.append(f"element vertex {count}")
    lines += [f"property {TYPES[spec.dtype]} {spec.name}" for spec in points.fields]
    file.sink.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
    for block in points:
        file.sink.write(block.tobytes())
        written()
    return count
