"""Light that reaches a surface by one bounce from another: form factors, and the phase of the longer way.

The lamp lights a rectangle, each of whose points returns light in all directions by the cosine law. At a point of
another surface these add, weighted by the form factor, each with the phase of its way. From the point, directions are
taken in half planes about the axis where both planes meet: a half plane meets the rectangle in a straight piece. The
integral over angles is smooth and needs few nodes, also next to the seam.
"""

import math
from functools import lru_cache

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import beam_directions_of
from tofmix.simulation.echoes import ComplexArray
from tofmix.simulation.surface import Surface

_PARALLEL = 1.0e-9  # sine of the angle of two planes
_LEAST_MM = 1.0e-6  # less is no length


_Optics = Equiangular | Pinhole


@lru_cache(maxsize=64)
def one_bounce(
    surface: Surface, source: Surface, optics: _Optics, shape: tuple[int, int], turn_mm: float, falloff: float = 0.0
) -> ComplexArray:
    """Light of one bounce over the direct light, for a share of 1 at full form factor.

    Parameters
    ----------
    surface, source : Surface
        Where the light arrives, and the rectangle from which it comes; the sides that face the camera.
    optics, shape
        Of the camera, at the origin with its lamp.
    turn_mm : float
        d_u, mm.
    falloff : float
        Power of the lamp's light at each point of the rectangle over that at the point where the light arrives, both by
        the square of the distance and the cosine of incidence: 0 for a source that is lit as the point is.

    Returns
    -------
    (pixel,) complex128
        Sum over the rectangle of form factor times exp(i pi extra path / d_u), times the lamp's part; 0 for a point
        that does not face it.

    References
    ----------
    Siegel and Howell, Thermal Radiation Heat Transfer: the form factor of a point is the integral of cosines over solid
    angle, divided by pi.
    """
    beams = beam_directions_of(optics, shape).reshape(-1, 3)
    facing, away = _towards_camera(surface), _towards_camera(source)
    origin = np.array(source.center_mm)
    points, use = _points(surface, facing, beams)
    use &= (points - origin) @ away > _LEAST_MM
    corners = _clipped(_corners(source), facing, np.array(surface.center_mm))
    out = np.zeros(len(beams), dtype=np.complex128)
    if use.any() and len(corners):
        out[use] = _integral(points[use], facing, away, corners, turn_mm, falloff)
    out.setflags(write=False)
    return out


def sees(surface: Surface, source: Surface) -> bool:
    """Whether light of one bounce from a rectangle can reach a point of a surface at all."""
    there = _clipped(_corners(source), _towards_camera(surface), np.array(surface.center_mm))
    here = _clipped(_corners(surface), _towards_camera(source), np.array(source.center_mm))
    return bool(len(there) and len(here))


def _towards_camera(surface: Surface) -> FloatArray:
    normal = surface.rotation()[:, 2]
    return np.asarray(-normal if normal @ np.array(surface.center_mm) > 0 else normal)


def _corners(surface: Surface) -> FloatArray:
    """Corners (4, 3) of the rectangle in order, mm."""
    u, v = surface.rotation()[:, :2].T * 0.5 * np.array(surface.size_mm)[:, None]
    return np.asarray(np.array(surface.center_mm) + np.array([-u - v, u - v, u + v, v - u]))


def _clipped(corners: FloatArray, normal: FloatArray, point: FloatArray) -> FloatArray:
    """The part (n, 3) of a convex polygon that is before a plane; Sutherland and Hodgman, for one plane."""
    above = (corners - point) @ normal
    out = []
    for k, (a, b) in enumerate(zip(above, np.roll(above, -1), strict=True)):
        here, there = corners[k], corners[(k + 1) % len(corners)]
        if a > _LEAST_MM:
            out.append(here)
        if (a > _LEAST_MM) != (b > _LEAST_MM):
            out.append(here + (there - here) * (a / (a - b)))
    return np.array(out).reshape(-1, 3)


