"""Differences of two windows of one size, pixel by pixel and layer by layer.

`tofmix.report.comparison.comparison` sums this up over the windows of two files.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.layers import Layers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowDifference:
    """One window of A against one of B."""

    # (row, col) bool: another number of surfaces; another status.
    count_differs: BoolArray
    status_differs: BoolArray
    # (row, col, layer) bool: as many surfaces in both, and this one's range beyond the tolerance.
    layer_differs: BoolArray
    # (row, col, layer) float64: range of B less that of A where both have as many surfaces, mm; NaN elsewhere.
    gap_mm: FloatArray
    # (row, col, layer) float64: the same in combined standard errors; infinite where the errors are not known and the
    # ranges differ.
    gap_errors: FloatArray

    @property
    def range_differs(self) -> BoolArray:
        """Pixels with a range beyond the tolerance (row, col)."""
        return np.asarray(self.layer_differs.any(axis=-1))

    @property
    def differs(self) -> BoolArray:
        """Pixels that count as different (row, col)."""
        return self.count_differs | self.range_differs


def compare_windows(
    a: Layers, b: Layers, *, tolerance: float, unambiguous_range_mm: float | None = None
) -> WindowDifference:
    """Compare two windows of the leading shape (row, col).

    Parameters
    ----------
    a, b : Layers
        Of one leading shape; they may hold different numbers of layers.
    tolerance : float
        In combined standard errors, at least 0. Where an error is not known, ranges must be equal.
    unambiguous_range_mm : float, optional
        Where the ranges of both are on one circle: its length, mm. Differences then go the short way round, and
        layers are paired in the order round the circle in which they differ least: a surface at the fold may be
        the last layer in one and the first in the other.
    """
    shared = min(a.max_layers, b.max_layers)
    count_differs = a.n_modes != b.n_modes
    present = (np.arange(shared) < a.n_modes[..., np.newaxis]) & ~count_differs[..., np.newaxis]
    range_a, range_b = (one.range[..., :shared].astype(np.float64) for one in (a, b))
    stderr_a, stderr_b = (one.range_stderr[..., :shared].astype(np.float64) for one in (a, b))
    gap = np.where(present, range_b - range_a, np.nan)
    if unambiguous_range_mm is not None:
        pair = _pairs_on_circle(range_a, range_b, np.where(count_differs, 0, a.n_modes), unambiguous_range_mm)
        range_b, stderr_b = (np.take_along_axis(values, pair, axis=-1) for values in (range_b, stderr_b))
        gap = np.where(present, _circular_difference(range_b - range_a, unambiguous_range_mm), np.nan)
    errors = np.nan_to_num(np.hypot(stderr_a, stderr_b), nan=0.0, posinf=0.0)
    both_unknown = np.isnan(range_a) & np.isnan(range_b)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap_errors = np.where(gap == 0.0, 0.0, gap / errors)
        beyond = present & ~both_unknown & ~(np.abs(gap) <= tolerance * errors)
    return WindowDifference(
        count_differs=np.asarray(count_differs),
        status_differs=np.asarray(a.status != b.status),
        layer_differs=np.asarray(beyond),
        gap_mm=np.asarray(gap),
        gap_errors=np.asarray(gap_errors),
    )


def _circular_difference(gap_mm: FloatArray, length_mm: float) -> FloatArray:
    """Differences of two places on a circle, by the shorter way, mm."""
    return np.asarray(gap_mm - length_mm * np.round(gap_mm / length_mm))


def _pairs_on_circle(range_a: FloatArray, range_b: FloatArray, n_modes: IntArray, length_mm: float) -> IntArray:
    """For each layer of A (row, col, layer) the layer of B with which it is compared."""
    layer = np.arange(range_a.shape[-1])
    count = np.maximum(n_modes, 1).astype(np.int64)[..., np.newaxis]
    best = np.broadcast_to(layer, range_a.shape)
    least = np.full(range_a.shape[:-1], np.inf)
    for turned in range(int(count.max(initial=1))):
        # Past the pixel's layers every layer is its own pair; they are not compared.
        pair = np.where(layer < count, (layer + turned) % count, layer)
        apart = np.abs(_circular_difference(np.take_along_axis(range_b, pair, axis=-1) - range_a, length_mm))
        total = np.nansum(np.where(layer < count, apart, 0.0), axis=-1)
        better = total < least
        best, least = np.where(better[..., np.newaxis], pair, best), np.where(better, total, least)
    return np.asarray(best)
