"""Linking: which layers are of one plane, and the planes.

Growing of planar surfaces from node to node. Compiled.

A surface begins at a node with flat neighbours, with a plane that faces the camera and has almost unknown slopes. Every
neighbour that lies on the plane within the errors of both joins it and makes the plane better known.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.plane import dot, solve
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.settings import DEFAULT_SETTINGS, LinkSettings


@borrowing
def begin(
    inverse: float, direction: FloatArray, information: FloatArray, right: FloatArray, prior_slope: float
) -> None:
    """Set the normal equations to those of a plane that faces the beam, with slopes of `prior_slope`."""
    weight = 1.0 / (prior_slope * inverse) ** 2
    for i in range(3):
        right[i] = 0.0
        for j in range(3):
            information[i, j] = weight * ((1.0 if i == j else 0.0) - direction[i] * direction[j])


@borrowing
def add(inverse: float, variance: float, direction: FloatArray, information: FloatArray, right: FloatArray) -> None:
    """Add a node to the normal equations."""
    for i in range(3):
        right[i] += direction[i] * inverse / variance
        for j in range(3):
            information[i, j] += direction[i] * direction[j] / variance


@borrowing
def own_variance(variance: float, shift: float, down: FloatArray, across: FloatArray, plane: FloatArray) -> float:
    """Variance of a node's inverse range about a plane: a part of a pixel may be seen off the pixel's centre."""
    if shift == 0.0:
        return variance
    along_row, along_col = dot(plane, down), dot(plane, across)
    return float(variance + shift * shift * (along_row * along_row + along_col * along_col))


@borrowing
def misfit(inverse: float, variance: float, direction: FloatArray, plane: FloatArray, covariance: FloatArray) -> float:
    """Squared distance of a node from a plane in units of the variance of both."""
    spread = 0.0
    for i in range(3):
        spread += direction[i] * dot(covariance[i], direction)
    miss = inverse - dot(plane, direction)
    return float(miss * miss / (variance + max(spread, 0.0)))


@jit
def flatness(
    index: NDArray[np.int32],
    row: NDArray[np.int32],
    col: NDArray[np.int32],
    inverse: FloatArray,
    variance: FloatArray,
    shift: FloatArray,
    direction: FloatArray,
    down: FloatArray,
    across: FloatArray,
    settings: LinkSettings,
) -> FloatArray:
    """How flat the eight neighbours of each node are: the mean of their squared misfits, a missing one counted as bad.

    Parameters are those of `Nodes`.

    Returns
    -------
    (node,) float64
        0 to `most_sigmas` ** 2.
    """
    rows, cols, depth = index.shape
    out = np.empty(len(row))
    information, covariance = np.empty((3, 3)), np.empty((3, 3))
    right, plane = np.empty(3), np.empty(3)
    chosen = np.empty(8, np.int64)
    worst = settings.most_sigmas * settings.most_sigmas
    for node in range(len(row)):
        begin(inverse[node], direction[node], information, right, settings.prior_slope)
        add(inverse[node], variance[node], direction[node], information, right)
        count = 0
        for r in range(max(row[node] - 1, 0), min(row[node] + 2, rows)):
            for c in range(max(col[node] - 1, 0), min(col[node] + 2, cols)):
                best = -1
                for k in range(depth):
                    other = index[r, c, k]
                    if (
                        other >= 0
                        and other != node
                        and (best < 0 or abs(inverse[other] - inverse[node]) < abs(inverse[best] - inverse[node]))
                    ):
                        best = other
                if best >= 0 and not (r == row[node] and c == col[node]):
                    add(inverse[best], variance[best], direction[best], information, right)
                    chosen[count] = best
                    count += 1
        solve(information, right, plane, covariance)
        total = (8 - count) * worst
        for k in range(count):
            other = chosen[k]
            spread = own_variance(variance[other], shift[other], down[other], across[other], plane)
            miss = inverse[other] - dot(plane, direction[other])
            total += min(worst, miss * miss / spread)
        miss = inverse[node] - dot(plane, direction[node])
        out[node] = (total + min(worst, miss * miss / variance[node])) / 9.0
    return out


@jit
def grow(
    index: NDArray[np.int32],
    row: NDArray[np.int32],
    col: NDArray[np.int32],
    inverse: FloatArray,
    variance: FloatArray,
    shift: FloatArray,
    direction: FloatArray,
    down: FloatArray,
    across: FloatArray,
    order: NDArray[np.int64],
    settings: LinkSettings,
) -> NDArray[np.int32]:
    """Grow surfaces, each from the first node in `order` that is of none yet.

    Parameters
    ----------
    order : (node,) int64
        Nodes, the flattest first. The others are those of `Nodes`.

    Returns
    -------
    (node,) int32
        Number of the surface of each node, in the order in which they began.
    """
    rows, cols, depth = index.shape
    label = np.full(len(row), -1, np.int32)
    queue = np.empty(len(row), np.int64)
    information, covariance = np.empty((3, 3)), np.empty((3, 3))
    right, plane = np.empty(3), np.empty(3)
    worst = settings.most_sigmas * settings.most_sigmas
    found = 0
    few = 32  # with fewer nodes than this it is solved after each
    # A plane is solved again when it has this many times the nodes: more often changes nothing that matters.
    after = 1.1
    for seed in order:
        if label[seed] >= 0:
            continue
        begin(inverse[seed], direction[seed], information, right, settings.prior_slope)
        add(inverse[seed], variance[seed], direction[seed], information, right)
        solve(information, right, plane, covariance)
        label[seed] = found
        queue[0] = seed
        count, solved = 1, 1
        for sweep in range(2):
            # In the second sweep the whole plane is known: who was passed over too early gets another chance.
            if sweep == 1:
                solve(information, right, plane, covariance)
            at = 0
            while at < count:
                node = queue[at]
                at += 1
                for r in range(max(row[node] - 1, 0), min(row[node] + 2, rows)):
                    for c in range(max(col[node] - 1, 0), min(col[node] + 2, cols)):
                        best, least, there = -1, worst, False
                        for k in range(depth):
                            other = index[r, c, k]
                            if other < 0:
                                continue
                            if label[other] == found:
                                there = True
                            elif label[other] < 0:
                                spread = own_variance(variance[other], shift[other], down[other], across[other], plane)
                                far = misfit(inverse[other], spread, direction[other], plane, covariance)
                                if far < least:
                                    best, least = other, far
                        if best < 0 or there:
                            continue
                        spread = own_variance(variance[best], shift[best], down[best], across[best], plane)
                        add(inverse[best], spread, direction[best], information, right)
                        label[best] = found
                        queue[count] = best
                        count += 1
                        if count < few or count > after * solved:
                            solve(information, right, plane, covariance)
                            solved = count
        found += 1
    return label


@jit
def fit(
    label: NDArray[np.int32],
    count: int,
    inverse: FloatArray,
    variance: FloatArray,
    shift: FloatArray,
    direction: FloatArray,
    down: FloatArray,
    across: FloatArray,
    settings: LinkSettings,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit the plane of each surface to its nodes.

    Parameters
    ----------
    label : (node,) int32
        Surface of each node; below 0: none.
    count : int
        Surfaces. The others are those of `Nodes`.

    Returns
    -------
    planes, covariances, sizes, misfits
        (surface, 3) m of 1/r = m . d; (surface, 3, 3); nodes of each; mean squared misfit of its nodes.
    """
    planes, covariances = np.zeros((count, 3)), np.zeros((count, 3, 3))
    sizes, misfits = np.zeros(count), np.zeros(count)
    information, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for step in range(2):  # the second time with the slopes of the first
        sizes[:] = 0.0
        for node in range(len(label)):
            one = label[node]
            if one < 0:
                continue
            if sizes[one] == 0.0:
                begin(inverse[node], direction[node], information[one], right[one], settings.prior_slope)
            sizes[one] += 1.0
            spread = variance[node]
            if step == 1:
                spread = own_variance(spread, shift[node], down[node], across[node], planes[one])
            add(inverse[node], spread, direction[node], information[one], right[one])
        for one in range(count):
            if sizes[one] > 0.0:
                solve(information[one], right[one], planes[one], covariances[one])
    for node in range(len(label)):
        one = label[node]
        if one >= 0:
            spread = own_variance(variance[node], shift[node], down[node], across[node], planes[one])
            miss = inverse[node] - dot(planes[one], direction[node])
            misfits[one] += miss * miss / spread / sizes[one]
    return planes, covariances, sizes, misfits