def _points(surface: Surface, facing: FloatArray, beams: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Where beams (pixel, 3) meet a surface's plane, mm, and which (pixel,) do so on it or a little beside it."""
    center = np.array(surface.center_mm)
    along = beams @ facing
    ahead = along < -_PARALLEL
    points = beams * (facing @ center / np.where(ahead, along, -1.0))[:, None]
    local = np.abs((points - center) @ surface.rotation()[:, :2])
    # also pixels whose centre is a little beside the surface see it
    return points, ahead & (local <= 0.5 * 1.5 * np.array(surface.size_mm)).all(axis=1)


def _integral(
    points: FloatArray, facing: FloatArray, away: FloatArray, corners: FloatArray, turn_mm: float, falloff: float
) -> ComplexArray:
    """The sum (n,) for points (n, 3) of a plane with normal `facing`, from a polygon with normal `away`."""
    axis = np.cross(facing, away)
    length = float(np.linalg.norm(axis))
    axis = axis / length if length > _PARALLEL else _any_across(facing)
    across, up = np.cross(axis, away), np.cross(facing, axis)  # in the polygon's plane; in the surface's
    origin = corners.mean(axis=0)
    ends = np.stack([(corners - origin) @ across, (corners - origin) @ axis], axis=1)
    low, high = float(ends[:, 0].min()), float(ends[:, 0].max())
    if high - low < _LEAST_MM:
        return np.zeros(len(points), dtype=np.complex128)
    node, weight = np.polynomial.legendre.leggauss(9)  # right to 0.5 % in a room, lit by the lamp
    angles = [_angle(origin + s * across - points, facing, up) for s in (low, high)]
    first, last = np.minimum(*angles)[:, None], np.maximum(*angles)[:, None]
    psi = 0.5 * (last + first) + 0.5 * (last - first) * node
    by_psi = 0.5 * (last - first) * weight * np.sin(psi)
    # a half plane at psi meets the polygon's plane at this distance from the axis through the point
    sine, cosine = np.sin(psi), np.cos(psi)
    towards = sine * float(away @ facing) + cosine * float(away @ up)
    before = ((points - origin) @ away)[:, None]
    rho = before / np.maximum(-towards, _PARALLEL)
    s = ((points - origin) @ across)[:, None] + rho * (sine * float(facing @ across) + cosine * float(up @ across))
    begin, end = _chord(ends, np.clip(s, low, high))
    at = ((points - origin) @ axis)[:, None]
    bottom, top = np.arctan2(begin - at, rho), np.arctan2(end - at, rho)
    half = 0.5 * (top - bottom)[..., None]
    phi = 0.5 * (top + bottom)[..., None] + half * node
    way = rho[..., None] / np.cos(phi)
    direct = np.linalg.norm(points, axis=1)[:, None, None]
    along = rho[..., None] * np.tan(phi)
    height, aside = (points @ facing)[:, None] + rho * sine, (points @ up)[:, None] + rho * cosine
    lamp = np.sqrt((height**2 + aside**2)[..., None] + ((points @ axis)[:, None, None] + along) ** 2)
    phase = (math.pi / turn_mm) * (lamp + way - direct)
    light = half * weight * np.cos(phi) ** 2 * np.exp(1j * phase)
    if falloff:
        there, here = abs(float(origin @ away)) / lamp**3, np.abs(points @ facing)[:, None, None] / direct**3
        light = light * (there / here) ** falloff
    light = light.sum(axis=2)
    return np.asarray((by_psi * light).sum(axis=1) / math.pi)


def _angle(vectors: FloatArray, facing: FloatArray, up: FloatArray) -> FloatArray:
    """Angle (n,) of vectors (n, 3) about the axis, from the surface's plane towards its normal."""
    return np.asarray(np.arctan2(np.maximum(vectors @ facing, 0.0), vectors @ up))


def _any_across(normal: FloatArray) -> FloatArray:
    """A unit vector across a normal."""
    other = np.eye(3)[int(np.argmin(np.abs(normal)))]
    across = np.cross(normal, other)
    return np.asarray(across / np.linalg.norm(across))


def _chord(ends: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest second coordinate of a convex polygon (n, 2) at first coordinates s of any shape."""
    begin, end = np.full(s.shape, np.inf), np.full(s.shape, -np.inf)
    for (s0, t0), (s1, t1) in zip(ends, np.roll(ends, -1, axis=0), strict=True):
        low, high = min(s0, s1), max(s0, s1)
        inside = (s >= low) & (s <= high)
        part = (s - s0) / (s1 - s0) if abs(s1 - s0) > _LEAST_MM else np.zeros(s.shape)
        t = t0 + part * (t1 - t0)
        ends_ = (t, t) if abs(s1 - s0) > _LEAST_MM else (np.full(s.shape, min(t0, t1)), np.full(s.shape, max(t0, t1)))
        begin = np.where(inside, np.minimum(begin, ends_[0]), begin)
        end = np.where(inside, np.maximum(end, ends_[1]), end)
    return begin, end
