"""Which of a pixel's sorted samples lie near a range: the part of them that a sum over a narrow kernel needs."""

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import LANES


@borrowing
def whole_lanes(first: int, stop: int, n: int) -> tuple[int, int]:
    """Widen [first, stop) of n values to whole `LANES`, within n: a few more values cost less than a partial lane."""
    return first // LANES * LANES, min((stop + LANES - 1) // LANES * LANES, n)


@borrowing
def within_reach(values: FloatArray, first: int, stop: int, low: float, high: float) -> tuple[int, int]:
    """Move [first, stop) to the ascending values in [low, high]; cheap when it moves little."""
    n = len(values)
    while first > 0 and values[first - 1] >= low:
        first -= 1
    while first < n and values[first] < low:
        first += 1
    stop = max(stop, first)
    while stop > first and values[stop - 1] > high:
        stop -= 1
    while stop < n and values[stop] <= high:
        stop += 1
    return first, stop
