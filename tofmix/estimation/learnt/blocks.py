"""Layers of a block of pixels under the learnt noise: the kernel."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.acceleration import maximise, value_of
from tofmix.estimation.learnt.cells import step_at
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    GAIN,
    LOG_WIDTH,
    MEAN,
    OWN,
    SIGMA,
    SUPPORT,
    WEIGHT,
    remove_surface,
)
from tofmix.estimation.learnt.counting import LearntRules, count_surfaces
from tofmix.estimation.learnt.errors import standard_errors
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.pixel_samples import Samples, fill_cells, fill_times, take_samples
from tofmix.estimation.learnt.thresholds import GainThresholds, read_gains
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.mixture.components import sort_surfaces
from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS, chance_of
from tofmix.estimation.noise.pixel_noise import beam_of_pixel
from tofmix.estimation.settings import KernelOptions
from tofmix.flags import Status
from tofmix.range_step import LEAST_SIGMA

AT_LEAST = 1.001
"""A sigma up to this factor on the least one that a step tells is the least: both are interpolated by range."""

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
    if sigma < AT_LEAST * least:
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
