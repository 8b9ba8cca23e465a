"""Each pixel's own noise curve, where noise depends on amplitude.

Use `pixel_curves` on a block of samples whose noise curve has a law of amplitude, and
`beam_of_pixel` wherever a kernel takes the beam of one pixel. Samples of one surface
lie together in range and have about one amplitude. So sigma near a range follows
from the amplitudes of the samples near it: a dark and a bright surface of one pixel
each get their own. Where two of them overlap, it is between the two.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam, PixelCurves, Steps, sigma_at
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.sensor import NoiseCurve

CLUSTER_SAMPLES = 3.0
"""Weight of the cluster's median amplitude in this mean, in samples, for ranges with few samples."""


class _Law(NamedTuple):
    """A curve with a law as the kernel reads it: logarithms of the amplitudes and factors."""

    curve_range: FloatArray
    curve_sigma: FloatArray
    log_reference_factor: FloatArray
    log_amplitude: FloatArray
    log_factor: FloatArray


@jit
def _log_scale(range_mm: float, amplitude: float, law: _Law) -> float:
    """Log factor on the curve at a range and amplitude; NaN where the amplitude is not a number above 0."""
    if not 0.0 < amplitude < math.inf:
        return math.nan
    reference = sigma_at(range_mm, law.curve_range, law.log_reference_factor)
    return float(sigma_at(math.log(amplitude), law.log_amplitude, law.log_factor) - reference)


@jit
def _middle(values: FloatArray) -> float:
    """Median of the values that are numbers, 0 without any."""
    count = 0
    for value in values:
        count += not math.isnan(value)
    if count == 0:
        return 0.0
    ordered = np.sort(values)  # NaN last
    return float(0.5 * (ordered[(count - 1) // 2] + ordered[count // 2]))


@jit
def _fill_cluster(
    values: FloatArray, scale: FloatArray, law: _Law, curve_range: FloatArray, curve_sigma: FloatArray, size: int
) -> int:
    """Append the points of one cluster to a pixel's curve; return their number so far."""
    middle = _middle(scale)
    first, stop, total, known = 0, 0, 0.0, 0
    for j in range(len(values)):
        base = sigma_at(values[j], law.curve_range, law.curve_sigma)
        reach = base * math.exp(middle)  # one sigma, within which samples give the amplitude at a range
        while stop < len(values) and values[stop] <= values[j] + reach:
            if not math.isnan(scale[stop]):
                total, known = total + scale[stop], known + 1
            stop += 1
        while values[first] < values[j] - reach:
            if not math.isnan(scale[first]):
                total, known = total - scale[first], known - 1
            first += 1
        if size == 0 or values[j] > curve_range[size - 1]:
            curve_range[size] = values[j]
            curve_sigma[size] = base * math.exp((total + CLUSTER_SAMPLES * middle) / (known + CLUSTER_SAMPLES))
            size += 1
    return size


@jit
def _fill(block: Float32Array, amplitude: Float32Array, law: _Law, out: PixelCurves) -> None:
    frames, pixels = block.shape
    values, scale = np.empty(frames), np.empty(frames)
    for pixel in range(pixels):
        n = 0
        for frame in range(frames):
            if abs(block[frame, pixel]) <= FARTHEST_MM:  # false for NaN
                values[n] = block[frame, pixel]
                scale[n] = _log_scale(values[n], amplitude[frame, pixel], law)
                n += 1
        # Samples of one range go by their scales: the order of the frames must not change the rounding of a sum.
        order = np.argsort(scale[:n], kind="mergesort")
        order = order[np.argsort(values[:n][order], kind="mergesort")]
        ordered, scales = values[:n][order], scale[:n][order]
        size, first = 0, 0
        widest = 0.0
        for j in range(n):
            factor = 1.0 if math.isnan(scales[j]) else math.exp(scales[j])
            sigma = factor * sigma_at(ordered[j], law.curve_range, law.curve_sigma)
            # sigmas: a wider gap separates two clusters, each with its own amplitude
            if j > first and ordered[j] - ordered[j - 1] > 3.0 * max(sigma, widest):
                size = _fill_cluster(
                    ordered[first:j], scales[first:j], law, out.range_mm[pixel], out.sigma_mm[pixel], size
                )
                first = j
            widest = sigma
        if n > 0:
            size = _fill_cluster(ordered[first:n], scales[first:n], law, out.range_mm[pixel], out.sigma_mm[pixel], size)
        out.size[pixel] = size


def pixel_curves(block: Float32Array, amplitude: Float32Array, curve: NoiseCurve) -> PixelCurves:
    """Each pixel's curve from the amplitudes of its samples.

    Parameters
    ----------
    block : (frame, pixel) float32
        Samples, mm; values that are not finite, or beyond 10^9 mm, are skipped.
    amplitude : (frame, pixel) float32
        Their amplitudes. An amplitude that is not a number above 0 is replaced by those of its neighbours, or by the
        curve.
    curve : NoiseCurve
        With a law.

    Returns
    -------
    PixelCurves
        Points at the samples' ranges. Samples less than three sigmas from their neighbour are a cluster. At a range
        in it, log sigma has the mean scale of the samples within one sigma, and of `CLUSTER_SAMPLES` more with
        the cluster's median scale.

    Raises
    ------
    ValueError
        If the two differ in shape, or the curve has no law.
    """
    if block.shape != amplitude.shape:
        raise ValueError(f"amplitude: shape {amplitude.shape} differs from range {block.shape}")
    if curve.law is None:
        raise ValueError("the noise curve has no law of amplitude")
    frames, pixels = block.shape
    out = PixelCurves(np.zeros((pixels, frames)), np.zeros((pixels, frames)), np.zeros(pixels, dtype=np.int64))
    law = _Law(
        np.array(curve.range_mm),
        np.array(curve.sigma_mm),
        curve.law.log_factor(curve.law.reference),
        np.log(curve.law.amplitude),
        np.log(curve.law.factor),
    )
    _fill(np.ascontiguousarray(block), np.ascontiguousarray(amplitude), law, out)
    return out


@jit
def beam_of_pixel(beam: Beam, pixel: int) -> Beam:
    """The beam with the pixel's own curve, and its own step, where there are."""
    size = beam.pixel_curves.size[pixel] if pixel < len(beam.pixel_curves.size) else 0
    steps = beam.steps
    if pixel < len(steps.of_pixel):
        steps = Steps(steps.range_mm[:1], steps.of_pixel[pixel : pixel + 1], steps.of_pixel)
    elif size == 0:
        return beam
    return Beam(
        beam.pixel_curves.range_mm[pixel, :size] if size > 0 else beam.curve_range,
        beam.pixel_curves.sigma_mm[pixel, :size] if size > 0 else beam.curve_sigma,
        beam.range_max,
        beam.sigma_max,
        beam.no_return_from,
        beam.no_return_to,
        beam.surface_end,
        beam.p_outlier,
        beam.outlier_density,
        beam.range_min,
        beam.range_top,
        beam.pixel_curves,
        steps,
        beam.background,
    )
