"""The result of `estimate`: the layers of each pixel, and their names in a file.

`LAYER_FIELDS` is the one list of datasets. The estimator fills a `Layers`, the
layers file stores one, the report reads one; all three follow this list.

The report reads a `LayersSource`: a file of `tofmix.io`, or anything else with its members.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from tofmix.flags import MixingLaw
from tofmix.sensor import Sensor

LAYER_DIMS = ("window", "row", "col", "layer")
"""Dimensions of layers; numbers of a pixel have the first three."""

ENDS = "ends"
"""Dimension of two values, the first and the last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerField:
    """One dataset of a layers file.

    `per_layer` datasets have the dimensions (window, row, col, layer), the others (window, row, col); with `ends` there
    are two values of each, the first and the last.
    """

    name: str
    dtype: str
    units: str
    long_name: str
    per_layer: bool = False
    ends: bool = False

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of its dimensions."""
        return (*(LAYER_DIMS if self.per_layer else LAYER_DIMS[:3]), *((ENDS,) if self.ends else ()))

    def full_shape(self, shape: tuple[int, ...], max_layers: int) -> tuple[int, ...]:
        """Shape of its array for the leading shape of pixels."""
        return (*shape, *((max_layers,) if self.per_layer else ()), *((2,) if self.ends else ()))


LAYER_FIELDS: tuple[LayerField, ...] = (
    LayerField(name="n_modes", dtype="u1", units="1", long_name="surfaces found in the pixel"),
    LayerField(name="n_peaks", dtype="u1", units="1", long_name="peaks of the density, before any refinement"),
    LayerField(name="range", dtype="f4", units="mm", long_name="range of each surface, near to far", per_layer=True),
    LayerField(name="sigma", dtype="f4", units="mm", long_name="standard deviation of the component", per_layer=True),
    LayerField(name="weight", dtype="f4", units="1", long_name="share of the beam, p(c_i)", per_layer=True),
    LayerField(name="range_stderr", dtype="f4", units="mm", long_name="standard error of range", per_layer=True),
    LayerField(name="weight_stderr", dtype="f4", units="1", long_name="standard error of weight", per_layer=True),
    LayerField(name="probability", dtype="f4", units="1", long_name="how surely the layer exists", per_layer=True),
    LayerField(name="weight_no_return", dtype="f4", units="1", long_name="share without a return, p(c_0)"),
    LayerField(name="weight_outlier", dtype="f4", units="1", long_name="share of random values, p(c_r)"),
    LayerField(name="log_likelihood", dtype="f4", units="nat", long_name="log likelihood of the window's samples"),
    LayerField(name="n_samples", dtype="u4", units="1", long_name="valid samples used"),
    LayerField(name="n_iter", dtype="u2", units="1", long_name="EM iterations"),
    LayerField(name="status", dtype="u1", units="1", long_name="outcome of the estimator"),
)
"""Every dataset with a pixel dimension that all layers files have, in the order of the file."""

NOISE_WIDTH = LayerField(
    name="noise_width", dtype="f4", units="1", long_name="width of the pixel's own noise over the common one"
)
"""Where pixels have widths of their own."""

INVALID_SHARE = LayerField(
    name="invalid_share", dtype="f4", units="1", long_name="share of the window's frames without a valid sample"
)
"""Lost samples: dark, saturated, out of range, or dropped by the camera. In all files but those of old versions."""

AMPLITUDE = LayerField(
    name="amplitude", dtype="f4", units="1", long_name="mean amplitude of the layer's samples", per_layer=True
)
"""Where the recording has amplitudes; NaN where samples are phasor sums of several surfaces."""

MIXING = LayerField(name="mixing", dtype="u1", units="1", long_name="what the samples of the pixel are of")
"""Where the phasors of samples are known: amplitudes, and one modulation frequency."""

LAW_TEXTS = {
    "phasor_share": "share of the samples at edges that are phasor sums",
    "phasor_pixels": "pixels that tell it",
}
"""Datasets of each window that describe `mixing`."""

SUSPECT = LayerField(
    name="suspect", dtype="u1", units="1", long_name="reasons to doubt that the layer is there", per_layer=True
)
"""Where any layer is suspect."""

SUSPECT_FRAMES = LayerField(
    name="suspect_frames",
    dtype="u4",
    units="1",
    long_name="first and last frame of a passing layer",
    per_layer=True,
    ends=True,
)
"""Where any layer is a passing one; 0 for all others."""

OPTIONAL_FIELDS = (NOISE_WIDTH, INVALID_SHARE, AMPLITUDE, MIXING, SUSPECT, SUSPECT_FRAMES)
"""Datasets that some layers files have, after the others."""


def layer_fields(sensor: Sensor, *, amplitude: bool = False, mixing: bool = False) -> tuple[LayerField, ...]:
    """Datasets of the layers that are estimated with a sensor, from samples with amplitudes, and of unmixed ones."""
    own = sensor.learnt is not None and sensor.noise is not None and sensor.noise.width_spread > 0
    optional = ((NOISE_WIDTH, own), (INVALID_SHARE, True), (AMPLITUDE, amplitude), (MIXING, mixing))
    return (*LAYER_FIELDS, *(spec for spec, is_there in optional if is_there))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layers:
    """The layers of pixels in any arrangement.

    Every array has the same leading shape (...): (pixel,) inside the estimator,
    (window, row, col) in a file. Those marked `per_layer` in `LAYER_FIELDS` have
    one more axis of length `max_layers`, near to far, NaN past `n_modes`.
    """

    n_modes: NDArray[np.uint8]
    n_peaks: NDArray[np.uint8]
    range: NDArray[np.float32]
    sigma: NDArray[np.float32]
    weight: NDArray[np.float32]
    range_stderr: NDArray[np.float32]
    weight_stderr: NDArray[np.float32]
    probability: NDArray[np.float32]
    weight_no_return: NDArray[np.float32]
    weight_outlier: NDArray[np.float32]
    log_likelihood: NDArray[np.float32]
    n_samples: NDArray[np.uint32]
    n_iter: NDArray[np.uint16]
    status: NDArray[np.uint8]
    noise_width: NDArray[np.float32] | None = None
    invalid_share: NDArray[np.float32] | None = None
    amplitude: NDArray[np.float32] | None = None
    mixing: NDArray[np.uint8] | None = None
    suspect: NDArray[np.uint8] | None = None
    suspect_frames: NDArray[np.uint32] | None = None

    @classmethod
    def empty(cls, shape: tuple[int, ...], max_layers: int, fields: tuple[LayerField, ...] = LAYER_FIELDS) -> Self:
        """Layers without a surface, with the given datasets: counts 0, numbers NaN."""
        arrays: dict[str, Any] = {}
        for spec in fields:
            full = spec.full_shape(shape, max_layers)
            arrays[spec.name] = np.full(full, np.nan if spec.dtype.startswith("f") else 0, dtype=spec.dtype)
        return cls(**arrays)

    @property
    def shape(self) -> tuple[int, ...]:
        """The leading shape, without the layer axis."""
        return self.n_modes.shape

    @property
    def max_layers(self) -> int:
        """Length of the layer axis."""
        return int(self.range.shape[-1])

    @property
    def fields(self) -> tuple[LayerField, ...]:
        """The datasets that are there, in the order of the file."""
        return (*LAYER_FIELDS, *(spec for spec in OPTIONAL_FIELDS if getattr(self, spec.name) is not None))

    @property
    def unsuspected(self) -> NDArray[np.bool_]:
        """Whether each layer (..., layer) is there and has no mark of `suspect`."""
        present = np.isfinite(self.range)
        return present if self.suspect is None else present & (self.suspect == 0)

    def suspects(self) -> int:
        """Number of layers that are suspect."""
        return 0 if self.suspect is None else int(np.count_nonzero(self.suspect))

    def trusted(self) -> "Layers":
        """The same layers without their marks, for users who take suspect ones too; arrays are shared."""
        arrays: dict[str, Any] = {spec.name: getattr(self, spec.name) for spec in self.fields}
        return Layers(**{name: values for name, values in arrays.items() if not name.startswith(SUSPECT.name)})

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The arrays in the order of `LAYER_FIELDS`, for a kernel to fill."""
        return tuple(getattr(self, spec.name) for spec in LAYER_FIELDS)

    def reshaped(self, shape: tuple[int, ...]) -> "Layers":
        """The same pixels in another arrangement, as `numpy.reshape`; arrays are shared."""
        arrays: dict[str, Any] = {}
        for spec in self.fields:
            arrays[spec.name] = getattr(self, spec.name).reshape(spec.full_shape(shape, self.max_layers))
        return Layers(**arrays)


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Source and options of layers; independent of time, machine and number of workers.

    `options` holds every option that affects values, by its name on the command line. `targets` is the length of the
    recording's axis of targets, 0 without one: a share is then a share of detections. `has_amplitude` says whether the
    recording has amplitudes.
    """

    source: str
    source_sha256: str
    version: str
    sensor: Sensor
    options: dict[str, str | int | float] = field(default_factory=dict)
    frames_left_out: int = 0
    targets: int = 0
    has_amplitude: bool = False

    @property
    def is_unmixed(self) -> bool:
        """Whether the law of mixing was measured, and layers unmixed where samples are phasor sums."""
        return "mixing" in self.options

    @property
    def has_mixing(self) -> bool:
        """Whether layers say the kind of mixing."""
        return self.is_unmixed or self.sensor.filters_over_pixels

    @property
    def fields(self) -> tuple[LayerField, ...]:
        """Datasets of the layers."""
        return layer_fields(self.sensor, amplitude=self.has_amplitude, mixing=self.has_mixing)

    @property
    def samples_a_frame(self) -> int:
        """Samples that a frame has of each pixel, at most."""
        return max(1, self.targets)

    @property
    def unambiguous_range_mm(self) -> float | None:
        """Length of the circle that the ranges are on, mm; None: they are on a line."""
        value = self.options.get("unambiguous_range_mm")
        return float(value) if isinstance(value, int | float) and 0 < value < math.inf else None


if tuple(f.name for f in fields(Layers)) != tuple(spec.name for spec in (*LAYER_FIELDS, *OPTIONAL_FIELDS)):
    raise AssertionError("Layers and its lists of datasets differ")


class LayersSource(Protocol):
    """Layers of an image sequence, read window by window."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Windows, rows, columns."""

    @property
    def max_layers(self) -> int:
        """Length of the layer axis."""

    @property
    def window_start(self) -> NDArray[np.uint64]:
        """First frame of each window, (window,)."""

    @property
    def window_stop(self) -> NDArray[np.uint64]:
        """One past the last frame of each window, (window,)."""

    @property
    def provenance(self) -> Provenance:
        """Source and options of the layers."""

    @property
    def mixing_law(self) -> MixingLaw | None:
        """The law of mixing over all windows; None where it was not measured."""

    def read_window(self, window: int) -> Layers:
        """Layers of one window, of the leading shape (row, col)."""
