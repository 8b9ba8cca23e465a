"""Each pixel's share of background under a noise model."""

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.blocks import take_samples
from tofmix.estimation.learnt.counting import Rules, Thresholds, count_surfaces, new_work
from tofmix.estimation.learnt.fitting import BACKGROUND, OWN, Samples, background_density, fill_times, mix
from tofmix.estimation.learnt.fitting import TOTAL as TOTAL_ROW
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.pixel_noise import beam_of_pixel
from tofmix.jit import jit


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
    work = new_work(max_layers + 1, frames, thresholds.first.shape[1])
    rules = Rules(1.0e-3, 4.0, max_layers)
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        n = take_samples(samples[pixel], value, time)
        if n < 4:  # noqa: PLR2004  fewer fit nothing
            continue
        data = Samples(value[:n], time[:n])
        fill_times(data, work.room)
        k, law = count_surfaces(data, work, laws, own, thresholds, rules)
        if k == 0:
            continue
        mix(data, k, work.fit, law, own, work.room)
        random = work.fit[OWN, BACKGROUND] * background_density(beam)
        total = 0.0
        for j in range(n):
            total += random / work.room[TOTAL_ROW, j]
        share[pixel], number[pixel] = total / n, float(n)
    return share, number
