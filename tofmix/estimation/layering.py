"""From the samples of many pixels to their layers: steps 1 and 2, pixel by pixel.

Use `layer_pixels` on a block of samples in memory. It is a pure function of
each pixel's samples: neither the neighbours, nor the block's size, nor the order
of the frames changes a result.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import least_of, product_of
from tofmix.estimation.beam import Beam, beam_of, is_no_return, is_uniform, reaches_no_return, sigma_at
from tofmix.estimation.filters import layers_before_filter
from tofmix.estimation.mixture.counting import (
    Rules,
    Workspace,
    chance_of,
    count_surfaces,
    drop_unsupported,
    gain_table,
    grow,
    least_gain,
    may_gain_more,
    new_workspace,
    surface_gains,
)
from tofmix.estimation.mixture.em import (
    GAIN,
    MEAN,
    RANDOM,
    ROOT_TWO_PI,
    SHARE,
    SIGMA,
    SPARE,
    SUPPORT,
    TOTAL,
    WEIGHT,
    Components,
    Scratch,
    draw_sigmas,
    em_step,
    expectation_maximisation,
    fill_random,
    gaussians,
    log_likelihood,
    maximise_likelihood,
    mix,
    new_sigma,
    remove_surface,
    sort_surfaces,
    start_at,
)
from tofmix.estimation.mixture.uncertainty import standard_errors
from tofmix.estimation.noise.amplitude import beam_of_pixel, pixel_curves
from tofmix.estimation.paper import paper_pixels
from tofmix.estimation.peaks.counters import MAX_PEAKS, Kde, Peaks, no_peaks
from tofmix.estimation.samples import Readings, SortedSamples, gather, invalid_share, padded, sort_samples
from tofmix.estimation.settings import (
    MODE_PRIOR,
    MODE_TIED,
    EstimateOptions,
    KernelOptions,
    counts_with_learnt,
    kernel_options,
)
from tofmix.estimation.unrolling import fold_layers, unrolled
from tofmix.flags import Status
from tofmix.layers import Layers, layer_fields
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor

_OK = int(Status.OK)
_TOO_FEW_SAMPLES = int(Status.TOO_FEW_SAMPLES)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NO_SURFACE = int(Status.NO_SURFACE)
_DEGENERATE = int(Status.DEGENERATE)


@borrowing
def _split_no_return(places: FloatArray, heights: FloatArray, k: int, beam: Beam) -> tuple[int, float]:
    """Take out the peaks that belong to c_0; return the surfaces' number and c_0's height."""
    no_return = 0.0
    for i in range(k - 1, -1, -1):
        if is_no_return(places[i], beam):
            no_return += heights[i]
            for j in range(i, k - 1):
                places[j], heights[j] = places[j + 1], heights[j + 1]
            k -= 1
    return k, no_return


@borrowing
def _fit_clear(data: Readings, fit: Components, beam: Beam) -> bool:
    """Fit one surface by the mean of all samples, if all lie near it (paper, section V: no EM is needed)."""
    values = data.value
    mean = product_of(values, data.times) / data.total
    sigma = sigma_at(mean, beam.curve_range, beam.curve_sigma)
    clear_sigmas = 4.0  # one peak and no sample farther from the mean than this: the mean is the fit, no EM is needed
    if max(values[-1] - mean, mean - values[0]) > clear_sigmas * sigma or is_no_return(mean, beam):
        return False
    fit[MEAN, 0], fit[SIGMA, 0], fit[WEIGHT, 0], fit[WEIGHT, -1] = mean, sigma, 1.0 - beam.p_outlier, 0.0
    fit[SUPPORT, 0], fit[SUPPORT, -1] = data.total, 0.0
    return True


@borrowing
def _no_return_helps(data: Readings, fit: Components, beam: Beam, scratch: Scratch) -> bool:
    """Whether the likelihood rises as share moves from the one surface to c_0: if not, p(c_0) is 0."""
    mix(data, 1, fit, beam, scratch)
    m, count, total = len(data.value), data.times, scratch[TOTAL]
    no_return, share = scratch[SPARE, :m], scratch[SHARE]
    gaussians(data.value, beam.range_max, beam.sigma_max, no_return)
    for j in range(m):
        share[j] = count[j] / total[j]
        random = beam.outlier_density if is_uniform(beam) else scratch[RANDOM, j]
        no_return[j] = (1.0 - beam.p_outlier) * no_return[j] + random
    return bool(product_of(no_return, share) > data.total)


@borrowing
def _finish_clear(data: Readings, fit: Components, beam: Beam, mode: int, scratch: Scratch) -> float:
    """Give the sigma of the one surface that holds all samples; return the log likelihood, nat.

    Where even the farthest sample is not c_r's, all samples are the surface's, and both follow from their spread.
    """
    values, m, mean = data.value, len(data.value), fit[MEAN, 0]
    square, away = scratch[SPARE, :m], max(values[m - 1] - mean, mean - values[0])
    for j in range(m):
        square[j] = (values[j] - mean) * (values[j] - mean)
    squares = product_of(square, data.times)
    curve_sigma = fit[SIGMA, 0]
    sigma = new_sigma(curve_sigma, squares, data.total, mode)
    height = fit[WEIGHT, 0] / (sigma * ROOT_TWO_PI)
    random = beam.outlier_density
    if not is_uniform(beam):
        for j in range(m):
            random = max(random, scratch[RANDOM, j])
    quiet = 1.0e-3  # a sample of which c_r takes no more than this part belongs to the surface
    if random < quiet * height * math.exp(-0.5 * (away / sigma) ** 2):
        fit[SIGMA, 0] = sigma
        return float(data.total * math.log(height) - 0.5 * squares / sigma**2)
    if mode != MODE_TIED:
        em_step(data, 1, fit, beam, mode, scratch)  # one EM iteration is the solution
        fit[SUPPORT, 0], fit[SUPPORT, -1] = data.total, 0.0
    return log_likelihood(data, 1, fit, beam, scratch)


@borrowing
def _held(options: KernelOptions) -> int:
    """Mode that means and shares are fitted in: counted by likelihood, a prior's sigmas are drawn from a tied fit."""
    return MODE_TIED if options.refine and options.mode == MODE_PRIOR else options.mode


