"""The plane of a surface: changes of its ranges with its pose, and the pose from its measured ranges."""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.surface import Surface, tilts_to

_PASSES, _FAR = 12, 6.0  # of a fit; largest residual of a pixel, in medians of the residuals
_LEAST_MM = 1.0  # range


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePose:
    """A pose relative to that of the model.

    Parameters
    ----------
    shift_mm : float
        Along the model's normal, mm.
    tilts_deg : (float, float)
        About the surface's own u and v axes, degrees.
    explained : float
        Share of the weighted squares of the biases that the pose explains.
    z : float
        Distance from the model's pose, in standard errors.
    turn_nats : float
        Gain of the tilts beyond a shift, nats.
    """

    shift_mm: float
    tilts_deg: tuple[float, float]
    explained: float
    z: float
    turn_nats: float


def ranges_to(surface: Surface, beams: FloatArray) -> FloatArray:
    """Range (n,) at which unit beams (n, 3) meet the plane of a surface, mm; inf where they run along it."""
    normal = surface.rotation()[:, 2]
    with np.errstate(divide="ignore"):
        return np.asarray(float(normal @ np.array(surface.center_mm)) / (beams @ normal))


def range_slopes(surface: Surface, beams: FloatArray) -> FloatArray:
    """Derivatives of ranges along unit beams (n, 3) by shift and both tilts: (n, 3), mm/mm and mm/degree.

    The plane n . p = n . c, c shifted along n and n turned about c, is met at r = n . c / (n . d).
    """
    center = np.array(surface.center_mm)
    u, v, normal = surface.rotation().T
    facing = beams @ normal
    slopes = [1.0 / facing]
    for turned in (-v, u):  # the change of the normal by a tilt about u, and by one about v
        change = float(turned @ center) / facing - float(normal @ center) * (beams @ turned) / facing**2
        slopes.append(np.radians(1.0) * change)
    return np.stack(slopes, axis=1)


def measured_pose(surface: Surface, beams: FloatArray, bias_mm: FloatArray, information: FloatArray) -> PlanePose:
    """The plane through a surface's pixels at their measured mean ranges.

    A beam d meets the plane q . p = 1 at the range 1 / (q . d), so the inverse range is linear in q. Pixels with large
    residuals see another surface, because an edge has moved; they are left out.


    Parameters
    ----------
    surface : Surface
        The surface of the model.
    beams : (n, 3) float64
        Unit vectors of the pixels that see it.
    bias_mm : (n,) float64
        Measured minus predicted mean range.
    information : (n,) float64
        Of the bias, 1/mm2.

    References
    ----------
    Schlossmacher, J. Am. Stat. Assoc. 68 (1973) 857: least absolute values by weighted least squares.
    """
    expected = ranges_to(surface, beams)
    measured = np.maximum(expected + bias_mm, _LEAST_MM)
    root = np.sqrt(information) * expected**2  # the error of 1 / r is that of r over r squared
    rows, wanted = beams * root[:, None], (1 / measured - 1 / expected) * root
    use = np.isfinite(wanted)
    shift = float(np.median(bias_mm[use])) if use.any() else 0.0
    left: FloatArray = np.where(use, (bias_mm - shift) * np.sqrt(information), np.inf)
    change: FloatArray = np.zeros(3)
    for _ in range(_PASSES):  # least absolute values: up to a third of the pixels may be far off
        weight = np.where(use, 1.0 / np.sqrt(np.maximum(np.abs(left), 1.0)), 0.0)
        change = np.asarray(np.linalg.lstsq(rows[use] * weight[use, None], wanted[use] * weight[use], rcond=None)[0])
        left = np.where(use, wanted - rows @ change, np.inf)
    use = np.abs(left) <= _FAR * max(float(np.median(np.abs(left))), 1.0)
    change = np.asarray(np.linalg.lstsq(rows[use], wanted[use], rcond=None)[0])
    left = wanted - rows @ change
    normal, center = surface.rotation()[:, 2], np.array(surface.center_mm)
    after = normal / float(normal @ center) + change
    new = after / np.linalg.norm(after) * math.copysign(1.0, float(after @ normal))
    weighed, along = information[use] * bias_mm[use], 1.0 / (beams @ normal)[use]
    total, rest = float((weighed * bias_mm[use]).sum()), float((left[use] ** 2).sum())
    shifted = float((weighed * along).sum()) ** 2 / max(float((information[use] * along**2).sum()), 1e-30)
    curvature = rows[use].T @ rows[use]
    return PlanePose(
        shift_mm=(1.0 - float(after @ center)) / float(after @ normal),
        tilts_deg=tilts_to(surface, new),
        explained=1.0 - rest / max(total, 1e-30),
        turn_nats=0.5 * (total - rest - shifted),
        z=math.sqrt(max(float(change @ curvature @ change), 0.0)),
    )
