"""Fits of hidden states, which a smooth search cannot find.

Each function returns the numbers of a hidden state (`tofmix.simulation.effects.hidden`), or the values of pixels, or
None if there is no evidence. The step of quantised samples is among them.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import erf
from scipy.stats import mode

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.beats import FrameNoise, fit_beat, overlaps
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part, forward
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import PixelBiases, marginal_pattern, pixel_biases, spreads_of
from tofmix.simulation.effects.hidden import FrameChain, PatternSpreads

_LEAST_STEP_MM, _MOST_STEP_MM = 1.6, 120.0  # a finer step hardly shows in whole mm; a scene does not fill a coarser one
_ON_LATTICE = 0.985  # least share of the samples on the steps; the others are random values
_AS_MANY = 0.999  # least share of the samples that a coarser step explains, against a finer one
_AROUND = 60  # lines of the spectrum on either side of a peak that are searched for the step
_MANY = 0.1  # least share of varying pixels
_FULL = 5.0  # counts of a mm that has a density


def find_lattice(evidence: Evidence, state: ModelState) -> float | None:
    """The step, mm, of which nearly all stored values are rounded multiples, from the spectrum of their histogram."""
    count = np.bincount(evidence.samples[:, _telling(evidence, state)].ravel(), minlength=65_536).astype(np.float64)
    count[0] = 0
    total = count.sum()
    smooth = np.convolve(count, np.ones(9) / 9, mode="same")
    comb = np.where(smooth >= _FULL, np.clip((count - smooth) / np.sqrt(np.maximum(smooth, 1)), -6, 6), 0.0)
    length = 1 << 20
    power = np.abs(np.fft.rfft(comb, length))
    line = np.arange(power.size) / length
    inside = (line > 1 / _MOST_STEP_MM) & (line < 1 / _LEAST_STEP_MM)
    values = np.flatnonzero(count)
    weights = count[values]
    peaks = [peak / length for peak in _peaks(np.where(inside, power, 0.0), 12)]
    # Aliasing: whole mm show no more than half a cycle a mm, so a step of less than 2 mm appears at 1 - f
    folded = [1 - f for f in peaks if 1 - f < 1 / _LEAST_STEP_MM]
    for frequency in (*peaks, *folded):
        trial = frequency + np.linspace(-_AROUND, _AROUND, 4 * _AROUND + 1) / length
        held = [_held(1 / f, values, weights) / total for f in trial]
        if max(held) >= _ON_LATTICE:
            best = np.flatnonzero(np.array(held) >= max(held) - 1e-9)
            fine = float(1 / trial[best].mean())
            step = _sharpened(fine * _multiple(fine, values, weights), values, weights)
            # The last digit decides ties of rounding: a step of few digits may be that of the camera
            near = [*(round(step, digits) for digits in (0, 1, 2, 3)), step]
            return max(near, key=lambda s: _held(s, values, weights, slack=0.0))
    return None


def _telling(evidence: Evidence, state: ModelState) -> BoolArray:
    """The working pixels (pixel,) that vary, if there are many: the value of a stuck pixel is on no step."""
    varying = state.working & (evidence.samples != evidence.samples[0]).any(axis=0)
    return varying if varying.sum() > _MANY * state.working.sum() else state.working


def _sharpened(step: float, values: IntArray, weights: FloatArray) -> float:
    """The middle of the interval of steps near this one of which most samples are rounded multiples.

    The k-th multiple rounds to v for steps from (v - 0.5) / k to (v + 0.5) / k. Sorted ends of these intervals show
    where most of them overlap.
    """
    k = np.rint(values / step)
    near = (k > 0) & (np.abs(k * step - values) <= 1.0)
    k, v, weight = k[near], values[near], weights[near]
    ends = np.concatenate([(v - 0.5) / k, (v + 0.5) / k])
    order = np.argsort(ends, kind="stable")
    held = np.cumsum(np.concatenate([weight, -weight])[order])
    at = int(held[:-1].argmax())
    return float(0.5 * (ends[order[at]] + ends[order[at + 1]]))


def _multiple(step: float, values: IntArray, weights: FloatArray) -> int:
    """The factor by which a step may be coarser and explain as many samples: 6.25 mm also explains steps of 12.5 mm."""
    held = _held(step, values, weights)
    coarser = (k for k in (4, 3, 2) if k * step <= _MOST_STEP_MM)
    return next((k for k in coarser if _held(k * step, values, weights) >= _AS_MANY * held), 1)


def _peaks(power: FloatArray, most: int) -> list[int]:
    """The strongest frequencies, lowest first: the period of the step before its overtones."""
    power = power.copy()
    found = []
    for _ in range(most):
        at = int(power.argmax())
        if power[at] <= 0:
            break
        found.append(at)
        power[max(0, at - 400) : at + 400] = 0.0
    return sorted(found)


def _held(step: float, values: IntArray, weights: FloatArray, *, slack: float = 0.02) -> float:
    """Number of samples on the steps; `slack` mm more than half a mm are allowed, for ties of rounding."""
    nearest = np.rint(values / step) * step
    on = np.abs(nearest - values) <= 0.5 + slack if slack else np.rint(nearest) == values
    return float(weights[on].sum())


_MANY_STUCK = 0.05  # share of constant pixels, above which they may be due to quantisation
_LATTICE = 0.9  # least share of two values in a pixel that quantisation explains
_UNLIKELY_NATS = 25.0  # a constant pixel that the model explains to within this is not stuck
VALUE_NATS = math.log(65_534.0)  # price of the value of a stuck pixel: any whole mm is equally likely
_FAR = 10.0  # standard deviations
_CHANCE = 2.0  # standard deviations
_MOST_FRAMES = 0.9  # largest share of frames in bursts
_BEYOND = 0.1  # least part of the gain of bursts that noise in all frames does not reach
_LONGEST = 0.3  # of the frames: a longer burst is a change that starts or stops once
_MOST_LOG_MM = 6.9  # logarithm of the upper bound of a spread
_LEAST_DIFFERENT = 2  # pixels: one bias is an offset
_MOST_BURST_MM = 10_000.0  # largest noise of disturbed frames
_NEXT = math.log(2.0)  # logarithm of the ratio of first trial sizes


def find_stuck(likelihood: Likelihood, mixture: Mixture) -> FloatArray | None:
    """Values (pixel,), mm, of pixels with one value in every frame that no bias of a pixel explains; NaN for others."""
    evidence = likelihood.evidence
    x = evidence.samples
    constant = (x == x[0]).all(axis=0) & (x[0] > 0)
    known = mixture.step > 0  # quantisation, whose effect on a pixel is known
    if not constant.any() or (constant.mean() > _MANY_STUCK and not known and _on_lattice(x[:, ~constant])):
        return None
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    best = sum((_constant_nats(view) for view in views(likelihood, mixture, whole)), np.zeros(whole[1].size))
    stuck = constant & (-best > _UNLIKELY_NATS + VALUE_NATS)
    if not stuck.any():
        return None
    return np.where(stuck, x[0].astype(np.float64), np.nan)


def _on_lattice(samples: NDArray[np.uint16]) -> bool:
    """Whether most pixels of (frame, pixel) samples have hardly more than two values.

    Quantisation that gives some pixels one value gives the others at most two; a defect does not change the others.
    """
    if not samples.size:
        return True
    first, often = mode(samples, axis=0)
    others = -1 - np.arange(samples.shape[0])  # of the first value's samples, each of them once
    _, next_often = mode(np.where(samples == first, others[:, None], samples.astype(np.int64)), axis=0)
    return bool(np.median(often + next_often) > _LATTICE * samples.shape[0])


def _constant_nats(view: RecordingView) -> FloatArray:
    """Largest log-likelihood (pixel,) of one repeated value, for a normal with the pixel's sigma and any mean."""
    spread = view.mixture.of_main(view.mixture.sigma)
    cell = max(1.0, view.mixture.step)
    best = np.log(erf(cell / np.sqrt(8 * (spread**2 + 1 / 12))))
    return np.where(_beyond_lattice(view), -np.inf, best * view.evidence.shape[0])


