"""Smooth surfaces: what bends, and is smooth and continuous, is one surface; planes stay where planes hold.

Planes that touch are joined. Groups that bend, by the scales that `tofmix.image.scales` learns from their
own pixels, are smooth surfaces; all others stay the planes that they were. Then layers at the rim join in rounds, those
of mixed pixels too, if a patch through the surface's pixels nearby predicts them within the errors of both: so a limb
belongs to its surface, however steep.

Which planes of the linking are pieces of a surface that bends.

A sphere is linked into planes that touch. Two pieces that touch are one smooth surface, or two: windows of pixels along
their border are explained by one patch (`tofmix.image.patch`), or by one patch for each piece, and the evidence of
both tells. A crease between two boards, and a step, need two. Pieces join in rounds, the surest pairs first.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.patch import LEAST_HITS, PLACES_9, drawn_ranges, fit_patches
from tofmix.image.scales import BENDS, MOST_NATS, THIRDS, UNKNOWN, Scales, learn_scales, may_bend
from tofmix.image.segments import (
    LEAST_PIXELS,
    REACH,
    View,
    components,
    count_around,
    members_around,
    near,
    neighbour_pairs,
)
from tofmix.layers import Layers
from tofmix.surfaces.linking import Linked, fit, numbered
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.settings import LinkSettings, SurfaceSettings

_TRIALS = np.array(
    [(BENDS[0], THIRDS[0]), (BENDS[2], THIRDS[0]), (UNKNOWN[0], THIRDS[0]), UNKNOWN, (BENDS[-1], THIRDS[-1])]
)
"""Scales of curvatures and cubic terms that pieces are tried with, the same for one piece and for both."""


def pieces_of(view: View, label: IntArray, settings: LinkSettings) -> IntArray:
    """Number (pixel,) of the piece of each valid pixel: connected pixels of one surface; -1 for small pieces.

    Parameters
    ----------
    view : View
        The image.
    label : (pixel,) int64
        Surface of each valid pixel.
    """
    a, b = neighbour_pairs(view.shape)
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


def _borders(view: View, group: IntArray, settings: LinkSettings) -> dict[tuple[int, int], IntArray]:
    """Pixels along the border of each two groups that touch without a large step."""
    a, b = neighbour_pairs(view.shape)
    touch = (group[a] >= 0) & (group[b] >= 0) & (group[a] != group[b])
    a, b = a[touch], b[touch]
    sigma = np.sqrt(view.range_variance[a] + view.range_variance[b])
    near_mm = np.minimum(view.range_mm[a], view.range_mm[b])
    step = 0.04  # largest difference between neighbours that may be of one surface, as a part of the range
    even = np.abs(view.range_mm[a] - view.range_mm[b]) < step * near_mm + settings.most_sigmas * sigma
    a, b = a[even], b[even]
    low, high = np.minimum(group[a], group[b]), np.maximum(group[a], group[b])
    keys, which = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    which = which.reshape(len(a))
    draw = np.random.default_rng(1)
    out = {}
    windows = 4  # along the border of two pieces
    for number, (one, other) in enumerate(keys.tolist()):
        pixels = np.unique(np.concatenate([a[which == number], b[which == number]]))
        out[one, other] = pixels[draw.permutation(pixels.size)[:windows]]
    return out


def _gains(view: View, group: IntArray, pairs: list[tuple[int, int]], borders: list[IntArray]) -> list[float]:
    """Log evidence of one surface less that of two, nat, of pairs of groups by the pixels along their borders."""
    if not pairs:
        return []
    at = np.concatenate(borders)
    owner = np.repeat(np.arange(len(pairs)), [border.size for border in borders])
    one, other = (np.array(part)[owner] for part in zip(*pairs, strict=True))
    reach = 3  # of these windows: more takes in the next border
    first, second = (members_around(view.shape, group, at, number, reach, own=True) for number in (one, other))
    both = np.where(first >= 0, first, second)
    usable = (first >= 0).any(axis=1) & (second >= 0).any(axis=1)
    at, owner, first, second, both = (part[usable] for part in (at, owner, first, second, both))
    apart = _best_of(view, at, first, owner, len(pairs)) + _best_of(view, at, second, owner, len(pairs))
    gain = np.clip(_best_of(view, at, both, owner, len(pairs)) - apart, -MOST_NATS, MOST_NATS)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smooth:
    """Smooth surfaces of a window.

    Parameters
    ----------
    view : View
        The image, of the pixels that see one surface alone.
    segment : (pixel,) int64
        Smooth surface that fills each pixel; -1: none.
    scales : Scales
        Of the smooth surfaces: how much they bend.
    """

    view: View
    segment: IntArray
    scales: Scales


def link_smooth(
    layers: Layers, nodes: Nodes, linked: Linked, rays: FloatArray, settings: SurfaceSettings
) -> tuple[Linked, Smooth | None]:
    """Link what bends into smooth surfaces.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    nodes : Nodes
        The layers that may be of a surface.
    linked : Linked
        Planes.
    rays : (row, col, 3, 3) float64
        Ray through the centre of each pixel, and its change to the next row and to the next column.

    Returns
    -------
    linked : Linked
        The same object where nothing bends.
    smooth : Smooth or None
        The smooth surfaces, if there are any.
    """
    alone = _alone(layers, nodes, settings.share.least_open_samples)
    if not (alone >= 0).any():
        return linked, None
    view = view_of_nodes(nodes, alone, rays)
    at = alone[view.valid]
    label = np.full(view.valid.size, -1, np.int64)
    label[view.valid] = linked.label[at]
    piece = pieces_of(view, label, settings.link)
    group = joined_pieces(view, piece, settings.link)
    misfit = np.zeros(view.valid.size)
    plane = (linked.planes[linked.label[at]] * nodes.direction[at]).sum(axis=1)
    misfit[view.valid] = (nodes.inverse[at] - plane) ** 2 / nodes.variance[at]
    segment, scales = _bent(view, group, (group != piece) | _of(is_loose(group, misfit, settings.link), group))
    if not len(scales.bend):
        return linked, None
    planes = len(linked.sizes)
    label_of = linked.label.astype(np.int64)
    label_of[at] = np.where(segment[view.valid] >= 0, planes + segment[view.valid], label_of[at])
    _Rim(view, nodes, linked, alone, segment, scales, settings).grow(label_of)
    return _renumbered(nodes, label_of, planes, settings), Smooth(view=view, segment=segment, scales=scales)


def _alone(layers: Layers, nodes: Nodes, least_open: float) -> IntArray:
    """Node (pixel,) of each pixel that sees one surface and nothing else; -1 for others."""
    used = nodes.index >= 0
    nothing = np.nan_to_num(layers.weight_no_return.astype(np.float64)) * layers.n_samples
    valid = (used.sum(axis=-1) == 1) & (nothing < least_open)
    return np.where(valid, nodes.index.max(axis=-1), -1).ravel().astype(np.int64)


def view_of_nodes(nodes: Nodes, alone: IntArray, rays: FloatArray) -> View:
    """The image as smooth surfaces take it: the ranges of some nodes, (pixel,) -1 for none, without their light."""
    valid = alone >= 0
    range_mm = np.where(valid, 1.0 / nodes.inverse[alone], 1.0)
    length = np.linalg.norm(rays[..., :1, :], axis=-1, keepdims=True)
    direction, below, right = np.moveaxis((rays / length).reshape(-1, 3, 3), 1, 0)
    size = valid.size
    return View(
        shape=rays.shape[:2],
        scale_mm=np.inf,
        valid=valid,
        range_mm=range_mm,
        range_variance=np.where(valid, nodes.variance[alone] * range_mm**4, 1.0),
        log_amplitude=np.zeros(size),
        amplitude_variance=np.ones(size),
        pattern_variance=0.0,
        texture_variance=0.0,
        direction=direction,
        right=right,
        below=below,
        pitch=np.maximum(*(np.linalg.norm(part, axis=1) for part in (below, right))),
    )


def _of(values: BoolArray, number: IntArray) -> BoolArray:
    """Values of numbers; False for -1."""
    return np.asarray(np.append(values, False)[number])


def _bent(view: View, group: IntArray, doubtful: BoolArray) -> tuple[IntArray, Scales]:
    """Smooth surface (pixel,) of the pixels of groups that bend, among those with doubtful pixels; and their scales."""
    numbers = np.unique(group[doubtful & (group >= 0)])
    numbers = numbers[may_bend(view, group, numbers, REACH)[0]]
    if not numbers.size:
        return np.full(view.valid.size, -1), Scales(*np.zeros((3, 0)))
    scales = learn_scales(view, group, numbers, REACH)
    bent = np.flatnonzero(scales.is_known() & ~scales.is_flat())
    place = np.full(int(group.max(initial=-1)) + 2, -1)
    place[numbers[bent]] = np.arange(len(bent))
    return place[group], Scales(*(part[bent] for part in scales))


class _Rim:
    """Growth of smooth surfaces at their rims; changes the segments."""

    def __init__(
        self,
        view: View,
        nodes: Nodes,
        linked: Linked,
        alone: IntArray,
        segment: IntArray,
        scales: Scales,
        settings: SurfaceSettings,
    ) -> None:
        self._view, self._nodes, self._linked, self._alone = view, nodes, linked, alone
        self._segment, self._scales, self._settings = segment, scales, settings.link
        self._planes = len(linked.sizes)
        self._pixel = nodes.row.astype(np.int64) * view.shape[1] + nodes.col

    def grow(self, label: IntArray) -> None:
        """Give nodes (node,) at the rims the labels of smooth surfaces, those after the planes'; `label` is changed."""
        for _ in range(self._settings.rounds):
            node, place = self._candidates(label)
            if not node.size:
                return
            cost = self._cost(node, place, label)
            better = cost < self._plane_cost(node, label)
            node, place, cost = node[better], place[better], cost[better]
            chosen = self._one_each(node, place, cost)
            if not chosen.size:
                return
            node, place = node[chosen], place[chosen]
            label[node] = self._planes + place
            own = self._alone[self._pixel[node]] == node
            self._segment[self._pixel[node[own]]] = place[own]

    def _has(self, label: IntArray, number: int) -> BoolArray:
        """Pixels (row, col) with a node of a surface."""
        out = np.zeros(self._view.valid.size, np.bool_)
        out[self._pixel[label == number]] = True
        return out.reshape(self._view.shape)

    def _candidates(self, label: IntArray) -> tuple[IntArray, IntArray]:
        """Nodes of planes beside smooth surfaces that their pixels have no node of, and the surfaces."""
        found, places = [], []
        free = label < self._planes
        for place in range(len(self._scales.bend)):
            has = self._has(label, self._planes + place)
            beside = (near(has, 1) & ~has).ravel()
            some = np.flatnonzero(free & beside[self._pixel])
            members = members_around(
                self._view.shape, self._segment, self._pixel[some], np.full(some.size, place), REACH
            )
            some = some[(members >= 0).sum(axis=1) >= LEAST_PIXELS]
            found.append(some)
            places.append(np.full(some.size, place))
        return np.concatenate(found), np.concatenate(places)

    def _cost(self, node: IntArray, place: IntArray, label: IntArray) -> FloatArray:
        """Cost of nodes on smooth surfaces; infinite where these miss or contradict them."""
        pixel, nodes = self._pixel[node], self._nodes
        mean, variance, slope, seen = predict(self._view, self._segment, self._scales, pixel, place)
        range_mm = 1.0 / nodes.inverse[node]
        own = nodes.variance[node] * range_mm**4 + (nodes.shift[node] * slope) ** 2
        squared = (range_mm - mean) ** 2 / (own + variance)
        size = np.bincount(self._segment[self._segment >= 0], minlength=len(self._scales.bend))[place]
        cost = squared + np.log(own + variance) + self._apart(pixel, self._planes + place, label)
        cost = cost + self._settings.surface_cost / size
        return np.where(seen & (squared < self._settings.most_sigmas**2), cost, np.inf)

    def _plane_cost(self, node: IntArray, label: IntArray) -> FloatArray:
        """Cost of nodes on the planes that they are of; infinite where hardly any pixel sees the plane alone.

        Layers of mixed pixels along an upright limb lie on a plane, too.
        """
        nodes, surface = self._nodes, label[node]
        direction, plane = nodes.direction[node], self._linked.planes[surface]
        spread = np.einsum("ni,nij,nj->n", direction, self._linked.covariances[surface], direction)
        slopes = [(plane * part[node]).sum(axis=1) for part in (nodes.down, nodes.across)]
        variance = nodes.variance[node] + nodes.shift[node] ** 2 * (slopes[0] ** 2 + slopes[1] ** 2)
        variance = variance + np.maximum(spread, 0.0)
        squared = (nodes.inverse[node] - (plane * direction).sum(axis=1)) ** 2 / variance
        cost = squared + np.log(variance / nodes.inverse[node] ** 4) + self._apart(self._pixel[node], surface, label)
        size = np.maximum(np.bincount(label, minlength=self._planes)[surface], 1)
        seen = np.bincount(label[self._alone[self._view.valid]], minlength=int(label.max()) + 1)[surface]
        return np.where(seen >= self._settings.least_layers, cost + self._settings.surface_cost / size, np.inf)

    def _apart(self, pixel: IntArray, surface: IntArray, label: IntArray) -> FloatArray:
        """Cost of the neighbouring pixels without a surface."""
        beside = np.zeros(pixel.size)
        for number in np.unique(surface).tolist():
            mine = surface == number
            has = self._has(label, number)
            beside[mine] = (count_around(has, 1) - has).ravel()[pixel[mine]]
        return self._settings.apart_cost * (8.0 - beside)

    def _one_each(self, node: IntArray, place: IntArray, cost: FloatArray) -> IntArray:
        """Cheapest choices: each node for one surface, and one node of a pixel for each surface."""
        taken: set[tuple[int, int]] = set()
        out = []
        for k in np.argsort(cost, kind="stable").tolist():
            marks = {(-1, int(node[k])), (int(place[k]), int(self._pixel[node[k]]))}
            if not marks & taken:
                taken |= marks
                out.append(k)
        return np.array(out, dtype=np.int64)


