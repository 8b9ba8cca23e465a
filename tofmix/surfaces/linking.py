"""Linking: which layers are of one plane, and the planes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.surfaces.growing import fit, flatness, grow, reassign
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.settings import DEFAULT_SETTINGS, LinkSettings

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
