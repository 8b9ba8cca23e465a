"""Normalised Hermite polynomials of orders 1 to 4, and their slopes.

Of a standard normal z their means are 0, their variances 1, and their covariances 0.
"""

from collections.abc import Iterator

import numpy as np

from tofmix.arrays import Float32Array, FloatArray


def hermite(z: Float32Array) -> Iterator[Float32Array]:
    """Yield the polynomials of orders 1 to 4 at z."""
    square = z * z
    yield z
    yield ((square - 1) / np.sqrt(2)).astype(np.float32)
    yield ((square - 3) * z / np.sqrt(6)).astype(np.float32)
    yield ((square * (square - 6) + 3) / np.sqrt(24)).astype(np.float32)


def hermite_slopes(z: FloatArray) -> Iterator[FloatArray]:
    """Yield the derivatives of the polynomials of orders 1 to 4 at z."""
    yield np.ones_like(z)
    yield 2 * z / np.sqrt(2.0)
    yield 3 * (z**2 - 1) / np.sqrt(6.0)
    yield 4 * (z**3 - 3 * z) / np.sqrt(24.0)
