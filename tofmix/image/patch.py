"""A patch of a smooth surface around a place: least squares through the ranges of the pixels there.

In a frame with the normal n and the tangents e1 and e2, the height h over (u, v) obeys

    2 h = 2 (a + b u + c v) + k11 u^2 + 2 k12 u v + k22 v^2 + 2 h (p u + q v) + (g + e) h^2,

    g = tr(K^2) tr(K) / max(tr(K)^2, tr(K^2)),

a quadric, which rays meet in closed form. With p = q = e = 0 it is exact for planes, spheres and cylinders; an
ellipsoid's are about as large as its curvatures. The curvatures have the prior N(0, bend^2); p, q and e that of `_SKEW`
and `_CONIC` times their size. Cubic terms are integrated out: they are errors that neighbours share. Four have the
standard deviation `third`, or twice the square of the curvatures where that is more. In the evidence of scales, where
p, q and e are left out, two others stand for the latter, x'Kx (Kx)_i / 2: a quadric's, some 2/3 away from its vertex in
slope. They bend a cylinder across, not along its axis, so a straight axis does not speak against curvature.
A polynomial of 1 / r is no such model: at the limb of a round thing 1 / r has the singularity of a square root.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.compiled.plane import dot
from tofmix.image.segments import View

BENT = 6
"""Numbers of a patch up to its curvatures: a, b, c, k11, k12, k22."""
STATE = BENT + 3
"""Numbers of a patch: those, and p, q, e."""

_HEIGHT_MM, _SLOPE = 1e4, 2.0  # standard deviations of a, and of b and c, which pixels in one line leave open
_SKEW, _CONIC = 0.5, 1.0
"""Standard deviations of p and q, and of e, in units of the size of the curvatures."""
THIRD_OF_BEND = 2.0
"""Least third derivative in units of the square of the curvatures: what a bent thing bends otherwise."""
_SLOPE_OF_QUADRIC = THIRD_OF_BEND / 3.0
"""Standard deviation of the slope, away from its vertex, at which a quadric has that third derivative."""
DIRECTIONS = 8
_ALONG = 0.05
"""Ways in which a thing may bend in one direction, and its bend along its axis, as a part of that across."""
LOG_WAYS = np.log(np.array([0.5, *np.full(DIRECTIONS, 0.5 / DIRECTIONS)]))
"""Log prior of bending in all directions alike, and in each one."""

_SAMPLES, LEAST_HITS = 40, 10
"""Draws of a patch, and the fewest of them that a ray must meet."""

_GAUSS = np.array([-np.sqrt(0.15), 0.0, np.sqrt(0.15)])
PLACES_9 = np.array([(y, x) for y in _GAUSS for x in _GAUSS])
"""Places of Gauss-Legendre's rule over a pixel (9, 2), and their weights."""
WEIGHTS_9 = np.outer(np.array([5.0, 8.0, 5.0]) / 18.0, np.array([5.0, 8.0, 5.0]) / 18.0).ravel()


class TangentFrame(NamedTuple):
    """Frames (n, 3) of patches, mm: origin, tangents, normal."""

    origin: FloatArray
    e1: FloatArray
    e2: FloatArray
    normal: FloatArray


class Patches(NamedTuple):
    """Fitted patches.

    Parameters
    ----------
    frame : Frame
        Their frames.
    state : (n, 9) float64
        a (mm), b, c, k11, k12, k22, p, q, e (1 / mm).
    covariance : (n, 9, 9) float64
        Its covariance, by the scatter of the members.
    members, kept : (n, place) int64, bool
        The pixels, and which of them are no outliers and there.
    third : (n,) float64
        Standard deviation of the cubic terms, 1 / mm^2.
    log_evidence : (n,) float64
        Log density of the members' heights over their frame, nat; all members count.
    log_ways : (n, 1 + DIRECTIONS) float64
        Those of patches that bend in all directions alike, and in one.
    log_slope : (n,) float64
        What turns it into that of their ranges: the sum of the logarithms of a height's change with the range. Patches
        whose frames differ are compared with it.
    """

    frame: TangentFrame
    state: FloatArray
    covariance: FloatArray
    members: IntArray
    kept: BoolArray
    third: FloatArray
    log_evidence: FloatArray
    log_ways: FloatArray
    log_slope: FloatArray

    def some(self, which: IntArray) -> "Patches":
        """Some of the patches, perhaps several times."""
        return Patches(
            TangentFrame(*(part[which] for part in self.frame)),
            self.state[which],
            self.covariance[which],
            self.members[which],
            self.kept[which],
            self.third[which],
            self.log_evidence[which],
            self.log_ways[which],
            self.log_slope[which],
        )


