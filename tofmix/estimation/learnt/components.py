"""The samples of one pixel, the surfaces of a mixture under the learnt noise, and scratch arrays for its fit.

The surfaces of a mixture under the learnt noise, and scratch arrays for its fit.

Both are plain float64 arrays with a row for each quantity, as in `tofmix.estimation.mixture.em`: fits are
copied, sorted and extrapolated as wholes.

A fit is (ROWS, capacity + 1). Rows MEAN and SIGMA (of the noise curve) are in mm, SUPPORT is a surface's sum of
responsibilities, in samples, and GAIN the loss of the objective without the surface, nat. From DRIFT on stand `DRIFTS`
coefficients of a surface's drift, mm. The last column of row WEIGHT is the share of c_0. Row OWN has the numbers of the
pixel, in the columns LOG_WIDTH and BACKGROUND (its share). Row PLACE has steps of the means, in sigmas; from FIRST,
SECOND and THIRD on stand the three vectors of an acceleration.

A scratch is (rows, samples): TOTAL is p(r_j), SHARE 1 / p(r_j), TERM and NEW are free for any loop, and CELL has half
the step on which a sample is stored, mm (`law`), and RANDOM the density of background, 1/mm. From TIME on stand the
polynomials of time, from SCORES on three scores, and from DENSITY on the densities of the surfaces, 1/mm. Then follow
the density of c_0 (`no_return_row`), -f' of the surfaces (`slope_row`), and the samples less the drift of each surface
(`still_row`).

The samples of one pixel, ascending, with their times within the window.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import NO_RETURN_REACH, Beam, background_at, near_no_return, sigma_at
from tofmix.estimation.learnt.law import has_steps, step_at
from tofmix.estimation.mixture.em import LEAST_SHARE
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.noise_shape import DRIFTS

MEAN, SIGMA, WEIGHT, SUPPORT, GAIN, DRIFT = range(6)
OWN = DRIFT + DRIFTS
PLACE = OWN + 1
FIRST = PLACE + 1

VECTOR = 3 + DRIFTS
"""Rows of a vector: means in sigmas, shares, drifts in sigmas, the pixel's numbers."""

SECOND, THIRD = FIRST + VECTOR, FIRST + 2 * VECTOR
ROWS = FIRST + 3 * VECTOR

LOG_WIDTH, BACKGROUND = range(2)
OWN_NUMBERS = 2
"""Columns of row OWN."""

TOTAL, SHARE, TERM, NEW, CELL, RANDOM, TIME = range(7)
SCORES = TIME + DRIFTS
DENSITY = SCORES + 3


@jit
def new_fit(capacity: int) -> FloatArray:
    """Make room (ROWS, capacity + 1) for `capacity` surfaces and c_0."""
    return np.zeros((ROWS, max(capacity, OWN_NUMBERS) + 1))


@jit
def new_scratch(capacity: int, samples: int) -> FloatArray:
    """Make room (rows, samples) for pixels of up to `samples` samples and `capacity` surfaces."""
    return np.zeros((DENSITY + 3 * max(capacity, OWN_NUMBERS) + 1, samples))


@borrowing
def capacity_of(fit: FloatArray) -> int:
    """Most surfaces that there is room for."""
    return len(fit[MEAN]) - 1


@borrowing
def no_return_row(fit: FloatArray) -> int:
    """Row of the densities of c_0."""
    return DENSITY + capacity_of(fit)


@borrowing
def slope_row(fit: FloatArray) -> int:
    """First row of the slopes -f'."""
    return DENSITY + capacity_of(fit) + 1


@borrowing
def still_row(fit: FloatArray) -> int:
    """First row of the samples less each surface's drift; filled where the law has a drift."""
    return DENSITY + 2 * capacity_of(fit) + 1


@borrowing
def copy_fit(source: FloatArray, target: FloatArray) -> None:
    """Copy the surfaces, c_0 and the numbers of the pixel."""
    for row in range(OWN + 1):
        for i in range(len(source[row])):
            target[row, i] = source[row, i]


@borrowing
def start_without_surface(value: FloatArray, fit: FloatArray, beam: Beam) -> None:
    """Fill `fit` with background alone, and with c_0 where some of the samples (n,), mm, lie near r_max."""
    n = len(value)
    for row in range(ROWS):
        for i in range(len(fit[row])):
            fit[row, i] = 0.0
    near = 0.0
    if math.isfinite(beam.range_max):
        for j in range(n):
            if near_no_return(value[j], NO_RETURN_REACH, beam):
                near += 1.0
    share = near / n
    fit[OWN, BACKGROUND] = 1.0 if near == 0.0 else max(1.0 - share, 1.0 / n)
    fit[WEIGHT, -1] = 0.0 if near == 0.0 else 1.0 - fit[OWN, BACKGROUND]


@borrowing
def add_surface(k: int, place: float, share: float, fit: FloatArray, beam: Beam) -> int:
    """Add a surface at `place`, mm, with this share; scale the shares of all else down. Return k + 1."""
    for i in range(k):
        fit[WEIGHT, i] *= 1.0 - share
    fit[WEIGHT, -1] *= 1.0 - share
    fit[OWN, BACKGROUND] *= 1.0 - share
    fit[MEAN, k], fit[WEIGHT, k] = place, share
    for d in range(DRIFTS):
        fit[DRIFT + d, k] = 0.0
    fit[SIGMA, k] = sigma_at(place, beam.curve_range, beam.curve_sigma)
    return k + 1


@borrowing
def clear_width_and_drift(fit: FloatArray) -> None:
    """Give the pixel the common width, and its surfaces no drift."""
    fit[OWN, LOG_WIDTH] = 0.0
    for d in range(DRIFTS):
        for i in range(len(fit[DRIFT])):
            fit[DRIFT + d, i] = 0.0


@borrowing
def remove_surface(k: int, index: int, fit: FloatArray) -> int:
    """Close the gap that surface `index` leaves; divide its share among all else. Return k - 1."""
    weight = fit[WEIGHT, index]
    for row in range(OWN):
        for i in range(index, k - 1):
            fit[row, i] = fit[row, i + 1]
    left = 1.0 - weight
    if k == 1 and fit[WEIGHT, -1] == 0.0:
        fit[OWN, BACKGROUND] = 1.0
        clear_width_and_drift(fit)
    elif left > LEAST_SHARE:
        for i in range(k - 1):
            fit[WEIGHT, i] /= left
        fit[WEIGHT, -1] /= left
        fit[OWN, BACKGROUND] /= left
    return k - 1


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
