"""Points as comma-separated text, binary PLY and binary PCD 0.7: headers of text, for which no library is needed."""

from collections.abc import Callable, Sequence

import numpy as np

from tofmix.io.atomic.storage import AtomicFile
from tofmix.points import PointField, PointSource
from tofmix.version import __version__

_PLY_TYPES = {"<f4": "float", "|u1": "uchar", "<u2": "ushort", "<u4": "uint", "<i4": "int"}


def write_csv(file: AtomicFile, points: PointSource, _: str, written: Callable[[], None]) -> int:
    """Write the points below a header line; a value that is not known is ``nan``."""
    file.sink.write((",".join(spec.name for spec in points.fields) + "\n").encode())
    # Nine digits give every float32 back.
    line = ",".join("%.9g" if spec.dtype == "<f4" else "%d" for spec in points.fields) + "\n"
    count = 0
    for block in points:
        file.sink.write("".join(line % row for row in block.tolist()).encode())
        written()
        count += len(block)
    return count


def write_ply(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None]) -> int:
    """Write the points as ``element vertex``, little-endian; comments name the units."""
    return _write_packed(file, points, ply_header(title, points.fields, points.count()), written)


def write_pcd(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None]) -> int:
    """Write the points as an unorganised cloud; comments name the units."""
    count, kinds = points.count(), [np.dtype(spec.dtype) for spec in points.fields]
    lines = ["# .PCD v0.7 - Point Cloud Data file format", *described("#", title, points.fields)]
    lines += [
        "VERSION 0.7",
        f"FIELDS {' '.join(spec.name for spec in points.fields)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    return _write_packed(file, points, lines, written)


def ply_header(title: str, fields: Sequence[PointField], count: int, *elements: str) -> list[str]:
    """Lines of a header of PLY, with lines of elements beside the vertices."""
    lines = ["ply", "format binary_little_endian 1.0", *described("comment", title, fields), f"element vertex {count}"]
    lines += [f"property {_PLY_TYPES[spec.dtype]} {spec.name}" for spec in fields]
    return [*lines, *elements, "end_header"]


def described(mark: str, title: str, fields: Sequence[PointField] = ()) -> list[str]:
    """Comments of a header: title, version, and the meaning of each field."""
    texts = [title, f"written by tofmix {__version__}"]
    texts += [f"{spec.name}: {spec.long_name} ({spec.units})" for spec in fields]
    return [f"{mark} {text}" for text in texts]


def _write_packed(file: AtomicFile, points: PointSource, header: list[str], written: Callable[[], None]) -> int:
    file.sink.write("\n".join([*header, ""]).encode("ascii"))
    count = 0
    for block in points:
        file.sink.write(block.tobytes())
        written()
        count += len(block)
    return count
