"""Edge lines: the pieces of edges in neighbouring pixels, one after the other.

Errors of edges of unmixed shares: the common part of the errors along a run.

Shares that are counts are independent of each other. Those of phasor sums are not: a pixel's share depends on the
phasors of its two neighbouring surfaces, and the next pixels depend on nearly the same ones. Fits take shares for
independent, so their variances are too small. A fit cannot show an error that its whole run has in common; it follows
from the windows in which unmixing measures a surface. The scatter of runs beyond their errors is measured. It is of the
edge, which is not as straight or as round as the fit, and so in common too.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.surfaces.edge_shape import AGREES, AHEAD, ANGLE, BACK, BAR, COLUMNS, KIND, VAR_ANGLE, VAR_THIRD, own_area
from tofmix.surfaces.found import Edges, no_edges
from tofmix.surfaces.regions import (
    ALL,
    ANY,
    AT,
    BEND,
    DOWN,
    EITHER,
    FIRST,
    ONE,
    RIGHT,
    SECOND,
    SHAPE,
    VARIANCE,
    edge_side,
    inside,
)
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shares import Cuts, Shares


def widened(fits: FloatArray, cuts: Cuts, shares: Shares, settings: EdgeSettings) -> FloatArray:
    """Fits (cut, FIT_COLUMNS) with larger variances where shares are unmixed; else the same.

    Parameters
    ----------
    fits : (cut, FIT_COLUMNS) float64
        From `fit_edges`.
    cuts, shares
        Of the same window.
    """
    if not shares.common or not len(cuts.row):
        return fits
    length = fits[:, BACK] + fits[:, AHEAD] + 1.0
    # A line of this direction crosses so many pixels on a length of 1.
    crossed = np.abs(np.cos(fits[:, ANGLE])) + np.abs(np.sin(fits[:, ANGLE]))
    # Variance of a mean over the run, of errors that are in common, in units of that of independent ones.
    alike = np.maximum(1.0, crossed * length * _alike(length, settings.alike_distance))
    factor = 1.0 - shares.common + (shares.common + _excess(fits, cuts, shares, settings.longest_run)) * alike
    out = fits.copy()
    out[:, VAR_ANGLE : VAR_THIRD + 1] *= factor[:, np.newaxis]
    return out


def _alike(length: FloatArray, distance: float) -> FloatArray:
    """Mean (...) of exp(-(h / distance)^2) over the distances h of two places on a length."""
    steps = (np.arange(200) + 0.5) / 200
    # The distance of two places on a length has a density that falls linearly to 0 at its end.
    kernel = np.exp(-((length[..., np.newaxis] * steps / distance) ** 2)) * 2.0 * (1.0 - steps)
    return np.asarray(kernel.mean(axis=-1))


def _excess(fits: FloatArray, cuts: Cuts, shares: Shares, reach: int) -> FloatArray:
    """Variance (cut,) that an edge's pixels show beyond their errors and chance, in units of these."""
    row, col = cuts.row, cuts.col
    told = (fits[:, AGREES] > 0) & (fits[:, KIND] != BAR) & (cuts.entry == 0) & (shares.entries[row, col] > 1)
    chosen = np.flatnonzero(told)
    out = np.zeros(len(fits))
    if not chosen.size:
        return out
    row, col, near = row[chosen], col[chosen], cuts.near[chosen]
    squares = _squares(fits[chosen], shares.up_to[row, col, 0], shares.samples[row, col], shares.floor[row, col])
    # Surfaces are far apart in the third coordinate, so that edges of one alone are neighbours.
    places = np.column_stack([row, col, near.astype(np.float64) * 4.0 * reach])
    for cut, others in zip(chosen, cKDTree(places).query_ball_point(places, reach), strict=True):
        chance = 1.0 + np.sqrt(2.0 / len(others))  # a mean of squares, and its standard deviation
        out[cut] = max(0.0, float(squares[others].mean() - chance))
    return out


