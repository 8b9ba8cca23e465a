"""Vectors of three numbers, and the normal equations of a plane. Compiled, for kernels to call."""

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing


@borrowing
def dot(one: FloatArray, other: FloatArray) -> float:
    """Scalar product of two vectors (3,)."""
    return float(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])


@borrowing
def solve(information: FloatArray, right: FloatArray, plane: FloatArray, covariance: FloatArray) -> None:
    """Fill the plane (3,) and its covariance (3, 3) from the normal equations, by cofactors."""
    a, b, c = information[0, 0], information[0, 1], information[0, 2]
    d, e, f = information[1, 1], information[1, 2], information[2, 2]
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    whole = a * co_a + b * co_b + c * co_c
    covariance[0, 0], covariance[0, 1], covariance[0, 2] = co_a / whole, co_b / whole, co_c / whole
    covariance[1, 1], covariance[1, 2] = (a * f - c * c) / whole, (b * c - a * e) / whole
    covariance[2, 2] = (a * d - b * b) / whole
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = covariance[0, 1], covariance[0, 2], covariance[1, 2]
    for i in range(3):
        plane[i] = covariance[i, 0] * right[0] + covariance[i, 1] * right[1] + covariance[i, 2] * right[2]
