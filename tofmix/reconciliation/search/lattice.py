"""The step of quantised samples, which no smooth search finds."""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.simulation.effects.quantisation import Quantisation

_LEAST_STEP_MM, _MOST_STEP_MM = 1.6, 120.0  # a finer step hardly shows in whole mm; a scene does not fill a coarser one
_ON_LATTICE = 0.985  # least share of the samples on the steps; the others are random values
_AS_MANY = 0.999  # least share of the samples that a coarser step explains, against a finer one
_AROUND = 60  # lines of the spectrum on either side of a peak that are searched for the step
_MANY = 0.1  # least share of varying pixels
_FULL = 5.0  # counts of a mm that has a density


def find_lattice(evidence: Evidence, state: ModelState) -> Quantisation | None:
    """The step of which nearly all stored values are rounded multiples, from the spectrum of their histogram."""
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
            return Quantisation(step_mm=max(near, key=lambda s: _held(s, values, weights, slack=0.0)))
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