def bend_term(k11: FloatArray, k12: FloatArray, k22: FloatArray) -> FloatArray:
    """G of the curvatures."""
    trace, square = k11 + k22, k11 * k11 + 2.0 * k12 * k12 + k22 * k22
    return np.asarray(square * trace / np.maximum(np.maximum(trace * trace, square), 1e-30))


def meet(frame: TangentFrame, state: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where rays meet patches.

    Parameters
    ----------
    frame : Frame
        Of n patches.
    state : (n, sample, 9) float64
        States of each patch.
    rays : (n, ray, 3) float64
        Unit vectors from the camera.

    Returns
    -------
    range_mm, cosine : (n, sample, ray) float64
        Range along the ray, and the cosine of incidence; NaN where the ray misses.
    """
    n, samples = state.shape[:2]
    range_mm, cosine = np.empty((n, samples, rays.shape[1])), np.empty((n, samples, rays.shape[1]))
    origin, e1, e2, normal = (np.ascontiguousarray(part) for part in frame)
    _meet(origin, e1, e2, normal, np.ascontiguousarray(state), np.ascontiguousarray(rays), range_mm, cosine)
    return range_mm, cosine


def drawn_ranges(patches: Patches, rays: FloatArray) -> FloatArray:
    """Ranges (n, sample, ray), mm, at which rays (n, ray, 3) meet draws of patches; NaN where they miss.

    The normal numbers of the draws are the same in each run, each with its negative.
    """
    half = np.random.default_rng(0).standard_normal((_SAMPLES // 2, STATE))
    spread = np.linalg.cholesky(_steadied(patches.covariance))
    state = patches.state[:, np.newaxis] + np.einsum("nij,sj->nsi", spread, np.concatenate([half, -half]))
    return meet(patches.frame, state, rays)[0]


def _steadied(covariance: FloatArray) -> FloatArray:
    size = covariance.shape[-1]
    out = covariance.copy()
    out[:, range(size), range(size)] *= 1.0 + 1e-6
    out[:, range(size), range(size)] += 1e-30
    return out


@jit
def _meet(
    origin: FloatArray,
    e1: FloatArray,
    e2: FloatArray,
    normal: FloatArray,
    state: FloatArray,
    rays: FloatArray,
    range_mm: FloatArray,
    cosine: FloatArray,
) -> None:
    """Fill ranges and cosines (n, sample, ray), as `meet` gives them."""
    conic = np.empty(state.shape[1])
    for i in range(len(origin)):
        for s in range(state.shape[1]):
            k11, k12, k22 = state[i, s, 3], state[i, s, 4], state[i, s, 5]
            trace, square = k11 + k22, k11 * k11 + 2.0 * k12 * k12 + k22 * k22
            conic[s] = square * trace / max(trace * trace, square, 1e-30) + state[i, s, 8]
        u0, v0, h0 = dot(origin[i], e1[i]), dot(origin[i], e2[i]), dot(origin[i], normal[i])
        for j in range(rays.shape[1]):
            du, dv, dh = dot(rays[i, j], e1[i]), dot(rays[i, j], e2[i]), dot(rays[i, j], normal[i])
            for s in range(state.shape[1]):
                a, b, c = state[i, s, 0], state[i, s, 1], state[i, s, 2]
                k11, k12, k22 = state[i, s, 3], state[i, s, 4], state[i, s, 5]
                p, q, g = state[i, s, 6], state[i, s, 7], conic[s]
                skew, skew_0 = p * du + q * dv, p * u0 + q * v0
                alpha = -0.5 * (g * dh * dh + k11 * du * du + 2.0 * k12 * du * dv + k22 * dv * dv) - dh * skew
                beta = (
                    dh
                    + g * dh * h0
                    - b * du
                    - c * dv
                    + k11 * du * u0
                    + k12 * (du * v0 + dv * u0)
                    + k22 * dv * v0
                    + dh * skew_0
                    + h0 * skew
                )
                gamma = (
                    -h0
                    - 0.5 * g * h0 * h0
                    - h0 * skew_0
                    - a
                    + b * u0
                    + c * v0
                    - 0.5 * (k11 * u0 * u0 + 2.0 * k12 * u0 * v0 + k22 * v0 * v0)
                )
                below = beta * beta - 4.0 * alpha * gamma
                root = math.sqrt(below) if below >= 0.0 else math.nan
                t = 2.0 * gamma / (root - beta) if root != beta else math.nan
                if not t > 0.0:
                    range_mm[i, s, j], cosine[i, s, j] = math.nan, math.nan
                    continue
                u, v, h = t * du - u0, t * dv - v0, t * dh - h0
                across, down = b + k11 * u + k12 * v + p * h, c + k12 * u + k22 * v + q * h
                up = 1.0 - g * h - p * u - q * v
                range_mm[i, s, j] = t
                cosine[i, s, j] = root / math.sqrt(up * up + across * across + down * down)


def fit_patches(
    view: View,
    at: IntArray,
    members: IntArray,
    bend: FloatArray,
    third: FloatArray,
    *,
    robust: bool = True,
    third_of_bend: float = THIRD_OF_BEND,
    quadric: bool = False,
) -> Patches:
    """Fit a patch through members of one surface each.

    Parameters
    ----------
    view : View
        The image.
    at : (n,) int64
        Pixels in question: the patch is expanded at the members nearest to them.
    members : (n, place) int64
        Pixels of the surface; -1 for none. At least six each.
    bend, third : (n,) float64
        Standard deviations of curvatures (1 / mm) and of cubic terms (1 / mm^2).
    robust : bool
        Whether members far from the patch are left out.
    third_of_bend : float
        Least cubic terms in units of the square of the curvatures. With 0 `third` is taken as it is: for evidence,
        where shapes that are bent and nothing else are among those that are compared.
    quadric : bool
        Whether curvatures alone give the cubic terms of a quadric, not those of any surface.

    Returns
    -------
    Patches
        The patches.
    """
    there = members >= 0
    pixel = np.where(there, members, 0)
    cols = view.shape[1]
    away = np.hypot(pixel // cols - (at // cols)[:, np.newaxis], pixel % cols - (at % cols)[:, np.newaxis])
    rank = np.argsort(np.argsort(np.where(there, away, np.inf), axis=1, kind="stable"), axis=1, kind="stable")
    ray, range_mm = view.direction[pixel], view.range_mm[pixel]
    noise = view.range_variance[pixel]
    first = 10  # nearest members, through which the first plane goes
    middle = 3  # nearest members, in whose middle the origin lies
    normal, origin = _first_plane(ray * range_mm[..., np.newaxis], there & (rank < first), there & (rank < middle))
    n, places = members.shape
    averaged, keep, state = np.zeros((n, places)), there.copy(), np.zeros((n, STATE))
    inner = view.rays(pixel, PLACES_9).reshape(n, places * len(PLACES_9), 3)
    e1 = e2 = normal
    least_bend = 1e-7  # 1 / mm, so that the prior of a plane is finite
    rounds = 3  # of least squares: the frame is tilted to the patch between two
    for number in range(rounds):
        if number:
            tilted = normal - state[:, 1:2] * e1 - state[:, 2:3] * e2
            origin = origin + state[:, :1] * normal
            normal = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
        e1, e2 = _tangents(normal)
        frame = TangentFrame(origin, e1, e2, normal)
        bent = state[:, 3:BENT] if number else np.zeros((n, 3))
        least = third_of_bend * (bent**2 @ np.array([1.0, 2.0, 1.0]))
        cubed = np.maximum(third, 0.0) if quadric else np.maximum(third, least)
        design, cubic, value, variance, steep = _equations(
            frame, ray, range_mm - averaged, noise, bent, cubed, _SLOPE_OF_QUADRIC * quadric
        )
        prior = np.full((n, STATE), [0.0, _SLOPE**-2, _SLOPE**-2, *np.zeros(STATE - 3)])
        prior[:, 3:BENT] = (1.0 / bend**2)[:, np.newaxis]
        size = np.sqrt(bent**2 @ np.array([1.0, 2.0, 1.0]) + least_bend**2)[:, np.newaxis]
        prior[:, BENT:] = 1.0 / (np.array([_SKEW, _SKEW, _CONIC]) * size) ** 2
        state, covariance, residual = _solved(design, cubic, value, keep / variance, prior)
        residual = residual / np.sqrt(variance)
        if robust and number:
            keep = _without_outliers(residual, there)
        if number == rounds - 1:
            break
        averaged = _averaged(frame, state, inner, ray, range_mm)
    evidence, ways = _log_evidence(design[..., :BENT], cubic, value, variance, there, bend)
    chi = np.where(keep, residual**2, 0.0).sum(axis=1) / np.maximum(keep.sum(axis=1) - 4, 1)
    return Patches(
        frame,
        state,
        covariance * np.maximum(1.0, chi)[:, np.newaxis, np.newaxis],
        members,
        keep,
        cubed,
        evidence,
        ways,
        np.where(there, 0.5 * np.log(steep), 0.0).sum(axis=1),
    )


def _first_plane(points: FloatArray, few: BoolArray, fewest: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Normals (n, 3) towards the camera of planes through few of the points (n, place, 3), and the origins (n, 3)."""
    some = np.where(few[..., np.newaxis], points, 0.0)
    square = np.einsum("nki,nkj->nij", some, some)
    # Points in one line leave the plane's tilt about it open: the ridge chooses the one nearest to facing the camera.
    square += np.einsum("nii->n", square)[:, np.newaxis, np.newaxis] * 1e-9 * np.eye(3)
    m = np.linalg.solve(square, some.sum(axis=1)[..., np.newaxis])[..., 0]
    normal = -m / np.linalg.norm(m, axis=1, keepdims=True)
    part = fewest / np.maximum(fewest.sum(axis=1, keepdims=True), 1)
    origin = (points * part[..., np.newaxis]).sum(axis=1)
    facing = np.where((normal * origin).sum(axis=1) > 0, -1.0, 1.0)
    return normal * facing[:, np.newaxis], origin


def _tangents(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (n, 3) across each normal and each other."""
    e1 = np.cross(normal, [0.0, 1.0, 0.0])
    length = np.linalg.norm(e1, axis=1, keepdims=True)
    e1 = np.where(length > 0.1, e1 / np.maximum(length, 0.1), np.array([1.0, 0.0, 0.0]))  # noqa: PLR2004  any other axis
    e1 = e1 - normal * (e1 * normal).sum(axis=1, keepdims=True)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    return e1, np.cross(normal, e1)


def _equations(
    frame: TangentFrame,
    ray: FloatArray,
    range_mm: FloatArray,
    noise: FloatArray,
    bent: FloatArray,
    third: FloatArray,
    slope_of_quadric: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Design (n, place, 9), cubic terms (n, place, 4 or 6), values and variances (n, place).

    Last the squares (n, place) of the change of a height with the range.
    """
    x = range_mm[..., np.newaxis] * ray - frame.origin[:, np.newaxis]
    u, v, h = (np.matmul(x, part[:, :, np.newaxis])[..., 0] for part in frame[1:])
    du, dv, dh = (np.matmul(ray, part[:, :, np.newaxis])[..., 0] for part in frame[1:])
    k11, k12, k22 = (bent[:, i, np.newaxis] for i in range(3))
    g = bend_term(k11, k12, k22)
    ku, kv = k11 * u + k12 * v, k12 * u + k22 * v
    slope = dh * (1.0 - g * h) - du * ku - dv * kv
    quadric = 0.5 * slope_of_quadric * (u * ku + v * kv)
    other = third[:, np.newaxis]
    away = u * u + v * v + h * h
    remainder = 0.3  # part of the cubic terms' error that each pixel has on its own
    own = remainder**2 * (other**2 * away**3 / 36.0 + quadric**2 * (ku * ku + kv * kv))
    steepest = 1.0e-4  # least square of the cosine of incidence by which noise counts
    steep = np.maximum(slope**2, steepest)
    variance = steep * noise + own
    terms = [other * u**3 / 6.0, other * u * u * v / 2.0, other * u * v * v / 2.0, other * v**3 / 6.0]
    cubic = np.stack([*terms, quadric * ku, quadric * kv] if slope_of_quadric else terms, axis=-1)
    design = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v, h * u, h * v, 0.5 * h * h], axis=-1)
    return design, cubic, h - 0.5 * g * h * h, variance, steep