@borrowing
def _fit_pixel(
    data: Readings,
    places: FloatArray,
    heights: FloatArray,
    found: int,
    work: Workspace,
    beam: Beam,
    options: KernelOptions,
    rules: Rules,
) -> tuple[int, int, int, float]:
    """Return surfaces found, peaks found, EM iterations (negative: not converged) and the log likelihood, nat.

    The fit is work.fit.
    """
    fit, scratch = work.fit, work.scratch
    start, no_return = _split_no_return(places, heights, max(found, 1), beam)
    n_peaks = min(start, found)
    near = reaches_no_return(data.value, beam)
    k = 0
    clear = (start == 1 or options.refine) and no_return == 0.0 and _fit_clear(data, fit, beam)
    if clear and not (near and _no_return_helps(data, fit, beam, scratch)):
        if not options.refine or not may_gain_more(data, 1, work, beam, rules):
            return 1, n_peaks, 0, _finish_clear(data, fit, beam, options.mode, scratch)
        k = grow(data, 1, work, beam, rules) if start == 1 else 0
        if k == 1:
            return 1, n_peaks, 0, _finish_clear(data, fit, beam, options.mode, scratch)
    if k == 0:
        no_return = max(no_return, 1.0 / data.total) if near else 0.0
        start_at(places, heights, start, no_return, fit, beam)
        k = count_surfaces(data, start, work, beam, rules) if options.refine else start
    while True:
        if options.refine:
            n_iter = maximise_likelihood(data, k, fit, beam, _held(options), options.max_iter, options.tol, scratch)
        else:
            n_iter = expectation_maximisation(data, k, fit, beam, options.mode, options.max_iter, options.tol, scratch)
        left = drop_unsupported(data.total, k, fit, beam, rules)
        while left > options.max_layers:
            left = remove_surface(left, least_of(fit[WEIGHT, :left]), fit)
        if left == k:
            if options.mode != _held(options):
                draw_sigmas(data, k, fit, beam, scratch)
            return k, n_peaks, n_iter, log_likelihood(data, k, fit, beam, scratch)
        k = left


