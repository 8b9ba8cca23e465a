"""The layers of one window as nodes: inverse range, its variance and its beam, for the linking into surfaces.

A plane has 1/r = m . d with the unit vector d of the beam: linear in the three numbers m of the plane, and exact on any
grid of pixels.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.surfaces.edge_shape import UNIFORM_VARIANCE
from tofmix.surfaces.settings import DEFAULT_SETTINGS, LinkSettings

_MEDIAN_CHI2 = round(NormalDist().inv_cdf(0.75) ** 2, 7)
"""Median of chi-square with one degree of freedom, Phi^-1(3/4)^2, to seven decimals."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nodes:
    """Layers that may be of a surface, by row, column and layer.

    Parameters
    ----------
    index : (row, col, layer) int32
        Number of the node of each layer, -1 without one.
    row, col : (node,) int32
        Pixel.
    inverse : (node,) float64
        1 / r, 1/mm.
    variance : (node,) float64
        Of `inverse`; includes the scatter of neighbours on a plane beyond their standard errors.
    shift : (node,) float64
        Standard deviation of where in the pixel a layer is seen, pixels, along rows and columns: 0 if it fills the
        pixel.
    direction, down, across : (node, 3) float64
        Unit vector of the beam, and its change from row to row and from column to column.
    """

    index: NDArray[np.int32]
    row: NDArray[np.int32]
    col: NDArray[np.int32]
    inverse: FloatArray
    variance: FloatArray
    shift: FloatArray
    direction: FloatArray
    down: FloatArray
    across: FloatArray

    def __len__(self) -> int:
        """Nodes."""
        return len(self.row)


def used_layers(layers: Layers, least_probability: float) -> BoolArray:
    """Layers (row, col, layer) that may be of a surface: neither undecided nor improbable nor suspect."""
    used = layers.unsuspected & (layers.range > 0)
    used &= ~(layers.probability < least_probability)
    if layers.mixing is not None:
        used &= (layers.mixing != int(Mixing.UNDECIDED))[..., np.newaxis]
    return np.asarray(used)


def make_nodes(layers: Layers, directions: FloatArray, settings: LinkSettings = DEFAULT_SETTINGS.link) -> Nodes:
    """Make the nodes of a window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    directions : (row, col, 3) float64
        Unit vectors along the beams.
    """
    used = used_layers(layers, settings.least_probability)
    row, col, layer = np.nonzero(used)
    index = np.full(used.shape, -1, dtype=np.int32)
    index[row, col, layer] = np.arange(len(row))
    range_mm = layers.range[row, col, layer].astype(np.float64)
    error = layers.range_stderr[row, col, layer].astype(np.float64)
    error = np.where(np.isfinite(error) & (error > 0), error, settings.unknown_error * range_mm)
    inverse, variance = 1.0 / range_mm, (error / range_mm**2) ** 2
    alone = used.sum(axis=-1) == 1
    variance *= _excess(
        np.where(alone, 1.0 / np.where(used, layers.range, np.inf).min(axis=-1), np.nan),
        _pixels(variance, index, alone),
        directions,
    )
    share = layers.weight[row, col, layer].astype(np.float64)
    shift = np.where(alone[row, col], 0.0, math.sqrt(UNIFORM_VARIANCE) * np.clip(1.0 - share, 0.0, 1.0))
    down, across = (_gradient(directions, axis)[row, col] for axis in (0, 1))
    return Nodes(
        index=index,
        row=row.astype(np.int32),
        col=col.astype(np.int32),
        inverse=inverse,
        variance=variance,
        shift=shift,
        direction=np.ascontiguousarray(directions[row, col]),
        down=down,
        across=across,
    )


def _gradient(directions: FloatArray, axis: int) -> FloatArray:
    """Change (row, col, 3) from one pixel to the next; 0 along an axis of one pixel."""
    if directions.shape[axis] == 1:
        return np.zeros_like(directions)
    return np.ascontiguousarray(np.gradient(directions, axis=axis))


def _pixels(values: FloatArray, index: NDArray[np.int32], alone: BoolArray) -> FloatArray:
    """Values (row, col) of the nodes that have their pixel for themselves; NaN elsewhere."""
    out = np.full(alone.shape, np.nan)
    out[alone] = values[index[alone].max(axis=-1)]
    return out


def _excess(inverse: FloatArray, variance: FloatArray, directions: FloatArray) -> float:
    """How many times the variances neighbours on a plane differ by, 1 at least.

    Three beams in a plane have d_0 = a d_- + b d_+; on a flat surface so have their inverse ranges. Of the squared
    misfits in units of their variances the median is compared with chi-square's: steps and creases are few.
    """
    ratios = []
    for axis in (0, 1):
        if inverse.shape[axis] < 3:  # noqa: PLR2004  three pixels in a row
            continue
        first, middle, last = (
            tuple(np.moveaxis(part, axis, 0)[cut] for part in (inverse, variance, directions))
            for cut in (slice(None, -2), slice(1, -1), slice(2, None))
        )
        a, b = _between(first[2], middle[2], last[2])
        misfit = middle[0] - a * first[0] - b * last[0]
        expected = middle[1] + a**2 * first[1] + b**2 * last[1]
        ratio = misfit**2 / expected
        ratios.append(ratio[np.isfinite(ratio)])
    known = np.concatenate(ratios) if ratios else np.zeros(0)
    return max(1.0, float(np.median(known)) / _MEDIAN_CHI2) if len(known) else 1.0


def _between(first: FloatArray, middle: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (a, b) of the middle vector as a sum of the two others, by least squares."""
    ff, ll, fl = ((x * y).sum(axis=-1) for x, y in ((first, first), (last, last), (first, last)))
    fm, lm = ((x * middle).sum(axis=-1) for x in (first, last))
    whole = np.maximum(ff * ll - fl**2, np.finfo(float).tiny)
    return np.asarray((fm * ll - lm * fl) / whole), np.asarray((lm * ff - fm * fl) / whole)
