"""Hypotheses for the mean phasor of a pixel beside smooth surfaces that bend: one, or two of them. Bayes' rule.

Where a surface goes on in a pixel is known with an error that grows with distance and curvature. So each surface is 64
draws of its patch and light, and each draw is seen at 64 places of the pixel:

- ONE: a surface fills the pixel.
- LIMB: the rays of a part of the pixel miss the nearer surface, which ends there by itself. The share of hits and the
  return go together, draw by draw.
- CUT: an edge that is no limb; the share is uniform, on the surface's own side.
- LIMB and CUT before open space: one surface with the share of light that comes back.
- EMPTY: open space fills the pixel, and noise gave samples.
- UNSEEN: a surface shares the pixel with one that no pixel nearby sees alone.
- NEW: none of these. The phasor is uniform in the disc of the image's amplitudes.

Each share is one Gaussian of share, amplitudes and ranges, which the mean phasor updates; their evidence adds up.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.light import STATES, Lit, with_light
from tofmix.image.patch import STATE, fit_patches, meet
from tofmix.image.scales import Scales
from tofmix.image.segments import LEAST_PIXELS, REACH, View, grid_of_places, lattice_of_places, members_around
from tofmix.unmixing.chords import unseen_log_density
from tofmix.unmixing.image import ComplexArray, PhasorImage
from tofmix.unmixing.likeliest import OpenSpace


class Bent(IntEnum):
    """Kind of a hypothesis."""

    NEW = 0
    ONE = 1
    LIMB = 2
    CUT = 3
    EMPTY = 4
    UNSEEN = 5


PRIORS = {
    Bent.NEW: 0.01,
    Bent.ONE: 0.5,
    Bent.LIMB: 0.2,
    Bent.CUT: 0.25,
    Bent.EMPTY: 0.5,
    Bent.UNSEEN: 0.01,
}
"""Prior probabilities; that of one surface, and of one beside an unseen one, is shared by those nearby.

Of the pairs, one in 50 has a surface that no pixel within two sees alone: none beside spheres and columns, 0.05 at a
person's neck, 0.1 beside fingers.
"""

_PARTS = 64
_PLACES = lattice_of_places(_PARTS, 27)
_COARSE = grid_of_places(3)
"""Parts of a pixel beside one surface alone: the mean over it needs no more."""
_DRAWS = 64  # of each surface
_ALL = 0.995  # share of the parts that counts as all
_SOME = 0.01  # and as some
_LEAST_DRAWS, _LEAST_LIMBS, _LEAST_CUTS = 6, 4, _DRAWS // 4
_ANY = 0.03  # part of a limb's shares that no draw has
_FAR, _NEAR = 4.0, 0.25  # of the range in the middle: a patch is not continued farther
_BLOCK = 48  # pairs at once: some 50 MB


class Verdicts(NamedTuple):
    """The most probable hypothesis of pixels (n,).

    Parameters
    ----------
    kind : int64
        `Bent`.
    probability : float64
        That of the kind, or of a pair: of its two surfaces.
    one : int64
        ONE: the segment.
    pair : (n, 2) int64
        LIMB and CUT: both segments, the nearer first; -1 for open space behind it.
    mean, covariance : (n, 5), (n, 5, 5) float64
        LIMB and CUT: share of the nearer, then logarithm of the amplitude and range of the nearer and the farther;
        those of open space are 0.
    chord : complex128
        LIMB and CUT: difference of both phasors.
    log_density : float64
        Log density of the mean phasor, nat.
    """

    kind: IntArray
    probability: FloatArray
    one: IntArray
    pair: IntArray
    mean: FloatArray
    covariance: FloatArray
    chord: ComplexArray
    log_density: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Draws of surfaces seen through the parts of pixels; arrays are (item, draw, part) or (item, draw)."""

    hit: BoolArray
    range_mm: FloatArray
    phasor: ComplexArray
    log_cosine: FloatArray
    level: FloatArray
    gamma: FloatArray
    usable: BoolArray

    @property
    def share(self) -> FloatArray:
        """Share of the parts that are hit."""
        return np.asarray(self.hit.mean(axis=2))


