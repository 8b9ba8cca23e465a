"""Simple ways from shares to parts of pixels, to stand beside the reconstruction: they get the true links of layers.

Whole pixels, bilinear and bicubic interpolation of the share of all surfaces up to the nearer one (edge at 0.5), and
Youngs' method: a straight edge in each pixel, across the gradient of the shares of 3 x 3 pixels, that keeps the pixel's
own share. All take the surfaces of a pixel from near to far, and know the true surface of each layer. For scenes with a
wall behind all else.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from support.edges import matched
from support.plates import PARTS, Scene
from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.layers import Layers

_OFFSETS = (np.arange(PARTS) - (PARTS - 1) / 2) / PARTS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Labelled:
    """Shares by true surface.

    `row`, `col` are the pixels with several surfaces, `label` (pixel, layer) their true surfaces from near to far, -1
    past the last; `shares` (surface, row, col) of all pixels.
    """

    row: IntArray
    col: IntArray
    label: IntArray
    shares: FloatArray

    @property
    def patches(self) -> FloatArray:
        """Shares (pixel, layer, 3, 3) of each layer's surface and all nearer ones around each pixel."""
        padded = np.pad(self.shares, ((0, 1), (1, 1), (1, 1)), mode="edge")
        padded[-1] = 0.0  # of no surface
        around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))
        return np.asarray(np.cumsum(around[self.label, self.row[:, np.newaxis], self.col[:, np.newaxis]], axis=1))


def _labelled(one: Scene, layers: Layers) -> _Labelled:
    label = matched(one, layers, any_distance=True)
    weight = np.where(label >= 0, layers.weight, 0.0).astype(float)
    shares = np.stack([np.where(label == k, weight, 0.0).sum(axis=-1) for k in range(len(one.plates))])
    shares /= np.maximum(shares.sum(axis=0), 1e-9)
    for k in range(1, layers.max_layers):  # a surface that was found twice is one
        again = (label[..., :k] == label[..., k : k + 1]).any(axis=-1)
        label[..., k] = np.where(again, -1, label[..., k])
    row, col = np.nonzero((label >= 0).sum(axis=-1) > 1)
    return _Labelled(row=row, col=col, label=label[row, col], shares=shares)


def _painted(layers: Layers, cells: _Labelled, inside: BoolArray) -> FloatArray:
    """Range image of parts; with several surfaces, of the first layer that a part (pixel, layer, 64) is inside."""
    rows, cols = layers.shape
    largest = np.nan_to_num(layers.weight, nan=-1.0).argmax(axis=-1)
    whole = np.take_along_axis(layers.range, largest[..., np.newaxis], -1)[..., 0].astype(float)
    out = np.repeat(np.repeat(whole, PARTS, axis=0), PARTS, axis=1).reshape(rows, PARTS, cols, PARTS)
    there = cells.label >= 0
    last = there.shape[1] - 1 - there[:, ::-1].argmax(axis=1)
    inside = inside & there[:, :, np.newaxis]
    inside[np.arange(len(last)), last] = True
    pick = inside.argmax(axis=1)
    ranges = np.take_along_axis(layers.range[cells.row, cells.col].astype(float), pick, axis=1)
    out[cells.row, :, cells.col, :] = ranges.reshape(-1, PARTS, PARTS)
    return np.asarray(out.reshape(rows * PARTS, cols * PARTS))


def whole_pixels(one: Scene, layers: Layers) -> FloatArray:
    """Each pixel all of the surface with the largest share."""
    cells = _labelled(one, layers)
    none = _Labelled(row=cells.row[:0], col=cells.col[:0], label=cells.label[:0], shares=cells.shares)
    return _painted(layers, none, np.zeros((0, layers.max_layers, PARTS**2), dtype=bool))


def bilinear(one: Scene, layers: Layers) -> FloatArray:
    """Shares interpolated between the centres of pixels."""
    return _interpolated(one, layers, 1)


