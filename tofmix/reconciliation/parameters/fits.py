"""The numbers of all effects as one vector, and the curvature of the log-likelihood over them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.search import Problem


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """An effect with numbers: the effect, its vector, and its search."""

    effect: Effect
    vector: FloatArray
    problem: Problem

    @property
    def at_a_bound(self) -> bool:
        """Whether the numbers are so close to a bound that another effect describes the same."""
        return self.problem.other is not None and self.problem.other(self.vector)


SOFT = 1e-9
"""Curvature, in nats, that every number has."""

_UNIT = (0.3, 3.0)  # limits of a drop of the log-likelihood that is taken as 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Numbers:
    """Effects with numbers, as one vector.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : ModelState
        The model with all its effects.
    fits : mapping of int to Fitted
        The search of each effect, by its number in the state.
    part : (frames, pixels)
        Data of the fits.
    """

    likelihood: Likelihood
    state: ModelState
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
        """The effects with other numbers; ValueError out of bounds."""
        effects, fits, start = list(self.state.effects), {}, 0
        for number, fitted in self.fits.items():
            own = x[start : start + fitted.problem.parameters]
            start += own.size
            effects[number] = fitted.problem.make(own)
            effects[number].check(self.likelihood.scene.model.sensor, self.likelihood.scene.names)
            fits[number] = replace(fitted, vector=own, effect=effects[number])
        return replace(self, fits=fits, state=replace(self.state, effects=tuple(effects)))

    def at(self, x: FloatArray) -> "Value | None":
        """The objective of fits, in total and by pixel and frame; None out of bounds, and where it is not finite."""
        try:
            state = self.moved(x).state
        except ValueError:
            return None
        sums = self.likelihood.marginal(self.likelihood.mixture(state), state, self.part)
        total = sums.total + self.likelihood.outside(state)
        return Value(total=total, by_pixel=sums.by_pixel, by_frame=sums.by_frame) if math.isfinite(total) else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Value:
    """The objective, and the log-likelihood by pixel and frame as in `Sums`."""

    total: float
    by_pixel: FloatArray
    by_frame: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parabola:
    """The log-likelihood near a vector, in units of `steps`, each of about one nat; a pattern's values are fixed.

    Parameters
    ----------
    steps : (number,) float64
        Steps in the units of the searches.
    top : Value
        At the vector.
    slope : (number,) float64
    hessian : (number, number) float64
        Its negative second derivatives.
    cross : (number, pixel) float64
        Negative second derivatives by a number and a pixel's bias, per mm.
    by_pixel, by_frame : (number, pixel), (number, frame) float64
        Slopes.
    """

    steps: FloatArray
    top: Value
    slope: FloatArray
    hessian: FloatArray
    cross: FloatArray
    by_pixel: FloatArray
    by_frame: FloatArray


def parabola(numbers: Numbers) -> Parabola | None:
    """The log-likelihood near the numbers, by differences; None if all numbers are at their bounds.

    Numbers at their bounds are fixed: no slope, no curvature.
    """
    x = numbers.vector
    top = numbers.at(x)
    if top is None:
        return None
    steps = np.array([_unit_drop(numbers, x, k, step, top.total) for k, step in enumerate(numbers.first_steps)])
    unit = np.diag(steps)
    above, below = ([numbers.at(x + s * unit[k]) for k in range(x.size)] for s in (1, -1))
    free = np.array([a is not None and b is not None for a, b in zip(above, below, strict=True)], dtype=bool)
    if x.size and not free.any():
        return None
    unit[~free] = 0.0
    up, down = ([top if s is None or not free[k] else s for k, s in enumerate(ends)] for ends in (above, below))
    hessian = _hessian(numbers, x, unit, top.total, ([s.total for s in up], [s.total for s in down]))
    hessian[~free], hessian[:, ~free] = 0.0, 0.0
    if not np.isfinite(hessian).all():
        hessian = np.diag(np.where(np.isfinite(np.diag(hessian)), np.diag(hessian), 1.0))
    pairs = list(zip(up, down, strict=True))
    return Parabola(
        steps=steps,
        top=top,
        slope=np.array([0.5 * (a.total - b.total) for a, b in pairs]),
        hessian=hessian,
        cross=_table([0.5 * (b.by_pixel[:, 1] - a.by_pixel[:, 1]) for a, b in pairs], top.by_pixel),
        by_pixel=_table([0.5 * (a.by_pixel[:, 0] - b.by_pixel[:, 0]) for a, b in pairs], top.by_pixel),
        by_frame=_table([0.5 * (a.by_frame[:, 0] - b.by_frame[:, 0]) for a, b in pairs], top.by_frame),
    )


def _table(rows: list[FloatArray], like: FloatArray) -> FloatArray:
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(like))


def inverse(hessian: FloatArray) -> FloatArray:
    """The covariance of a curvature; 0 for numbers without any effect."""
    acts = np.ix_(hessian.any(axis=1), hessian.any(axis=1))
    covariance = np.zeros_like(hessian)
    covariance[acts] = np.linalg.pinv(hessian[acts] + SOFT * np.eye(len(hessian[acts])), hermitian=True)
    return covariance


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
