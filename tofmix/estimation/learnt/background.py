"""Background under the learnt noise: the share of each pixel, with its width, and the density over range of all.

Shares and widths follow from a count of surfaces under a noise model. The density shows fog and rain, which return
light near the sensor.

Expectation-maximisation over the image: under a density, the surfaces of each pixel are counted and fitted, and each
sample is background with its responsibility; a smooth density of all these samples is the next one. The first density
is that of all samples, in wide cells: a surface is far narrower, stands out, and leaves the next densities, whose cells
are finer. From the uniform density on, chance clumps of fog would pass for surfaces, and never become background; and
from fine cells on, surfaces at the same range in all pixels would pass for background.

The logarithm of the density is a random walk over its cells. The variance of its steps is that of the largest evidence
(Laplace's approximation); 0 makes it uniform.

References
----------
Rue and Held, Gaussian Markov Random Fields, 2005, sections 3.3 and 4.4.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.acceleration import LEARNING_ITER, LEARNING_TOL, maximise
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    LEAST_SAMPLES,
    LOG_WIDTH,
    MEAN,
    OWN,
    RANDOM,
    SUPPORT,
    TOTAL,
    Samples,
    fill_cells,
    fill_times,
    take_samples,
)
from tofmix.estimation.learnt.counting import LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, LearntRules, count_surfaces
from tofmix.estimation.learnt.em import mix
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.model import GainThresholds
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.noise.amplitude import beam_of_pixel
from tofmix.noise_shape import BackgroundDensity
from tofmix.sensor import NoiseCurve


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


CELL_SIGMAS = 64.0, 32.0, 16.0, 8.0
"""Least widths of the cells of the densities, in sigmas. Nearly all samples of a surface lie in one of the last cells;
in the first ones it has at least the tenfold density of background of the same number of samples."""

MOST_CELLS = 128
"""Most cells of a density."""

_STEP_DEVIATIONS = np.geomspace(0.01, 3.0, 24)
"""Standard deviations of the steps of log density from cell to cell that are tried."""

_NEWTON_STEPS, _NEWTON_TOLERANCE = 60, 1e-8
"""Most steps to the most probable log density, and the step that ends them."""


@jit
def background_counts(
    samples: Float32Array,
    laws: tuple[Law, Law],
    beam: Beam,
    thresholds: GainThresholds,
    max_layers: int,
    edges: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Number of samples of background in cells of range, and share of each pixel, of pixels with a surface.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples, mm, NaN where invalid.
    laws, beam, thresholds, max_layers
        As for `held_out.held_out_scores`.
    edges : (cell + 1,) float64
        Edges of the cells, mm, ascending.

    Returns
    -------
    (cell,) float64
        Sums of responsibilities. Samples beyond the edges are left out.
    (pixel,), (pixel,) float64
        Share and number as of `shares.background_shares`.
    """
    pixels, frames = samples.shape
    out = np.zeros(len(edges) - 1)
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
            continue  # its samples may be of surfaces or of background
        maximise(data, k, work.fit, law, own, LEARNING_ITER, LEARNING_TOL, work.scratch)
        mix(data, k, work.fit, law, own, work.scratch)
        cell, number[pixel] = 0, float(n)
        for j in range(n):
            random = work.fit[OWN, BACKGROUND] * work.scratch[RANDOM, j] / work.scratch[TOTAL, j]
            share[pixel] += random / n
            while cell < len(out) and data.value[j] >= edges[cell + 1]:
                cell += 1
            if cell < len(out) and data.value[j] >= edges[cell]:
                out[cell] += random
    return out, share, number


