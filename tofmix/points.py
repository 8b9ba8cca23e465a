"""Layers as points in space: one point a layer, in the sensor's frame.

Use `LayerPoints` to pass the layers of a file on to programs that take point clouds. `POINT_FIELDS` is the one list of
the fields that every point has, `FURTHER_FIELDS` that of those which a layers file may add; every format writes all
that the points have.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.flags import Mixing
from tofmix.layers import AMPLITUDE, LAYER_FIELDS, OPTIONAL_FIELDS, LayerField, Layers
from tofmix.optics.projection import Projection, beam_directions_of

MM_A_METRE = 1000.0  # mm in a metre


@dataclass(frozen=True, slots=True, kw_only=True)
class PointField:
    """One attribute of a point; `dtype` is little-endian."""

    name: str
    dtype: str
    units: str
    long_name: str


POINT_FIELDS: tuple[PointField, ...] = (
    PointField(name="x", dtype="<f4", units="m", long_name="to the right"),
    PointField(name="y", dtype="<f4", units="m", long_name="down"),
    PointField(name="z", dtype="<f4", units="m", long_name="away from the sensor"),
    *(
        PointField(name=spec.name, dtype=f"<{spec.dtype}", units=spec.units, long_name=spec.long_name)
        for spec in LAYER_FIELDS
        if spec.per_layer
    ),
    PointField(name="return_number", dtype="|u1", units="1", long_name="layer, 1 = nearest"),
    PointField(name="number_of_returns", dtype="|u1", units="1", long_name="layers of the pixel"),
    PointField(name="status", dtype="|u1", units="1", long_name="outcome of the estimator"),
    PointField(name="row", dtype="<u4", units="1", long_name="row of the pixel, 0 = top"),
    PointField(name="col", dtype="<u4", units="1", long_name="column of the pixel"),
    PointField(name="window", dtype="<u4", units="1", long_name="window of the layers file"),
)
"""Properties of a point. Those of a layers file have their name and unit there."""

FURTHER_FIELDS: tuple[LayerField, ...] = tuple(
    spec for spec in (*LAYER_FIELDS, *OPTIONAL_FIELDS) if spec.name not in {known.name for known in POINT_FIELDS}
)
"""What else a layers file may know of a layer or its pixel, under the names and units there (`point_fields`)."""

_ENDS = "first", "last"  # what the dimension `ENDS` counts

INTENSITY = PointField(name="intensity", dtype="<f4", units="1", long_name="amplitude")
"""The name that viewers of point clouds know for an amplitude."""

PointArray = NDArray[np.void]


def packed(fields: Sequence[PointField]) -> np.dtype[np.void]:
    """A packed record of fields."""
    return np.dtype([(spec.name, spec.dtype) for spec in fields])


POINT_DTYPE = packed(POINT_FIELDS)
"""A packed record of `POINT_FIELDS`."""


def point_fields(spec: LayerField) -> tuple[PointField, ...]:
    """A dataset of a layers file as attributes of its points: one, or NAME_first and NAME_last where it has `ENDS`."""
    dtype = np.dtype(spec.dtype).newbyteorder("<").str
    names = [f"{spec.name}_{end}" for end in _ENDS] if spec.ends else [spec.name]
    return tuple(PointField(name=name, dtype=dtype, units=spec.units, long_name=spec.long_name) for name in names)


def fields_of_names(names: Sequence[str], present: Sequence[str]) -> tuple[LayerField, ...]:
    """The further fields of some names, in the order of `FURTHER_FIELDS`; fields that every point has are left out.

    Parameters
    ----------
    names : sequence of str
        Names of fields; ``all`` means all that the file has.
    present : sequence of str
        Datasets of the layers file.

    Raises
    ------
    ValueError
        If there is no such field, or the file does not have it.
    """
    known = [spec.name for spec in FURTHER_FIELDS]
    here = [name for name in known if name in present]
    for name in names:
        if name not in (*known, *(spec.name for spec in POINT_FIELDS), ALL_FIELDS):
            raise ValueError(f"unknown field {name!r}; choose from {', '.join(here)} or {ALL_FIELDS}")
        if name in known and name not in present:
            raise ValueError(f"the layers have no {name}; they have {', '.join(here)}")
    wanted = here if ALL_FIELDS in names else names
    return tuple(spec for spec in FURTHER_FIELDS if spec.name in wanted)


ALL_FIELDS = "all"
"""Name for all fields that a file has."""


class PointSource(Protocol):
    """Points that come block by block, such as `LayerPoints`."""

    @property
    def fields(self) -> tuple[PointField, ...]:
        """Properties of a point."""

    def __iter__(self) -> Iterator[PointArray]:
        """Blocks (point,) of packed records of `fields`."""

    def __len__(self) -> int:
        """Blocks."""

    def count(self) -> int:
        """Points of all blocks, for a header that precedes them."""


class WindowSource(Protocol):
    """Layers that are read window by window, such as `tofmix.io.layers.layers_file.LayersFile`."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Windows, rows, columns."""

    def read_window(self, window: int) -> Layers:
        """Layers of one window, of the leading shape (row, col)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointFilter:
    """Which layers become points: those with at least this weight and this probability.

    None sets no limit. A layer with an unknown value (NaN) does not pass a limit on this value. Layers of undecided
    pixels (`Mixing.UNDECIDED`) pass only with `undecided`, suspect ones only with `suspect`.
    """

    min_weight: float | None = None
    min_probability: float | None = None
    undecided: bool = False
    suspect: bool = False

    def passes(self, layers: Layers) -> NDArray[np.bool_]:
        """Whether each layer (row, col, layer) passes; one without a finite range never does."""
        keep = np.isfinite(layers.range) if self.suspect else layers.unsuspected
        if not self.undecided and layers.mixing is not None:
            keep &= (layers.mixing != int(Mixing.UNDECIDED))[..., np.newaxis]
        if self.min_weight is not None:
            keep &= layers.weight >= self.min_weight
        if self.min_probability is not None:
            keep &= layers.probability >= self.min_probability
        return keep


class LayerPoints:
    """The points of a layers file, window by window: memory is that of one window.

    Parameters
    ----------
    source : WindowSource
        The layers.
    optics : Projection
        Where the pixels look, such as `tofmix.sensor.Sensor.optics`.
    windows : sequence of int, optional
        Which windows; all without it.
    chosen : PointFilter
        Which layers.
    further : sequence of LayerField
        Fields beyond `POINT_FIELDS`, from `fields_of_names`.
    intensity : bool
        Whether amplitudes among them are written as `INTENSITY` too.

    Raises
    ------
    ValueError
        If a pixel looks nowhere.
    """

    def __init__(
        self,
        source: WindowSource,
        *,
        optics: Projection,
        windows: Sequence[int] | None = None,
        chosen: PointFilter | None = None,
        further: Sequence[LayerField] = (),
        intensity: bool = False,
    ) -> None:
        count, rows, cols = source.shape
        self._source = source
        self._windows = range(count) if windows is None else windows
        self._chosen = chosen or PointFilter()
        self._directions = beam_directions_of(optics, (rows, cols))
        self._further = tuple(further)
        self._intensity = intensity and AMPLITUDE in further

    @property
    def fields(self) -> tuple[PointField, ...]:
        """Properties of a point."""
        further = tuple(field for spec in self._further for field in point_fields(spec))
        return (*POINT_FIELDS, *further, *((INTENSITY,) if self._intensity else ()))

    def __iter__(self) -> Iterator[PointArray]:
        """Points of one window after the other, (point,) records of `fields`; by row, column and layer within each."""
        for window in self._windows:
            yield window_points(
                self._source.read_window(window),
                self._directions,
                window=window,
                chosen=self._chosen,
                fields=self.fields,
            )

    def count(self) -> int:
        """Count the points, for a header that precedes them; reads every window."""
        return sum(int(self._chosen.passes(self._source.read_window(window)).sum()) for window in self._windows)

    def __len__(self) -> int:
        """Windows."""
        return len(self._windows)


def window_points(
    layers: Layers,
    directions: FloatArray,
    *,
    window: int,
    chosen: PointFilter,
    fields: Sequence[PointField] = POINT_FIELDS,
) -> PointArray:
    """Points of one window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    directions : (row, col, 3) float64
        From `tofmix.optics.projection.beam_directions_of`.
    window : int
        Number of the window.
    chosen : PointFilter
        Which layers. `return_number` and `number_of_returns` count all layers of the pixel, also those left out.
    fields : sequence of PointField
        `POINT_FIELDS`, and any of `FURTHER_FIELDS` that the layers have.

    Returns
    -------
    (point,) records of fields
        By row, column and layer.
    """
    row, col, layer = np.nonzero(chosen.passes(layers))
    points: Any = np.zeros(len(row), dtype=packed(fields))
    place = directions[row, col] * (layers.range[row, col, layer].astype(np.float64) / MM_A_METRE)[:, np.newaxis]
    points["x"], points["y"], points["z"] = place.T
    for spec in LAYER_FIELDS:
        if spec.per_layer:
            points[spec.name] = getattr(layers, spec.name)[row, col, layer]
    points["return_number"] = layer + 1
    points["number_of_returns"] = layers.n_modes[row, col]
    points["status"] = layers.status[row, col]
    points["row"], points["col"], points["window"] = row, col, window
    names = {spec.name for spec in fields}
    for spec in FURTHER_FIELDS:
        wanted = point_fields(spec)
        if wanted[0].name in names:
            values = getattr(layers, spec.name)
            values = values[row, col, layer] if spec.per_layer else values[row, col]
            for field, value in zip(wanted, values.T if spec.ends else [values], strict=True):
                points[field.name] = value
    if INTENSITY.name in names:
        points[INTENSITY.name] = points[AMPLITUDE.name]
    return np.asarray(points)