def _beyond_lattice(view: RecordingView) -> BoolArray:
    """Whether quantisation cannot give the value of a pixel (pixel,): it is off the steps, or far from each surface.

    Coarse quantisation also gives working pixels one value, so a constant value is no evidence there.
    """
    m, value = view.mixture, view.evidence.samples[0].astype(np.float64)
    if m.step <= 0:
        return np.zeros(value.shape, dtype=bool)
    near = np.where(m.weight > 0, np.abs(value - m.mean) - _FAR * m.sigma, np.inf).min(axis=(0, 1))
    return np.asarray((near > 2 * m.step) | (np.rint(np.rint(value / m.step) * m.step) != value))


def fit_bursts(likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part) -> FrameChain | None:
    """Share, length and noise of bursts, with the states of frames integrated out."""
    lit = mixture.of_main(mixture.lit).astype(bool)
    sigmas = mixture.of_main(mixture.sigma)
    sigma = float(np.median(sigmas[lit] if lit.any() else sigmas))  # without a return, sigma is at the largest range
    numbers = likelihood.evidence.frame_number[part[0]]

    def at(size: float, start: tuple[float, float]) -> tuple[float, FrameChain]:
        size = min(size, _MOST_BURST_MM)
        pair = likelihood.frame_pair(mixture, state, part, size)

        def make(x: FloatArray) -> FrameChain:
            p = 1 / (1 + math.exp(-min(max(x[0], -7.0), 3.0)))
            return FrameChain(probability=p, sigma_mm=size, burst_frames=1 + math.exp(min(max(x[1], -2.0), 4.0)))

        options: Any = {"maxfev": 60, "xatol": 1e-2, "fatol": 0.05}

        def cost(x: FloatArray) -> float:
            return -forward(*pair, numbers, make(x))[0]

        found = minimize(cost, np.array(start, dtype=np.float64), method="Nelder-Mead", options=options)
        return -float(found.fun), make(found.x)

    best = max((at(sigma * 2.0**k, (-1.5, 1.2)) for k in range(-4, 4)), key=lambda pair: pair[0])
    while 8.0 * sigma <= best[1].sigma_mm < _MOST_BURST_MM / 4:  # a larger size may be better
        more = at(2 * best[1].sigma_mm, (-1.5, 1.2))
        if more[0] <= best[0]:
            break
        best = more
    start = math.log(best[1].probability / (1 - best[1].probability)), math.log(max(best[1].burst_frames - 1, 0.14))
    middle = math.log(best[1].sigma_mm)
    finer: Any = minimize_scalar(
        lambda size: -at(math.exp(size), start)[0],
        bounds=(middle - _NEXT, middle + _NEXT),
        method="bounded",
        options={"xatol": 2e-3, "maxiter": 12},
    )
    best = max(best, at(math.exp(float(finer.x)), start), key=lambda pair: pair[0])
    lasting = best[1].burst_frames > _LONGEST * len(likelihood.evidence.samples)
    if lasting or best[1].probability > _MOST_FRAMES:
        return None
    # The same noise in all frames must be worse than bursts, by a part of their gain
    calm, disturbed = (float(np.sum(x)) for x in likelihood.frame_pair(mixture, state, part, best[1].sigma_mm)[:2])
    return best[1] if best[0] - disturbed > _BEYOND * (best[0] - calm) else None


