"""Held-out likelihood: of samples that no fit has seen, in pixels that the noise was not learnt from."""

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.acceleration import LEARNING_ITER, LEARNING_TOL, maximise
from tofmix.estimation.learnt.components import TOTAL
from tofmix.estimation.learnt.counting import LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, LearntRules, count_surfaces
from tofmix.estimation.learnt.em import background_density, mix
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.pixel_samples import LEAST_SAMPLES, Samples, fill_cells, fill_times, take_samples
from tofmix.estimation.learnt.thresholds import GainThresholds
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS
from tofmix.estimation.noise.pixel_noise import beam_of_pixel

PARTS = 4
"""Parts of the frames of a pixel, each predicted by a fit to the others. A fit to fewer samples predicts badly under
the true noise too, above all where a shape is steep."""

LEAST_GAIN = 7.0
"""Threshold of a further surface under any model, nat: for Gaussian noise it is 6 at one false alarm in 1000."""

LEAST_FIRST_GAIN = 4.0
"""Threshold of the first surface over background alone, nat. It is low because the background may span few sigmas: a
pixel with a surface must not pass for background. A pixel without surfaces costs all models the same."""

NO_SURFACE_NATS = 1.0e9
"""Threshold of the first surface where each pixel has one, below 0: no gain is as low."""

SURPRISES = 0.02
"""Share of background that is mixed into every model: samples of a surface that no other frame shows are improbable
under all models, and must not decide between them."""

_CHANCES = len(FALSE_ALARMS)
_MULTIPLIER, _BITS = 0x9E3779B1, 0xFFFFFFFF
"""Hash of a frame: the factor is 2^32 by the golden ratio, odd (Knuth, The Art of Computer Programming 3, 6.4)."""


def flat_thresholds(*, always_one: bool = False) -> GainThresholds:
    """Make thresholds that are the same for all models and samples: those of a model are known after its choice.

    With `always_one`, each pixel has a surface. A model without background by pixel must not explain a pixel by
    background alone.
    """
    return GainThresholds(
        log_n=np.zeros(1),
        background=np.zeros(1),
        more=np.full((1, 1, _CHANCES), LEAST_GAIN) + 1e-9 * np.arange(_CHANCES),
        first=np.full((1, _CHANCES), -NO_SURFACE_NATS if always_one else LEAST_FIRST_GAIN) + 1e-9 * np.arange(_CHANCES),
    )


@borrowing
def _part_of(frame: int) -> int:
    """Part of a frame, 0 to PARTS - 1, by a hash: surfaces, or targets of a frame, may come in turn."""
    mixed = (frame + 1) * _MULTIPLIER & _BITS
    mixed = (mixed ^ mixed >> 15) * _MULTIPLIER & _BITS
    return (mixed ^ mixed >> 13) % PARTS


@jit
def held_out_scores(
    samples: Float32Array, laws: tuple[Law, Law], beam: Beam, thresholds: GainThresholds, max_layers: int
) -> tuple[FloatArray, FloatArray]:
    """Log likelihood of each of `PARTS` of a pixel's frames under a fit to the others.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples, mm, NaN where invalid.
    laws : (Law, Law)
        The noise, with and without drift.
    beam : Beam
        The fixed part of equation (1).
    thresholds : Thresholds
        Gains that surfaces must have; see `flat_thresholds`.
    max_layers : int
        Most surfaces of a pixel.

    Returns
    -------
    (pixel,) float64
        Sum over the parts, nat; NaN where a pixel has too few samples.
    (pixel,) float64
        Mean number of surfaces.
    """
    pixels, frames = samples.shape
    out, found = np.full(pixels, np.nan), np.zeros(pixels)
    value, time = np.empty(frames), np.empty(frames)
    part = np.empty(frames, dtype=np.float32)
    work = new_workspace(max_layers + 1, frames, _CHANCES)
    rules = LearntRules(LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, max_layers)
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        total, count = 0.0, 0
        for held in range(PARTS):
            for frame in range(frames):
                part[frame] = samples[pixel, frame] if _part_of(frame) != held else np.nan
            n = take_samples(part, value, time)
            if n < LEAST_SAMPLES:
                continue
            data = Samples(value[:n], time[:n])
            fill_times(data, work.scratch)
            fill_cells(data, own, work.scratch)
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
            fill_cells(seen, own, work.scratch)
            mix(seen, k, work.fit, law, own, work.scratch)
            floor = SURPRISES * background_density(own)
            for j in range(m):
                total += np.log((1.0 - SURPRISES) * work.scratch[TOTAL, j] + floor)
            count += m
        if count > 0:
            out[pixel] = total
    return out, found
