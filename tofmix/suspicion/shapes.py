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
    return _rms((directions @ plane) * range_mm**2 - range_mm)


def evidence_nats(misfit_mm: float, other_mm: float, stderr_mm: FloatArray, numbers: int) -> float:
    """Evidence, nat, for the first of two shapes, from their misfits.

    Parameters
    ----------
    misfit_mm, other_mm : float
        Root mean square misfit of each shape.
    stderr_mm : (n,) float64
        Standard errors of the ranges: neither shape fits better than these.
    numbers : int
        The larger number of free numbers of the two shapes.
    """
    free = min(SHAPES, max(0.0, len(stderr_mm) - numbers))
    floor = _rms(stderr_mm) ** 2
    ratio = (other_mm**2 + floor) / (misfit_mm**2 + floor)
    return min(max(0.5 * free * math.log(ratio), -MOST_EVIDENCE), MOST_EVIDENCE) if math.isfinite(ratio) else 0.0


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))
