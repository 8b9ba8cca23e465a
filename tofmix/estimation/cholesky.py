"""The Cholesky factor of an information matrix, which both kinds of fit take standard errors from."""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing

_SINGULAR = 1.0e-10
"""A pivot below this, of a matrix with a unit diagonal, is rounding."""


@borrowing
def scaled_cholesky(matrix: FloatArray, scale: FloatArray, lower: FloatArray) -> bool:
    """Fill `lower` (n, n) with the factor of S M S, S = diag(`scale`), whose diagonal is 1; false if M has none.

    Means and shares have other units: S makes their pivots comparable. `lower` holds zeros before; of `matrix` (n, n),
    symmetric, the lower half is read.
    """
    n = len(matrix)
    for i in range(n):
        if not matrix[i, i] > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(matrix[i, i])
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j] * scale[i] * scale[j]
            for m in range(j):
                value -= lower[i, m] * lower[j, m]
            if i == j:
                if not value > _SINGULAR:
                    return False
                lower[i, i] = math.sqrt(value)
            else:
                lower[i, j] = value / lower[j, j]
    return True