def judge_bent(
    image: PhasorImage,
    view: View,
    segment: IntArray,
    pixels: IntArray,
    scales: Scales,
    apart: float,
    space: OpenSpace | None = None,
) -> Verdicts:
    """Find the most probable hypothesis of each pixel.

    Parameters
    ----------
    image, view
        The window.
    segment : (pixel,) int64
        Segment of each pixel; -1 for none.
    pixels : (n,) int64
        The pixels in question; they count for no segment here.
    scales : Scales
        Of the segments.
    apart : float
        Part of the range below which two surfaces in a pixel are one: so they are where two parts of a thing meet.
    space : OpenSpace, optional
        The return of open space, which may lie behind any surface.
    """
    owner, number = _items(view, segment, pixels)
    largest = 1.5 * float(np.quantile(image.amplitude[image.valid], 0.999))
    best = _Best(len(pixels), math.log(PRIORS[Bent.NEW]) - math.log(math.pi * largest**2), apart)
    if space is not None:
        best.empty = math.log(PRIORS[Bent.EMPTY]) + space.log_density(image, pixels)
    if not owner.size:
        return best.verdicts()
    at = pixels[owner]
    members = members_around(view.shape, segment, at, number, REACH)
    patches = fit_patches(view, at, members, scales.bend[number], scales.third[number])
    patches = patches._replace(covariance=patches.covariance * scales.inflation[number][:, np.newaxis, np.newaxis])
    lit = with_light(view, at, patches)
    count = np.bincount(owner, minlength=len(pixels))[owner]
    log_prior = math.log(PRIORS[Bent.ONE]) - np.log(count)
    beside_open = np.zeros(len(at), np.bool_) if space is None else space.nearby[at]
    alone, several = np.flatnonzero((count == 1) & ~beside_open), np.flatnonzero((count > 1) | beside_open)
    seen = _see(view, at[alone], _some(lit, alone), _COARSE)
    log = _one(seen, _totals(seen, view), image.phasor[at[alone]], _matrix(image.mean_covariance[at[alone]]), view)
    best.put_one(owner[alone], number[alone], log_prior[alone] + log)
    owner, number, at, lit, log_prior = (
        owner[several],
        number[several],
        at[several],
        _some(lit, several),
        log_prior[several],
    )
    side = _middle(view, at, members[several])
    seen = _see(view, at, lit, _PLACES)
    totals = _totals(seen, view)
    phasor, noise = image.phasor[at], _matrix(image.mean_covariance[at])
    best.put_one(owner, number, log_prior + _one(seen, totals, phasor, noise, view))
    log_share = math.log(PRIORS[Bent.UNSEEN] / PRIORS[Bent.ONE])
    best.put_unseen(owner, log_prior + log_share + _beside_unseen(seen, totals, phasor, noise, largest, view))
    first, second = _pairs(owner, seen)
    for start in range(0, first.size, _BLOCK):
        a, b = first[start : start + _BLOCK], second[start : start + _BLOCK]
        order = _order(side[a] - side[b])
        far = _far(seen, totals, b, order, view)
        for kind in (Bent.LIMB, Bent.CUT):
            found = _pair(_ends(seen, totals, a, order, kind, view), far, phasor[a], noise[a], view)
            best.put_pair(owner[a], np.stack([number[a], number[b]], axis=1), kind, math.log(PRIORS[kind]), found)
    if space is not None:
        ends = np.flatnonzero(space.nearby[at] & seen.usable & seen.hit.any(axis=(1, 2)))
        for start in range(0, ends.size, _BLOCK):
            a = ends[start : start + _BLOCK]
            order = _order(side[a])
            for kind in (Bent.LIMB, Bent.CUT):
                found = _pair(_ends(seen, totals, a, order, kind, view), space, phasor[a], noise[a], view)
                pair = np.stack([number[a], np.full(a.size, -1)], axis=1)
                best.put_pair(owner[a], pair, kind, math.log(PRIORS[kind]), found)
    return best.verdicts()


def _items(view: View, segment: IntArray, pixels: IntArray) -> tuple[IntArray, IntArray]:
    """Pixel (by its place among the pixels) and segment of each surface beside a pixel."""
    rows, cols = view.shape
    steps = np.arange(-REACH, REACH + 1)
    down, right = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    row, col = (pixels // cols)[:, np.newaxis] + down, (pixels % cols)[:, np.newaxis] + right
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols) & ((down != 0) | (right != 0))
    found = np.where(inside, segment[np.where(inside, row * cols + col, 0)], -1)
    nearest = 2  # pixels, within which a surface must have one
    close = np.maximum(np.abs(down), np.abs(right)) <= nearest
    owners, numbers = [], []
    for place in range(len(pixels)):
        for number in np.unique(found[place]).tolist():
            if number >= 0 and (found[place] == number).sum() >= LEAST_PIXELS and (found[place][close] == number).any():
                owners.append(place)
                numbers.append(number)
    return np.array(owners, dtype=np.int64), np.array(numbers, dtype=np.int64)


