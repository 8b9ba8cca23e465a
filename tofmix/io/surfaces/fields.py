"""The datasets of a surfaces file.

`FIELDS` is the one list of datasets. Surfaces and lines are numbered within the file.
"""

from dataclasses import dataclass

FORMAT = "tofmix-surfaces"

MOST_FACTOR = 32
"""Parts along each side of a pixel at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceField:
    """One dataset of a surfaces file; with `of_windows`, only where there is more than one window."""

    name: str
    dtype: str
    units: str
    long_name: str
    dims: tuple[str, ...]
    of_windows: bool = False


_IMAGE, FINE_DIMS, _POINT, _OF_SURFACE = (
    ("window", "row", "col", "layer"),
    ("window", "row_fine", "col_fine"),
    ("edge_point",),
    ("surface_index",),
)

FIELDS: tuple[SurfaceField, ...] = (
    SurfaceField(name="surface", dtype="i4", units="1", dims=_IMAGE, long_name="surface of the layer, -1 = none"),
    SurfaceField(name="range_fine", dtype="f4", units="mm", dims=FINE_DIMS, long_name="range of the nearest surface"),
    SurfaceField(name="surface_fine", dtype="i4", units="1", dims=FINE_DIMS, long_name="nearest surface, -1 = none"),
    SurfaceField(name="edge_row", dtype="f4", units="pixel", dims=_POINT, long_name="row of the point of an edge"),
    SurfaceField(name="edge_col", dtype="f4", units="pixel", dims=_POINT, long_name="column of the point of an edge"),
    SurfaceField(
        name="edge_stderr", dtype="f4", units="pixel", dims=_POINT, long_name="standard error across the edge"
    ),
    SurfaceField(name="edge_near", dtype="i4", units="1", dims=_POINT, long_name="surface that ends at the edge"),
    SurfaceField(
        name="edge_far", dtype="i4", units="1", dims=_POINT, long_name="surface behind the edge, -1 = no return"
    ),
    SurfaceField(name="edge_line", dtype="i4", units="1", dims=_POINT, long_name="line that the point belongs to"),
    SurfaceField(
        name="edge_window", dtype="u4", units="1", dims=_POINT, long_name="window of the point", of_windows=True
    ),
    SurfaceField(name="n_pixels", dtype="u4", units="1", dims=_OF_SURFACE, long_name="layers that are of the surface"),
    SurfaceField(
        name="plane_normal", dtype="f4", units="1", dims=(*_OF_SURFACE, "axis"), long_name="unit normal n of the plane"
    ),
    SurfaceField(
        name="plane_offset_mm", dtype="f4", units="mm", dims=_OF_SURFACE, long_name="offset of the plane, n . x"
    ),
    SurfaceField(
        name="rms_mm", dtype="f4", units="mm", dims=_OF_SURFACE, long_name="rms distance of layers along the beams"
    ),
    SurfaceField(
        name="surface_window",
        dtype="u4",
        units="1",
        dims=_OF_SURFACE,
        long_name="window of the surface",
        of_windows=True,
    ),
)
"""Every dataset, in the order of the file."""

EDGE_KEYS = ("row", "col", "stderr", "near", "far", "line")
PLANE_KEYS = {"n_pixels": "n_pixels", "normal": "plane_normal", "offset_mm": "plane_offset_mm", "rms_mm": "rms_mm"}
AXIS = 3  # x, y, z