def fitted_again(
    likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part, chain: FrameChain
) -> FrameChain:
    """Bursts, or a beat, fitted again; as they were if none are found."""
    if not chain.period_frames:
        return fit_bursts(likelihood, mixture, state, part) or chain
    found = fit_beat(FrameNoise(likelihood, mixture, state, part))
    return chain if found is None else found[0]


def disturbed_frames(likelihood: Likelihood, mixture: Mixture, state: ModelState, chain: FrameChain) -> FloatArray:
    """Probability (frame,) that each frame is disturbed, from all its samples; of a beat, the square of its overlap."""
    frames, pixels = likelihood.evidence.shape
    part = (np.arange(frames), np.arange(pixels))
    if chain.period_frames:
        return overlaps(FrameNoise(likelihood, mixture, state, part), chain)
    pair = likelihood.frame_pair(mixture, state, part, chain.sigma_mm)
    return forward(*pair, likelihood.evidence.frame_number, chain)[1]


def fit_pattern(
    likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part
) -> tuple[PatternSpreads, PixelBiases] | None:
    """Spreads of a pattern by pixel, column and row, by marginal likelihood."""
    found = pixel_biases(likelihood, mixture, state, part)
    return fit_spreads(found, likelihood.evidence.image)


def fit_spreads(found: PixelBiases, image: tuple[int, int]) -> tuple[PatternSpreads, PixelBiases] | None:
    """The spreads that are most likely for the pixels' biases and their noise, in an image of any size.

    What all pixels have in common is an offset, and tells no spread. In a single row, the bias of a column is that of
    its pixel, and the bias of the row is an offset; likewise in a single column. Then only the spread by pixel is
    fitted.
    """
    use = found.information > 0
    if use.sum() < _LEAST_DIFFERENT:
        return None
    apart = _apart(found)
    if not _beyond_chance(apart, image):
        return None
    size = _size(apart.bias[use])

    def of(x: FloatArray) -> tuple[float, float, float]:
        fitted = [float(math.exp(min(max(v, -8.0), _MOST_LOG_MM))) for v in x]
        pixel, column, row = (*fitted, 0.0, 0.0)[:3]
        return pixel, column, row

    def cost(x: FloatArray) -> float:
        return -marginal_pattern(apart, image, of(x))[0]

    start = np.log(np.array([size, size * 0.3, size * 0.3])[: spreads_of(image)])
    simplex = np.vstack([start, start + 0.5 * np.eye(start.size)])
    options: Any = {"maxfev": 80, "fatol": 0.1, "xatol": 0.02, "initial_simplex": simplex}
    best = minimize(cost, start, method="Nelder-Mead", options=options)
    pixel, column, row = of(best.x)
    return PatternSpreads(pixel_sigma_mm=pixel, column_sigma_mm=column, row_sigma_mm=row), found


