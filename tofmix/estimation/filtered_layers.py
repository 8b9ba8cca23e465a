"""Layers of independent samples behind a temporal filter, as layers of the samples before it.

`layer_pixels` calls `layers_before_filter` last. Averages and means are undone in the samples: their layers stay as
they are.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.temporal_filter import RunningMedian


def layers_before_filter(layers: Layers, sensor: Sensor) -> None:
    """Change layers of the leading shape (pixel,) in place, if the camera has a filter.

    Medians: shares and ranges become those of the samples (`RunningMedian`).
    """
    found = sensor.temporal_filter
    if isinstance(found, RunningMedian):
        _before_median(layers, sensor, found)


def _before_median(layers: Layers, sensor: Sensor, median: RunningMedian) -> None:
    """Shares and ranges before a median; errors by the spread and dependence of seen samples.

    Sigma is the curve's: a fit of sigma follows the spread of seen samples, which differs between surfaces.
    """
    curve = sensor.noise
    if curve is not None:
        sigma = curve.sigma(layers.range.astype(np.float64)).astype(np.float32)
        layers.range_stderr[:] *= sigma / layers.sigma
        layers.sigma[:] = sigma
    shares, order = _ordered_shares(layers, sensor)
    whole = np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)
    found, slope = median.shares_of_samples(np.take_along_axis(shares, order, axis=1) / whole)
    back = np.argsort(order, axis=1)
    new, factor = (np.take_along_axis(part, back, axis=1) for part in (found * whole, slope))
    present = np.isfinite(layers.weight)
    layers.weight[:] = np.where(present, new[:, :-1], layers.weight)
    layers.weight_stderr[:] *= factor[:, :-1].astype(np.float32)
    layers.weight_no_return[:] = np.where(np.isfinite(layers.weight_no_return), new[:, -1], layers.weight_no_return)
    ends = np.concatenate([np.zeros((len(found), 1)), np.cumsum(found, axis=1)], axis=1).clip(0.0, 1.0)
    for pixel, layer in np.argwhere(present).tolist():
        place = back[pixel, layer]
        mean, _ = median.moments(float(ends[pixel, place]), float(ends[pixel, place + 1]))
        layers.range[pixel, layer] -= np.float32(mean * layers.sigma[pixel, layer])
    dependence = median.dependence()
    layers.range_stderr[:] *= np.float32(median.moments(0.0, 1.0)[1] * math.sqrt(dependence))
    layers.weight_stderr[:] *= np.float32(math.sqrt(dependence))


def _ordered_shares(layers: Layers, sensor: Sensor) -> tuple[FloatArray, IntArray]:
    """Shares (pixel, n) of the layers and of no return, 0 where there is none, and their order from near to far."""
    none = sensor.no_return_mm if sensor.no_return_mm is not None else sensor.range_max_mm
    far = np.full((len(layers.range), 1), np.inf if none is None else none)
    at = np.concatenate([np.where(np.isfinite(layers.range), layers.range, np.inf).astype(np.float64), far], axis=1)
    shares = np.concatenate([layers.weight, layers.weight_no_return[:, None]], axis=1)
    return np.nan_to_num(shares.astype(np.float64)), np.argsort(at, axis=1, kind="stable")