@jit
def _squares(fits: FloatArray, share: FloatArray, samples: FloatArray, floor: FloatArray) -> FloatArray:
    """Squared residuals (cut,) of pixels' own shares in units of their variances."""
    out = np.empty(len(fits))
    pixel, scratch, work = np.empty(COLUMNS), np.empty(7), np.empty((3, 8, 2))
    for i in range(len(fits)):
        area = own_area(fits[i], pixel, scratch, work)
        out[i] = (share[i] - area) ** 2 / ((area * (1.0 - area) + 0.25 / samples[i]) / samples[i] + floor[i])
    return out


_NOTHING = 1.0e-9
"""Smallest length of a piece, pixels."""


def trace(cuts: Cuts, regions: FloatArray, kept: int) -> Edges:
    """Trace the edges of a window.

    A line of unknown error throughout is left out. No share around it agrees with an edge, so nothing says that a
    surface ends there: one pixel may have a false layer, or see a speck.

    Parameters
    ----------
    cuts : Cuts
        Where surfaces end.
    regions : (cut, REGION_COLUMNS) float64
        Areas that they cover.
    kept : int
        Surfaces whose edges are traced: those of a lower number.
    """
    pieces, owner = _pieces(cuts.row, cuts.col, cuts.first, cuts.following, cuts.margin, regions)
    ours = cuts.near[owner] < kept
    pieces, owner = pieces[ours], owner[ours]
    if not len(pieces):
        return no_edges()
    follower = _followers(pieces, cuts.near[owner])
    known = np.isfinite(pieces[:, 6])
    lines = [chain for chain in _chains(follower) if known[chain].any()]
    return _edges(pieces, owner, cuts, lines) if lines else no_edges()


@jit
def _pieces(
    rows: NDArray[np.int32],
    cols: NDArray[np.int32],
    first_cut: NDArray[np.int32],
    next_cut: NDArray[np.int32],
    margin: FloatArray,
    regions: FloatArray,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Visible pieces (piece, 7): begin, middle, end (row, col of each) and variance; and the cut of each.

    The covered side is to the left, as rows run downward.
    """
    out, owner = np.empty((3 * len(rows), 7)), np.empty(3 * len(rows), np.int64)
    total = 0
    for cut in range(len(rows)):
        region = regions[cut]
        sides = 1 if region[SHAPE] == ONE else (3 if region[SHAPE] >= ALL else 2)
        for side in range(sides):
            at = FIRST + side * (SECOND - FIRST)
            piece = out[total]
            if not _piece(region, at, sides, 0.5 + margin[cut], piece):
                continue
            hidden, nearer = False, first_cut[rows[cut], cols[cut]]
            while nearer >= 0 and nearer != cut:
                hidden = hidden or inside(regions[nearer], piece[2], piece[3])
                nearer = next_cut[nearer]
            if hidden or nearer != cut:  # behind a nearer surface, or replaced by an edge that grazes the pixel
                continue
            for i in range(3):
                piece[2 * i] += rows[cut]
                piece[2 * i + 1] += cols[cut]
            piece[6] = region[at + VARIANCE]
            owner[total] = cut
            total += 1
    return out[:total].copy(), owner[:total].copy()


@borrowing
def _piece(region: FloatArray, at: int, sides: int, half: float, out: FloatArray) -> bool:
    """Fill begin, middle and end of an edge's piece up to `half` off the centre, on the right side of the others."""
    down, right = region[at + DOWN], region[at + RIGHT]
    ahead_down, ahead_right = right, -down  # the covered side, (down, right), is to the left of it
    begin, end = -2.0, 2.0
    for axis in range(2):
        place = (down if axis == 0 else right) * region[at + AT]
        pace = ahead_down if axis == 0 else ahead_right
        if abs(pace) < _NOTHING:
            if abs(place) > half:
                return False
            continue
        one, two = (-half - place) / pace, (half - place) / pace
        begin, end = max(begin, min(one, two)), min(end, max(one, two))
    for side in range(sides):
        other = FIRST + side * (SECOND - FIRST)
        if other == at:
            continue
        # Along the piece the other edge's side changes once: from `value` at its start by `slope`.
        sign = -1.0 if region[SHAPE] in (EITHER, ANY) else 1.0
        value = sign * edge_side(region, other, down * region[at + AT], right * region[at + AT])
        slope = sign * (region[other + DOWN] * ahead_down + region[other + RIGHT] * ahead_right)
        if abs(slope) < _NOTHING:
            if value < 0.0:
                return False
        elif slope > 0.0:
            begin = max(begin, -value / slope)
        else:
            end = min(end, -value / slope)
    if end - begin < _NOTHING:
        return False
    for i in range(3):
        along = begin + 0.5 * i * (end - begin)
        off = region[at + AT] + 0.5 * region[at + BEND] * along * along
        out[2 * i] = down * off + ahead_down * along
        out[2 * i + 1] = right * off + ahead_right * along
    return True


def _followers(pieces: FloatArray, near: NDArray[np.int32]) -> IntArray:
    """Piece that follows each, -1 for none: of the same surface, beginning nearest to its end; the closest first."""
    count = len(pieces)
    candidates = 6  # beginnings that are looked at for each end
    wanted = min(candidates, count)
    reach = 1.0  # distance, pixels, from the end of a piece to the beginning of the next one at most
    found = cKDTree(pieces[:, :2]).query(pieces[:, 4:6], k=wanted, distance_upper_bound=reach)
    distance, other = (np.asarray(values).ravel() for values in found)
    one = np.repeat(np.arange(count), wanted)
    there = np.isfinite(distance)
    one, other, distance = one[there], other[there], distance[there]
    way = pieces[:, 4:6] - pieces[:, :2]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), _NOTHING)
    alike: BoolArray = (near[one] == near[other]) & (one != other)
    sharpest = -0.5  # cosine of 120 degrees, as at the tip of a triangle
    alike &= (way[one] * way[other]).sum(axis=1) > sharpest
    order = np.flatnonzero(alike)[np.argsort(distance[alike], kind="stable")]
    follower, taken = np.full(count, -1), np.zeros(count, bool)
    for k in order:
        if follower[one[k]] < 0 and not taken[other[k]]:
            follower[one[k]] = other[k]
            taken[other[k]] = True
    return follower


