"""Quantiles of a stream of float32 values in bounded memory.

Use it where the values of thousands of windows pass by once. Where they all fit
in memory, `numpy.quantile` does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray, IntArray

_SPREAD = (0.05, 0.5, 0.95)  # probabilities of `Quantiles`
_SIGN = np.uint32(0x8000_0000)
_LARGEST_FINITE_KEY = np.uint32(0xFF7F_FFFF)


@dataclass(frozen=True, slots=True)
class Quantiles:
    """How values spread: their count, and the values below which 5, 50 and 95 % lie (None without a value)."""

    count: int
    q05: float | None
    q50: float | None
    q95: float | None


class ValueCounts:
    """How often each value occurred, coarsened only when there are too many different ones.

    Values are kept as the leading bits of their float32, in an order-preserving
    form. Up to `limit` different values nothing is lost, and the quantiles are
    those of `numpy.quantile`. Past it, trailing bits are dropped, one at a time,
    until the counts fit again: ranges between 1 and 8 m stay known to 0.25 mm.
    The result does not depend on the order of the values.

    Parameters
    ----------
    limit : int
        Different values held at most, at least 1; a 144 x 176 image has 25,344.
    """

    def __init__(self, limit: int = 65_536) -> None:
        self._limit = limit
        self._shift = 0
        self._keys = np.empty(0, dtype=np.uint32)
        self._counts = np.empty(0, dtype=np.int64)
        self._pending: list[NDArray[np.uint32]] = []
        self._n_pending = 0

    def add(self, values: NDArray[np.floating]) -> None:
        """Count values of any shape; those not finite are passed over."""
        finite = np.asarray(values, dtype=np.float32)[np.isfinite(values)]
        if finite.size == 0:
            return
        self._pending.append(_encoded(finite))
        self._n_pending += finite.size
        # Sorting in batches: one merge a window would sort the whole table each time.
        if self._n_pending >= self._limit:
            self._merge()

    @property
    def count(self) -> int:
        """Values counted."""
        return int(self._counts.sum()) + self._n_pending

    def quantiles(self, *probabilities: float) -> list[float | None]:
        """Quantiles by linear interpolation between order statistics; None without a value.

        Parameters
        ----------
        *probabilities : float
            Each in [0, 1].
        """
        self._merge()
        if self._keys.size == 0:
            return [None] * len(probabilities)
        values = self._values()
        last_rank = np.cumsum(self._counts)
        return [_interpolated(values, last_rank, p) for p in probabilities]

    def _merge(self) -> None:
        if not self._pending:
            return
        keys, counts = np.unique(np.concatenate(self._pending) >> np.uint32(self._shift), return_counts=True)
        self._pending, self._n_pending = [], 0
        self._keys, self._counts = _united(
            np.concatenate([self._keys, keys]), np.concatenate([self._counts, counts.astype(np.int64)])
        )
        while self._keys.size > self._limit:
            self._shift += 1
            self._keys, self._counts = _united(self._keys >> np.uint32(1), self._counts)

    def _values(self) -> FloatArray:
        """Middle of the values of each key, float64."""
        low = self._keys << np.uint32(self._shift)
        high = np.minimum(low | np.uint32((1 << self._shift) - 1), _LARGEST_FINITE_KEY)
        middle: FloatArray = (_decoded(low).astype(np.float64) + _decoded(high).astype(np.float64)) / 2
        return middle


def _united(keys: NDArray[np.uint32], counts: IntArray) -> tuple[NDArray[np.uint32], IntArray]:
    """Sorted different keys and the sum of the counts of each."""
    order = np.argsort(keys, kind="stable")
    keys, counts = keys[order], counts[order]
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[first], np.add.reduceat(counts, first)


def _encoded(values: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Map float32 to uint32 in the same order: negative values are flipped, the others moved above them."""
    bits = np.ascontiguousarray(values).view(np.uint32)
    return np.asarray(np.where(bits & _SIGN, ~bits, bits | _SIGN), dtype=np.uint32)


def _decoded(keys: NDArray[np.uint32]) -> NDArray[np.float32]:
    bits = np.where(keys & _SIGN, keys & ~_SIGN, ~keys).astype(np.uint32)
    return bits.view(np.float32)


def _interpolated(values: FloatArray, last_rank: IntArray, probability: float) -> float:
    position = probability * (int(last_rank[-1]) - 1)
    below = int(np.floor(position))
    low, high = values[np.searchsorted(last_rank, [below, min(below + 1, int(last_rank[-1]) - 1)], side="right")]
    return float(low + (high - low) * (position - below))


def spread_of(values: ValueCounts | FloatArray) -> Quantiles:
    """Count and quantiles of values; an array has at least one, all finite."""
    if isinstance(values, ValueCounts):
        return Quantiles(values.count, *values.quantiles(*_SPREAD))
    return Quantiles(values.size, *(float(q) for q in np.quantile(values, _SPREAD)))
