"""The samples of one pixel, ascending, with their times within the window."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam, background_at
from tofmix.estimation.learnt.cells import has_steps, step_at
from tofmix.estimation.learnt.components import CELL, RANDOM, TIME
from tofmix.estimation.samples import FARTHEST_MM

LEAST_SAMPLES = 4
"""Least samples of a pixel that noise is learnt from: fewer determine no fit."""


class Samples(NamedTuple):
    """Samples of a pixel: `value` (n,) ascending, mm, and `time` (n,) of each, -1 to 1 over the window."""

    value: FloatArray
    time: FloatArray


@jit
def take_samples(samples: Float32Array, value: FloatArray, time: FloatArray) -> int:
    """Fill `value` (frame,) with the valid samples of a pixel (frame,), ascending, mm, and `time` with their times.

    Return their number. Time runs from -1 at the first frame to 1 at the last.
    """
    frames, n = len(samples), 0
    half = 0.5 * (frames - 1) if frames > 1 else 1.0
    order = np.argsort(samples, kind="mergesort")  # stable: equal samples stay in the order of frames; NaN last
    for frame in order:
        x = samples[frame]
        if abs(x) <= FARTHEST_MM:  # false for NaN
            value[n], time[n] = x, frame / half - 1.0
            n += 1
    return n


@borrowing
def cell_of(value: float, beam: Beam) -> tuple[float, float]:
    """Middle and half the length, mm, of the step that a stored value stands for.

    A step that grows with range reaches farther beyond the stored value than before it: the ends of the step are half a
    step away, each by the step on its own side.
    """
    step = step_at(value, beam)
    below, above = step_at(value - 0.25 * step, beam), step_at(value + 0.25 * step, beam)
    return value + 0.25 * (above - below), 0.25 * (above + below)


@borrowing
def fill_cells(data: Samples, beam: Beam, scratch: FloatArray) -> None:
    """Fill row RANDOM with the density of background at each sample, 1/mm, and row CELL with half its step, mm.

    Where the beam has steps, each value moves to the middle of its step, and `cells` reads row CELL. A value that has
    moved must not be given again.
    """
    for j in range(len(data.value)):
        scratch[RANDOM, j] = background_at(data.value[j], beam)
    if has_steps(beam):
        for j in range(len(data.value)):
            data.value[j], scratch[CELL, j] = cell_of(data.value[j], beam)


@borrowing
def fill_times(data: Samples, scratch: FloatArray) -> None:
    """Fill the rows from TIME on with the Legendre polynomials of time, of the degrees 1 to 3."""
    for j in range(len(data.value)):
        t = data.time[j]
        scratch[TIME, j] = t
        scratch[TIME + 1, j] = 1.5 * t * t - 0.5
        scratch[TIME + 2, j] = (2.5 * t * t - 1.5) * t