def _chains(follower: IntArray) -> list[list[int]]:
    """Pieces of each line in order: lines with a beginning first, then rings."""
    has_one_before = np.zeros(len(follower), bool)
    has_one_before[follower[follower >= 0]] = True
    done = np.zeros(len(follower), bool)
    chains = []
    for start in (*np.flatnonzero(~has_one_before), *range(len(follower))):
        if done[start]:
            continue
        chain, piece = [], int(start)
        while piece >= 0 and not done[piece]:
            done[piece] = True
            chain.append(piece)
            piece = int(follower[piece])
        chains.append(chain if piece < 0 else [*chain, piece])
    return chains


def _edges(pieces: FloatArray, owner: IntArray, cuts: Cuts, chains: list[list[int]]) -> Edges:
    """Points: the beginning of a line's first piece, the middle of each, its end at a corner, the end of the last."""
    order, place, line = [], [], []
    for number, chain in enumerate(chains):
        ring = len(chain) > 1 and chain[0] == chain[-1]
        if not ring:
            order.append(chain[0])
            place.append(0)
            line.append(number)
        for k, piece in enumerate(chain):
            last = k == len(chain) - 1
            corner = not last and owner[chain[k + 1]] == owner[piece]
            for where in (1, 2) if corner or (last and not ring) else (1,):
                order.append(piece)
                place.append(where)
                line.append(number)
    order_, place_ = np.array(order), np.array(place)
    cut = owner[order_]
    return Edges(
        row=pieces[order_, 2 * place_].astype(np.float32),
        col=pieces[order_, 2 * place_ + 1].astype(np.float32),
        stderr=np.sqrt(pieces[order_, 6]).astype(np.float32),
        near=cuts.near[cut],
        far=cuts.far[cut],
        line=np.array(line, dtype=np.int32),
    )
