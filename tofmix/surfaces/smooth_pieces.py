"""Which planes of the linking are pieces of a surface that bends.

A sphere is linked into planes that touch. Two pieces that touch are one smooth surface, or two: windows of pixels along
their border are explained by one patch of `tofmix.image.smooth`, or by one patch for each piece, and the evidence of
both tells. A crease between two boards, and a step, need two. Pieces join in rounds, the surest pairs first.
"""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.masks import components
from tofmix.image.smooth.patch import fit_patches
from tofmix.image.smooth.scales import BENDS, THIRDS, UNKNOWN
from tofmix.image.smooth.segments import around
from tofmix.image.smooth.view import View
from tofmix.surfaces.settings import LinkSettings

_TRIALS = np.array(
    [(BENDS[0], THIRDS[0]), (BENDS[2], THIRDS[0]), (UNKNOWN[0], THIRDS[0]), UNKNOWN, (BENDS[-1], THIRDS[-1])]
)
"""Scales of curvatures and cubic terms that pieces are tried with, the same for one piece and for both."""

_REACH = 3  # of these windows: more takes in the next border
_WINDOWS = 4  # along the border of two pieces
_MOST_NATS = 25.0  # that one window speaks for or against: one flying pixel does not outweigh the rest


def pieces_of(view: View, label: IntArray, settings: LinkSettings) -> IntArray:
    """Number (pixel,) of the piece of each valid pixel: connected pixels of one surface; -1 for small pieces.

    Parameters
    ----------
    view : View
        The image.
    label : (pixel,) int64
        Surface of each valid pixel.
    settings : LinkSettings
        Thresholds.
    """
    a, b = _neighbours(view.shape)
    joined = view.valid[a] & view.valid[b] & (label[a] == label[b])
    number = components(a[joined], b[joined], view.valid.size)
    size = np.bincount(number[view.valid], minlength=int(number.max()) + 1)
    large = size >= settings.least_layers
    renamed = np.where(large, np.cumsum(large) - 1, -1)
    return np.where(view.valid, renamed[number], -1)


def joined_pieces(view: View, piece: IntArray, settings: LinkSettings) -> IntArray:
    """Number (pixel,) of the group of each piece: those that are one smooth surface. Pieces and groups are pixels' own.

    Parameters
    ----------
    view : View
        The image.
    piece : (pixel,) int64
        From `pieces_of`.
    settings : LinkSettings
        Thresholds.
    """
    group = piece.copy()
    known: dict[tuple[int, int], float] = {}
    fresh = int(group.max(initial=-1)) + 1
    while True:
        borders = _borders(view, group, settings)
        asked = [pair for pair in borders if pair not in known]
        known |= dict(zip(asked, _gains(view, group, asked, [borders[pair] for pair in asked]), strict=True))
        ones, others = _surest({pair: known[pair] for pair in borders if known[pair] > 0.0})
        if not ones.size:
            return group
        whole = components(ones, others, fresh)
        alone = np.bincount(whole)[whole] == 1
        renamed = np.append(np.where(alone, np.arange(fresh), fresh + whole), -1)
        group, fresh = renamed[group], fresh + int(whole.max()) + 1


def _neighbours(shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Both pixels of all pairs beside each other."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    return (
        np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()]),
        np.concatenate([index[:, 1:].ravel(), index[1:].ravel()]),
    )


def _borders(view: View, group: IntArray, settings: LinkSettings) -> dict[tuple[int, int], IntArray]:
    """Pixels along the border of each two groups that touch without a large step."""
    a, b = _neighbours(view.shape)
    touch = (group[a] >= 0) & (group[b] >= 0) & (group[a] != group[b])
    a, b = a[touch], b[touch]
    sigma = np.sqrt(view.range_variance[a] + view.range_variance[b])
    near_mm = np.minimum(view.range_mm[a], view.range_mm[b])
    even = np.abs(view.range_mm[a] - view.range_mm[b]) < _STEP * near_mm + settings.most_sigmas * sigma
    a, b = a[even], b[even]
    low, high = np.minimum(group[a], group[b]), np.maximum(group[a], group[b])
    keys, which = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    which = which.reshape(len(a))
    draw = np.random.default_rng(1)
    out = {}
    for number, (one, other) in enumerate(keys.tolist()):
        pixels = np.unique(np.concatenate([a[which == number], b[which == number]]))
        out[one, other] = pixels[draw.permutation(pixels.size)[:_WINDOWS]]
    return out


_STEP = 0.04
"""Largest difference between neighbours that may be of one surface, as a part of the range."""


def _gains(view: View, group: IntArray, pairs: list[tuple[int, int]], borders: list[IntArray]) -> list[float]:
    """Log evidence of one surface less that of two, nat, of pairs of groups by the pixels along their borders."""
    if not pairs:
        return []
    at = np.concatenate(borders)
    owner = np.repeat(np.arange(len(pairs)), [border.size for border in borders])
    one, other = (np.array(part)[owner] for part in zip(*pairs, strict=True))
    first, second = (around(view.shape, group, at, number, _REACH, own=True) for number in (one, other))
    both = np.where(first >= 0, first, second)
    usable = (first >= 0).any(axis=1) & (second >= 0).any(axis=1)
    at, owner, first, second, both = (part[usable] for part in (at, owner, first, second, both))
    apart = _best_of(view, at, first, owner, len(pairs)) + _best_of(view, at, second, owner, len(pairs))
    gain = np.clip(_best_of(view, at, both, owner, len(pairs)) - apart, -_MOST_NATS, _MOST_NATS)
    total: list[float] = np.bincount(owner, weights=gain, minlength=len(pairs)).tolist()
    return total


def _best_of(view: View, at: IntArray, members: IntArray, owner: IntArray, count: int) -> FloatArray:
    """Log evidence (window,) of the members' ranges, with the scales that are most likely for all windows of a pair."""
    if not at.size:
        return np.zeros(0)
    members = -np.sort(-members, axis=1)[:, : int((members >= 0).sum(axis=1).max())]  # without empty places
    evidence = np.zeros((len(_TRIALS), at.size))
    for number, (bend, third) in enumerate(_TRIALS):
        fitted = fit_patches(
            view, at, members, np.full(at.size, bend), np.full(at.size, third), robust=False, third_of_bend=0.0
        )
        evidence[number] = fitted.log_evidence + fitted.log_slope
    sums = np.stack([np.bincount(owner, weights=row, minlength=count) for row in evidence])
    return np.asarray(evidence[sums.argmax(axis=0)[owner], np.arange(at.size)])


def _surest(gains: dict[tuple[int, int], float]) -> tuple[IntArray, IntArray]:
    """Both groups of the pairs that gain most for one of them: each group joins the best of its neighbours."""
    best: dict[int, tuple[int, int]] = {}
    for pair, gain in gains.items():
        for one in pair:
            if one not in best or gain > gains[best[one]]:
                best[one] = pair
    pairs = np.array(sorted(set(best.values())), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def is_loose(group: IntArray, misfit: FloatArray, settings: LinkSettings) -> BoolArray:
    """Which groups scatter about their planes by more than noise; `misfit` (pixel,) is squared, in variances."""
    inside = group >= 0
    count = np.bincount(group[inside])
    mean = np.bincount(group[inside], weights=misfit[inside]) / np.maximum(count, 1)
    return np.asarray(mean > 1.0 + settings.most_sigmas * np.sqrt(2.0 / np.maximum(count, 1)))
