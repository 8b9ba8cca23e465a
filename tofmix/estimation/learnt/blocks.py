"""Layers of a block of pixels under the learnt noise, with their standard errors.

Standard errors under the learnt noise, by the information of means, shares, width and drift together.

The information of the samples is that of samples whose surface is known, less the information that is lost because it
is not known. That of known samples is Fisher's: an isolated surface has the standard error u sigma / sqrt(n I).

References
----------
Louis, Journal of the Royal Statistical Society B 44(2), 1982, doi:10.1111/j.2517-6161.1982.tb01203.x.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.acceleration import maximise, value_of
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    CELL,
    DENSITY,
    DRIFT,
    GAIN,
    LOG_WIDTH,
    MEAN,
    OWN,
    RANDOM,
    SIGMA,
    SUPPORT,
    TIME,
    TOTAL,
    WEIGHT,
    Samples,
    fill_cells,
    fill_times,
    no_return_row,
    remove_surface,
    slope_row,
    still_row,
    take_samples,
)
from tofmix.estimation.learnt.counting import LearntRules, count_surfaces
from tofmix.estimation.learnt.em import mix
from tofmix.estimation.learnt.law import Law, edges_at, has_steps, information_of, precision_of_t, step_at
from tofmix.estimation.learnt.model import GainThresholds, PixelNoise, read_gains, thresholds_of
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.mixture.counting import FALSE_ALARMS, chance_of
from tofmix.estimation.mixture.em import sort_surfaces
from tofmix.estimation.mixture.uncertainty import scaled_cholesky
from tofmix.estimation.noise.amplitude import beam_of_pixel
from tofmix.estimation.settings import EstimateOptions, KernelOptions, SigmaMode, kernel_options
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.noise_shape import DRIFTS, LEAST_SIGMA
from tofmix.sensor import Sensor


@jit
def standard_errors(  # noqa: PLR0915  one pass over the samples
    data: Samples,
    k: int,
    fit: FloatArray,
    law: Law,
    beam: Beam,
    scratch: FloatArray,
    by_mean: FloatArray,
    by_share: FloatArray,
) -> bool:
    """Fill the standard errors of `k` means, mm, and shares, both (k,); return whether the information has an inverse.

    Where it has none, they are those of isolated surfaces.
    """
    known = np.empty((k, 3))
    for i in range(k):
        support, own_width = max(fit[SUPPORT, i], 1.0), math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, i]
        known[i, 0], known[i, 1], known[i, 2] = information_of(data.value, support, fit[MEAN, i], own_width, law, beam)
        by_mean[i] = own_width / math.sqrt(support * known[i, 0])
        by_share[i] = math.sqrt(max(fit[WEIGHT, i] * (1.0 - fit[WEIGHT, i]), 0.0) / len(data.value))
    if k == 0:
        return True
    n, width, slopes = len(data.value), math.exp(fit[OWN, LOG_WIDTH]), slope_row(fit)
    mix(data, k, fit, law, beam, scratch)
    with_width, moving = law.width_spread > 0.0, 0
    for d in range(DRIFTS):
        moving += 1 if law.drift_mm[d] > 0.0 else 0
    with_no_return = fit[WEIGHT, -1] > 0.0
    shares = k + (1 if with_no_return else 0)
    at_width = k
    at_drift = at_width + (1 if with_width else 0)
    at_share = at_drift + k * moving
    size = at_share + shares
    # The largest surface, whose share is never 0, has the share that all else leaves.
    largest = 0
    for i in range(1, k):
        if fit[WEIGHT, i] > fit[WEIGHT, largest]:
            largest = i
    information = np.zeros((size, size))
    score, mean_score = np.zeros(size), np.zeros(size)
    reference = np.zeros(shares)
    nothing = 1.0e-12  # least responsibility of a surface for a sample that has information on it
    for j in range(n):
        total = scratch[TOTAL, j]
        mean_score[:] = 0.0
        place = 0
        for i in range(k):
            if i != largest:
                mean_score[at_share + place] = (scratch[DENSITY + i, j] - scratch[DENSITY + largest, j]) / total
                place += 1
        if with_no_return:
            mean_score[at_share + place] = (scratch[no_return_row(fit), j] - scratch[DENSITY + largest, j]) / total
            place += 1
        mean_score[at_share + place] = (scratch[RANDOM, j] - scratch[DENSITY + largest, j]) / total
        for i in range(k):
            part = fit[WEIGHT, i] * scratch[DENSITY + i, j] / total
            if part < nothing:
                continue
            scale = 1.0 / (width * fit[SIGMA, i])
            psi = scratch[slopes + i, j] / scratch[DENSITY + i, j]
            z = ((scratch[still_row(fit) + i, j] if moving > 0 else data.value[j]) - fit[MEAN, i]) * scale
            score[:at_share] = 0.0
            score[i] = psi * scale
            information[i, i] += part * known[i, 0] * scale * scale
            if with_width:
                narrow = 1.0
                if has_steps(beam):
                    narrow = edges_at(z, scratch[CELL, j] * scale, law) * scale / scratch[DENSITY + i, j]
                score[at_width] = z * psi - narrow
                information[at_width, at_width] += part * known[i, 1]
                cross = part * known[i, 2] * scale
                information[i, at_width] += cross
                information[at_width, i] += cross
            first = at_drift + i * moving
            place = 0
            for d in range(DRIFTS):
                if law.drift_mm[d] <= 0.0:
                    continue
                basis = scratch[TIME + d, j]
                score[first + place] = basis * psi * scale
                shared = part * known[i, 0] * scale * scale * basis
                information[i, first + place] += shared
                information[first + place, i] += shared
                if with_width:
                    cross = part * known[i, 2] * scale * basis
                    information[at_width, first + place] += cross
                    information[first + place, at_width] += cross
                other = 0
                for e in range(DRIFTS):
                    if law.drift_mm[e] > 0.0:
                        information[first + place, first + other] += shared * scratch[TIME + e, j]
                        other += 1
                place += 1
            for a in range(at_share):
                mean_score[a] += part * score[a]
                for b in range(at_share):
                    information[a, b] -= part * score[a] * score[b]
        for a in range(size):
            for b in range(size):
                information[a, b] += mean_score[a] * mean_score[b]
    if with_width:
        information[at_width, at_width] += precision_of_t(fit[OWN, LOG_WIDTH], law.width_spread)
    for i in range(k):
        place = at_drift + i * moving
        for d in range(DRIFTS):
            if law.drift_mm[d] > 0.0:
                information[place, place] += precision_of_t(fit[DRIFT + d, i], law.drift_mm[d])
                place += 1
    b = max(fit[OWN, BACKGROUND], 1.0e-6)
    information[size - 1, size - 1] += law.background_near / (b * b) + law.background_far
    return _invert(information, k, at_share, largest, reference, by_mean, by_share)


@jit
def _invert(
    information: FloatArray,
    k: int,
    at_share: int,
    largest: int,
    reference: FloatArray,
    by_mean: FloatArray,
    by_share: FloatArray,
) -> bool:
    """Fill standard errors from the inverse of a positive definite matrix; false, and no change, where it is not."""
    size = len(information)
    unit, lower = np.zeros(size), np.zeros((size, size))
    if not scaled_cholesky(information, unit, lower):
        return False
    for i in range(k):
        by_mean[i] = _error_of(lower, unit, i, at_share, 0)
    place = 0
    for i in range(k):
        if i != largest:
            by_share[i] = _error_of(lower, unit, at_share + place, at_share, 0)
            place += 1
    # The largest surface has the share that all else leaves: its variance is that of their sum.
    by_share[largest] = _error_of(lower, unit, at_share, at_share, len(reference)) if len(reference) > 0 else 0.0
    return True


@jit
def _error_of(lower: FloatArray, unit: FloatArray, first: int, at_share: int, summed: int) -> float:
    """Standard error of one number, or of the sum of `summed` numbers from `at_share` on where that is above 0."""
    size = len(lower)
    half = np.zeros(size)
    square = 0.0
    for a in range(size):
        value = 0.0
        if (summed == 0 and a == first) or (summed > 0 and at_share <= a < at_share + summed):
            value = unit[a]
        for c in range(a):
            value -= lower[a, c] * half[c]
        half[a] = value / lower[a, a]
        square += half[a] * half[a]
    return math.sqrt(square)


_CHANCES = len(FALSE_ALARMS)
_OK = int(Status.OK)
_TOO_FEW_SAMPLES = int(Status.TOO_FEW_SAMPLES)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NO_SURFACE = int(Status.NO_SURFACE)
_DEGENERATE = int(Status.DEGENERATE)


@borrowing
def _told_by_step(sigma: float, error: float, range_mm: float, beam: Beam) -> tuple[float, float]:
    """Sigma and standard error of a range, mm, where ranges are stored on a step.

    A smaller sigma is not told; nor is then where between two values the surface is.
    """
    least = LEAST_SIGMA * step_at(range_mm, beam)
    # A sigma up to this factor on the least one that a step tells is the least: both are interpolated by range.
    at_least = 1.001
    if sigma < at_least * least:
        return least, math.sqrt(error * error + least * least)
    return sigma, error


@jit
def fill_layers(  # noqa: PLR0915  one pass over the pixels
    block: Float32Array,
    out: tuple[NDArray[Any], ...],
    width: FloatArray,
    common: Beam,
    laws: tuple[Law, Law],
    thresholds: GainThresholds,
    options: KernelOptions,
) -> None:
    """Fill the layers and the widths of pixels.

    `block` (pixel, frame) are samples, mm, NaN where invalid. `out` are the arrays of `tofmix.layers.Layers` in their
    order, and `width` (pixel,) factors on sigma(r).
    """
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
    pixels, frames = block.shape
    value, time = np.empty(frames), np.empty(frames)
    capacity = options.max_layers + 1
    range_errors, weight_errors = np.zeros(capacity), np.zeros(capacity)
    work = new_workspace(capacity, frames, _CHANCES)
    fit, scratch = work.fit, work.scratch
    rules = LearntRules(options.false_alarm, options.no_return_gain, options.max_layers)
    for pixel in range(pixels):
        n = take_samples(block[pixel], value, time)
        n_samples[pixel] = n
        width[pixel] = 1.0
        if n < options.min_samples:
            status[pixel] = _TOO_FEW_SAMPLES
            continue
        beam = beam_of_pixel(common, pixel)
        data = Samples(value[:n], time[:n])
        fill_times(data, scratch)
        fill_cells(data, beam, scratch)
        k, law = count_surfaces(data, work, laws, beam, thresholds, rules)
        found = k
        iterations = maximise(data, k, fit, law, beam, options.max_iter, options.tol, scratch)
        while k > 0:  # a surface that the last iterations left without samples is removed
            weakest = 0
            for i in range(1, k):
                if fit[SUPPORT, i] < fit[SUPPORT, weakest]:
                    weakest = i
            if fit[SUPPORT, weakest] >= 1.0:
                break
            k = remove_surface(k, weakest, fit)
            iterations = maximise(data, k, fit, law, beam, options.max_iter, options.tol, scratch)
        sort_surfaces(k, fit, OWN)
        known = standard_errors(data, k, fit, law, beam, scratch, range_errors, weight_errors)
        width[pixel] = math.exp(fit[OWN, LOG_WIDTH])
        n_modes[pixel], n_peaks[pixel] = k, found
        n_iter[pixel] = abs(iterations)
        read_gains(float(n), fit[OWN, BACKGROUND], k == 1, thresholds, work.gains)
        for i in range(k):
            mean[pixel, i], weight[pixel, i] = fit[MEAN, i], fit[WEIGHT, i]
            own = width[pixel] * fit[SIGMA, i]
            sigma[pixel, i], range_stderr[pixel, i] = _told_by_step(own, range_errors[i], fit[MEAN, i], beam)
            weight_stderr[pixel, i] = weight_errors[i]
            gain = fit[GAIN, i]
            probability[pixel, i] = 1.0 if math.isinf(gain) else 1.0 - chance_of(gain, work.gains)
        no_return[pixel] = fit[WEIGHT, -1]
        outlier[pixel] = fit[OWN, BACKGROUND]
        likelihood[pixel] = value_of(data, k, fit, law, beam, scratch)
        if k == 0:
            status[pixel] = _NO_SURFACE
        elif iterations < 0:
            status[pixel] = _NOT_CONVERGED
        else:
            status[pixel] = _OK if known else _DEGENERATE


def layers_with_learnt(block: Float32Array, beam: Beam, sensor: Sensor, options: EstimateOptions, out: Layers) -> None:
    """Fill `out` for samples (pixel, frame), mm, NaN where invalid.

    On a circle of ranges no pixel drifts, because unrolled samples are not in the order of frames.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or carries no learnt noise.
    """
    if sensor.learnt is None:
        raise ValueError("the sensor carries no learnt noise")
    law, plain = PixelNoise.of(sensor).laws()
    if options.sigma is SigmaMode.TIED:
        law, plain = law._replace(width_spread=0.0), plain._replace(width_spread=0.0)
    if options.unambiguous_range_mm is not None:
        law = law._replace(drift_mm=np.zeros(DRIFTS))
    width = np.ones(len(block))
    fill_layers(block, out.arrays(), width, beam, (law, plain), thresholds_of(sensor.learnt), kernel_options(options))
    if out.noise_width is not None:
        out.noise_width[...] = width
    inflation = math.sqrt((1.0 + sensor.learnt.memory) / (1.0 - sensor.learnt.memory))
    if inflation > 1.0:
        # The variance of the mean of AR(1) noise is larger by this factor.
        out.range_stderr[...] *= inflation
