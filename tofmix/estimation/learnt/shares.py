"""What single pixels tell of a noise model, by a count under it: their share of background, and their width."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.blocks import take_samples
from tofmix.estimation.learnt.components import BACKGROUND, LOG_WIDTH, MEAN, OWN, SUPPORT
from tofmix.estimation.learnt.components import TOTAL as TOTAL_ROW
from tofmix.estimation.learnt.counting import Rules, count_surfaces
from tofmix.estimation.learnt.fitting import (
    LEARNING_ITER,
    LEARNING_TOL,
    Samples,
    background_density,
    fill_times,
    maximise,
    mix,
)
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.thresholds import Thresholds
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.noise.pixel_noise import beam_of_pixel


@jit
def background_shares(
    samples: Float32Array, laws: tuple[Law, Law], beam: Beam, thresholds: Thresholds, max_layers: int
) -> tuple[FloatArray, FloatArray]:
    """Share of background (pixel,) among the samples (pixel, frame), without its prior; and their number (pixel,).

    The number is 0 where a pixel shows no surface: nothing tells its background from far surfaces then.
    """
    pixels, frames = samples.shape
    share, number = np.zeros(pixels), np.zeros(pixels)
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(max_layers + 1, frames, thresholds.first.shape[1])
    rules = Rules(1.0e-3, 4.0, max_layers)
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        n = take_samples(samples[pixel], value, time)
        if n < 4:  # noqa: PLR2004  fewer fit nothing
            continue
        data = Samples(value[:n], time[:n])
        fill_times(data, work.scratch)
        k, law = count_surfaces(data, work, laws, own, thresholds, rules)
        if k == 0:
            continue
        mix(data, k, work.fit, law, own, work.scratch)
        random = work.fit[OWN, BACKGROUND] * background_density(beam)
        total = 0.0
        for j in range(n):
            total += random / work.scratch[TOTAL_ROW, j]
        share[pixel], number[pixel] = total / n, float(n)
    return share, number


class PixelWidths(NamedTuple):
    """Widths of pixels, all (pixel,): mean `place` of the surfaces, mm, `log_width`, samples of them, and how many."""

    place: FloatArray
    log_width: FloatArray
    support: FloatArray
    surfaces: FloatArray


@jit
def pixel_widths(
    samples: Float32Array, laws: tuple[Law, Law], free: Law, beam: Beam, thresholds: Thresholds, max_layers: int
) -> PixelWidths:
    """Width of the samples (pixel, frame) about all surfaces that each pixel is found to have; none of pixels without.

    For recordings in which no surface stands clear of others. Surfaces are counted under `laws`, and their width is
    measured under `free`, which leaves it to the samples: a count with free widths takes three surfaces for a wide one.
    """
    pixels, frames = samples.shape
    out = PixelWidths(np.zeros(pixels), np.zeros(pixels), np.zeros(pixels), np.zeros(pixels))
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(max_layers + 1, frames, thresholds.first.shape[1])
    rules = Rules(1.0e-3, 4.0, max_layers)
    count = 0
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        n = take_samples(samples[pixel], value, time)
        if n < 4:  # noqa: PLR2004  fewer fit nothing
            continue
        data = Samples(value[:n], time[:n])
        fill_times(data, work.scratch)
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
