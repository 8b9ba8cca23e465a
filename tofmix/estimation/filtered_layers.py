"""Layers of independent samples behind a temporal filter, as layers of the samples before it.

`layer_pixels` calls `layers_before_filter` last. Exponential averages are undone in the samples, and change nothing here.
"""

from itertools import pairwise

import numpy as np

from tofmix.flags import MOST_UNDECIDED, Mixing
from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.temporal_filter import RunningMedian


def layers_before_filter(layers: Layers, sensor: Sensor) -> None:
    """Change layers of the leading shape (pixel,) in place, if the camera has a filter.

    Medians: shares and ranges become those of the samples (`RunningMedian`). Filters whose samples may be of several
    surfaces: pixels of several layers are undecided.
    """
    found = sensor.temporal_filter
    if found is None:
        return
    if not found.separates and layers.mixing is not None:
        several = layers.n_modes > 1
        layers.mixing[several] = int(Mixing.UNDECIDED)
        layers.probability[several] = np.minimum(layers.probability[several], np.float32(MOST_UNDECIDED))
    if isinstance(found, RunningMedian):
        _before_median(layers, sensor, found)


def _before_median(layers: Layers, sensor: Sensor, median: RunningMedian) -> None:
    """Shares and ranges of pixels of several layers, or of a layer and no return, before a median."""
    weight = np.nan_to_num(layers.weight.astype(np.float64))
    none = np.nan_to_num(layers.weight_no_return.astype(np.float64))
    mixed = np.flatnonzero((layers.n_modes > 1) | ((layers.n_modes == 1) & (none > 0.0)))
    if not mixed.size:
        return
    place = sensor.no_return_mm if sensor.no_return_mm is not None else sensor.range_max_mm
    far = np.inf if place is None else place
    at = np.concatenate([layers.range[mixed].astype(np.float64), np.full((mixed.size, 1), far)], axis=1)
    at[:, :-1][np.isnan(at[:, :-1])] = np.inf  # past the last layer, where shares are 0
    shares = np.concatenate([weight[mixed], none[mixed, None]], axis=1)
    order = np.argsort(at, axis=1, kind="stable")
    whole = shares.sum(axis=1, keepdims=True)
    ordered = np.take_along_axis(shares, order, axis=1) / whole
    found, slope = median.samples_shares(ordered)
    back = np.argsort(order, axis=1)
    new, factor = (np.take_along_axis(part, back, axis=1) for part in (found * whole, slope))
    present = np.isfinite(layers.weight[mixed])
    layers.weight[mixed] = np.where(present, new[:, :-1], layers.weight[mixed])
    layers.weight_stderr[mixed] *= factor[:, :-1].astype(np.float32)
    layers.weight_no_return[mixed] = new[:, -1]
    ends = np.concatenate([np.zeros((mixed.size, 1)), np.cumsum(found, axis=1)], axis=1)
    alone = median.moments(0.0, 1.0)[1]
    for row, pixel in enumerate(mixed.tolist()):
        parts = list(pairwise(np.clip(ends[row], 0.0, 1.0).tolist()))
        for layer in range(int(layers.n_modes[pixel])):
            mean, _ = median.moments(*parts[back[row, layer]])
            layers.range[pixel, layer] -= np.float32(mean * layers.sigma[pixel, layer] / alone)
