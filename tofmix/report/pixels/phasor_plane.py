"""A pixel of a lock-in camera in the complex plane: its samples, its neighbours, and the surfaces it was unmixed to.

Use `read_around` for the samples and `phasor_plane` for the data of the figure. Drawing is left to
`tofmix.report.pixels.pixel_figures`.
"""

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.recording import SampleSource, amplitude_source
from tofmix.sensor import Sensor
from tofmix.unmixing.image import FIELDS, ComplexArray, mean_phasors, phase_scale_mm

REACH = 3
"""Neighbours are shown up to so many pixels from the pixel, by row and by column: unmixing looks as far."""


_REAL, _IMAGINARY, _VARIANCE_REAL, _VARIANCE_IMAGINARY, _COVARIANCE, _SAMPLES = (
    FIELDS.index(name) for name in ("real", "imaginary", "variance_real", "variance_imaginary", "covariance", "samples")
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhasorEnd:
    """A surface of an unmixed pixel, or its open space."""

    share: float  # its share of the samples' sum, as the layers file has it
    range_mm: float  # of the layer; infinite for open space
    phase: float  # range / K, radians
    amplitude: float | None  # median of the neighbours that see it alone; None if there are none. 0 for open space.

    @property
    def phasor(self) -> complex | None:
        """A exp(i r / K); None where the amplitude is not known."""
        return None if self.amplitude is None else cmath.rect(self.amplitude, self.phase)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhasorPlane:
    """A pixel of one window in the complex plane, all in units of amplitude."""

    # The pixel.
    row: int
    col: int
    mixing: Mixing  # its kind of mixing
    n_layers: int  # layers that it has
    samples: ComplexArray  # (sample,) complex128: z = A exp(i r / K) of each valid sample
    mean: complex | None  # their mean, without outliers; None without a sample
    # (2, 2) float64: of the mean's real and imaginary part: that of a sample over their number.
    mean_covariance: FloatArray
    neighbours: ComplexArray  # (neighbour,) complex128: mean phasors of the pixels within `REACH`
    neighbour_is_single: BoolArray  # (neighbour,) bool: whether a neighbour sees one surface
    # The surfaces of an unmixed pixel, near to far, and open space last; none for any other pixel.
    ends: tuple[PhasorEnd, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SamplesAround:
    """Samples of the pixels around one."""

    # The pixel that ``[:, 0, 0]`` is of.
    first_row: int
    first_col: int
    # (frame, row, col) float32: samples, mm, NaN where invalid, and their amplitudes.
    range_mm: Float32Array
    amplitude: Float32Array


def read_around(source: SampleSource, *, row: int, col: int, start: int, stop: int) -> SamplesAround | None:
    """Read the samples of the pixels within `REACH` of one over frames [start, stop); None without amplitudes."""
    lights = amplitude_source(source)
    if lights is None:
        return None
    frames, rows, cols = source.shape
    rows_near = slice(max(0, row - REACH), min(rows, row + REACH + 1))
    cols_near = slice(max(0, col - REACH), min(cols, col + REACH + 1))
    blocks = [
        (
            source.read_range(block, rows_near)[..., cols_near].copy(),
            lights.read_amplitude(block, rows_near)[..., cols_near].copy(),
        )
        for block in _frame_blocks(start, min(stop, frames), source.frame_step)
    ]
    range_mm, amplitude = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return SamplesAround(first_row=rows_near.start, first_col=cols_near.start, range_mm=range_mm, amplitude=amplitude)


def _frame_blocks(
    start: int,
    stop: int,
    step: int,
    *,
    least_frames: int = 64,  # read at once: rows are stored whole, of which a few columns are kept
) -> Iterator[slice]:
    """Cut frames into blocks of whole steps, so that each stored chunk is read once."""
    length = step * math.ceil(least_frames / step)
    while start < stop:
        end = min(stop, (start // length + 1) * length)
        yield slice(start, end)
        start = end


def phasor_plane(
    layers: Layers,
    around: SamplesAround,
    sensor: Sensor,
    *,
    row: int,
    col: int,
    unambiguous_range_mm: float | None = None,
) -> PhasorPlane:
    """Collect the data of a pixel in the complex plane.

    The `layers` (row, col) have `mixing`, the samples `around` are of the same window, and the sensor's modulation
    frequency is known. On a circle of ranges its length is `unambiguous_range_mm`.
    """
    if layers.mixing is None:
        raise ValueError("the complex plane needs layers with mixing")
    phasors = mean_phasors(around.range_mm, around.amplitude, sensor).astype(np.float64)
    assert sensor.modulation_frequency_hz is not None  # noqa: S101  mean_phasors has refused it
    scale_mm = phase_scale_mm(sensor.modulation_frequency_hz)
    rows, cols = phasors.shape[:2]
    here = row - around.first_row, col - around.first_col
    patch = slice(around.first_row, around.first_row + rows), slice(around.first_col, around.first_col + cols)
    single = (layers.mixing[patch] == int(Mixing.ONE_SURFACE)) & (layers.n_modes[patch] == 1)
    neighbours = phasors[..., _SAMPLES] > 0
    neighbours[here] = False
    means = phasors[..., _REAL] + 1j * phasors[..., _IMAGINARY]
    ends: tuple[PhasorEnd, ...] = ()
    mixing = Mixing(int(layers.mixing[row, col]))
    if mixing == Mixing.PHASOR:
        known = neighbours & single
        ends = _ends(
            layers,
            (row, col),
            np.abs(means[known]),
            layers.range[patch][..., 0][known].astype(np.float64),
            scale_mm,
            unambiguous_range_mm,
        )
    own = phasors[here]
    range_mm, light = (part[:, *here].astype(np.float64) for part in (around.range_mm, around.amplitude))
    valid = np.isfinite(range_mm) & np.isfinite(light)
    covariance = np.array([[own[_VARIANCE_REAL], own[_COVARIANCE]], [own[_COVARIANCE], own[_VARIANCE_IMAGINARY]]])
    return PhasorPlane(
        row=row,
        col=col,
        mixing=mixing,
        n_layers=int(layers.n_modes[row, col]),
        samples=light[valid] * np.exp(1j * range_mm[valid] / scale_mm),
        mean=complex(means[here]) if own[_SAMPLES] > 0 else None,
        mean_covariance=covariance / max(1.0, own[_SAMPLES]),
        neighbours=means[neighbours],
        neighbour_is_single=single[neighbours],
        ends=ends,
    )


def _ends(
    layers: Layers,
    pixel: tuple[int, int],
    amplitude: FloatArray,
    range_mm: FloatArray,
    scale_mm: float,
    length_mm: float | None,
) -> tuple[PhasorEnd, ...]:
    """The surfaces of an unmixed pixel, with amplitude and range (neighbour,) of the neighbours of one surface."""
    count = int(layers.n_modes[pixel])
    of_layers = layers.range[pixel][:count].astype(np.float64)
    gap = np.abs(range_mm[:, np.newaxis] - of_layers)
    if length_mm is not None:
        gap = np.minimum(gap % length_mm, length_mm - gap % length_mm)
    nearest = gap.argmin(axis=1) if count and range_mm.size else np.zeros(range_mm.size, np.int64)
    ends = []
    same_surface = 0.03  # part of a layer's range within which a neighbour's range is of the same surface
    for k in range(count):
        same = (nearest == k) & (gap[:, k] <= same_surface * of_layers[k])
        ends.append(
            PhasorEnd(
                share=float(layers.weight[(*pixel, k)]),
                range_mm=float(of_layers[k]),
                phase=float(of_layers[k] / scale_mm),
                amplitude=float(np.median(amplitude[same])) if same.any() else None,
            )
        )
    empty = float(layers.weight_no_return[pixel])
    if empty > 0:
        ends.append(PhasorEnd(share=empty, range_mm=math.inf, phase=0.0, amplitude=0.0))
    return tuple(ends)