def bicubic(one: Scene, layers: Layers) -> FloatArray:
    """Shares interpolated by cubic splines."""
    return _interpolated(one, layers, 3)


def _interpolated(one: Scene, layers: Layers, order: Literal[1, 3]) -> FloatArray:
    cells = _labelled(one, layers)
    down = (cells.row[:, np.newaxis, np.newaxis] + _OFFSETS[:, np.newaxis] + np.zeros(PARTS)).reshape(-1, PARTS**2)
    across = (cells.col[:, np.newaxis, np.newaxis] + np.zeros((PARTS, 1)) + _OFFSETS).reshape(-1, PARTS**2)
    values = np.zeros((*cells.label.shape, PARTS**2))
    for k, share in enumerate(cells.shares):
        pixel, layer = np.nonzero(cells.label == k)
        smooth = np.asarray(spline_filter(share, order=order, mode="nearest") if order == 3 else share, np.float64)
        values[pixel, layer] = map_coordinates(
            smooth, np.stack([down[pixel], across[pixel]]), order=order, mode="nearest", prefilter=False
        )
    return _painted(layers, cells, np.cumsum(values, axis=1) >= 0.5)


def youngs(one: Scene, layers: Layers) -> FloatArray:
    """A straight edge in each pixel that keeps its own share."""
    cells = _labelled(one, layers)
    normal, reach = youngs_lines(cells.patches)
    y, x = (part.ravel() for part in np.meshgrid(_OFFSETS, _OFFSETS, indexing="ij"))
    return _painted(layers, cells, normal[..., :1] * y + normal[..., 1:] * x <= reach[..., np.newaxis])


def youngs_points(one: Scene, layers: Layers) -> tuple[FloatArray, FloatArray]:
    """Places (row, col) of the middle of the nearest surface's edge in each pixel with several."""
    cells = _labelled(one, layers)
    normal, reach = youngs_lines(cells.patches[:, 0])
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    foot = normal * reach[:, np.newaxis]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(-0.5 - foot) / along, (0.5 - foot) / along])
    ends = np.where(np.isfinite(ends), ends, np.array([-np.inf, np.inf])[:, np.newaxis, np.newaxis])
    low, high = np.sort(ends, axis=0)
    middle = 0.5 * (low.max(axis=-1) + high.min(axis=-1))
    place = foot + middle[:, np.newaxis] * along
    return cells.row + place[:, 0], cells.col + place[:, 1]


def youngs_lines(patches: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edges n . (row, col) = c of shares (..., 3, 3): the unit vector n (..., 2) away from the surface, and c (...)."""
    sides = np.array([1.0, 2.0, 1.0])
    down = (patches[..., 0, :] - patches[..., 2, :]) @ sides
    across = (patches[..., :, 0] - patches[..., :, 2]) @ sides
    length = np.hypot(down, across)
    flat = length < 1e-12
    normal = np.stack([np.where(flat, 1.0, down), np.where(flat, 0.0, across)], axis=-1)
    normal /= np.where(flat, 1.0, length)[..., np.newaxis]
    return normal, reach_of_area(normal, patches[..., 1, 1])


def reach_of_area(normal: FloatArray, area: FloatArray) -> FloatArray:
    """Distance c (...) of the line n . x = c from the centre of a unit square of which n . x <= c is this area.

    Scardovelli and Zaleski, J. Comput. Phys. 164 (2000), 228-237.
    """
    size = np.abs(normal).sum(axis=-1)
    least = np.abs(normal).min(axis=-1) / size
    most = 1.0 - least
    area = np.clip(area, 0.0, 1.0)
    less = np.minimum(area, 1.0 - area)
    corner = less < least / (2.0 * most)
    along = np.where(corner, np.sqrt(2.0 * least * most * less), most * less + 0.5 * least)
    return np.asarray(size * np.where(area <= 0.5, along - 0.5, 0.5 - along))


RIVALS = {"whole pixels": whole_pixels, "bilinear": bilinear, "bicubic": bicubic, "Youngs": youngs}
"""By name."""
