"""How much a surface bends: the scales of its curvatures and cubic terms that its own pixels make most likely."""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.patch import DIRECTIONS, LEAST_HITS, LOG_WAYS, drawn_ranges, fit_patches
from tofmix.image.segments import View, members_around, rim_of

BENDS = (1e-7, 1e-4, 5e-4, 2e-3, 5e-3, 1e-2)
"""Standard deviations of a curvature that are tried, 1 / mm: from a plane to a radius of 100 mm."""

THIRDS = (1e-12, 1e-7, 1e-6, 1e-5)
"""Those of a cubic term, 1 / mm^2."""

UNKNOWN = 3e-3, 1e-6
"""Scales of a surface with too few pixels to tell."""

_ODDS_OF_PLANE = 100.0
"""Prior odds that a surface is a plane: things are made of walls, and a few pixels of a board bend by chance."""

_LEAST_WINDOWS = 3
_LEAST_VARIANCE = 0.5
"""Least variance of the members' places across, square pixels: two columns (0.25) tell no curvature, three do."""
MOST_NATS = 25.0
"""Most nats that one window speaks against scales: one crease does not outweigh the rest."""


_TESTS, _LEAST_TESTS = 18, 5  # pixels at the rim that are predicted, and the fewest that tell
_UNTESTED, _MOST_INFLATED = 1.5, 4.0  # factors on the variance: without tests, and at most


class Scales(NamedTuple):
    """Scales (segment,) of curvatures, 1 / mm, and of cubic terms, 1 / mm^2; factor on the variance of predictions."""

    bend: FloatArray
    third: FloatArray
    inflation: FloatArray

    def is_flat(self) -> BoolArray:
        """Which segments are planes, as far as their pixels tell: radii beyond 10 m."""
        return np.asarray(self.bend <= BENDS[1])

    def is_known(self) -> BoolArray:
        """Which segments have enough pixels to tell."""
        return np.asarray(self.bend != UNKNOWN[0])


def may_bend(view: View, segment: IntArray, numbers: IntArray, reach: int) -> tuple[BoolArray, BoolArray]:
    """Which segments (m,) a bent surface explains better than a plane, and which have enough pixels to tell."""
    if not len(numbers):
        return np.zeros(0, np.bool_), np.zeros(0, np.bool_)
    trials = np.array([(BENDS[0], THIRDS[0]), (BENDS[2], THIRDS[0]), UNKNOWN])
    owner, sums = _evidence(view, segment, numbers, reach, trials)
    enough = np.bincount(owner, minlength=len(numbers)) >= _LEAST_WINDOWS
    return np.asarray(enough & (sums[1:].max(axis=0) > sums[0] + math.log(_ODDS_OF_PLANE))), enough


