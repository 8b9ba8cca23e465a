"""Every dataset of recordings and surfaces files, stated once; those of layers files are `tofmix.layers.LAYER_FIELDS`.

Writers make the datasets from these lists by `hdf5.add_field`, readers hold files against them, and `verify` checks
units, storage and rules by them. The group `sensor` is `tofmix.io.sensor_group`, the root attributes of results are
`tofmix.io.layers.layers_file`, and a reconciliation's `gap.json` is `tofmix.io.reconciliation`.
"""

import math
from typing import NamedTuple

from tofmix.layers import LAW_TEXTS, LAYER_DIMS, LAYER_FIELDS, OPTIONAL_FIELDS, LayerField

RECORDING, LAYERS, SURFACES = "tofmix-recording", "tofmix-layers", "tofmix-surfaces"
"""Root attribute `format` of each kind of file."""

FRAME_DIMS, TARGET = ("frame", "row", "col"), "target"
FINE_DIMS = ("window", "row_fine", "col_fine")
AXIS = 3  # x, y, z

MOST_FACTOR = 32
"""Parts along each side of a pixel at most."""


class Field(NamedTuple):
    """One dataset: its dimensions by the names of their scales, and `_FillValue` where it has one."""

    name: str
    dtype: str
    units: str
    dims: tuple[str, ...]
    long_name: str
    fill: float | None = None


_IMAGE, _POINT, _SURFACE = ("row", "col"), ("edge_point",), ("surface_index",)

RANGE = Field("range", "u2", "mm", FRAME_DIMS, "radial range", 0)
RECORDING_FIELDS = (
    RANGE,
    Field("amplitude", "f4", "1", FRAME_DIMS, "amplitude"),
    Field("time", "f8", "s", ("frame",), "start of the frame"),
    Field("temperature", "f4", "degC", ("frame",), "temperature"),
)
"""Of a recording; ranges may also be float32 with NaN. Files of other programs may be of any type of number."""

TRUTH_FIELDS = (
    Field("n_modes", "u1", "1", _IMAGE, "surfaces in the beam"),
    Field("range_true", "f4", "mm", (*_IMAGE, "layer"), "range of each surface, near to far", math.nan),
    Field("weight_true", "f4", "1", (*_IMAGE, "layer"), "share of the beam, p(c_i)", math.nan),
    Field("weight_no_return", "f4", "1", _IMAGE, "share without a return, p(c_0)"),
)
"""Of the group `truth` of a synthetic recording."""

RANGE_TRUE_FRAMES = Field(
    "range_true_frames", "f4", "mm", (*FRAME_DIMS, "layer"), "range of each surface in each frame", math.nan
)
"""Of `truth` too, where surfaces move."""

WINDOW_FIELDS = (
    Field("window_start", "u8", "1", ("window",), "first frame of the window"),
    Field("window_stop", "u8", "1", ("window",), "one past the last frame of the window"),
)
LAW_FIELDS = tuple(
    Field(name, dtype, "1", ("window",), text)
    for (name, text), dtype in zip(LAW_TEXTS.items(), ("f4", "u4"), strict=True)
)
"""Of each window of a layers file; the latter where mixing was measured."""


def field_of(spec: LayerField) -> Field:
    """The dataset of a field of `tofmix.layers`; real numbers are NaN where nothing was estimated."""
    fill = math.nan if spec.dtype.startswith("f") else None
    return Field(spec.name, spec.dtype, spec.units, spec.dims, spec.long_name, fill)


LAYERS_FIELDS = (*map(field_of, (*LAYER_FIELDS, *OPTIONAL_FIELDS)), *WINDOW_FIELDS)

IMAGE_FIELDS = (
    Field("surface", "i4", "1", LAYER_DIMS, "surface of the layer, -1 = none"),
    Field("range_fine", "f4", "mm", FINE_DIMS, "range of the nearest surface", math.nan),
    Field("surface_fine", "i4", "1", FINE_DIMS, "nearest surface, -1 = none"),
)
"""Of a surfaces file: written and read window by window."""

LIST_FIELDS = (
    Field("edge_row", "f4", "pixel", _POINT, "row of the point of an edge"),
    Field("edge_col", "f4", "pixel", _POINT, "column of the point of an edge"),
    Field("edge_stderr", "f4", "pixel", _POINT, "standard error across the edge"),
    Field("edge_near", "i4", "1", _POINT, "surface that ends at the edge"),
    Field("edge_far", "i4", "1", _POINT, "surface behind the edge, -1 = no return"),
    Field("edge_line", "i4", "1", _POINT, "line that the point belongs to"),
    Field("edge_window", "u4", "1", _POINT, "window of the point"),
    Field("n_pixels", "u4", "1", _SURFACE, "layers that are of the surface"),
    Field("plane_normal", "f4", "1", (*_SURFACE, "axis"), "unit normal n of the plane"),
    Field("plane_offset_mm", "f4", "mm", _SURFACE, "offset of the plane, n . x"),
    Field("rms_mm", "f4", "mm", _SURFACE, "rms distance of layers along the beams"),
    Field("surface_window", "u4", "1", _SURFACE, "window of the surface"),
)
"""Of a surfaces file: points of edges and surfaces of all windows, numbered within the file."""

OF_WINDOWS = ("edge_window", "surface_window")
"""Datasets that a file of one window lacks."""

SURFACES_FIELDS = (*IMAGE_FIELDS, *LIST_FIELDS)
