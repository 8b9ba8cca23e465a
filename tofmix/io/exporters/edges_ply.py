"""Edges as binary PLY: their points as ``element vertex``, the pieces between them as ``element edge``."""

from collections.abc import Sequence

import numpy as np

from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.edge_lines import EdgeLine
from tofmix.io.exporters.ply import TYPES
from tofmix.points import PointArray, PointField, packed
from tofmix.version import __version__

FIELDS: tuple[PointField, ...] = (
    PointField(name="x", dtype="<f4", units="m", long_name="to the right, on the plane of the nearer surface"),
    PointField(name="y", dtype="<f4", units="m", long_name="down"),
    PointField(name="z", dtype="<f4", units="m", long_name="away from the sensor"),
    PointField(name="row", dtype="<f4", units="pixel", long_name="row in the image"),
    PointField(name="col", dtype="<f4", units="pixel", long_name="column in the image"),
    PointField(name="stderr", dtype="<f4", units="pixel", long_name="standard error across the edge"),
    PointField(name="near", dtype="<i4", units="1", long_name="surface that ends at the edge"),
    PointField(name="far", dtype="<i4", units="1", long_name="surface behind the edge, -1 = no return"),
    PointField(name="line", dtype="<i4", units="1", long_name="line that the point belongs to"),
    PointField(name="window", dtype="<u4", units="1", long_name="window of the layers file"),
)
"""Properties of a point of an edge."""


def write(file: AtomicFile, lines: Sequence[EdgeLine], title: str) -> None:
    """Write the points that have a position in space, and the edges between them."""
    runs = [_vertices(line, run) for line in lines for run in line.runs()]
    vertices = np.concatenate([np.zeros(0, packed(FIELDS)), *runs])
    joined = np.ones(len(vertices), dtype=np.bool_)  # to the next
    joined[np.cumsum([len(run) for run in runs], dtype=np.intp) - 1] = False
    start = np.flatnonzero(joined)
    text = ["ply", "format binary_little_endian 1.0", f"comment {title}", f"comment written by tofmix {__version__}"]
    text += [f"comment {spec.name}: {spec.long_name} ({spec.units})" for spec in FIELDS]
    text.append(f"element vertex {len(vertices)}")
    text += [f"property {TYPES[spec.dtype]} {spec.name}" for spec in FIELDS]
    text += [f"element edge {len(start)}", "property int vertex1", "property int vertex2", "end_header", ""]
    file.sink.write("\n".join(text).encode("ascii"))
    file.sink.write(vertices.tobytes())
    file.sink.write(np.stack([start, start + 1], axis=-1).astype("<i4").tobytes())


def _vertices(line: EdgeLine, run: slice) -> PointArray:
    vertices = np.zeros(run.stop - run.start, dtype=packed(FIELDS))
    for axis, values in zip("xyz", line.place_m[run].T, strict=True):
        vertices[axis] = values
    for name in ("row", "col", "stderr"):
        vertices[name] = getattr(line, name)[run]
    for name in ("near", "far", "line", "window"):
        vertices[name] = getattr(line, name)
    return vertices
