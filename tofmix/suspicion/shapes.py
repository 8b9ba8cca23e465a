"""Which of two shapes a set of ranges has: evidence for suspicions that amplitudes alone do not settle."""

import math

import numpy as np

from tofmix.arrays import FloatArray

SHAPES = 6.0
"""Free numbers of the deviations of a smooth shape from another: more pixels than these tell no more."""

PLANE_NUMBERS = 3
"""Free numbers of a plane."""

MOST_EVIDENCE = math.log(1000.0)
"""Most that shapes tell, nat: one surface in a thousand has a shape by chance that another hypothesis predicts."""


def plane_misfit_mm(range_mm: FloatArray, directions: FloatArray) -> float:
    """Root mean square distance, mm along the beams, of ranges (n,) from the plane 1/r = m . d through them.

    `directions` (n, 3) are the unit vectors of the beams.
    """
    weights = (range_mm**2)[:, np.newaxis]
    plane, *_ = np.linalg.lstsq(directions * weights, range_mm, rcond=None)
    return rms((directions @ plane) * range_mm**2 - range_mm)


def evidence_nats(misfit: float, other: float, error: float, free: int) -> float:
    """Evidence, nat, for the first of two shapes, from their misfits.

    Parameters
    ----------
    misfit, other : float
        Root mean square misfit of each shape, as parts of the range.
    error : float
        Root mean square standard error of the ranges, likewise: neither shape fits better.
    free : int
        Ranges less the free numbers of the shape that has more of them.
    """
    squares = [max(value**2, error**2) for value in (misfit, other)]
    if free <= 0 or not 0.0 < squares[0] < math.inf or not 0.0 < squares[1] < math.inf:
        return 0.0
    evidence = 0.5 * min(SHAPES, free) * math.log(squares[1] / squares[0])
    return min(max(evidence, -MOST_EVIDENCE), MOST_EVIDENCE)


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return math.sqrt(float(np.mean(values**2)))
