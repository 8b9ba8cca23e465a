"""Edges as lines, in the image and in space, and the formats that draw them: GeoJSON, Wavefront OBJ, binary PLY."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.exporters.clouds import described, ply_header
from tofmix.io.exporters.placing import on_surfaces
from tofmix.io.storage import AtomicFile
from tofmix.io.surfaces_file import SurfacesFile
from tofmix.points import PointArray, PointField, packed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeLine:
    """A piece of a line of an edge that has the same two surfaces on its sides."""

    # window, line: Window; number of the line in the file.
    window: int
    line: int
    # near, far: Numbers of the surfaces, -1: none.
    near: int
    far: int
    # row, col, stderr: (n,) float32: Points, and their standard errors across the edge, pixels.
    row: NDArray[np.float32]
    col: NDArray[np.float32]
    stderr: NDArray[np.float32]
    place_m: FloatArray  # (n, 3) float64: Points on the nearer surface, metres; NaN where the beam does not meet it

    def runs(self) -> list[slice]:
        """Runs of points that have a place in space."""
        known = np.isfinite(self.place_m).all(axis=-1)
        ends = np.flatnonzero(np.diff(known, prepend=False, append=False))
        return [slice(int(start), int(stop)) for start, stop in zip(ends[::2], ends[1::2], strict=True)]


def edge_lines(file: SurfacesFile, windows: Sequence[int]) -> list[EdgeLine]:
    """Lines of some windows, in the order of the file.

    Where a line passes from one pair of surfaces to another, both pieces have the first point of the second.
    """
    return [line for window in windows for line in _lines_of_window(file, window)]


def _lines_of_window(file: SurfacesFile, window: int) -> Iterator[EdgeLine]:
    edges = file.read_edges(window)
    if not len(edges):
        return
    keys = np.stack([edges.line, edges.near, edges.far])
    starts = np.flatnonzero(np.r_[True, (keys[:, 1:] != keys[:, :-1]).any(axis=0)])
    for start, end in zip(starts, [*starts[1:], len(edges)], strict=True):
        goes_on = end < len(edges) and edges.line[end] == edges.line[start]
        part = slice(int(start), int(end) + bool(goes_on))
        near, far = int(edges.near[start]), int(edges.far[start])
        row, col = edges.row[part], edges.col[part]
        on = np.full(len(row), near if near >= 0 else far)
        yield EdgeLine(
            window=window,
            line=int(edges.line[start]),
            near=near,
            far=far,
            row=row,
            col=col,
            stderr=edges.stderr[part],
            place_m=on_surfaces(file, window, on, row, col),
        )


def write_geojson(file: AtomicFile, lines: Sequence[EdgeLine], title: str) -> None:
    """Write GeoJSON (RFC 7946) in the image's coordinates in place of the earth's.

    One LineString a line, a Point where it has but one; a standard error that is not known is null.
    """
    content = {
        "type": "FeatureCollection",
        "title": title,
        "coordinates": "[col, row], pixels; the centre of the first pixel is at [0, 0], rows run downward",
        "features": [_feature(line) for line in lines],
    }
    file.sink.write(f"{json.dumps(content, allow_nan=False)}\n".encode())


def _feature(line: EdgeLine) -> dict[str, Any]:
    points = [list(point) for point in zip(map(short, line.col), map(short, line.row), strict=True)]
    one = len(points) == 1
    shape = {"type": "Point" if one else "LineString", "coordinates": points[0] if one else points}
    stderr = [short(value) for value in line.stderr]
    properties = {"line": line.line, "near": line.near, "far": line.far, "window": line.window, "stderr": stderr}
    return {"type": "Feature", "geometry": shape, "properties": properties}


def short(value: np.float32) -> float | None:
    """The shortest number that gives the float32 back; None for one that is not finite."""
    return float(str(value)) if np.isfinite(value) else None


def obj_header(title: str) -> list[str]:
    """First lines of a Wavefront OBJ text."""
    return [*described("#", title), "# metres: x to the right, y down, z away"]


def obj_vertices(places_m: FloatArray) -> list[str]:
    """Lines of vertices (n, 3), metres, to a micrometre; OBJ counts them from 1."""
    return ["v {:.6f} {:.6f} {:.6f}".format(*place) for place in places_m.tolist()]


def write_obj(file: AtomicFile, lines: Sequence[EdgeLine], title: str) -> None:
    """Write one object a line, in space; points at which the beam does not meet the plane part it."""
    text, first = obj_header(title), 1
    for line in lines:
        text.append(f"o line_{line.line}_near_{line.near}_far_{line.far}")
        for run in line.runs():
            count = run.stop - run.start
            text += obj_vertices(line.place_m[run])
            numbers = " ".join(str(first + k) for k in range(count))
            text.append(f"{'l' if count > 1 else 'p'} {numbers}")
            first += count
    file.sink.write("\n".join([*text, ""]).encode("ascii"))


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


def write_ply(file: AtomicFile, lines: Sequence[EdgeLine], title: str) -> None:
    """Write the points that have a position in space as vertices, and the edges between them."""
    runs = [_vertices(line, run) for line in lines for run in line.runs()]
    vertices = np.concatenate([np.zeros(0, packed(FIELDS)), *runs])
    joined = np.ones(len(vertices), dtype=np.bool_)  # to the next
    joined[np.cumsum([len(run) for run in runs], dtype=np.intp) - 1] = False
    start = np.flatnonzero(joined)
    edges = f"element edge {len(start)}", "property int vertex1", "property int vertex2"
    header = ply_header(title, FIELDS, len(vertices), *edges)
    file.sink.write("\n".join([*header, ""]).encode("ascii"))
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
