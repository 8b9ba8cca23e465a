"""The last steps of a window, when the layers of its whole image are there: unmixing, and what lost samples say.

Files and memory take them here, so that both have the same values.

The mean amplitude of each layer's samples.

Use `layer_amplitudes` where samples and layers of a block are in memory. A sample is of the layer that most probably
gave it; outliers are of none.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit
from tofmix.flags import MOST_UNDECIDED, Mixing
from tofmix.layers import Layers
from tofmix.lost_samples import learn_losses
from tofmix.sensor import Sensor
from tofmix.suspicion.evidence import layer_of
from tofmix.unmixing.unmix import unmix


@jit
def _add_amplitudes(
    samples: Float32Array,
    light: Float32Array,
    n_modes: NDArray[np.uint8],
    mean: Float32Array,
    sigma: Float32Array,
    weight: Float32Array,
    circle: float,
    total: FloatArray,
    count: FloatArray,
) -> None:
    """Add up the amplitudes of the samples of each layer (pixel, layer), and count them."""
    for t in range(samples.shape[0]):
        for pixel in range(samples.shape[1]):
            value, bright = samples[t, pixel], light[t, pixel]
            if not (math.isfinite(value) and math.isfinite(bright)):
                continue
            found: Any = np.int64(n_modes[pixel])  # signed: of unsigned numbers numba makes floats
            chosen = layer_of(value, found, mean[pixel], sigma[pixel], weight[pixel], circle)
            if chosen >= 0:
                total[pixel, chosen] += bright
                count[pixel, chosen] += 1.0


def layer_amplitudes(
    range_mm: NDArray[np.floating], amplitude: NDArray[np.floating], layers: Layers, *, circle_mm: float | None = None
) -> Float32Array:
    """Mean amplitude of the samples of each layer.

    Parameters
    ----------
    range_mm : (sample, ...) array of float
        Samples, mm; not finite where invalid.
    amplitude : (sample, ...) array of float
        Their amplitudes; not finite where unknown.
    layers : Layers
        Of the same pixels, with the leading shape (...).
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.

    Returns
    -------
    (..., layer) float32
        NaN where there is no layer, or none of its samples has an amplitude.
    """
    pixels = math.prod(layers.shape)
    flat = layers.reshaped((pixels,))
    samples = np.ascontiguousarray(range_mm, np.float32).reshape(-1, pixels)
    light = np.ascontiguousarray(amplitude, np.float32).reshape(-1, pixels)
    total, count = np.zeros(flat.range.shape), np.zeros(flat.range.shape)
    circle = 0.0 if circle_mm is None else float(circle_mm)
    _add_amplitudes(samples, light, flat.n_modes, flat.range, flat.sigma, flat.weight, circle, total, count)
    with np.errstate(invalid="ignore"):
        mean = total / count  # NaN where none
    return np.asarray(mean.reshape(layers.range.shape), dtype=np.float32)


def _doubt_edges(layers: Layers, *, but_sums: bool) -> Layers:
    """The layers of a camera that filters over pixels: where they are several, samples are of several pixels.

    With `but_sums`, unmixed layers stay: a filter that keeps edges changes few of them.
    """
    mixing, probability = layers.mixing, layers.probability.copy()
    if mixing is None:
        mixing = np.full(layers.shape, int(Mixing.ONE_SURFACE), np.uint8)
    several = (layers.n_modes > 1) | ((layers.n_modes > 0) & (layers.weight_no_return > 0))
    several &= ~(but_sums & (mixing == int(Mixing.PHASOR)))
    probability[several] = np.minimum(probability[several], MOST_UNDECIDED)
    mixing = np.where(several, int(Mixing.UNDECIDED), mixing).astype(np.uint8)
    return replace(layers, mixing=mixing, probability=probability)


class FinishedWindow(NamedTuple):
    """Layers (row, col) of a window, the share of phasor sums and the pixels that tell it; None: not measured."""

    layers: Layers
    phasor_share: float | None = None
    phasor_pixels: int | None = None


def finish_window(
    layers: Layers,
    phasors: Float32Array | None,
    sensor: Sensor,
    *,
    frames: int,
    insist: bool = False,
    circle_mm: float | None = None,
) -> FinishedWindow:
    """Finish the layers of a window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), pixel by pixel.
    phasors : (row, col, 7) float32 or None
        Mean phasors of the pixels (`tofmix.unmixing.image`); None: nothing is unmixed.
    frames : int
        Frames of the window.
    insist : bool
        Whether all samples at edges are taken as phasor sums.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    """
    done = FinishedWindow(layers)
    if phasors is not None:
        found = unmix(layers, phasors, sensor, insist=insist, circle_mm=circle_mm)
        done = FinishedWindow(found.layers, found.phasor_share, found.informative_pixels)
    if sensor.filters_over_pixels:
        done = done._replace(layers=_doubt_edges(done.layers, but_sums=insist))
    lost = done.layers.invalid_share
    if lost is None:
        return done
    probability = learn_losses(lost, frames).weighed(done.layers.probability, lost)
    return done._replace(layers=replace(done.layers, probability=probability))