def predict(
    view: View, segment: IntArray, scales: Scales, pixel: IntArray, place: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Predict smooth surfaces in pixels (n,) from their pixels around, without the pixel itself.

    Returns
    -------
    mean, variance, slope, seen : (n,)
        Mean range over the part of the pixel that is hit, mm; its variance, mm^2; the change of the range along a
        pixel's side, mm; whether enough draws hit the pixel.
    """
    members = members_around(view.shape, segment, pixel, place, REACH)
    patches = fit_patches(view, pixel, members, scales.bend[place], scales.third[place])
    patches = patches._replace(covariance=patches.covariance * scales.inflation[place][:, np.newaxis, np.newaxis])
    ranges = drawn_ranges(patches, view.rays(pixel, PLACES_9))
    hit = np.isfinite(ranges)
    parts = hit.sum(axis=2)
    within = np.where(hit, ranges, 0.0).sum(axis=2) / np.maximum(parts, 1)
    off = np.where(hit, ranges - within[..., np.newaxis], 0.0)
    some = parts > 0
    count = np.maximum(some.sum(axis=1), 1)
    mean = np.where(some, within, 0.0).sum(axis=1) / count
    variance = np.where(some, (within - mean[:, np.newaxis]) ** 2, 0.0).sum(axis=1) / count
    # Places spread evenly over a pixel's side have a variance of 1/12 of its square.
    slope = np.sqrt(12.0 * (off**2).sum(axis=(1, 2)) / np.maximum(hit.sum(axis=(1, 2)), 1))
    return mean, variance, slope, some.sum(axis=1) >= LEAST_HITS


def _renumbered(nodes: Nodes, label: IntArray, planes: int, settings: SurfaceSettings) -> Linked:
    """Surfaces by their size; those from the number `planes` on are smooth."""
    new = numbered(label)
    place = np.full(int(new.max()) + 1, -1, np.int32)
    place[new] = np.where(label >= planes, label - planes, -1)
    values = (nodes.inverse, nodes.variance, nodes.shift, nodes.direction, nodes.down, nodes.across)
    fitted, covariances, sizes, _ = fit(new, len(place), *values, settings.link)
    return Linked(label=new, planes=fitted, covariances=covariances, sizes=sizes.astype(np.int64), smooth=place)
