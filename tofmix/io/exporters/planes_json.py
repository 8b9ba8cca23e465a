"""Surfaces as JSON: the plane of each, and the outlines of its visible part in space."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.outlines import Outline, placed
from tofmix.io.surfaces.surfaces_file import SurfacesFile

_DECIMALS = 6  # of a metre: micrometres


def write(file: AtomicFile, source: SurfacesFile, outlines: Sequence[Outline], title: str) -> None:
    """Write one object a surface; the points of an outline are in metres, and the last is the first again."""
    content = {
        "title": title,
        "frame": "of the sensor: x to the right, y down, z away; plane n . x = offset; outlines in metres",
        "surfaces": [_surface(source, outline) for outline in outlines],
    }
    file.sink.write(f"{json.dumps(content, allow_nan=False)}\n".encode())


def _surface(source: SurfacesFile, outline: Outline) -> dict[str, Any]:
    planes, k = source.planes, outline.surface
    return {
        "surface": k,
        "window": outline.window,
        "normal": [_known(value) for value in planes.normal[k]],
        "offset_mm": _known(planes.offset_mm[k]),
        "rms_mm": _known(planes.rms_mm[k]),
        "n_pixels": int(planes.n_pixels[k]),
        "polygons": [_polygon(source, k, polygon) for polygon in outline.polygons],
    }


def _known(value: np.float32) -> float | None:
    """The shortest number that gives the float32 back; None for one that is not finite."""
    return float(str(value)) if np.isfinite(value) else None


def _polygon(source: SurfacesFile, surface: int, polygon: Any) -> dict[str, Any]:  # noqa: ANN401  shapely has no types
    return {
        "outline": _ring(source, surface, polygon.exterior),
        "holes": [_ring(source, surface, ring) for ring in polygon.interiors],
    }


def _ring(source: SurfacesFile, surface: int, ring: Any) -> list[list[float]]:  # noqa: ANN401  shapely has no types
    """Points of a ring that lie on the plane, closed; a beam next to a grazing one may miss the plane."""
    places = placed(source, surface, np.asarray(ring.coords)[:-1])
    known: list[list[float]] = np.round(places[np.isfinite(places).all(axis=-1)], _DECIMALS).tolist()
    return [*known, *known[:1]]
