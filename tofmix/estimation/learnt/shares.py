"""Shares of background and widths of pixels, by a count of their surfaces under a noise model."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.acceleration import LEARNING_ITER, LEARNING_TOL, maximise
from tofmix.estimation.learnt.components import BACKGROUND, LOG_WIDTH, MEAN, OWN, RANDOM, SUPPORT, TOTAL
from tofmix.estimation.learnt.counting import LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, LearntRules, count_surfaces
from tofmix.estimation.learnt.em import mix
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.pixel_samples import LEAST_SAMPLES, Samples, fill_cells, fill_times, take_samples
from tofmix.estimation.learnt.thresholds import GainThresholds
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.noise.pixel_noise import beam_of_pixel


@jit
def background_shares(
    samples: Float32Array, laws: tuple[Law, Law], beam: Beam, thresholds: GainThresholds, max_layers: int
) -> tuple[FloatArray, FloatArray]:
    """Share of background of each pixel, without its prior.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples, mm, NaN where invalid.
    laws, beam, thresholds, max_layers
        As for `held_out_scores`.

    Returns
    -------
    (pixel,) float64
        Share of background among the samples.
    (pixel,) float64
        Number of samples; 0 where a pixel has no surface, as its samples may then be of surfaces or of background.
    """
    pixels, frames = samples.shape
    share, number = np.zeros(pixels), np.zeros(pixels)
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(max_layers + 1, frames, thresholds.first.shape[1])
    rules = LearntRules(LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, max_layers)
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        n = take_samples(samples[pixel], value, time)
        if n < LEAST_SAMPLES:
            continue
        data = Samples(value[:n], time[:n])
        fill_times(data, work.scratch)
        fill_cells(data, own, work.scratch)
        k, law = count_surfaces(data, work, laws, own, thresholds, rules)
        if k == 0:
            continue
        mix(data, k, work.fit, law, own, work.scratch)
        background, total = work.fit[OWN, BACKGROUND], 0.0
        for j in range(n):
            total += background * work.scratch[RANDOM, j] / work.scratch[TOTAL, j]
        share[pixel], number[pixel] = total / n, float(n)
    return share, number


class PixelWidths(NamedTuple):
    """Widths of pixels, all (pixel,).

    `place` is the mean range of a pixel's surfaces, mm, `support` the number of their samples, and `surfaces` the
    number of the surfaces.
    """

    place: FloatArray
    log_width: FloatArray
    support: FloatArray
    surfaces: FloatArray


@jit
def pixel_widths(
    samples: Float32Array, laws: tuple[Law, Law], free: Law, beam: Beam, thresholds: GainThresholds, max_layers: int
) -> PixelWidths:
    """Width of each pixel, common to all its surfaces; pixels without surfaces are left out.

    For recordings in which no surface is isolated. Surfaces are counted under `laws`, and their width is fitted under
    `free`, whose prior is weak: a count under `free` would take three surfaces for a wide one.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples, mm, NaN where invalid.
    laws, beam, thresholds, max_layers
        As for `held_out_scores`.
    free : Law
        The noise with a weak prior of log width.
    """
    pixels, frames = samples.shape
    out = PixelWidths(np.zeros(pixels), np.zeros(pixels), np.zeros(pixels), np.zeros(pixels))
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(max_layers + 1, frames, thresholds.first.shape[1])
    rules = LearntRules(LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, max_layers)
    count = 0
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        n = take_samples(samples[pixel], value, time)
        if n < LEAST_SAMPLES:
            continue
        data = Samples(value[:n], time[:n])
        fill_times(data, work.scratch)
        fill_cells(data, own, work.scratch)
        k, _ = count_surfaces(data, work, laws, own, thresholds, rules)
        if k == 0:
            continue
        maximise(data, k, work.fit, free, own, LEARNING_ITER, LEARNING_TOL, work.scratch)
        held, place = 0.0, 0.0
        for i in range(k):
            held += work.fit[SUPPORT, i]
            place += work.fit[SUPPORT, i] * work.fit[MEAN, i]
        out.place[count], out.log_width[count] = place / held, work.fit[OWN, LOG_WIDTH]
        out.support[count], out.surfaces[count] = held, float(k)
        count += 1
    return PixelWidths(out.place[:count], out.log_width[:count], out.support[:count], out.surfaces[:count])
