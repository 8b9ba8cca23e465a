"""How bright each surface would be if it filled a pixel: from the amplitudes of the pixels that it fills around.

The logarithm of A r^2 of a surface changes slowly from pixel to pixel (incidence, vignetting), and its texture scatters
about that. A plane in row and column is fitted to the pixels near by, with a prior on its slopes; its variance at the
pixel, with the scatter, is that of the logarithm of the brightness.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.settings import BrightnessSettings

_MEDIAN_DEVIATION = 1.482602218505602
"""A Gaussian's standard deviation over its median absolute deviation."""


class Brightness(NamedTuple):
    """Logarithm of A r^2, r in mm, of the surface that alone fills a pixel.

    Parameters
    ----------
    log_light : (row, col) float64
        NaN where no surface fills the pixel, or its amplitude is not known.
    label : (row, col) int32
        The surface; -1: none fills it.
    inside : (row, col) bool
        Whether no other surface is in the eight pixels around.
    scatter : dict of int to float
        Standard deviation of `log_light` about its neighbours, of each surface.
    """

    log_light: FloatArray
    label: NDArray[np.int32]
    inside: BoolArray
    scatter: dict[int, float]


def measure_brightness(
    amplitude: Float32Array, nodes: Nodes, label: NDArray[np.int32], settings: BrightnessSettings
) -> Brightness:
    """Collect the light of the pixels that one surface fills.

    Parameters
    ----------
    amplitude : (row, col, layer) float32
        Mean amplitude of each layer; NaN where it is not known.
    nodes : Nodes
        Of the window.
    label : (node,) int32
        Surface of each.
    settings : BrightnessSettings
        Thresholds.
    """
    used = nodes.index >= 0
    alone = used.sum(axis=-1) == 1
    layer = used.argmax(axis=-1)
    node = np.where(alone, np.take_along_axis(nodes.index, layer[..., np.newaxis], axis=-1)[..., 0], 0)
    light = np.take_along_axis(amplitude, layer[..., np.newaxis], axis=-1)[..., 0].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_light = np.where(alone & (light > 0), np.log(light) - 2.0 * np.log(nodes.inverse[node]), np.nan)
    whose = np.where(alone, label[node], -1).astype(np.int32)
    around = [_moved(whose, down, right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    inside = alone & np.all([place == whose for place in around], axis=0)
    scatter = {int(one): _scatter(log_light, inside & (whose == one), settings) for one in np.unique(whose[alone])}
    return Brightness(log_light, whose, inside, scatter)


class Light(NamedTuple):
    """Logarithm of A r^2 of a surface at a pixel; the variance of its mean there, and of the pixel's own about that."""

    log_light: float
    of_mean: float
    own: float


def brightness_at(bright: Brightness, surface: int, row: int, col: int, settings: BrightnessSettings) -> Light:
    """Light of a surface at a pixel; NaN and of infinite variance if no pixel near by tells it.

    Pixels inside the surface tell it; where it is too thin to have any, those at its ends do.
    """
    reach = settings.reach
    part = (slice(max(0, row - reach), row + reach + 1), slice(max(0, col - reach), col + reach + 1))
    ours = (bright.label[part] == surface) & np.isfinite(bright.log_light[part])
    inside = ours & bright.inside[part]
    chosen = inside if inside.sum() >= settings.least_pixels else ours
    if not chosen.any():
        return Light(np.nan, np.inf, np.inf)
    at_row, at_col = np.nonzero(chosen)
    light = bright.log_light[part][chosen]
    variance = bright.scatter[surface] ** 2
    columns = np.stack([np.ones(len(light)), at_row + part[0].start - row, at_col + part[1].start - col])
    prior = np.diag([0.0, settings.slope**-2, settings.slope**-2])
    covariance = np.linalg.inv(columns @ columns.T / variance + prior)
    return Light(float(covariance[0] @ (columns @ light) / variance), float(covariance[0, 0]), variance)


def _moved(values: NDArray[np.int32], down: int, right: int) -> NDArray[np.int32]:
    """Values of the pixels `down` and `right` of each; of the border those at the border."""
    rows, cols = (np.arange(size) for size in values.shape)
    return values[np.ix_(np.clip(rows + down, 0, len(rows) - 1), np.clip(cols + right, 0, len(cols) - 1))]


def _scatter(log_light: FloatArray, inside: BoolArray, settings: BrightnessSettings) -> float:
    """Standard deviation of light about the mean of its four neighbours, of pixels inside a surface."""
    light = np.where(inside, log_light, np.nan)
    here = light[1:-1, 1:-1]
    around = (light[:-2, 1:-1] + light[2:, 1:-1] + light[1:-1, :-2] + light[1:-1, 2:]) / 4.0
    off = (here - around)[np.isfinite(here - around)]
    if len(off) < settings.least_scatter_pixels:
        return settings.usual_scatter
    return max(float(np.median(np.abs(off)) * _MEDIAN_DEVIATION / np.sqrt(1.25)), settings.least_scatter)
