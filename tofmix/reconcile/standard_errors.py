"""Standard errors of the numbers of all effects together, and the last step of their fit.

The curvature of the log-likelihood over all numbers at once gives each one's error with the others free; a fixed
pattern's values are integrated out. Where noise is shared, among frames (a memory) or among pixels (a frame's bursts),
samples are fewer than they look: the errors are then those of scores summed over blocks of pixels or of frames.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconcile.evidence import BLOCK_FRAMES, BLOCK_PIXELS
from tofmix.reconcile.fits import Fitted
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.pixel_pattern import PixelBiases, marginal_pattern
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.fixed_pattern import FixedPattern

_UNIT = (0.3, 3.0)  # a drop of the log-likelihood that counts as 1
_MOST_STEPS = 4
_ENOUGH = 0.01  # nats that are not worth a step
_FARTHEST = 200.0  # nats that a step under a pattern may gain; beyond, the log-likelihood is no parabola
_SOFT = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Numbers:
    """Effects with numbers, as one vector.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : State
        The model with all its effects.
    fits : mapping of int to Fitted
        Number of an effect in the state to its search.
    part : (frames, pixels)
        What the fits may see.
    """

    likelihood: Likelihood
    state: State
    fits: Mapping[int, Fitted]
    part: Part

    @property
    def vector(self) -> FloatArray:
        """All numbers in the units of their searches."""
        return np.concatenate([np.zeros(0), *(f.vector for f in self.fits.values())])

    @property
    def first_steps(self) -> FloatArray:
        """Steps of the searches."""
        return np.array([step for f in self.fits.values() for step in f.problem.steps])

    def moved(self, x: FloatArray) -> "Numbers":
        """The effects with other numbers; a ValueError where they are out of bounds."""
        effects, fits, start = list(self.state.effects), {}, 0
        for number, fitted in self.fits.items():
            own = x[start : start + fitted.problem.parameters]
            start += own.size
            effects[number] = fitted.problem.make(own)
            effects[number].check(self.likelihood.scene.model.sensor, self.likelihood.scene.names)
            fits[number] = replace(fitted, vector=own, effect=effects[number])
        return replace(self, fits=fits, state=replace(self.state, effects=tuple(effects)))

    def at(self, x: FloatArray) -> "_Value | None":
        """What fits maximise, in all and by pixel and frame; None out of bounds."""
        try:
            state = self.moved(x).state
        except ValueError:
            return None
        sums = self.likelihood.sums(self.likelihood.scene.mixture(state.effects), state, self.part)
        return _Value(total=sums.total + self.likelihood.heard(state), by_pixel=sums.by_pixel, by_frame=sums.by_frame)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Value:
    """The objective, and of it the log-likelihood as `Sums` has it."""

    total: float
    by_pixel: FloatArray
    by_frame: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Parabola:
    """The log-likelihood about a vector: steps of about one nat, slopes by them, covariance in their units."""

    steps: FloatArray
    slope: FloatArray
    covariance: FloatArray
    by_pixel: FloatArray  # (number, pixel) slopes
    by_frame: FloatArray  # (number, frame)


def polish(numbers: Numbers) -> Numbers:
    """Newton's steps for all numbers at once, to the top of the log-likelihood; none of them lowers it.

    Under a fixed pattern, whose values follow after the step, the log-likelihood is that with them integrated out,
    and one step is made.
    """
    patterned = any(isinstance(e, FixedPattern) for e in numbers.state.effects)
    for _ in range(1 if patterned else _MOST_STEPS):
        x = numbers.vector
        about = _parabola(numbers, x) if x.size else None
        if about is None:
            break
        move = about.covariance @ about.slope
        gain = 0.5 * float(about.slope @ move)
        if gain < _ENOUGH:
            break
        if patterned:
            return _patterned(numbers, x + move * about.steps, gain)
        better = _better(numbers, x, move * about.steps)
        if better is None:
            break
        numbers = better
    return numbers


def _patterned(numbers: Numbers, wanted: FloatArray, gain: float) -> Numbers:
    return numbers if gain > _FARTHEST or numbers.at(wanted) is None else numbers.moved(wanted)


def _better(numbers: Numbers, x: FloatArray, move: FloatArray) -> Numbers | None:
    """A step, or a part of it, that raises the log-likelihood."""
    top = numbers.at(x)
    for part in (1.0, 0.5, 0.2, 0.05):
        found = numbers.at(x + part * move)
        if top is not None and found is not None and found.total > top.total:
            return numbers.moved(x + part * move)
    return None


def standard_errors(numbers: Numbers) -> dict[int, dict[str, float]]:
    """Standard errors of the effects' numbers, by the effects' places in the state.

    For each number the largest of three: by the curvature (Fisher), and by slopes summed over blocks of pixels, and
    over blocks of frames, between the curvature's inverses (the sandwich).

    References
    ----------
    White, Econometrica 50 (1982) 1; Liang and Zeger, Biometrika 73 (1986) 13, for blocks.
    """
    x = numbers.vector
    about = _parabola(numbers, x) if x.size else None
    if about is None:
        return {number: {} for number in numbers.fits}
    evidence = numbers.likelihood.evidence
    row, col = np.divmod(np.arange(evidence.shape[1]), evidence.image[1])
    squares = row // BLOCK_PIXELS * (evidence.image[1] // BLOCK_PIXELS + 1) + col // BLOCK_PIXELS
    spells = np.arange(evidence.shape[0]) // BLOCK_FRAMES
    found = [about.covariance]
    found += [_sandwich(about.covariance, _summed(about.by_pixel, squares))]
    found += [_sandwich(about.covariance, _summed(about.by_frame, spells))]
    out, start = {}, 0
    for number, fitted in numbers.fits.items():
        own = slice(start, start + fitted.problem.parameters)
        start = own.stop
        each = [_to_parameters(fitted, covariance[own, own], about.steps[own]) for covariance in found]
        out[number] = {name: max(errors[name] for errors in each) for name in each[0]}
    return out


def _summed(slopes: FloatArray, block: IntArray) -> FloatArray:
    """Slopes (number, block) of the blocks that have any."""
    total = np.stack([np.bincount(block, s) for s in slopes])
    return np.asarray(total[:, (total != 0).any(axis=0)])


def _sandwich(covariance: FloatArray, slopes: FloatArray) -> FloatArray:
    blocks = slopes.shape[1]
    if blocks <= 1:
        return covariance
    centred = slopes - slopes.mean(axis=1, keepdims=True)
    return np.asarray(covariance @ (centred @ centred.T) @ covariance * blocks / (blocks - 1))


def _parabola(numbers: Numbers, x: FloatArray) -> _Parabola | None:
    top = numbers.at(x)
    if top is None or not math.isfinite(top.total):
        return None
    steps = np.array([_unit_drop(numbers, x, k, step, top.total) for k, step in enumerate(numbers.first_steps)])
    unit = np.diag(steps)
    above, below = ([numbers.at(x + s * unit[k]) for k in range(x.size)] for s in (1, -1))
    up, down = [s for s in above if s is not None], [s for s in below if s is not None]
    if len(up) < x.size or len(down) < x.size:
        return None
    hessian = _hessian(numbers, x, unit, top.total, ([s.total for s in up], [s.total for s in down]))
    hessian -= _of_pattern(numbers, top, up, down)
    if not np.isfinite(hessian).all():
        hessian = np.diag(np.where(np.isfinite(np.diag(hessian)), np.diag(hessian), 1.0))
    pairs = list(zip(up, down, strict=True))
    return _Parabola(
        steps=steps,
        slope=np.array([0.5 * (a.total - b.total) for a, b in pairs]),
        covariance=np.asarray(np.linalg.pinv(hessian + _SOFT * np.eye(x.size), hermitian=True)),
        by_pixel=np.stack([0.5 * (a.by_pixel[:, 0] - b.by_pixel[:, 0]) for a, b in pairs]),
        by_frame=np.stack([0.5 * (a.by_frame[:, 0] - b.by_frame[:, 0]) for a, b in pairs]),
    )


def _hessian(
    numbers: Numbers, x: FloatArray, unit: FloatArray, top: float, single: tuple[list[float], list[float]]
) -> FloatArray:
    """Curvature in the units of the steps."""

    def value(at: FloatArray) -> float:
        found = numbers.at(at)
        return -math.inf if found is None else found.total

    around = [a + b for a, b in zip(*single, strict=True)]
    hessian = np.zeros((x.size, x.size))
    for i in range(x.size):
        hessian[i, i] = 2 * top - around[i]
        for j in range(i):
            both = value(x + unit[i] + unit[j]) + value(x - unit[i] - unit[j])
            hessian[i, j] = hessian[j, i] = -0.5 * (both - around[i] - around[j] + 2 * top)
    return hessian


def _of_pattern(numbers: Numbers, top: _Value, up: list[_Value], down: list[_Value]) -> FloatArray:
    """What the numbers' information loses because each pixel's bias is unknown too (Schur's complement)."""
    pattern = next((e for e in numbers.state.effects if isinstance(e, FixedPattern)), None)
    n = len(up)
    if pattern is None:
        return np.zeros((n, n))
    known = top.by_pixel[:, 2]
    inside = known > 0
    cross = np.stack([0.5 * (b.by_pixel[:, 1] - a.by_pixel[:, 1]) for a, b in zip(up, down, strict=True)])
    cross[:, ~inside] = 0.0
    spreads = (pattern.pixel_sigma_mm, pattern.column_sigma_mm, pattern.row_sigma_mm)
    image = numbers.likelihood.evidence.image
    taken = []
    for row in cross:
        found = PixelBiases(bias=row / np.where(inside, known, 1.0), information=known, gain=np.zeros(known.size))
        taken.append(marginal_pattern(found, image, spreads)[1])
    lost = cross @ np.stack(taken).T
    return np.asarray(0.5 * (lost + lost.T))


def _unit_drop(numbers: Numbers, x0: FloatArray, k: int, step: float, top: float) -> float:
    """A step along one number that lowers the log-likelihood by about 1."""

    def value(x: FloatArray) -> float:
        found = numbers.at(x)
        return -math.inf if found is None else found.total

    h = step * 0.05
    for _ in range(4):
        shift = np.zeros(x0.size)
        shift[k] = h
        drop = 0.5 * (2 * top - value(x0 + shift) - value(x0 - shift))
        if not math.isfinite(drop):
            h *= 0.2
        elif drop <= 0:
            h *= 5
        elif not _UNIT[0] < drop < _UNIT[1]:
            h *= min(max(drop**-0.5, 0.02), 20.0)
        else:
            break
    return h


def _to_parameters(fitted: Fitted, covariance: FloatArray, steps: FloatArray) -> dict[str, float]:
    """Standard errors of the effect's own numbers, by the slopes of `make`."""
    values = numeric(fitted.effect)
    slopes = np.zeros((len(values), steps.size))
    for k in range(steps.size):
        shift = np.zeros(steps.size)
        shift[k] = 0.3 * steps[k]
        try:
            above, below = (numeric(fitted.problem.make(fitted.vector + s * shift)) for s in (1, -1))
        except ValueError:
            continue
        for row, name in enumerate(values):
            change = above[name] - below[name]
            if name == "phase_rad":
                change = math.remainder(change, 2 * math.pi)
            slopes[row, k] = change / 0.6
    variance = np.einsum("ik,kl,il->i", slopes, covariance, slopes)
    return {name: float(math.sqrt(max(v, 0.0))) for name, v in zip(values, variance, strict=True)}


def numeric(effect: Effect) -> dict[str, float]:
    """An effect's numbers by name."""
    values = {name: getattr(effect, name) for name in effect.parameters()}
    return {name: float(v) for name, v in values.items() if isinstance(v, int | float)}
