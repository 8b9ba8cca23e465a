"""The noise curve as kernels read it."""

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing


@borrowing
def sigma_at(range_mm: float, curve_range: FloatArray, curve_sigma: FloatArray) -> float:
    """sigma(r), linear between the curve's points and constant past its ends."""
    last = len(curve_range) - 1
    if range_mm <= curve_range[0]:
        return float(curve_sigma[0])
    if range_mm >= curve_range[last]:
        return float(curve_sigma[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if curve_range[middle] <= range_mm:
            low = middle
        else:
            high = middle
    share = (range_mm - curve_range[low]) / (curve_range[high] - curve_range[low])
    return float(curve_sigma[low] + share * (curve_sigma[high] - curve_sigma[low]))