@jit
def _layer_block(
    block: SortedSamples,
    peaks: Peaks,
    out: tuple[NDArray[Any], ...],
    common: Beam,
    options: KernelOptions,
    table: FloatArray,
) -> None:
    """Fill `out`, the arrays of `Layers` in their order, for the pixels of a block and their peaks."""
    (
        n_modes,
        n_peaks,
        mean,
        sigma,
        weight,
        range_stderr,
        weight_stderr,
        probability,
        no_return,
        outlier,
        likelihood,
        n_samples,
        n_iter,
        status,
    ) = out
    columns = padded(block.values.shape[1])
    value, count = np.empty(columns), np.empty(columns)
    range_errors, weight_errors = np.zeros(MAX_PEAKS), np.zeros(MAX_PEAKS)
    work = new_workspace(MAX_PEAKS, columns)
    fit = work.fit
    for pixel in range(len(block.valid)):
        n = block.valid[pixel]
        n_samples[pixel] = n
        if n < options.min_samples:
            status[pixel] = _TOO_FEW_SAMPLES
            continue
        beam = beam_of_pixel(common, pixel)
        data = gather(block.values[pixel], n, beam.curve_range, beam.curve_sigma, value, count)
        fill_random(data.value, beam, work.scratch)
        place, height, found = peaks.place[pixel], peaks.height[pixel], peaks.found[pixel]
        gain = least_gain(options.false_alarm, table[n]) if options.refine else 0.0
        rules = Rules(
            gain, options.false_alarm if options.refine else math.inf, options.max_layers, options.no_return_gain
        )
        k, kept, iterations, fitted = _fit_pixel(data, place, height, found, work, beam, options, rules)
        surface_gains(data, k, work, beam)
        sort_surfaces(k, fit, GAIN + 1)
        known = standard_errors(data, k, fit, beam, options.mode, work.scratch, range_errors, weight_errors)
        n_modes[pixel], n_peaks[pixel] = k, kept
        n_iter[pixel] = abs(iterations)
        for i in range(k):
            mean[pixel, i], sigma[pixel, i], weight[pixel, i] = fit[MEAN, i], fit[SIGMA, i], fit[WEIGHT, i]
            range_stderr[pixel, i], weight_stderr[pixel, i] = range_errors[i], weight_errors[i]
            probability[pixel, i] = 1.0 - chance_of(fit[GAIN, i], table[n])
        no_return[pixel] = fit[WEIGHT, -1]
        outlier[pixel] = beam.p_outlier if k > 0 or fit[WEIGHT, -1] > 0.0 else 1.0
        likelihood[pixel] = fitted
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
    samples_a_frame: int = 1,
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
        Amplitudes of the samples, of the same shape; used where the noise curve has a law of amplitude, but not on a
        circle.
    samples_a_frame : int
        Targets of a frame, which follow each other, at least 1; for `invalid_share`.

    Returns
    -------
    Layers
        Of the leading shape (pixel,) or (row, col). `probability` is that of the valid samples;
        `tofmix.lost_samples.weighed` lets the lost ones of an image count.

    Raises
    ------
    ValueError
        If the samples have another number of dimensions or no frame, the amplitudes another shape, the sensor steps of
        other pixels or no noise curve, or the circle of `unambiguous_range_mm` is too short for it.
    """
    samples = np.asarray(range_mm, dtype=np.float32)
    if samples.ndim not in (2, 3) or samples.shape[0] == 0:
        raise ValueError(f"range: expected (frame, pixel) or (frame, row, col), got shape {samples.shape}")
    options = options or EstimateOptions()
    block = np.ascontiguousarray(samples).reshape(samples.shape[0], math.prod(samples.shape[1:]))
    if sensor.step is not None and sensor.step.own_mm is not None and len(sensor.step.own_mm) != block.shape[1]:
        raise ValueError(f"range: {block.shape[1]} pixels, but {len(sensor.step.own_mm)} of the sensor's range_step_mm")
    out = Layers.empty((block.shape[1],), options.max_layers, layer_fields(sensor))
    ordered = sort_samples(block)
    if options.paper and isinstance(options.counter, Kde):
        out = paper_pixels(
            ordered, sensor, gamma=options.counter.gamma, max_layers=options.max_layers, min_samples=options.min_samples
        )
    elif options.unambiguous_range_mm is None:
        beam = beam_of(sensor)
        if amplitude is not None and sensor.noise is not None and sensor.noise.law is not None:
            if amplitude.shape != samples.shape:
                raise ValueError(f"amplitude: shape {amplitude.shape} differs from range {samples.shape}")
            amplitudes = np.asarray(amplitude, np.float32).reshape(block.shape)
            beam = beam._replace(pixel_curves=pixel_curves(block, amplitudes, sensor.noise))
        if counts_with_learnt(sensor, options):
            from tofmix.estimation.learnt.blocks import layers_with_learnt

            layers_with_learnt(np.ascontiguousarray(block.T), beam, sensor, options, out)
        else:
            _layers_on_line(ordered, beam, options, out)
    else:
        _layers_on_circle(ordered, sensor, options, options.unambiguous_range_mm, out)
    layers_before_filter(out, sensor)
    lost = invalid_share(block, samples_a_frame=samples_a_frame, is_filtered=sensor.temporal_filter is not None)
    return replace(out, invalid_share=lost).reshaped(samples.shape[1:])


def _layers_on_line(samples: SortedSamples, beam: Beam, options: EstimateOptions, out: Layers) -> None:
    table = gain_table(samples.values.shape[1])
    _layer_block(samples, options.counter.peaks(samples, beam), out.arrays(), beam, kernel_options(options), table)


def _layers_on_circle(
    samples: SortedSamples, sensor: Sensor, options: EstimateOptions, length: float, out: Layers
) -> None:
    for part in unrolled(samples, sensor, length):
        found = Layers.empty((len(part.pixels),), options.max_layers, out.fields)
        if counts_with_learnt(sensor, options):
            from tofmix.estimation.learnt.blocks import layers_with_learnt

            steps, beam = part.beam.steps, part.beam
            if len(steps.of_pixel):
                beam = beam._replace(steps=steps._replace(of_pixel=steps.of_pixel[part.pixels]))
            layers_with_learnt(part.samples.values.astype(np.float32), beam, sensor, options, found)
        else:
            _layers_on_line(part.samples, part.beam, options, found)
        for spec in out.fields:
            getattr(out, spec.name)[part.pixels] = getattr(found, spec.name)
    fold_layers(out, length)


MADE_UP_MM = 1000.0  # range of the made-up samples


def warm_up(options: EstimateOptions, sensor: Sensor | None = None) -> None:
    """Compile the kernels that layers of a sensor take, or load them from their cache: the largest first.

    Parameters
    ----------
    sensor : Sensor, optional
        Whose noise decides which kernels are needed; default: one of Gaussian noise by range.
    """
    camera = _made_up_sensor(options, sensor)
    samples = np.full((options.min_samples, 1), MADE_UP_MM)
    is_gaussian = not options.paper and not counts_with_learnt(camera, options)
    if is_gaussian:
        out = Layers.empty((1,), options.max_layers, layer_fields(camera))
        block = sort_samples(samples.astype(np.float32))
        _layer_block(
            block, no_peaks(1), out.arrays(), beam_of(camera), kernel_options(options), gain_table(len(samples))
        )
    has_law = camera.noise is not None and camera.noise.law is not None
    layer_pixels(samples, camera, options, amplitude=np.full(samples.shape, 100.0) if has_law else None)


def find_made_up_peaks(options: EstimateOptions) -> None:
    """Compile the kernels that find peaks, or load them from their cache."""
    samples = sort_samples(np.full((options.min_samples, 1), MADE_UP_MM, dtype=np.float32))
    options.counter.peaks(samples, beam_of(_made_up_sensor(options, None)))


def _made_up_sensor(options: EstimateOptions, like: Sensor | None) -> Sensor:
    """A sensor for the made-up samples, whose noise takes the same kernels as that of another one."""
    sigma = 10.0 if options.unambiguous_range_mm is None else 0.01 * options.unambiguous_range_mm
    law = None
    if like is not None and like.noise is not None and like.noise.law is not None:
        law = AmplitudeLaw(np.array([100.0]), np.array([50.0, 200.0]), np.array([2.0, 0.5]))
    noise = NoiseCurve(np.array([MADE_UP_MM]), np.array([sigma]), None if options.unambiguous_range_mm else law)
    learnt = None if like is None else like.learnt
    return Sensor(name="warm-up", range_max_mm=2.0 * MADE_UP_MM, noise=noise, learnt=learnt)