def cell_edges(curve: NoiseCurve, low_mm: float, high_mm: float, cell_sigmas: float) -> FloatArray:
    """Edges (cell + 1,) of cells of equal numbers of sigmas, at least `cell_sigmas`, mm, over the working range."""
    at = np.union1d(np.linspace(low_mm, high_mm, 4 * MOST_CELLS + 1), np.clip(curve.range_mm, low_mm, high_mm))
    sigmas = np.concatenate([[0.0], np.cumsum(np.diff(at) / curve.sigma(0.5 * (at[1:] + at[:-1])))])
    cells = int(min(max(sigmas[-1] // cell_sigmas, 1), MOST_CELLS))
    edges = np.interp(np.linspace(0.0, sigmas[-1], cells + 1), sigmas, at)
    return np.asarray(edges, dtype=np.float64)


def cells_of_surface(curve: NoiseCurve, edges: FloatArray, law: Law) -> int:
    """Most cells that the samples of one surface lie in, wherever it stands; cells have equal numbers of sigmas."""
    sigmas = float((edges[1] - edges[0]) / curve.sigma(0.5 * (edges[:1] + edges[1:2]))[0])
    return math.ceil((law.high - law.low) / sigmas) + 1


def smooth_density(counts: FloatArray, edges: FloatArray, least_cells: int = 1) -> BackgroundDensity:
    """Most probable density of background, with the random walk of the largest evidence, less its narrow peaks.

    Where many pixels see a few samples of a surface, too few to be counted, the samples of all make a peak as narrow as
    the samples of one surface. Fog, rain and tails of pulses are wider. Such a peak is surfaces, not background: else a
    pixel that sees more of this surface would need more samples to show it there than anywhere else.

    Parameters
    ----------
    counts : (cell,) float64
        Samples of background in each cell.
    edges : (cell + 1,) float64
        Edges of the cells, mm.
    least_cells : int
        Peaks of fewer cells are cut off at the level beside them; see `cells_of_surface`. Where the cells without any
        sample begin, a peak may be cut by the reach of the camera: it stays.

    Returns
    -------
    BackgroundDensity
        Uniform where no random walk has a larger evidence.

    References
    ----------
    Serra, Image Analysis and Mathematical Morphology, 1982, chapter 12: the opening of a function by an interval.
    """
    uniform = BackgroundDensity.uniform(edges[0], edges[-1])
    total, width = float(counts.sum()), np.diff(edges)
    if total <= 0.0 or len(counts) < 2:  # noqa: PLR2004  one cell has no shape
        return uniform
    flat = math.log(total / width.sum())
    best = float((counts * (flat + np.log(width))).sum()) - total
    found, log_density = None, np.full(len(counts), flat)
    for deviation in _STEP_DEVIATIONS:
        log_density, evidence = _walk(counts, width, float(deviation), log_density)
        if evidence > best:
            best, found = evidence, log_density
    if found is None:
        return uniform
    filled = np.flatnonzero(counts)
    reach = slice(filled[0], filled[-1] + 1)
    found[reach] = _opened(found[reach], least_cells)
    middle = 0.5 * (edges[1:] + edges[:-1])
    at = np.concatenate([edges[:1], middle, edges[-1:]])
    return BackgroundDensity(at, np.exp(found[np.r_[0, np.arange(len(found)), -1]] - found.max()))


def _opened(value: FloatArray, cells: int) -> FloatArray:
    """Largest function (cell,) below `value` whose peaks have at least some cells; beyond the ends they may go on."""
    beyond = np.full(cells - 1, np.inf)
    lowest = sliding_window_view(np.concatenate([beyond, value, beyond]), cells).min(axis=1)
    return np.asarray(sliding_window_view(lowest, cells).max(axis=1))


@jit
def _walk(counts: FloatArray, width: FloatArray, deviation: float, start: FloatArray) -> tuple[FloatArray, float]:
    """Most probable log density (cell,) under steps of a standard deviation, by Newton's method, and its log evidence.

    The level of the walk has a flat prior, as that of the uniform density.
    """
    precision = 1.0 / (deviation * deviation)
    value, step = start.copy(), np.empty(len(counts))
    longest_step = 2.0  # most that a log density moves in one Newton step: counts of 0 would drive it far
    for _ in range(_NEWTON_STEPS):
        longest, _ = _newton_step(counts, width, precision, value, step)
        part = min(1.0, longest_step / longest) if longest > 0.0 else 1.0
        for j in range(len(value)):
            value[j] += step[j] * part
        if longest < _NEWTON_TOLERANCE:
            break
    _, volume = _newton_step(counts, width, precision, value, step)
    fit, squares, total = 0.0, 0.0, 0.0
    for j in range(len(value)):
        expected = math.exp(value[j]) * width[j]
        fit += counts[j] * math.log(expected) - expected
        squares += precision * (value[j] - value[j - 1]) ** 2 if j > 0 else 0.0
        total += counts[j]
    # The uniform density has the volume of its level alone, 1 / total.
    prior = -2.0 * (len(counts) - 1) * math.log(deviation)
    return value, fit + 0.5 * (prior - squares - volume + math.log(total))


@jit
def _newton_step(
    counts: FloatArray, width: FloatArray, precision: float, value: FloatArray, step: FloatArray
) -> tuple[float, float]:
    """Fill `step` (cell,) with Newton's; return the longest, and the log determinant of the Hessian.

    A step of the walk joins two neighbouring cells: the Hessian is tridiagonal, and elimination goes from cell to cell.
    """
    cells, longest, volume = len(counts), 0.0, 0.0
    pivot = np.empty(cells)
    for j in range(cells):
        pivot[j] = math.exp(value[j]) * width[j]
        step[j] = counts[j] - pivot[j]
        if j > 0:
            pivot[j] += precision
            step[j] -= precision * (value[j] - value[j - 1])
        if j < cells - 1:
            pivot[j] += precision
            step[j] -= precision * (value[j] - value[j + 1])
        if j > 0:
            pivot[j] -= precision * precision / pivot[j - 1]
            step[j] += precision / pivot[j - 1] * step[j - 1]
        volume += math.log(pivot[j])
    for j in range(cells - 1, -1, -1):
        if j < cells - 1:
            step[j] += precision * step[j + 1]
        step[j] /= pivot[j]
        longest = max(longest, abs(step[j]))
    return longest, volume
