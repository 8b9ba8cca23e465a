"""Points as comma-separated text, binary PLY and binary PCD 0.7: headers of text, for which no library is needed.

Points as LAS 1.4 and LAZ, point format 6, by laspy.

Coordinates are whole micrometres from the sensor; everything else that a point
carries is in extra dimensions, bit for bit. The format has room for 15 returns.
"""

from collections.abc import Callable, Sequence
from datetime import date
from typing import Any

import numpy as np

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.io.next_command import need
from tofmix.io.storage import AtomicFile
from tofmix.layers import AMPLITUDE
from tofmix.points import POINT_FIELDS, PointArray, PointField, PointSource
from tofmix.version import __version__

SCALE_M = 1e-6
"""A count of a coordinate, m."""


_COORDINATES = ("x", "y", "z")
_INTENSITY = "intensity"
_OWN = (*_COORDINATES, "return_number", "number_of_returns", _INTENSITY)
_FARTHEST_M = SCALE_M * np.iinfo(np.int32).max
_LARGEST_INTENSITY = float(np.iinfo(np.uint16).max)
_NO_DATE = date(1970, 1, 1)  # the format needs a date; the same points give the same bytes


def write_las(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None]) -> int:
    """Write the points as LAS."""
    return _write(file, points, title, written, compress=False)


def write_laz(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None]) -> int:
    """Write the points as LAZ, LAS compressed."""
    need("lazrs", extra="export", what="LAZ")
    return _write(file, points, title, written, compress=True)


def _write(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None], *, compress: bool) -> int:
    laspy = need("laspy", extra="export", what="LAZ" if compress else "LAS")
    fields = points.fields
    if fields[: len(POINT_FIELDS)] != POINT_FIELDS:
        raise UsageError(f"{file.path}: LAS stores points of layers only; choose .ply, .pcd or .csv")
    count = 0
    try:
        header, intensity = _header(laspy, title, fields), _intensity_of(points)
        with laspy.LasWriter(file.sink, header, do_compress=compress, closefd=False) as writer:
            for block in points:
                if len(block):
                    writer.write_points(_record(laspy, writer.header, block, file, intensity))
                written()
                count += len(block)
    except laspy.errors.LaspyException as error:
        raise StorageError(f"{file.path}: {' '.join(str(error).split())}") from error
    return count


def _header(laspy: Any, title: str, fields: Sequence[PointField]) -> Any:  # noqa: ANN401  laspy has no types
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, SCALE_M), np.zeros(3)
    header.creation_date = _NO_DATE
    description_bytes = 31  # of a text field of 32 bytes that ends with a zero
    header.system_identifier = title[:description_bytes]
    header.generating_software = f"tofmix {__version__}"
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(
                name=spec.name, type=spec.dtype[1:], description=f"{spec.units}: {spec.long_name}"[:description_bytes]
            )
            for spec in fields
            if spec.name not in _OWN
        ]
    )
    return header


def _intensity_of(points: PointSource) -> tuple[str, float]:
    """The field that becomes the intensity, and the intensity of one unit of it.

    An amplitude that 16 bits hold stays as it is; others are scaled so that the largest is 65,535. Without amplitudes
    it is the share.
    """
    if AMPLITUDE.name not in {spec.name for spec in points.fields}:
        return "weight", _LARGEST_INTENSITY
    largest = max((float(np.nan_to_num(block[AMPLITUDE.name]).max()) for block in points if len(block)), default=0.0)
    as_it_is = largest <= 0.0 or 1.0 < largest <= _LARGEST_INTENSITY
    return AMPLITUDE.name, 1.0 if as_it_is else _LARGEST_INTENSITY / largest


def _record(
    laspy: Any,  # noqa: ANN401  it has no types
    header: Any,  # noqa: ANN401
    block: PointArray,
    file: AtomicFile,
    intensity: tuple[str, float],
) -> Any:  # noqa: ANN401
    most = int(block["number_of_returns"].max())
    most_returns = 15  # of one pulse, by LAS 1.4
    if most > most_returns:
        raise BadInputError(
            f"{file.path}: a pixel has {most} layers, LAS stores {most_returns} returns at most;"
            " choose .ply, .pcd or .csv"
        )
    farthest = max(float(np.abs(block[axis]).max()) for axis in _COORDINATES)
    if farthest > _FARTHEST_M:
        raise BadInputError(
            f"{file.path}: a point lies {farthest:.0f} m away, LAS at {SCALE_M:g} m a count ends at"
            f" {_FARTHEST_M:.0f} m; choose .ply, .pcd or .csv"
        )
    record = laspy.ScaleAwarePointRecord.zeros(len(block), header=header)
    for axis in _COORDINATES:
        record[axis.upper()] = np.rint(block[axis].astype(np.float64) / SCALE_M).astype(np.int32)
    for name in block.dtype.names or ():
        if name not in (*_COORDINATES, _INTENSITY):
            record[name] = block[name]
    name, of_one = intensity
    values = np.nan_to_num(block[name].astype(np.float64)) * of_one
    record[_INTENSITY] = np.rint(np.clip(values, 0.0, _LARGEST_INTENSITY)).astype(np.uint16)
    return record


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
