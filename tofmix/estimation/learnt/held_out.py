"""How well a noise model predicts samples that no fit has seen, of pixels that it was not learnt from."""

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.blocks import take_samples
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
from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS
from tofmix.estimation.noise.pixel_noise import beam_of_pixel

PARTS = 4
"""Parts of a pixel's frames, each predicted from the others: a fit to half of a few samples predicts badly under the
true noise too, most of all where a shape is steep."""

LEAST_GAIN = 7.0
"""Gain, nat, that a surface must have here, under any model: a Gaussian's is 6 for one false alarm in 1000."""

LEAST_FIRST_GAIN = 4.0
"""Gain, nat, that the first surface must have beside background alone: a pixel with a surface must not go without one
where the recording's ranges, and so the background, span few sigmas; one without any costs all models the same."""

NO_SURFACE_NATS = 1.0e9
"""Nats by which background alone must explain a pixel better than one surface does, where it may not."""

SURPRISES = 0.02
"""Share of background that is mixed into every model here: samples of a surface that the other frames did not show
surprise all models alike, and say nothing of noise."""

_CHANCES = len(FALSE_ALARMS)
_MIX, _BITS = 0x9E3779B1, 0xFFFFFFFF  # 2^32 by the golden ratio, odd (Knuth): it scatters neighbouring frames


def flat_thresholds(*, always_one: bool = False) -> Thresholds:
    """The same gains for all models: what noise reaches is known only when one is chosen.

    With `always_one` every pixel has a surface: it is no model of noise that all samples of a pixel are background,
    where pixels have no background of their own.
    """
    return Thresholds(
        log_n=np.zeros(1),
        background=np.zeros(1),
        more=np.full((1, 1, _CHANCES), LEAST_GAIN) + 1e-9 * np.arange(_CHANCES),
        first=np.full((1, _CHANCES), -NO_SURFACE_NATS if always_one else LEAST_FIRST_GAIN) + 1e-9 * np.arange(_CHANCES),
    )


@borrowing
def _part_of(frame: int) -> int:
    """Part of a frame, 0 to PARTS - 1, as if at random: targets of a frame, or surfaces, may take turns."""
    mixed = (frame + 1) * _MIX & _BITS
    mixed = (mixed ^ mixed >> 15) * _MIX & _BITS
    return (mixed ^ mixed >> 13) % PARTS


@jit
def held_out_scores(
    samples: Float32Array, laws: tuple[Law, Law], beam: Beam, thresholds: Thresholds, max_layers: int
) -> tuple[FloatArray, FloatArray]:
    """Log likelihood, nat, of each of `PARTS` of a pixel's frames under a fit to the others.

    Returns the sum (pixel,) of all, NaN where there are too few samples, and the surfaces found (pixel,) on average.
    """
    pixels, frames = samples.shape
    out, found = np.full(pixels, np.nan), np.zeros(pixels)
    value, time = np.empty(frames), np.empty(frames)
    part = np.empty(frames, dtype=np.float32)
    work = new_workspace(max_layers + 1, frames, _CHANCES)
    rules = Rules(1.0e-3, 4.0, max_layers)
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        total, count = 0.0, 0
        for held in range(PARTS):
            for frame in range(frames):
                part[frame] = samples[pixel, frame] if _part_of(frame) != held else np.nan
            n = take_samples(part, value, time)
            if n < 4:  # noqa: PLR2004  fewer fit nothing
                continue
            data = Samples(value[:n], time[:n])
            fill_times(data, work.scratch)
            k, law = count_surfaces(data, work, laws, own, thresholds, rules)
            maximise(data, k, work.fit, law, own, LEARNING_ITER, LEARNING_TOL, work.scratch)
            found[pixel] += k / PARTS
            for frame in range(frames):
                part[frame] = samples[pixel, frame] if _part_of(frame) == held else np.nan
            m = take_samples(part, value, time)
            if m == 0:
                continue
            seen = Samples(value[:m], time[:m])
            fill_times(seen, work.scratch)
            mix(seen, k, work.fit, law, own, work.scratch)
            floor = SURPRISES * background_density(own)
            for j in range(m):
                total += np.log((1.0 - SURPRISES) * work.scratch[TOTAL_ROW, j] + floor)
            count += m
        if count > 0:
            out[pixel] = total
    return out, found
