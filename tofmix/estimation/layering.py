"""From the samples of many pixels to their layers: steps 1 and 2, pixel by pixel.

Use `layer_pixels` on a block of samples in memory. It is a pure function of
each pixel's samples: neither the neighbours, nor the block's size, nor the order
of the frames changes a result.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.estimation.acceleration import maximise_likelihood
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.counters.base import MAX_PEAKS, Peaks
from tofmix.estimation.counting import (
    Rules,
    count_surfaces,
    drop_unsupported,
    grow,
    remove_surface,
    surface_gains,
)
from tofmix.estimation.density import sigma_at
from tofmix.estimation.false_alarms import chance_of, gain_table, least_gain
from tofmix.estimation.mixture import (
    Components,
    em_step,
    expectation_maximisation,
    log_likelihood,
    new_components,
    start_at,
)
from tofmix.estimation.pixel_noise import beam_of_pixel, own_curves
from tofmix.estimation.samples import SortedSamples, sort_samples
from tofmix.estimation.settings import MODE_TIED, EstimateOptions, Knobs, knobs_of
from tofmix.estimation.uncertainty import standard_errors
from tofmix.flags import Status
from tofmix.jit import jit
from tofmix.layers import Layers
from tofmix.sensor import NoiseCurve, Sensor

CLEAR_SIGMAS = 4.0
"""One peak and no sample farther from the mean than this: the mean is the fit, no EM is needed."""

NO_RETURN_REACH = 6.0
"""Without a sample this near to range_max, in sigmas, p(c_0) is 0 from the start."""

_OK = int(Status.OK)
_TOO_FEW_SAMPLES = int(Status.TOO_FEW_SAMPLES)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NO_SURFACE = int(Status.NO_SURFACE)
_DEGENERATE = int(Status.DEGENERATE)


@jit
def _split_no_return(places: FloatArray, heights: FloatArray, k: int, beam: Beam) -> tuple[int, float]:
    """Take the peaks that belong to c_0 off the end; return the surfaces' number and c_0's height."""
    no_return = 0.0
    while k > 0 and places[k - 1] > beam.no_return_from:
        k -= 1
        no_return += heights[k]
    return k, no_return


@jit
def _fit_clear(samples: FloatArray, fit: Components, beam: Beam) -> bool:
    """Fit one surface by the mean of all samples, if none is far from it (paper, section V: no EM is needed)."""
    n = len(samples)
    mean = np.sum(samples) / n
    sigma = sigma_at(mean, beam.curve_range, beam.curve_sigma)
    if max(samples[n - 1] - mean, mean - samples[0]) > CLEAR_SIGMAS * sigma or mean > beam.no_return_from:
        return False
    fit.mean[0], fit.sigma[0], fit.weight[0], fit.no_return[0] = mean, sigma, 1.0 - beam.p_outlier, 0.0
    fit.support[0], fit.no_return[1] = n, 0.0
    return True


@jit
def _finish_clear(samples: FloatArray, fit: Components, beam: Beam, mode: int) -> None:
    """Give the sigma of the one surface that holds all samples: one EM iteration is the solution."""
    if mode != MODE_TIED:
        em_step(samples, 1, fit, beam, mode)
    fit.support[0], fit.no_return[1] = len(samples), 0.0


@jit
def _fit_pixel(
    samples: FloatArray,
    places: FloatArray,
    heights: FloatArray,
    found: int,
    work: tuple[Components, Components, Components],
    room: FloatArray,
    beam: Beam,
    knobs: Knobs,
    rules: Rules,
) -> tuple[int, int, int]:
    """Return surfaces found, peaks found, and EM iterations (negative: not converged); the fit is work[0]."""
    fit = work[0]
    start, no_return = _split_no_return(places, heights, max(found, 1), beam)
    n_peaks = min(start, found)
    near = samples[len(samples) - 1] > beam.range_max - NO_RETURN_REACH * beam.sigma_max
    if start == 1 and no_return == 0.0 and not near and _fit_clear(samples, fit, beam):
        k = grow(samples, 1, work, beam, rules, room) if knobs.refine else 1
        if k == 1:
            _finish_clear(samples, fit, beam, knobs.mode)
            return 1, n_peaks, 0
    else:
        no_return = max(no_return, 1.0 / len(samples)) if near else 0.0
        start_at(places, heights, start, no_return, fit, beam)
        k = count_surfaces(samples, start, work, room, beam, rules) if knobs.refine else start
    while True:
        if knobs.refine:
            n_iter = maximise_likelihood(samples, k, fit, beam, knobs.mode, knobs.max_iter, knobs.tol)
        else:
            n_iter = expectation_maximisation(samples, k, fit, beam, knobs.mode, knobs.max_iter, knobs.tol)
        left = drop_unsupported(len(samples), k, fit, beam, rules)
        while left > knobs.max_layers:
            left = remove_surface(left, int(np.argmin(fit.weight[:left])), fit)
        if left == k:
            return k, n_peaks, n_iter
        k = left


@jit
def _sort_surfaces(k: int, fit: Components) -> None:
    """Put the surfaces in order, near to far."""
    for i in range(1, k):
        for j in range(i, 0, -1):
            if fit.mean[j - 1] <= fit.mean[j]:
                break
            for values in (fit.mean, fit.sigma, fit.weight, fit.support, fit.gain):
                values[j - 1], values[j] = values[j], values[j - 1]


@jit
def _layer_block(
    block: SortedSamples, peaks: Peaks, out: tuple[NDArray[Any], ...], common: Beam, knobs: Knobs, table: FloatArray
) -> None:
    """Fill `out`, the arrays of `Layers` in their order, for the pixels of a block and their peaks."""
    (n_modes, n_peaks, mean, sigma, weight, range_stderr, weight_stderr, probability, no_return, outlier, likelihood,
     n_samples, n_iter, status) = out  # fmt: skip
    room, range_errors, weight_errors = np.zeros(block.values.shape[1]), np.zeros(MAX_PEAKS), np.zeros(MAX_PEAKS)
    work = new_components(MAX_PEAKS), new_components(MAX_PEAKS), new_components(MAX_PEAKS)
    fit = work[0]
    for pixel in range(len(block.valid)):
        n = block.valid[pixel]
        n_samples[pixel] = n
        if n < knobs.min_samples:
            status[pixel] = _TOO_FEW_SAMPLES
            continue
        beam = beam_of_pixel(common, pixel)
        samples = block.values[pixel, :n]
        place, height, found = peaks.place[pixel], peaks.height[pixel], peaks.found[pixel]
        gain = least_gain(knobs.false_alarm, table[n]) if knobs.refine else 0.0
        rules = Rules(gain, knobs.false_alarm if knobs.refine else math.inf, knobs.max_layers)
        k, kept, iterations = _fit_pixel(samples, place, height, found, work, room, beam, knobs, rules)
        surface_gains(samples, k, work, beam)
        _sort_surfaces(k, fit)
        known = standard_errors(samples, k, fit, beam, knobs.mode, range_errors, weight_errors)
        n_modes[pixel], n_peaks[pixel] = k, kept
        n_iter[pixel] = abs(iterations)
        for i in range(k):
            mean[pixel, i], sigma[pixel, i], weight[pixel, i] = fit.mean[i], fit.sigma[i], fit.weight[i]
            range_stderr[pixel, i], weight_stderr[pixel, i] = range_errors[i], weight_errors[i]
            probability[pixel, i] = 1.0 - chance_of(fit.gain[i], table[n])
        no_return[pixel] = fit.no_return[0]
        outlier[pixel] = beam.p_outlier if k > 0 or fit.no_return[0] > 0.0 else 1.0
        likelihood[pixel] = log_likelihood(samples, k, fit, beam)
        if k == 0:
            status[pixel] = _NO_SURFACE
        elif iterations < 0:
            status[pixel] = _NOT_CONVERGED
        else:
            status[pixel] = _OK if known else _DEGENERATE


def layer_pixels(
    range_mm: NDArray[np.floating],
    sensor: Sensor,
    options: EstimateOptions | None = None,
    *,
    amplitude: NDArray[np.floating] | None = None,
) -> Layers:
    """Layers of each pixel of a block.

    Parameters
    ----------
    range_mm : (frame, pixel) or (frame, row, col) array of float
        Samples, mm; values that are not finite, or beyond 10^9 mm, are skipped.
    sensor : Sensor
        Noise curve, working range and p(c_r).
    options : EstimateOptions, optional
        Defaults without it.
    amplitude : array of float, optional
        Amplitudes of the samples, of the same shape; used where the noise curve has a law of amplitude.

    Returns
    -------
    Layers
        Of the leading shape (pixel,) or (row, col).

    Raises
    ------
    ValueError
        If the samples have another number of dimensions or no frame, the amplitudes another shape, or the sensor has
        no noise curve.
    """
    samples = np.asarray(range_mm, dtype=np.float32)
    if samples.ndim not in (2, 3) or samples.shape[0] == 0:
        raise ValueError(f"range: expected (frame, pixel) or (frame, row, col), got shape {samples.shape}")
    options = options or EstimateOptions()
    block = np.ascontiguousarray(samples).reshape(samples.shape[0], math.prod(samples.shape[1:]))
    out = Layers.empty((block.shape[1],), options.max_layers)
    beam = beam_of(sensor)
    if amplitude is not None and sensor.noise is not None and sensor.noise.law is not None:
        if amplitude.shape != samples.shape:
            raise ValueError(f"amplitude: shape {amplitude.shape} differs from range {samples.shape}")
        beam = beam._replace(
            own=own_curves(block, np.asarray(amplitude, np.float32).reshape(block.shape), sensor.noise)
        )
    ordered, table = sort_samples(block), gain_table(block.shape[0])
    _layer_block(ordered, options.counter.peaks(ordered, beam), out.arrays(), beam, knobs_of(options), table)
    return out.reshaped(samples.shape[1:])


def warm_up(options: EstimateOptions) -> None:
    """Compile the kernels, or load them from their cache, by fitting one made-up pixel."""
    noise = NoiseCurve(np.array([1000.0]), np.array([10.0]))
    sensor = Sensor(name="warm-up", range_max_mm=2000.0, noise=noise)
    layer_pixels(np.full((options.min_samples, 1), 1000.0), sensor, options)
