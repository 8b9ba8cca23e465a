"""Shares of the surfaces in each pixel, near to far: the known areas that they cover.

Cuts: where a surface ends within a pixel, or at its border.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.flags import Mixing, Status
from tofmix.layers import Layers
from tofmix.surfaces.found import NO_SURFACE
from tofmix.surfaces.linking import Linked
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.settings import ShareSettings
from tofmix.surfaces.smooth_fits import Shapes, inverses_of


class Shares(NamedTuple):
    """The surfaces of each pixel, near to far; open space is the last entry.

    Parameters
    ----------
    entries : (row, col) int32
        How many each pixel has; 0: unknown.
    label : (row, col, entry) int32
        Surface of each entry; `NO_SURFACE`: open space.
    inverse : (row, col, entry) float64
        1 / r of each, 1/mm; 0 for open space.
    up_to : (row, col, entry) float64
        Share of the beam of an entry and of all nearer ones; 1 for the last.
    samples : (row, col) float64
        Samples that a share is worth: its variance is share (1 - share) / samples.
    floor : (row, col) float64
        Further variance of a share, of what a pixel may see without its being noticed.
    common : float
        Part of a share's variance that it has in common with the pixels near by; 0 where shares are counts.
    """

    entries: NDArray[np.int32]
    label: NDArray[np.int32]
    inverse: FloatArray
    up_to: FloatArray
    samples: FloatArray
    floor: FloatArray
    common: float = 0.0


def make_shares(layers: Layers, nodes: Nodes, linked: Linked, settings: ShareSettings) -> Shares:
    """Collect the shares of a window: layers (row, col), their nodes and the surfaces of these."""
    rows, cols, depth = nodes.index.shape
    used = nodes.index >= 0
    weight = np.where(used, layers.weight, 0.0).astype(np.float64)
    nothing = np.nan_to_num(layers.weight_no_return.astype(np.float64))
    total_samples = np.maximum(layers.n_samples.astype(np.float64), 1.0)
    nothing = np.where(nothing * total_samples >= settings.least_open_samples, nothing, 0.0)
    whole = weight.sum(axis=-1) + nothing
    # A pixel whose layers are not all of a surface says nothing.
    known: BoolArray = (whole > 0) & ~(np.isfinite(layers.range) & ~used).any(axis=-1)
    known &= layers.status != int(Status.TOO_FEW_SAMPLES)
    label = np.full((rows, cols, depth + 1), NO_SURFACE, np.int32)
    inverse = np.zeros((rows, cols, depth + 1))
    up_to = np.ones((rows, cols, depth + 1))
    count = np.zeros((rows, cols), np.int32)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(known[..., np.newaxis], weight / whole[..., np.newaxis], 0.0)
    surface = np.where(used, np.append(linked.label, NO_SURFACE)[nodes.index], NO_SURFACE)
    # Layers of one surface in a pixel are one entry: the first that is seen stands for all.
    again = np.zeros_like(used)
    for k in range(1, depth):
        again[..., k] = used[..., k] & (surface[..., :k] == surface[..., k : k + 1]).any(axis=-1)
    for k in range(1, depth):
        row, col = np.nonzero(again[..., k])
        first_seen = (surface[row, col] == surface[row, col, k][:, np.newaxis]).argmax(axis=1)
        np.add.at(share, (row, col, first_seen), share[row, col, k])
        share[row, col, k] = 0.0
    used = used & ~again
    row, col, layer = np.nonzero(used & known[..., np.newaxis])
    place = (np.cumsum(used, axis=-1) - 1)[row, col, layer]
    node = nodes.index[row, col, layer]
    label[row, col, place] = linked.label[node]
    inverse[row, col, place] = nodes.inverse[node]
    up_to[row, col, place] = np.cumsum(share, axis=-1)[row, col, layer]
    np.add.at(count, (row, col), 1)
    last = count.copy()
    is_open = known & (nothing > 0)
    count += is_open
    # The last entry fills the pixel, whatever the rounding.
    closed = known & ~is_open
    up_to[closed, last[closed] - 1] = 1.0
    errors = _errors(layers, share, count, total_samples, settings.unseen_share)
    common = settings.common_variance if errors["floor"].any() else 0.0
    return Shares(entries=count, label=label, inverse=inverse, up_to=up_to, common=common, **errors)


def _errors(
    layers: Layers, share: FloatArray, count: NDArray[np.int32], total_samples: FloatArray, unseen: float
) -> dict[str, FloatArray]:
    """Effective samples of the shares of each pixel, and the share that may be missed."""
    error = layers.weight_stderr.astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        effective = share * (1.0 - share) / error**2
    told = np.isfinite(effective) & (effective > 0) & (share > 0) & (share < 1)
    effective = np.where(told, effective, 0.0).sum(axis=-1) / np.maximum(told.sum(axis=-1), 1)
    mixed = (count > 1) & (effective > 0)
    floor = np.zeros(count.shape)
    if layers.mixing is None or not (layers.mixing == int(Mixing.PHASOR)).any():
        return {"samples": np.where(mixed, effective, total_samples), "floor": floor}
    usual = float(np.median(effective[mixed])) if mixed.any() else 1.0
    floor[~mixed] = unseen**2
    return {"samples": np.where(mixed, effective, usual), "floor": floor}


class Cuts(NamedTuple):
    """The cuts of one window, by row, column, and near to far.

    Parameters
    ----------
    row, col : (cut,) int32
        Pixel.
    near, far : (cut,) int32
        Surface that ends there, and the next one that the pixel sees; `NO_SURFACE`: open space.
    first : (row, col) int32
        Number of the first cut of each pixel; -1: it has none.
    following : (cut,) int32
        Number of the pixel's next cut; -1 after the last.
    entry : (cut,) int32
        Cuts of the pixel that are nearer.
    margin : (cut,) float64
        Distance beyond the pixel's border up to which the edge may lie: 0 for a cut within the pixel.
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    near: NDArray[np.int32]
    far: NDArray[np.int32]
    first: NDArray[np.int32]
    following: NDArray[np.int32]
    entry: NDArray[np.int32]
    margin: FloatArray


