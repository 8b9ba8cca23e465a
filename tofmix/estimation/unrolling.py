"""A circle of ranges, cut where it is emptiest, so that methods for a line apply.

Readings are folded into [0, d_u). Each pixel's circle is cut where no surface lies, and the readings below the cut move
up a turn: a surface at the fold is then one cluster, at d_u or just beyond. If no reading is near the fold, the cut is
the fold, and no reading moves. Ranges are folded back at the end.

A pixel without readings just before the fold, or nearer than the camera sees, has no surface at the fold: its near
readings are near surfaces, with the sigma of the noise curve.

c_0 is a reading at range_max. The cut never moves it, so its term of equation (1) does not change.
"""

import math
import warnings
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.circle import FOLD_SIGMAS, fold, unseen_zone
from tofmix.compiled.jit import jit
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.beam import Beam, beam_of, sigma_at
from tofmix.estimation.samples import FARTHEST_MM, SortedSamples
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.recording import SampleSource, SourceAround
from tofmix.sensor import Sensor

CUT_SIGMAS = 4.0
"""A cut is empty where no reading lies within this many sigma of it."""


@jit
def _crowding(values: FloatArray, place: float, reach: float, length: float) -> float:
    """Sum of 1 - distance / reach over the sorted readings within `reach` of a place; 0 without any."""
    n = len(values)
    total = 0.0
    after = np.searchsorted(values, place)
    for step in range(n):
        j = after + step
        away = values[j] - place if j < n else values[j - n] + length - place
        if away >= reach:
            break
        total += 1.0 - away / reach
    for step in range(1, n + 1):
        j = after - step
        away = place - values[j] if j >= 0 else place - values[j + n] + length
        if away >= reach:
            break
        total += 1.0 - away / reach
    return total


@jit
def _emptiest(values: FloatArray, beam: Beam, length: float) -> float:
    """Place to cut the circle of sorted readings: the fold if it is empty, else the first of the emptiest places."""
    n = len(values)
    best = _crowding(values, 0.0, CUT_SIGMAS * sigma_at(0.0, beam.curve_range, beam.curve_sigma), length)
    place = 0.0
    if best == 0.0:
        return place
    cut_after_sigmas = 5.0  # it is tried this many sigma after a reading, or in the middle of a gap that is shorter
    for j in range(n):
        gap = (values[j + 1] if j + 1 < n else values[0] + length) - values[j]
        if gap <= 0.0:
            continue
        at = values[j] + min(0.5 * gap, cut_after_sigmas * sigma_at(values[j], beam.curve_range, beam.curve_sigma))
        if at >= length:
            at -= length
        crowding = _crowding(values, at, CUT_SIGMAS * sigma_at(at, beam.curve_range, beam.curve_sigma), length)
        if crowding < best or (crowding == best and at < place):
            best, place = crowding, at
    return place


@jit
def _at_fold(values: FloatArray, beam: Beam, unseen: float, length: float) -> bool:
    """Whether two or more sorted readings lie where only a surface at the fold puts them: one alone is an outlier."""
    before = length - CUT_SIGMAS * sigma_at(0.0, beam.curve_range, beam.curve_sigma)
    return bool(np.searchsorted(values, unseen) + len(values) - np.searchsorted(values, before) > 1)


@jit
def unroll(samples: SortedSamples, beam: Beam, unseen: float, length: float) -> tuple[FloatArray, BoolArray]:
    """Cut the circle of each pixel and unroll its sorted samples, in place; return the cuts, mm, and `at_fold`.

    Samples then ascend from the cut on, over less than `length`. A cut past range_max, where there is a c_0, is taken
    a turn lower, so that range_max stays where it is. `unseen` is the zone after the fold that the camera does not
    see. Both results have the shape (pixel,).
    """
    cuts, at_fold = np.zeros(len(samples.valid)), np.zeros(len(samples.valid), dtype=np.bool_)
    for pixel in range(len(samples.valid)):
        n = samples.valid[pixel]
        values = samples.values[pixel, :n]
        for j in range(n):
            value = values[j] - length * math.floor(values[j] / length)
            values[j] = 0.0 if value >= length else value
        values.sort()
        at_fold[pixel] = _at_fold(values, beam, unseen, length)
        cut = _emptiest(values, beam, length) if at_fold[pixel] else 0.0
        below = np.searchsorted(values, cut)
        lower = length if math.isfinite(beam.range_max) and cut > beam.range_max else 0.0
        if below > 0 or lower > 0.0:
            values[:] = np.concatenate((values[below:] - lower, values[:below] + (length - lower)))
        cuts[pixel] = cut - lower
    return cuts, at_fold