def _middle(view: View, at: IntArray, members: IntArray) -> FloatArray:
    """Middle (n, 2) of the members around pixels, down and right, the nearest most."""
    cols = view.shape[1]
    there = members >= 0
    down = np.where(there, members // cols - (at // cols)[:, np.newaxis], 0)
    right = np.where(there, members % cols - (at % cols)[:, np.newaxis], 0)
    weight = np.where(there, np.exp(-(down**2 + right**2) / 4.0), 0.0)
    sums = np.stack([(weight * down).sum(axis=1), (weight * right).sum(axis=1)], axis=1)
    return np.asarray(sums / np.maximum(weight.sum(axis=1, keepdims=True), 1e-30))


def _student(count: int) -> FloatArray:
    """Numbers (count, STATES) of the draws, each with its negative: the same in each run.

    Student's t of four degrees of freedom, of unit variance: how far a surface goes on as it bends is known only
    by its own pixels, so a limb may lie farther away than Gaussian errors say.
    """
    draw = np.random.default_rng(0)
    normal = draw.standard_normal((count // 2, STATES))
    size = 1.0 / draw.chisquare(4, (count // 2, 1))  # degrees of freedom: tails of a fit to a few pixels
    normal *= np.sqrt(size / size.mean())
    return np.concatenate([normal, -normal])


_NORMAL = _student(_DRAWS)


def _some(lit: Lit, which: IntArray) -> Lit:
    return Lit(lit.patches.some(which), lit.state[which], lit.covariance[which], lit.fitted[which])


def _see(view: View, at: IntArray, lit: Lit, places: FloatArray) -> _Seen:
    """Draw the surfaces, and see them through the parts of their pixels, whose middles are at `places`."""
    state, covariance = lit.state, np.where(lit.fitted[:, np.newaxis, np.newaxis], lit.covariance, np.eye(STATES))
    sd = np.sqrt(np.maximum(covariance[:, range(STATES), range(STATES)], 1e-300))
    relative = covariance / sd[:, :, np.newaxis] / sd[:, np.newaxis, :] + 1e-9 * np.eye(STATES)
    spread = np.linalg.cholesky(relative) * sd[:, :, np.newaxis]
    draws = state[:, np.newaxis] + np.einsum("nij,sj->nsi", spread, _NORMAL)
    frame = lit.patches.frame
    range_mm, cosine = meet(frame, draws[..., :STATE], view.rays(at, places))
    distance = np.linalg.norm(frame.origin, axis=1)[:, np.newaxis, np.newaxis]
    with np.errstate(invalid="ignore"):
        hit = np.isfinite(range_mm) & (range_mm < _FAR * distance) & (range_mm > _NEAR * distance)
    range_mm = np.where(hit, range_mm, 0.0)
    phasor = np.where(hit, cosine, 0.0) / np.where(hit, range_mm, 1.0) ** 2 * np.exp(1j * range_mm / view.scale_mm)
    return _Seen(
        hit=hit,
        range_mm=range_mm,
        phasor=phasor,
        log_cosine=np.where(hit, np.log(np.where(hit, cosine, 1.0) + 1e-6), 0.0),
        level=draws[..., STATE],
        gamma=draws[..., -1],
        usable=lit.fitted,
    )


class _Sums(NamedTuple):
    """Means over parts of pixels: logarithm of the amplitude, range of the phasor, mean range. Arrays (item, ...)."""

    light: FloatArray
    range_mm: FloatArray
    area_mm: FloatArray

    def some(self, which: IntArray) -> "_Sums":
        """Those of some items, perhaps several times."""
        return _Sums(self.light[which], self.range_mm[which], self.area_mm[which])


def _means(
    phasor: ComplexArray,
    range_mm: FloatArray,
    log_cosine: FloatArray,
    count: FloatArray,
    level: FloatArray,
    gamma: FloatArray,
    scale_mm: float,
) -> _Sums:
    """Means of sums over `count` parts."""
    whole = np.maximum(count, 1)
    area = range_mm / whole
    mean = phasor / whole
    with np.errstate(divide="ignore"):
        light = np.log(np.abs(mean)) + level + gamma * log_cosine / whole
    return _Sums(light, area + scale_mm * np.angle(mean * np.exp(-1j * area / scale_mm)), area)


def _totals(seen: _Seen, view: View) -> _Sums:
    """Means over all parts that are hit, (item, draw)."""
    return _means(
        seen.phasor.sum(axis=2),
        seen.range_mm.sum(axis=2),
        seen.log_cosine.sum(axis=2),
        seen.hit.sum(axis=2),
        seen.level,
        seen.gamma,
        view.scale_mm,
    )


def _moments(sums: _Sums, ok: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (n, 2) and covariance (n, 2, 2) of light and range over the draws that are ok, and the area's offset."""
    values = np.stack([np.where(ok, sums.light, 0.0), np.where(ok, sums.range_mm, 0.0)], axis=-1)
    count = np.maximum(ok.sum(axis=1), 1)
    mean = values.sum(axis=1) / count[:, np.newaxis]
    off = np.where(ok[..., np.newaxis], values - mean[:, np.newaxis], 0.0)
    covariance = np.swapaxes(off, 1, 2) @ off / np.maximum(count - 1, 1)[:, np.newaxis, np.newaxis]
    covariance = covariance + np.diag([1e-8, 1e-4])
    offset = np.where(ok, sums.area_mm - sums.range_mm, 0.0).sum(axis=1) / count
    return mean, covariance, offset


def _own(view: View) -> FloatArray:
    """Covariance (2, 2) of light and range that a pixel of a surface has on its own: texture and fixed pattern."""
    return np.diag([view.texture_variance, view.pattern_variance])


def _matrix(covariance: FloatArray) -> FloatArray:
    """Covariances (n, 2, 2) of (n, 3): both variances, then the covariance."""
    x, y, both = covariance[:, 0], covariance[:, 1], covariance[:, 2]
    return np.stack([np.stack([x, both], axis=-1), np.stack([both, y], axis=-1)], axis=1)


def _plane(values: ComplexArray) -> FloatArray:
    return np.stack([values.real, values.imag], axis=-1)


def _return(mean: FloatArray, scale_mm: float) -> tuple[ComplexArray, FloatArray]:
    """Phasors (...,) of light and range (..., 2), and the derivatives (..., 2, 2) of their parts."""
    z = np.exp(mean[..., 0] + 1j * mean[..., 1] / scale_mm)
    return z, np.stack([_plane(z), _plane(1j * z / scale_mm)], axis=-1)


def _log_normal(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Log density (...,) of errors (..., 2)."""
    determinant = np.maximum(covariance[..., 0, 0] * covariance[..., 1, 1] - covariance[..., 0, 1] ** 2, 1e-30)
    x, y = error[..., 0], error[..., 1]
    form = covariance[..., 1, 1] * x * x - 2.0 * covariance[..., 0, 1] * x * y + covariance[..., 0, 0] * y * y
    return np.asarray(-0.5 * form / determinant - 0.5 * np.log(determinant) - math.log(2.0 * math.pi))


def _one(seen: _Seen, totals: _Sums, phasor: ComplexArray, noise: FloatArray, view: View) -> FloatArray:
    """Log evidence (item,) of one surface that fills the pixel."""
    ok = seen.share > _ALL
    mean, covariance, _ = _moments(totals, ok)
    covariance = covariance + _own(view)
    z, slope = _return(mean, view.scale_mm)
    log = _log_normal(_plane(phasor - z), slope @ covariance @ np.swapaxes(slope, 1, 2) + noise)
    possible = (ok.sum(axis=1) >= _LEAST_DRAWS) & seen.usable
    return np.where(possible, log + np.log(ok.mean(axis=1) + 0.01), -np.inf)


def _beside_unseen(
    seen: _Seen, totals: _Sums, phasor: ComplexArray, noise: FloatArray, largest: float, view: View
) -> FloatArray:
    """Log evidence (item,) of one surface that shares the pixel with one that no pixel nearby sees alone."""
    ok = seen.share > 0.5  # noqa: PLR2004  half
    mean, covariance, _ = _moments(totals, ok)
    z, slope = _return(mean, view.scale_mm)
    error = np.trace(slope @ (covariance + _own(view)) @ np.swapaxes(slope, 1, 2) + noise, axis1=1, axis2=2)
    possible = (ok.sum(axis=1) >= _LEAST_DRAWS) & seen.usable
    return np.where(possible, unseen_log_density(phasor, z, error, largest), -np.inf)


def _pairs(owner: IntArray, seen: _Seen) -> tuple[IntArray, IntArray]:
    """Items of the nearer and the farther surface of all pairs."""
    hits = seen.hit.sum(axis=(1, 2))
    range_mm = seen.range_mm.sum(axis=(1, 2)) / np.maximum(hits, 1)
    possible = seen.usable & (hits > 0)
    first, second = [], []
    for place in range(len(owner)):
        for other in range(place + 1, len(owner)):
            if owner[other] != owner[place]:
                break
            if possible[place] and possible[other]:
                nearer = range_mm[place] < range_mm[other]
                first.append(place if nearer else other)
                second.append(other if nearer else place)
    return np.array(first, dtype=np.int64), np.array(second, dtype=np.int64)


class _Ends(NamedTuple):
    """The nearer surface, share by share: arrays (pair, bin), (pair, bin, 2), (pair, bin, 2, 2), and (pair,)."""

    share: FloatArray
    width: float
    mass: FloatArray
    mean: FloatArray
    covariance: FloatArray
    offset: FloatArray


def _order(way: FloatArray) -> IntArray:
    """Order (pair, part) of the parts of a pixel, the farthest first in the direction `way` (pair, 2)."""
    toward = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    return np.argsort(-(toward @ _PLACES.T + 1e-6 * _PLACES[:, 0]), axis=1, kind="stable")


def _ends(seen: _Seen, totals: _Sums, which: IntArray, order: IntArray, kind: Bent, view: View) -> _Ends:
    """What is seen of the nearer surface, share by share, under one kind of end."""
    return _limb(seen, totals, which) if kind is Bent.LIMB else _cut(seen, which, order, view)


def _limb(seen: _Seen, totals: _Sums, which: IntArray) -> _Ends:
    """The share of the parts that are hit, and what is seen of the surface for each share: a regression on it."""
    share = seen.share[which]
    ok = (share > _SOME) & (share < 1.0 - _SOME)
    sums = totals.some(which)
    count = ok.sum(axis=1)
    whole = np.maximum(count, 1)
    mean = np.where(ok, share, 0.0).sum(axis=1) / whole
    spread = np.sqrt(np.where(ok, (share - mean[:, np.newaxis]) ** 2, 0.0).sum(axis=1) / whole)
    degree = np.where((count > 12) & (spread > 0.06), 2, np.where(spread > 0.02, 1, 0))  # noqa: PLR2004  few, or alike
    powers = np.stack([np.ones_like(share), share, share**2], axis=-1)
    used = np.arange(3) <= degree[:, np.newaxis]
    design = np.where(ok[..., np.newaxis] & used[:, np.newaxis], powers, 0.0)
    values = np.stack([np.where(ok, sums.light, 0.0), np.where(ok, sums.range_mm, 0.0)], axis=-1)
    normal = np.swapaxes(design, 1, 2) @ design + np.where(used, 1e-9, 1.0)[:, :, np.newaxis] * np.eye(3)
    coefficients = np.linalg.solve(normal, np.swapaxes(design, 1, 2) @ values)
    residual = np.where(ok[..., np.newaxis], values - design @ coefficients, 0.0)
    free = np.maximum(count - degree - 1, 1)[:, np.newaxis, np.newaxis]
    scatter = np.swapaxes(residual, 1, 2) @ residual / free + np.diag([1e-4, 1.0])
    bins = np.linspace(_SOME, 1.0 - _SOME, 50)  # bins of the share
    width = float(bins[1] - bins[0])
    smooth = np.maximum(1.06 * spread * whole**-0.2, 0.02)[:, np.newaxis, np.newaxis]
    bumps = np.exp(-0.5 * ((bins[:, np.newaxis] - share[:, np.newaxis]) / smooth) ** 2) / smooth
    density = np.where(ok[:, np.newaxis], bumps, 0.0).sum(axis=2) / whole[:, np.newaxis] / math.sqrt(2.0 * math.pi)
    mass = (density * (1.0 - _ANY) + _ANY) * width * ok.mean(axis=1)[:, np.newaxis]
    low = np.maximum(np.where(ok, share, 1.0).min(axis=1) - 0.1, _SOME)[:, np.newaxis]
    high = np.minimum(np.where(ok, share, 0.0).max(axis=1) + 0.1, 1.0 - _SOME)[:, np.newaxis]
    inside = np.clip(bins, low, high)
    beyond = (bins - inside) ** 2
    at = np.stack([np.ones_like(inside), inside, inside**2], axis=-1)
    covariance = scatter[:, np.newaxis] + beyond[..., np.newaxis, np.newaxis] * np.diag([1.0, 1e4])
    offset = np.where(ok, sums.area_mm - sums.range_mm, 0.0).sum(axis=1) / whole
    mass = np.where((count >= _LEAST_LIMBS)[:, np.newaxis], mass, 0.0)
    return _Ends(np.broadcast_to(bins, mass.shape), width, mass, at @ coefficients, covariance, offset)


def _cut(seen: _Seen, which: IntArray, order: IntArray, view: View) -> _Ends:
    """Each share of the parts from the surface's own side on, as far as nearly all of them are hit."""
    hit, phasor, range_mm, log_cosine = (
        np.take_along_axis(part[which], order[:, np.newaxis], axis=2)
        for part in (seen.hit, seen.phasor, seen.range_mm, seen.log_cosine)
    )
    last = np.arange(1, _PARTS, 2)
    counts = hit.cumsum(axis=2)[..., last]
    sums = _means(
        phasor.cumsum(axis=2)[..., last],
        range_mm.cumsum(axis=2)[..., last],
        log_cosine.cumsum(axis=2)[..., last],
        counts,
        seen.level[which][..., np.newaxis],
        seen.gamma[which][..., np.newaxis],
        view.scale_mm,
    )
    ok = counts / (last + 1) > _ALL
    n, bins = len(which), len(last)
    flat = _Sums(*(np.swapaxes(part, 1, 2).reshape(n * bins, -1) for part in sums))
    fits = np.swapaxes(ok, 1, 2).reshape(n * bins, -1)
    mean, covariance, offset = _moments(flat, fits)
    share = seen.share[which]
    limb = ((share > _SOME) & (share < 1.0 - _SOME)).mean(axis=1)
    width = 2.0 / _PARTS
    mass = width * ok.mean(axis=1) * (1.02 - limb)[:, np.newaxis]
    mass = np.where(ok.sum(axis=1) >= _LEAST_CUTS, mass, 0.0)
    offsets = offset.reshape(n, bins)
    weight = mass / np.maximum(mass.sum(axis=1, keepdims=True), 1e-30)
    return _Ends(
        np.broadcast_to((last + 0.5) / _PARTS, (n, bins)),
        width,
        mass,
        mean.reshape(n, bins, 2),
        covariance.reshape(n, bins, 2, 2),
        (weight * offsets).sum(axis=1),
    )


class _Found(NamedTuple):
    """Log evidence (pair,), posterior mean (pair, 5) and covariance (pair, 5, 5), and chord (pair,)."""

    log: FloatArray
    mean: FloatArray
    covariance: FloatArray
    chord: ComplexArray


class _Far(NamedTuple):
    """The farther surface of pairs, whichever end the nearer one has.

    `mean` (pair, part, 2) is that of the parts that are left beyond each, `covariance` (pair, 2, 2) and `offset`
    (pair,) are those of a whole pixel, and `possible` (pair,) says whether the surface is there.
    """

    mean: FloatArray
    covariance: FloatArray
    offset: FloatArray
    possible: BoolArray

    def at(self, share: FloatArray) -> FloatArray:
        """Mean (pair, bin, 2) where the nearer surface takes a share (pair, bin)."""
        place = np.clip(np.rint(share * _PARTS).astype(np.int64), 0, _PARTS - 1)
        return np.take_along_axis(self.mean, place[..., np.newaxis], axis=1)


def _pair(ends: _Ends, far: "_Far | OpenSpace", phasor: ComplexArray, noise: FloatArray, view: View) -> _Found:
    """Evidence of pairs, and share, light and ranges of both surfaces, or of one before open space."""
    one, one_slope = _return(ends.mean, view.scale_mm)
    if isinstance(far, OpenSpace):
        far_mean, far_covariance = np.zeros_like(ends.mean), np.zeros((len(phasor), 2, 2))
        far_offset, far_possible = np.zeros(len(phasor)), np.ones(len(phasor), np.bool_)
        other, other_slope = np.full_like(one, far.phasor), np.zeros_like(one_slope)
        noise = noise + far.variance * np.eye(2)
    else:
        far_mean, far_offset, far_possible = far.at(ends.share), far.offset, far.possible
        far_covariance = far.covariance + _own(view)
        other, other_slope = _return(far_mean, view.scale_mm)
    share = ends.share[..., np.newaxis, np.newaxis]
    slope = np.concatenate([_plane(one - other)[..., np.newaxis], share * one_slope, (1.0 - share) * other_slope], -1)
    n, bins = ends.share.shape
    prior = np.zeros((n, bins, 5, 5))
    prior[..., 0, 0] = (0.7 * ends.width) ** 2
    prior[..., 1:3, 1:3] = ends.covariance + _own(view)
    prior[..., 3:, 3:] = far_covariance[:, np.newaxis]
    through = prior @ np.swapaxes(slope, -1, -2)
    total = slope @ through + noise[:, np.newaxis]
    error = _plane(phasor[:, np.newaxis] - (ends.share * one + (1.0 - ends.share) * other))
    with np.errstate(divide="ignore"):
        log = np.log(ends.mass) + _log_normal(error, total)
    gain = through @ np.linalg.inv(total)
    start = np.concatenate([ends.share[..., np.newaxis], ends.mean, far_mean], axis=-1)
    state = start + (gain @ error[..., np.newaxis])[..., 0]
    left = prior - gain @ slope @ prior
    state[..., 2] += ends.offset[:, np.newaxis]
    state[..., 4] += far_offset[:, np.newaxis]
    possible = (state[..., 0] > -0.02) & (state[..., 0] < 1.02) & far_possible[:, np.newaxis]  # noqa: PLR2004  rounding
    log = np.where(possible & np.isfinite(log), log, -np.inf)
    most = log.max(axis=1)
    shift = np.where(np.isfinite(most), most, 0.0)[:, np.newaxis]
    weight = np.exp(log - shift)
    sum_ = np.maximum(weight.sum(axis=1), 1e-300)
    weight = weight / sum_[:, np.newaxis]
    mean = (weight[..., np.newaxis] * state).sum(axis=1)
    off = state - mean[:, np.newaxis]
    covariance = (weight[..., np.newaxis, np.newaxis] * (left + off[..., np.newaxis] * off[..., np.newaxis, :])).sum(1)
    evidence = np.where(np.isfinite(most), shift[:, 0] + np.log(sum_), -np.inf)
    return _Found(evidence, mean, covariance, (weight * (one - other)).sum(axis=1))


def _far(seen: _Seen, totals: _Sums, which: IntArray, order: IntArray, view: View) -> _Far:
    """The farther surface of pairs, the parts of whose pixels the nearer one takes in an order (pair, part)."""
    all_hit = seen.share[which] > _ALL
    most_hit = seen.share[which] > 0.5  # noqa: PLR2004  half
    ok = np.where((all_hit.sum(axis=1) >= _LEAST_DRAWS)[:, np.newaxis], all_hit, most_hit)
    _, covariance, offset = _moments(totals.some(which), ok)
    hit, phasor, range_mm, log_cosine = (
        np.take_along_axis(part[which], order[:, np.newaxis], axis=2)[..., ::-1].cumsum(axis=2)[..., ::-1]
        for part in (seen.hit, seen.phasor, seen.range_mm, seen.log_cosine)
    )
    sums = _means(
        phasor,
        range_mm,
        log_cosine,
        hit,
        seen.level[which][..., np.newaxis],
        seen.gamma[which][..., np.newaxis],
        view.scale_mm,
    )
    n = len(which)
    flat = _Sums(*(np.swapaxes(part, 1, 2).reshape(n * _PARTS, -1) for part in sums))
    fits = (ok[..., np.newaxis] & (hit > 0)).swapaxes(1, 2).reshape(n * _PARTS, -1)
    mean = _moments(flat, fits)[0].reshape(n, _PARTS, 2)
    fewest = 0.3  # share of the pixel that the farther surface fills in the mean of its draws
    possible = (ok.sum(axis=1) >= _LEAST_DRAWS) & (seen.share[which].mean(axis=1) >= fewest)
    return _Far(mean, covariance, offset, possible)


class _Best:
    """Keeps the most probable hypothesis of each pixel."""

    def __init__(self, count: int, log_new: float, apart: float) -> None:
        self._apart = apart
        self.empty = np.full(count, -np.inf)
        """Log (count,) of prior and density of open space alone."""
        self._new = np.full(count, log_new)
        self._one: list[list[tuple[float, int]]] = [[] for _ in range(count)]
        self._two: list[list[tuple[float, Bent, tuple[int, int], FloatArray, FloatArray, complex]]] = [
            [] for _ in range(count)
        ]

    def put_one(self, owner: IntArray, number: IntArray, log: FloatArray) -> None:
        """Put the hypothesis of one surface."""
        for place, segment, value in zip(owner.tolist(), number.tolist(), log.tolist(), strict=True):
            if math.isfinite(value):
                self._one[place].append((value, segment))

    def put_unseen(self, owner: IntArray, log: FloatArray) -> None:
        """Put the hypothesis of one surface and an unseen one: what is there is not known, as under NEW."""
        np.logaddexp.at(self._new, owner, log)

    def put_pair(self, owner: IntArray, pair: IntArray, kind: Bent, log_prior: float, found: _Found) -> None:
        """Put the hypothesis of two surfaces."""
        share, near_mm, far_mm = found.mean[:, 0], found.mean[:, 2], found.mean[:, 4]
        with np.errstate(invalid="ignore"):
            together = np.abs(far_mm - near_mm) < self._apart * far_mm
        for i, place in enumerate(owner.tolist()):
            value = float(found.log[i]) + log_prior
            if together[i] and math.isfinite(value):
                self._one[place].append((value, int(pair[i, 0 if share[i] > 0.5 else 1])))  # noqa: PLR2004  the larger
            elif math.isfinite(value):
                both = int(pair[i, 0]), int(pair[i, 1])
                self._two[place].append(
                    (value, kind, both, found.mean[i], found.covariance[i], complex(found.chord[i]))
                )

    def verdicts(self) -> Verdicts:
        """The most probable ones."""
        count = len(self._one)
        out = Verdicts(
            kind=np.zeros(count, np.int64),
            probability=np.zeros(count),
            one=np.full(count, -1),
            pair=np.full((count, 2), -1),
            mean=np.full((count, 5), np.nan),
            covariance=np.full((count, 5, 5), np.nan),
            chord=np.zeros(count, np.complex128),
            log_density=np.zeros(count),
        )
        for place in range(count):
            ones, twos = self._one[place], self._two[place]
            logs = np.array([self._new[place], self.empty[place], *(one[0] for one in ones), *(two[0] for two in twos)])
            weight = np.exp(logs - logs.max())
            weight /= weight.sum()
            out.log_density[place] = logs.max()
            pairs: dict[tuple[int, int], list[int]] = {}
            for k, two in enumerate(twos):
                pairs.setdefault(two[2], []).append(k)
            of_two = weight[2 + len(ones) :]
            most = int(weight.argmax())
            if pairs and of_two.sum() > 0.5:  # noqa: PLR2004  two surfaces rather than one
                both = max(pairs, key=lambda key: float(of_two[pairs[key]].sum()))
                self._mix(out, place, [twos[k] for k in pairs[both]], of_two[pairs[both]])
                out.pair[place] = both
            elif 2 <= most < 2 + len(ones):  # noqa: PLR2004  after NEW and EMPTY
                out.kind[place], out.one[place] = int(Bent.ONE), ones[most - 2][1]
                out.probability[place] = weight[2 : 2 + len(ones)].sum()
            elif most < 2:  # noqa: PLR2004
                out.kind[place], out.probability[place] = int((Bent.NEW, Bent.EMPTY)[most]), weight[most]
        return out

    @staticmethod
    def _mix(
        out: Verdicts,
        place: int,
        some: list[tuple[float, Bent, tuple[int, int], FloatArray, FloatArray, complex]],
        weight: FloatArray,
    ) -> None:
        part = weight / weight.sum()
        mean = sum(w * one[3] for w, one in zip(part, some, strict=True))
        spread = [one[4] + np.outer(one[3] - mean, one[3] - mean) for one in some]
        out.mean[place] = mean
        out.covariance[place] = sum(w * one for w, one in zip(part, spread, strict=True))
        out.chord[place] = sum(w * one[5] for w, one in zip(part.tolist(), some, strict=True))
        out.kind[place] = int(some[int(part.argmax())][1])
        out.probability[place] = weight.sum()