def _size(bias_mm: FloatArray) -> float:
    """Standard deviation of most biases about 0, mm."""
    return max(float(np.median(np.abs(bias_mm)) / 0.67), 1e-3)


def _apart(found: PixelBiases) -> PixelBiases:
    """Biases without what they have in common, a mean of pixels that differ by noise and by their own biases."""
    use = found.information > 0
    around = found.bias[use] - np.median(found.bias[use])
    weight = 1.0 / (1.0 / found.information[use] + _size(around) ** 2)
    bias = np.where(use, found.bias - float((weight * found.bias[use]).sum() / weight.sum()), found.bias)
    return replace(found, bias=bias, gain=0.5 * bias**2 * found.information)


def _beyond_chance(found: PixelBiases, image: tuple[int, int]) -> bool:
    """Whether pixels, columns or rows differ by more than two standard deviations of noise."""
    use = np.flatnonzero(found.information > 0)
    row, col = np.divmod(use, image[1])
    pulled, weight = found.bias[use] * found.information[use], found.information[use]
    deviates = [(2 * float(found.gain[use].sum()) - use.size) / math.sqrt(2 * use.size)]
    for line in (row, col):
        total, noise = np.bincount(line, pulled), np.bincount(line, weight)
        full = noise > 0
        chi2 = float((total[full] ** 2 / noise[full]).sum())
        deviates.append((chi2 - full.sum()) / math.sqrt(2 * full.sum()))
    return max(deviates) > _CHANCE


def pattern_map(
    likelihood: Likelihood, mixture: Mixture, state: ModelState, spreads: PatternSpreads, frames: IntArray
) -> tuple[FloatArray, FloatArray]:
    """The pattern (pixel,), mm, shrunk by its noise, from all pixels of some frames; and its variance, mm2."""
    part = (frames, np.arange(likelihood.evidence.shape[1]))
    found = pixel_biases(likelihood, mixture, state, part)
    whole = max(sum(s**2 for s in spreads), 1e-12)  # columns and rows have at least the variance of their pixels
    variance = np.where(found.information > 0, 1.0 / (found.information + 1.0 / whole), 0.0)
    return marginal_pattern(found, likelihood.evidence.image, spreads)[1], variance


def pattern_image(pattern: FloatArray, image: tuple[int, int]) -> Float32Array:
    """A pattern (pixel,), mm, as the map of an effect has it (row, col)."""
    return pattern.reshape(image).astype(np.float32)