@jit
def reassign(
    index: NDArray[np.int32],
    row: NDArray[np.int32],
    col: NDArray[np.int32],
    inverse: FloatArray,
    variance: FloatArray,
    shift: FloatArray,
    direction: FloatArray,
    down: FloatArray,
    across: FloatArray,
    label: NDArray[np.int32],
    planes: FloatArray,
    covariances: FloatArray,
    sizes: FloatArray,
    settings: LinkSettings,
) -> int:
    """Give each node the surface of its neighbourhood that fits it best; return how many changed.

    A surface's cost is the squared misfit, `apart_cost` for each of the eight neighbouring pixels without that
    surface, and a part of the cost of a surface: a few false layers next to a large surface return to it. `label` is
    changed in place.
    """
    rows, cols, depth = index.shape
    changed = 0
    near = np.empty(9 * depth, np.int64)
    times = np.empty(9 * depth, np.int64)
    for node in range(len(row)):
        count, alike = 0, True
        for r in range(max(row[node] - 1, 0), min(row[node] + 2, rows)):
            for c in range(max(col[node] - 1, 0), min(col[node] + 2, cols)):
                for k in range(depth):
                    other = index[r, c, k]
                    if other < 0 or label[other] < 0:
                        continue
                    next_to = 0 if r == row[node] and c == col[node] else 1
                    known = False
                    for i in range(count):
                        if near[i] == label[other]:
                            times[i] += next_to
                            known = True
                    if not known:
                        near[count], times[count] = label[other], next_to
                        count += 1
                        alike = alike and label[other] == label[node]
        if alike:
            continue
        best, least = label[node], np.inf
        for i in range(count):
            one = near[i]
            spread = own_variance(variance[node], shift[node], down[node], across[node], planes[one])
            cost = misfit(inverse[node], spread, direction[node], planes[one], covariances[one])
            if one != label[node] and cost > settings.most_sigmas * settings.most_sigmas:
                continue
            cost += settings.apart_cost * (8 - times[i]) + settings.surface_cost / sizes[one]
            if cost < least:
                best, least = one, cost
        if best != label[node]:
            label[node] = best
            changed += 1
    return changed


