"""From shares of samples to shares of the pixel's area, where samples do not share out by area.

A detector of single photons has a surface's samples in proportion to area times brightness; a camera that keeps the
strongest return has the samples of one surface alone, and its amplitude tells the area. Both need the brightness of
each surface, which amplitudes of the pixels around tell (`tofmix.surfaces.areas`).

How bright each surface would be if it filled a pixel: from the amplitudes of the pixels that it fills around.

The logarithm of A r^2 of a surface changes slowly from pixel to pixel (incidence, vignetting), and its texture scatters
about that. A plane in row and column is fitted to the pixels near by, with a prior on its slopes; its variance at the
pixel, with the scatter, is that of the logarithm of the brightness.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.sensor_schema import ShareLaw
from tofmix.surfaces.found import NO_SURFACE
from tofmix.surfaces.linking import Linked
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.settings import DEFAULT_SETTINGS, BrightnessSettings
from tofmix.surfaces.shares import Shares


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
    median_deviation = 1.482602218505602  # a Gaussian's standard deviation over its median absolute deviation
    return max(float(np.median(np.abs(off)) * median_deviation / np.sqrt(1.25)), settings.least_scatter)


_PAIR = 2  # a surface and the one beside it


class Areas(NamedTuple):
    """Shares of the area, and the number of mixed pixels whose shares of samples stand for areas untold."""

    shares: Shares
    assumed: int


def to_areas(
    shares: Shares,
    law: ShareLaw | None,
    layers: Layers,
    nodes: Nodes,
    linked: Linked,
    settings: BrightnessSettings = DEFAULT_SETTINGS.brightness,
) -> Areas:
    """Turn the shares of a window into areas.

    Parameters
    ----------
    shares : Shares
        Of the samples.
    law : ShareLaw or None
        The camera's; None is not known, and counts as area.
    layers : Layers
        Of the leading shape (row, col).
    nodes, linked : Nodes, Linked
        Their nodes, and the surfaces of these.
    """
    unmixed = np.zeros(layers.shape, bool) if layers.mixing is None else layers.mixing == int(Mixing.PHASOR)
    mixed = (shares.entries > 1) & ~unmixed
    if law is ShareLaw.AREA:
        return Areas(shares, 0)
    if law is None or layers.amplitude is None:
        return Areas(shares, int(mixed.sum()))
    bright = measure_brightness(layers.amplitude, nodes, linked.label, settings)
    turned = _Turned(shares, bright, _light_of_entries(shares, layers, nodes, linked), settings)
    at_edge: BoolArray = (shares.entries > 0) & ~bright.inside & ~unmixed
    turn = turned.by_detections if law is ShareLaw.DETECTIONS else turned.by_strongest
    told = np.zeros(layers.shape, bool)
    rows, cols = np.nonzero(at_edge)
    for row, col in zip(rows.tolist(), cols.tolist(), strict=True):
        told[row, col] = turn(row, col)
    return Areas(turned.areas(), int((mixed & ~told).sum()))


def _light_of_entries(shares: Shares, layers: Layers, nodes: Nodes, linked: Linked) -> FloatArray:
    """Mean amplitude (row, col, entry) of the samples of each entry; NaN where it is not known."""
    amplitude: Float32Array | None = layers.amplitude
    if amplitude is None:
        raise ValueError("the layers have no amplitudes")
    used = nodes.index >= 0
    label = np.where(used, linked.label[nodes.index], NO_SURFACE)
    weight = np.where(used, layers.weight, 0.0).astype(np.float64)
    light = np.full(shares.label.shape, np.nan)
    for entry in range(layers.max_layers + 1):
        ours: BoolArray = (
            used & (label == shares.label[:, :, entry : entry + 1]) & (entry < shares.entries)[..., np.newaxis]
        )
        whole = np.where(ours, weight, 0.0).sum(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            light[..., entry] = np.where(ours, weight * amplitude, 0.0).sum(axis=-1) / whole
    return light


def _of_others(values: FloatArray, area: FloatArray) -> FloatArray:
    """Mean (entry,) of the values of the other entries, by their areas."""
    return np.array([np.average(np.delete(values, k), weights=np.delete(area, k)) for k in range(len(values))])


class _Turned:
    """Shares while they become areas, pixel by pixel."""

    def __init__(self, shares: Shares, bright: Brightness, light: FloatArray, settings: BrightnessSettings) -> None:
        arrays = {
            name: getattr(shares, name).copy() for name in ("entries", "label", "inverse", "up_to", "samples", "floor")
        }
        self._before, self.shares = shares, shares._replace(**arrays)
        self._bright, self._light, self._settings = bright, light, settings
        self._common: list[float] = []

    def by_detections(self, row: int, col: int) -> bool:
        """Divide the shares of a pixel by brightness; whether it could be told."""
        before, out = self._before, self.shares
        count = int(before.entries[row, col])
        label = before.label[row, col, :count]
        if count == 1:
            return self._weigh_single(row, col)
        if (label == NO_SURFACE).any():  # the light that open space returns is no number
            return False
        part = np.diff(before.up_to[row, col, :count], prepend=0.0)
        log_light, of_mean, own = self._lights(row, col, label, before.inverse[row, col, :count])
        if not np.isfinite(log_light).all():
            return False
        area = part * np.exp(log_light.min() - log_light)
        area /= area.sum()
        # Of the logarithm of an area's odds: the samples', and the brightness of it and of the others.
        samples = part * (1.0 - part) * before.samples[row, col]
        of_samples = 1.0 / np.maximum(samples, self._settings.least_samples)
        of_light, of_means = (values + _of_others(values, area) for values in (of_mean + own, of_mean))
        of_area = (area * (1.0 - area)) ** 2 * (of_samples + of_light)
        self._common.append(float(np.mean(of_means / (of_samples + of_light))))
        out.up_to[row, col, :count] = np.append(np.cumsum(area)[:-1], 1.0)
        out.samples[row, col] = float(np.mean(area * (1.0 - area) / np.maximum(of_area, np.finfo(float).tiny)))
        return True

    def _weigh_single(self, row: int, col: int) -> bool:
        """Tell what a pixel with one surface may see of another one beside it without its being found.

        A share q = k a / (k a + 1 - a) of the samples for the ratio k of their brightness: the darker the other one is,
        the more of the pixel it may cover.
        """
        label, inverse = self._behind(row, col)
        if label == NO_SURFACE:
            return False
        before = self._before
        own = int(before.label[row, col, 0])
        log_light, *_ = self._lights(row, col, np.array([own, label]), np.array([before.inverse[row, col, 0], inverse]))
        if not np.isfinite(log_light).all():
            return False
        ratio, unseen = np.exp(log_light[0] - log_light[1]), self._settings.unseen_samples
        area = unseen * ratio / (before.samples[row, col] + unseen * (ratio - 1.0))
        self.shares.floor[row, col] = (min(area, 1.0) / 2.0) ** 2
        return True

    def by_strongest(self, row: int, col: int) -> bool:
        """Tell the area of the returned surface by its amplitude; whether it could be told."""
        before, out = self._before, self.shares
        count = int(before.entries[row, col])
        label, inverse = before.label[row, col, :count].copy(), before.inverse[row, col, :count].copy()
        light, known = self._light[row, col, :count], label != NO_SURFACE
        if count > _PAIR or not known[0]:
            return False
        log_light, of_mean, own = self._lights(row, col, label[known], inverse[known])
        with np.errstate(invalid="ignore", divide="ignore"):
            area = np.exp(np.log(light[known]) - log_light)
        if not np.isfinite(area).all():
            return False
        out.samples[row, col] = 1e6  # no count: the error of its amplitude is all of its variance
        spread = area**2 * (of_mean + own)
        self._common.append(float(np.mean(of_mean / (of_mean + own))))
        if known.sum() == _PAIR:  # two estimates; a return that is kept is brighter than in the mean
            near = np.average([area[0], 1.0 - area[1]], weights=1.0 / spread)
            error = 1.0 / (1.0 / spread).sum() + ((1.0 - area.sum()) / 2.0) ** 2
        else:
            near, error = area[0], spread[0]
            if count == 1:
                behind, inverse_behind = self._behind(row, col)
                missing = 1.0 - near
                if missing < self._settings.missing_sigmas * np.sqrt(error):
                    out.floor[row, col] = error
                    return True
                label, inverse = np.append(label, behind), np.append(inverse, inverse_behind)
                if inverse_behind > inverse[0]:
                    label, inverse, near = label[::-1], inverse[::-1], missing
        out.entries[row, col] = _PAIR
        out.label[row, col, :_PAIR], out.inverse[row, col, :_PAIR] = label, inverse
        out.up_to[row, col, 0], out.up_to[row, col, 1:] = np.clip(near, 0.0, 1.0), 1.0
        out.floor[row, col] = error
        return True

    def areas(self) -> Shares:
        """The shares, with the part of their variance that pixels near by have in common."""
        return self.shares._replace(common=float(np.mean(self._common))) if self._common else self.shares

    def _lights(
        self, row: int, col: int, label: NDArray[np.int32], inverse: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Logarithm of the amplitude of surfaces that fill the pixel; variance of the mean there, and of its own."""
        found = [brightness_at(self._bright, int(one), row, col, self._settings) for one in label]
        log_light, of_mean, own = np.array(found).T
        return log_light + 2.0 * np.log(inverse), of_mean, own

    def _behind(self, row: int, col: int) -> tuple[int, float]:
        """The other surface that most of the pixels around see, and its 1 / r there; open space without one."""
        before = self._before
        own = int(before.label[row, col, 0])
        part = (slice(max(0, row - 1), row + 2), slice(max(0, col - 1), col + 2))
        label, inverse = before.label[part], before.inverse[part]
        seen = (np.arange(label.shape[-1]) < before.entries[part][..., np.newaxis]) & (label != own)
        if not seen.any():
            return NO_SURFACE, 0.0
        values, often = np.unique(label[seen], return_counts=True)
        most = int(values[often.argmax()])
        return most, float(np.mean(inverse[seen & (label == most)]))