def _evidence(
    view: View, segment: IntArray, numbers: IntArray, reach: int, trials: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Place of the segment (window,) of some windows, and log evidence (trial, segment) of scales (trial, 2), nat.

    Each window bends in its own way, or all of a segment in one direction, as those of a cylinder do: as probable.
    """
    at, owner = _windows(segment, numbers)
    members = members_around(view.shape, segment, at, segment[at], reach, own=True)
    least = 10  # members
    usable = ((members >= 0).sum(axis=1) >= least) & (_narrowest(members, view.shape[1]) >= _LEAST_VARIANCE)
    at, owner, members = at[usable], owner[usable], members[usable]
    if not at.size:
        return owner, np.zeros((len(trials), len(numbers)))
    evidence = np.zeros((len(trials), 1 + DIRECTIONS, at.size))
    for number, (bend, third) in enumerate(trials):
        same = np.ones(at.size)
        fitted = fit_patches(view, at, members, bend * same, third * same, robust=False, quadric=True)
        evidence[number, 0], evidence[number, 1:] = fitted.log_evidence, fitted.log_ways[:, 1:].T
    evidence = np.maximum(evidence, evidence.max(axis=(0, 1)) - MOST_NATS)
    sums = np.stack([evidence[..., owner == place].sum(axis=-1) for place in range(len(numbers))], axis=-1)
    return owner, np.asarray(np.logaddexp.reduce(sums + LOG_WAYS[:, np.newaxis], axis=1))


def _narrowest(members: IntArray, cols: int) -> FloatArray:
    """Variance (n,) of the places of members (n, place) in the direction in which they spread least, square pixels."""
    there = members >= 0
    count = np.maximum(there.sum(axis=1), 1)
    places = np.stack([members // cols, members % cols], axis=-1) * there[..., np.newaxis]
    off = (places - places.sum(axis=1, keepdims=True) / count[:, np.newaxis, np.newaxis]) * there[..., np.newaxis]
    spread = np.swapaxes(off, 1, 2) @ off / count[:, np.newaxis, np.newaxis]
    return np.asarray(np.linalg.eigvalsh(spread)[:, 0])


def learn_scales(view: View, segment: IntArray, numbers: IntArray, reach: int) -> Scales:
    """Learn the scales of segments.

    Parameters
    ----------
    view : View
        The image.
    segment : (pixel,) int64
        Number of the segment of each pixel; -1 for none.
    numbers : (m,) int64
        The segments.
    reach : int
        Reach of a window, pixels.

    Returns
    -------
    Scales
        Of the m segments: by the sum of the log evidence of some windows of each, drawn with a fixed seed.
    """
    grid = np.array([(bend, third) for bend in BENDS for third in THIRDS])
    owner, evidence = _evidence(view, segment, numbers, reach, grid)
    bend, third = np.full(len(numbers), UNKNOWN[0]), np.full(len(numbers), UNKNOWN[1])
    for number in range(len(numbers)):
        mine = owner == number
        if mine.sum() >= _LEAST_WINDOWS:
            log = evidence[:, number] + math.log(_ODDS_OF_PLANE) * (grid[:, 0] <= BENDS[1])
            bend[number], third[number] = grid[int(log.argmax())]
    return Scales(bend, third, _inflation(view, segment, numbers, bend, third, reach))


def _inflation(
    view: View, segment: IntArray, numbers: IntArray, bend: FloatArray, third: FloatArray, reach: int
) -> FloatArray:
    """Mean square (m,) of errors over stated ones, where pixels at the rim are predicted from one side alone."""
    draw = np.random.default_rng(1)
    at, members, owner = [], [], []
    least_aside = 9  # pixels on that side
    for place, number in enumerate(numbers.tolist()):
        own = np.flatnonzero(segment == number)
        rim = rim_of(segment == number, view.shape)[own]
        order = draw.permutation(own.size)
        order = order[np.argsort(~rim[order], kind="stable")][: 4 * _TESTS]
        pixels = own[order]
        sides = _on_one_side(view, segment, pixels, number, reach, draw)
        usable = np.flatnonzero((sides >= 0).sum(axis=1) >= least_aside)[:_TESTS]
        if usable.size >= _LEAST_TESTS:
            at.append(pixels[usable])
            members.append(sides[usable])
            owner.append(np.full(usable.size, place))
    inflation = np.full(len(numbers), _UNTESTED)
    if not at:
        return inflation
    pixel, whose = np.concatenate(at), np.concatenate(owner)
    fitted = fit_patches(view, pixel, np.concatenate(members), bend[whose], third[whose], robust=False)
    range_mm = drawn_ranges(fitted, view.direction[pixel][:, np.newaxis])[..., 0]
    seen = np.isfinite(range_mm)
    count = np.maximum(seen.sum(axis=1), 1)
    mean = np.where(seen, range_mm, 0.0).sum(axis=1) / count
    variance = np.where(seen, (range_mm - mean[:, np.newaxis]) ** 2, 0.0).sum(axis=1) / count
    square = (view.range_mm[pixel] - mean) ** 2 / (variance + view.range_variance[pixel] + 0.01)
    usable = seen.sum(axis=1) >= LEAST_HITS
    left_out = 2  # of the largest errors
    for place in range(len(numbers)):
        own = np.sort(square[usable & (whose == place)])
        if own.size:
            inflation[place] = np.clip(own[: max(own.size - left_out, 1)].mean(), 1.0, _MOST_INFLATED)
    return inflation


def _on_one_side(
    view: View, segment: IntArray, at: IntArray, number: int, reach: int, draw: np.random.Generator
) -> IntArray:
    """Members (n, place) around pixels, on the side where most of them are; -1 for none."""
    cols = view.shape[1]
    members = members_around(view.shape, segment, at, np.full(at.size, number), reach)
    there = members >= 0
    down = np.where(there, members // cols - (at // cols)[:, np.newaxis], 0)
    right = np.where(there, members % cols - (at % cols)[:, np.newaxis], 0)
    count = np.maximum(there.sum(axis=1), 1)
    way = np.stack([down.sum(axis=1), right.sum(axis=1)], axis=1) / count[:, np.newaxis]
    vague = np.linalg.norm(way, axis=1) < 0.8  # noqa: PLR2004  pixels all around: any side
    way[vague] = draw.standard_normal((int(vague.sum()), 2))
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    beyond = down * way[:, :1] + right * way[:, 1:]
    aside = 0.7  # pixels beyond the pixel in question, on the side that predicts it
    return np.where(there & (beyond > aside), members, -1)


def _windows(segment: IntArray, numbers: IntArray) -> tuple[IntArray, IntArray]:
    """Some pixels of each segment, and the places of their segments among the numbers."""
    draw = np.random.default_rng(1)
    found, owners = [], []
    for place, number in enumerate(numbers.tolist()):
        own = np.flatnonzero(segment == number)
        chosen = own[draw.permutation(own.size)[:10]]  # ten windows
        found.append(chosen)
        owners.append(np.full(chosen.size, place))
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return np.concatenate(found), np.concatenate(owners)