_DECADE = math.log(10.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linked:
    """Surfaces of one window, the largest first.

    Parameters
    ----------
    label : (node,) int32
        Surface of each node.
    planes : (surface, 3) float64
        m of 1/r = m . d, 1/mm.
    covariances : (surface, 3, 3) float64
        Of m.
    sizes : (surface,) int64
        Nodes of each.
    smooth : (surface,) int32
        Place of each surface among those that are smooth and no planes; -1: a plane.
    """

    label: NDArray[np.int32]
    planes: FloatArray
    covariances: FloatArray
    sizes: NDArray[np.int64]
    smooth: NDArray[np.int32]


def link(nodes: Nodes, settings: LinkSettings = DEFAULT_SETTINGS.link) -> Linked:
    """Link nodes into surfaces; every node is of one, and may be its only one."""
    if not len(nodes):
        return Linked(
            label=np.zeros(0, np.int32),
            planes=np.zeros((0, 3)),
            covariances=np.zeros((0, 3, 3)),
            sizes=np.zeros(0, np.int64),
            smooth=np.zeros(0, np.int32),
        )
    places = (nodes.index, nodes.row, nodes.col)
    values = (nodes.inverse, nodes.variance, nodes.shift, nodes.direction, nodes.down, nodes.across)
    order = np.argsort(flatness(*places, *values, settings), kind="stable")
    label = grow(*places, *values, order, settings)
    for _ in range(settings.sweeps):
        planes, covariances, sizes, _ = fit(label, int(label.max()) + 1, *values, settings)
        if not reassign(*places, *values, label, planes, covariances, sizes, settings):
            break
    label = numbered(label)
    planes, covariances, sizes, _ = fit(label, int(label.max()) + 1, *values, settings)
    label = numbered(_joined(planes, covariances, sizes, settings)[label])
    planes, covariances, sizes, _ = fit(label, int(label.max()) + 1, *values, settings)
    return Linked(
        label=label,
        planes=planes,
        covariances=covariances,
        sizes=sizes.astype(np.int64),
        smooth=np.full(len(planes), -1, np.int32),
    )


def numbered(label: NDArray[np.integer]) -> NDArray[np.int32]:
    """Number surfaces by their size, the largest first, and drop empty ones."""
    sizes = np.bincount(label)
    order = np.argsort(-sizes, kind="stable")
    number = np.empty(len(sizes), np.int32)
    number[order] = np.arange(len(sizes))
    return np.asarray(number[label])


def _joined(
    planes: FloatArray, covariances: FloatArray, sizes: FloatArray, settings: LinkSettings
) -> NDArray[np.int32]:
    """New number of each surface: pieces of one plane, such as a wall behind slats, get that of the largest.

    Two pieces are joined if their planes agree within their errors, and if this is unlikely by chance: the density of
    the difference at 0, compared with that for a plane of any direction and range.
    """
    new = np.arange(len(planes), dtype=np.int32)
    big = int((sizes >= settings.least_piece).sum())  # by size, the largest first
    for piece in range(1, big):
        wholes = [whole for whole in range(piece) if new[whole] == whole]
        odds = _odds(planes[piece], covariances[piece], sizes[piece], planes[wholes], covariances[wholes], settings)
        if odds.size and odds.max() > 1.0:
            new[piece] = wholes[int(odds.argmax())]
    return new


def _odds(
    plane: FloatArray,
    covariance: FloatArray,
    size: float,
    planes: FloatArray,
    covariances: FloatArray,
    settings: LinkSettings,
) -> FloatArray:
    """Odds (whole,) that a piece belongs to each of the planes and not to a separate one."""
    both = covariances + covariance
    miss = planes - plane
    squared = (miss * np.linalg.solve(both, miss[..., np.newaxis])[..., 0]).sum(axis=-1)
    squared = np.where(squared < settings.slight_misfit * size, np.minimum(squared, 1.0), squared)
    agreed = np.exp(-0.5 * squared) / np.sqrt((2.0 * math.pi) ** 3 * np.maximum(np.linalg.det(both), 1e-300))
    inverse = float(np.linalg.norm(plane))
    any_other = 1.0 / (_DECADE * inverse) / (2.0 * math.pi * settings.prior_slope**2) / inverse**2
    return np.asarray(np.where(squared < settings.most_sigmas**2, settings.same_plane_odds * agreed / any_other, 0.0))