def _solved(
    design: FloatArray, cubic: FloatArray, value: FloatArray, weight: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """States (n, 9), their covariances, and residuals (n, place) less the cubic terms' part."""
    weighed = cubic * weight[..., np.newaxis]
    turned = np.swapaxes(weighed, 1, 2)
    inner = np.linalg.inv(np.eye(cubic.shape[-1]) + turned @ cubic)
    through = design * weight[..., np.newaxis] - weighed @ (inner @ (turned @ design))
    normal = np.swapaxes(design, 1, 2) @ through
    normal[:, range(STATE), range(STATE)] += prior
    covariance = scaled_inverse(normal)
    state = (covariance @ (np.swapaxes(through, 1, 2) @ value[..., np.newaxis]))[..., 0]
    residual = value - (design @ state[..., np.newaxis])[..., 0]
    residual = residual - (cubic @ (inner @ (turned @ residual[..., np.newaxis])))[..., 0]
    return state, covariance, residual


def scaled_inverse(matrix: FloatArray) -> FloatArray:
    """Inverses of positive matrices (n, k, k) whose numbers have different units."""
    size = matrix.shape[-1]
    scale = 1.0 / np.sqrt(np.maximum(matrix[:, range(size), range(size)], np.finfo(float).tiny))
    scale = scale[:, :, np.newaxis] * scale[:, np.newaxis, :]
    return np.asarray(np.linalg.inv(matrix * scale + 1.0e-12 * np.eye(size)) * scale)


def _without_outliers(residual: FloatArray, there: BoolArray) -> BoolArray:
    """Members within 4.5 standard errors; where too few are, the better two thirds."""
    size = np.where(there, np.abs(residual), np.inf)
    farthest = 4.5  # standard errors
    keep = size < farthest
    count = there.sum(axis=1)
    least = np.maximum(BENT, 2 * count // 3)[:, np.newaxis]
    rank = np.argsort(np.argsort(size, axis=1, kind="stable"), axis=1, kind="stable")
    few = (keep.sum(axis=1) < np.maximum(BENT, count // 2))[:, np.newaxis]
    return np.where(few, (rank < least) & there, keep)


def _averaged(
    frame: TangentFrame, state: FloatArray, inner: FloatArray, ray: FloatArray, range_mm: FloatArray
) -> FloatArray:
    """Difference (n, place) between the mean range over a pixel and that in its middle, as light weighs it."""
    n, places = range_mm.shape
    t, cosine = (part.reshape(n, places, -1) for part in meet(frame, state[:, np.newaxis], inner))
    seen = np.isfinite(t)
    light = np.where(seen, WEIGHTS_9 * cosine / np.where(seen, t, 1.0) ** 2, 0.0)
    middle = meet(frame, state[:, np.newaxis], ray)[0][:, 0]
    total = light.sum(axis=-1)
    mean = (light * np.where(seen, t, 0.0)).sum(axis=-1) / np.maximum(total, 1e-30)
    difference = np.where(np.isfinite(middle) & (total > 0), mean - middle, 0.0)
    most_averaged = 0.02  # largest difference, as a part of the range, between a pixel's mean and its middle
    return np.clip(difference, -most_averaged * range_mm, most_averaged * range_mm)


def _log_evidence(
    design: FloatArray, cubic: FloatArray, value: FloatArray, variance: FloatArray, there: BoolArray, bend: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Log densities (n,) of values with the prior of the state, and the cubic terms, integrated out; and by the way.

    A thing bends in all directions alike, or in one of `DIRECTIONS`, as a cylinder does: as probable. With the first
    alone a cylinder would pay for bending along its axis, which its pixels exclude, more than its bend explains.
    """
    shared = np.concatenate([cubic, design], axis=-1)
    weight = there / variance
    turned = np.swapaxes(shared * weight[..., np.newaxis], 1, 2)
    square, seen = turned @ shared, turned @ value[..., np.newaxis]
    constant = np.where(there, np.log(variance), 0.0).sum(axis=1) + (weight * value**2).sum(axis=1)
    logs = []
    for factor in _prior_factors(cubic.shape[-1], bend):
        across = np.swapaxes(factor, 1, 2)
        inside = np.eye(factor.shape[-1]) + across @ square @ factor
        own = across @ seen
        explained = (own * np.linalg.solve(inside, own))[..., 0].sum(axis=1)
        logs.append(-0.5 * (np.linalg.slogdet(inside)[1] + constant - explained))
    ways = np.stack(logs, axis=1)
    return np.asarray(np.logaddexp.reduce(ways + LOG_WAYS, axis=1)), ways


def _prior_factors(cubic: int, bend: FloatArray) -> list[FloatArray]:
    """Square roots (n, cubic + 6, m) of the prior covariances of cubic terms and state, by the way a thing bends."""
    rest = np.broadcast_to(np.eye(cubic + BENT), (len(bend), cubic + BENT, cubic + BENT)).copy()
    rest[:, cubic, cubic] = _HEIGHT_MM
    rest[:, [cubic + 1, cubic + 2], [cubic + 1, cubic + 2]] = _SLOPE
    last = np.arange(cubic + 3, cubic + BENT)
    rest[:, last, last] = bend[:, np.newaxis]
    factors = [rest]
    for angle in np.arange(DIRECTIONS) * math.pi / DIRECTIONS:
        x, y = math.cos(angle), math.sin(angle)
        one = np.concatenate([rest, np.zeros((len(bend), cubic + BENT, 1))], axis=-1)
        one[:, last, last] *= _ALONG
        one[:, last, -1] = np.array([x * x, x * y, y * y]) * bend[:, np.newaxis]
        factors.append(one)
    return factors
