"""Which layer of its pixel a sample is of."""

import math

from tofmix.arrays import Float32Array
from tofmix.compiled.jit import borrowing

FARTHEST_SIGMAS = 5.0
"""A sample farther from a layer than this many of its sigma is not of it."""


@borrowing
def layer_of(
    value: float, count: int, mean: Float32Array, sigma: Float32Array, weight: Float32Array, circle: float
) -> int:
    """The layer that a sample is most probably of; -1 if it is far from all.

    `count` layers (layer,) are there; `circle` is the length of the circle that ranges are on, mm, or 0.
    """
    best, chosen = -math.inf, -1
    for i in range(count):
        away = value - mean[i]
        if circle > 0.0:
            away -= circle * round(away / circle)
        z = abs(away) / sigma[i]
        if z <= FARTHEST_SIGMAS:
            density = math.log(max(weight[i], 1.0e-12) / sigma[i]) - 0.5 * z * z
            if density > best:
                best, chosen = density, i
    return chosen