class Part(NamedTuple):
    """Pixels of a block, by their numbers, that share a beam; their unrolled samples; and their cuts (pixel,), mm."""

    pixels: IntArray
    samples: SortedSamples
    beam: Beam
    cuts: FloatArray


def unrolled(samples: SortedSamples, sensor: Sensor, unambiguous_range_mm: float) -> list[Part]:
    """Unroll the circles of a block of pixels: those with a surface at the fold, perhaps, and those without.

    Raises
    ------
    ValueError
        As `beam_of`.
    """
    beam = beam_of(sensor, unambiguous_range_mm)
    cuts, at_fold = unroll(samples, beam, unseen_zone(sensor, unambiguous_range_mm), unambiguous_range_mm)
    parts = []
    for chosen, its_beam in ((at_fold, beam), (~at_fold, beam_of(sensor, unambiguous_range_mm, at_fold=False))):
        if chosen.any():
            own = SortedSamples(samples.values[chosen], samples.valid[chosen])
            parts.append(Part(np.flatnonzero(chosen), own, its_beam, cuts[chosen]))
    return parts


def unrolled_pixel(
    samples: FloatArray, start: FloatArray, sensor: Sensor, unambiguous_range_mm: float
) -> tuple[FloatArray, FloatArray, Beam]:
    """Unroll one pixel's samples (n,) and, with the same cut, starting means (k,); samples come back sorted."""
    block = SortedSamples(samples[np.newaxis].copy(), np.array([len(samples)]))
    (part,) = unrolled(block, sensor, unambiguous_range_mm)
    cut = part.cuts[0]
    return part.samples.values[0], cut + fold(start - cut, unambiguous_range_mm), part.beam


def fold_layers(layers: Layers, unambiguous_range_mm: float) -> None:
    """Fold the ranges of layers into [0, d_u) and put each pixel's layers near to far again, in place."""
    folded = fold(layers.range, unambiguous_range_mm).astype(np.float32)
    folded[folded >= unambiguous_range_mm] = 0.0  # rounded up to the fold
    layers.range[:] = folded
    order = np.argsort(folded, axis=-1, kind="stable")  # NaN last
    if not (order == np.arange(order.shape[-1])).all():
        for spec in LAYER_FIELDS:
            if spec.per_layer:
                values = getattr(layers, spec.name)
                values[:] = np.take_along_axis(values, order, axis=-1)


class UnrolledSource(SourceAround):
    """A recording whose samples are unrolled, without a noise curve: for measuring one.

    A pixel's samples in the frames that are read together are taken as one cluster. A cluster across the fold is cut
    after it, and moves to d_u or just beyond; others do not change. A cluster nearer than `range_min_mm`, or than 4 of
    its sigma, is taken to be at the fold.

    Parameters
    ----------
    source : SampleSource
        The recording.
    unambiguous_range_mm : float
        Length of the circle, mm.
    """

    def __init__(self, source: SampleSource, unambiguous_range_mm: float) -> None:
        super().__init__(source)
        self._length = unambiguous_range_mm

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid; in [0, 2 d_u)."""
        samples = self._source.read_range(frames, rows)
        readings = fold(np.where(np.abs(samples) <= FARTHEST_MM, samples, np.nan), self._length)
        middle, spread = _heaps(readings, self._length)
        nearest = np.maximum(self.sensor.range_min_mm or 0.0, FOLD_SIGMAS * spread)
        middle = np.where(middle < nearest, middle + self._length, middle)
        # The far end of the heap, seen past the fold; no cut where the heap ends before it.
        # A series whose median is this far, in robust sigmas, from the fold has no part on the other side.
        clear_sigmas = 8.0
        beyond = middle + clear_sigmas * spread - self._length
        cut = np.clip(beyond, 0.0, np.maximum(middle - clear_sigmas * spread, 0.0))
        cut = np.where(2 * clear_sigmas * spread < self._length, cut, 0.0)
        return np.asarray(readings + self._length * (readings < cut), dtype=np.float32)


def _heaps(readings: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """Median (row, col) in [0, d_u) of folded readings (frame, row, col) around their mean direction, and spread."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice|Mean of empty slice", RuntimeWarning)
        direction = np.angle(np.nanmean(np.exp(2j * np.pi / length * readings), axis=0)) * length / (2.0 * np.pi)
        away = fold(readings - direction + 0.5 * length, length) - 0.5 * length
        middle = np.nanmedian(away, axis=0)
        spread = MAD_TO_SIGMA * np.nanmedian(np.abs(away - middle), axis=0)
    return fold(direction + middle, length), spread
