"""Edges as the lines of a GeoJSON text (RFC 7946), in the image's coordinates in place of the earth's."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.edge_lines import EdgeLine


def write(file: AtomicFile, lines: Sequence[EdgeLine], title: str) -> None:
    """Write one LineString a line, a Point where it has but one; a standard error that is not known is null."""
    content = {
        "type": "FeatureCollection",
        "title": title,
        "coordinates": "[col, row], pixels; the centre of the first pixel is at [0, 0], rows run downward",
        "features": [_feature(line) for line in lines],
    }
    file.sink.write(f"{json.dumps(content, allow_nan=False)}\n".encode())


def _feature(line: EdgeLine) -> dict[str, Any]:
    points = [list(point) for point in zip(_short(line.col), _short(line.row), strict=True)]
    shape = {"type": "LineString", "coordinates": points} if len(points) > 1 else _point(points[0])
    stderr = [value if math.isfinite(value) else None for value in _short(line.stderr)]
    properties = {"line": line.line, "near": line.near, "far": line.far, "window": line.window, "stderr": stderr}
    return {"type": "Feature", "geometry": shape, "properties": properties}


def _point(place: list[float]) -> dict[str, Any]:
    return {"type": "Point", "coordinates": place}


def _short(values: NDArray[np.float32]) -> list[float]:
    """The shortest numbers that give the float32 back."""
    return [float(str(value)) for value in values]