def make_cuts(shares: Shares, planes: Shapes, directions: FloatArray, settings: ShareSettings) -> Cuts:
    """Make a cut between each two entries of a pixel, and one in each pixel at whose border its only surface ends.

    Parameters
    ----------
    shares : Shares
        Surfaces in each pixel.
    planes : Shapes
        Of the surfaces.
    directions : (row, col, 3) float64
        Unit vectors d.
    """
    entries = np.arange(shares.label.shape[2] - 1)
    row, col, entry = np.nonzero(entries < shares.entries[..., np.newaxis] - 1)
    at_border, behind = _borders(shares, planes, directions, settings.crease)
    border = np.nonzero(at_border)
    number = np.arange(len(row) + len(border[0]), dtype=np.int32)
    inner = number[: len(row)]
    first = np.full(shares.entries.shape, -1, np.int32)
    first[row[entry == 0], col[entry == 0]] = inner[entry == 0]
    first[border] = number[len(row) :]
    last = entry == shares.entries[row, col] - 2
    return Cuts(
        row=np.concatenate([row, border[0]]).astype(np.int32),
        col=np.concatenate([col, border[1]]).astype(np.int32),
        near=np.concatenate([shares.label[row, col, entry], shares.label[(*border, 0)]]),
        far=np.concatenate([shares.label[row, col, entry + 1], behind[border]]),
        first=first,
        following=np.concatenate([np.where(last, -1, inner + 1), np.full(len(border[0]), -1)]).astype(np.int32),
        entry=np.concatenate([entry, np.zeros(len(border[0]))]).astype(np.int32),
        margin=np.where(number < len(row), 0.0, settings.border_margin),
    )


def _borders(
    shares: Shares, planes: Shapes, directions: FloatArray, crease: float
) -> tuple[BoolArray, NDArray[np.int32]]:
    """Pixels (row, col) that one surface fills and next to which it is not seen, and the surface behind it there."""
    rows, cols = shares.entries.shape
    alone = (shares.entries == 1) & (shares.label[..., 0] != NO_SURFACE)
    found = np.zeros((rows, cols), bool)
    behind = np.full((rows, cols), NO_SURFACE, np.int32)
    places = np.indices((rows, cols))
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        here = (slice(max(0, -down), rows - max(0, down)), slice(max(0, -right), cols - max(0, right)))
        there = (slice(max(0, down), rows - max(0, -down)), slice(max(0, right), cols - max(0, -right)))
        surface = shares.label[here][..., 0]
        plane = inverses_of(planes, surface, places[0][there], places[1][there], directions)
        ends = (
            alone[here] & (shares.entries[there] > 0) & (shares.label[there] != surface[..., np.newaxis]).all(axis=-1)
        )
        ends &= (plane > 0) & (shares.inverse[there][..., 0] * (1.0 + crease) < plane)
        new = ends & ~found[here]
        behind[here][new] = shares.label[there][..., 0][new]
        found[here] |= ends
    return found, behind
