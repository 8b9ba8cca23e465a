"""Standard errors of the numbers of all effects together.

The curvature of the log-likelihood over all numbers gives the error of each with the others free; a fixed pattern's
values are integrated out. If noise is common to frames (a memory) or to pixels (bursts), samples are not independent.
The errors then come from scores summed over blocks of pixels or of frames.

Errors of an effect's parameters from the covariance of a search's numbers, if the likelihood is no parabola.

The profile likelihood falls by 2 nats at two ends, two standard errors from the top. A parameter's error is a quarter
of the distance between the ends: the mean of both sides. First the parabola gives the ends. If the log-likelihood at
these ends differs from the parabola's, the ends are searched for, with the other numbers at their best values.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.evidence import BLOCK_FRAMES, BLOCK_PIXELS, Evidence
from tofmix.reconciliation.parameters.fits import Fitted, Numbers, Parabola, inverse, parabola
from tofmix.reconciliation.parameters.pattern_errors import pattern_of, under_pattern
from tofmix.simulation.effects import Effect

_NEARER = (1.0, 0.5, 0.15)  # parts of this distance that are tried at a bound
_SLOPE = 0.3  # of a step, over which slopes are taken
_PARABOLA = (0.75, 1.33)  # ratio of the drop to that of the parabola, at which the parabola is accepted

Value = Callable[[FloatArray], float]
"""Log-likelihood where all numbers move by so many steps; minus infinity out of bounds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProfiledParameter:
    """One parameter of a fitted effect, as a function of all numbers.

    Parameters
    ----------
    name : str
        Of the parameter.
    fitted : Fitted
        Its effect's search.
    own : slice
        Position of the search's numbers among all.
    steps : (number,) float64
        Units of all numbers.
    """

    name: str
    fitted: Fitted
    own: slice
    steps: FloatArray

    def change(self, move: FloatArray) -> float | None:
        """Change of the parameter if the numbers move by so many steps; None out of bounds."""
        try:
            moved = self.fitted.problem.make(self.fitted.vector + (move * self.steps)[self.own])
        except ValueError:
            return None
        return self._turned(numeric(moved)[self.name] - numeric(self.fitted.effect)[self.name])

    def slope(self, move: FloatArray) -> FloatArray:
        """Slopes (number,) there; 0 across a bound."""
        out = np.zeros(move.size)
        for k in range(move.size)[self.own]:
            shift = np.zeros(move.size)
            shift[k] = _SLOPE
            above, below = self.change(move + shift), self.change(move - shift)
            if above is not None and below is not None:
                out[k] = self._turned(above - below) / (2 * _SLOPE)
        return out

    def _turned(self, change: float) -> float:
        return math.remainder(change, 2 * math.pi) if self.name.endswith("_rad") else change


def parabola_error(parameter: ProfiledParameter, covariance: FloatArray) -> float:
    """Standard error of a parameter if the log-likelihood is a parabola in the search's numbers.

    Parameters
    ----------
    parameter : Parameter
        The parameter.
    covariance : (number, number) float64
        In units of the steps.
    """
    ends = [_farthest(parameter, covariance, sign) for sign in (1.0, -1.0)]
    known = [end.side for end in ends if end is not None]
    return float(np.mean(known)) if known else 0.0


def stretch(parameter: ProfiledParameter, covariance: FloatArray, value: Value) -> float:
    """Error by the profile likelihood over that by the parabola.

    Parameters
    ----------
    parameter, covariance
        As for `parabola_error`; the covariance comes from the curvature of the log-likelihood.
    value : callable
        The log-likelihood.
    """
    top = value(np.zeros(len(covariance)))

    def drop(move: FloatArray) -> float:
        return top - value(move)

    ends = [end for sign in (1.0, -1.0) if (end := _farthest(parameter, covariance, sign)) is not None]
    begun = [(end.move, drop(end.move), 0.5 * end.errors**2) for end in ends]
    if all(_PARABOLA[0] < fallen / wanted < _PARABOLA[1] for _, fallen, wanted in begun):
        return 1.0
    found = [_profiled(parameter, covariance, drop, start) for start in begun]
    straight = sum(end.side for end in ends)
    true = sum(end.side if other is None else other for other, end in zip(found, ends, strict=True))
    return float(true / straight) if straight > 0 else 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _End:
    """The farthest point of a parameter, its distance in standard errors, and the change for each of them."""

    move: FloatArray
    errors: float
    side: float


def _farthest(parameter: ProfiledParameter, covariance: FloatArray, sign: float) -> _End | None:
    """One end of the ellipse of two standard errors.

    A nearer point if this one is out of bounds.
    """
    turns = 2  # of the search for the farthest point of an ellipse
    for part in _NEARER:
        at, found, errors = np.zeros(len(covariance)), None, 2.0 * part
        for _ in range(turns):
            slope = parameter.slope(at)
            length = float(slope @ covariance @ slope)
            if not length > 0:
                break
            at = sign * errors * (covariance @ slope) / math.sqrt(length)
            change = parameter.change(at)
            found = found if change is None else _End(move=at, errors=errors, side=abs(change) / errors)
        if found is not None:
            return found
    return None


def _profiled(
    parameter: ProfiledParameter, covariance: FloatArray, drop: Value, start: tuple[FloatArray, float, float]
) -> float | None:
    """A side of a parameter's error by the profile likelihood, from the parabola's end; None if none was found.

    Moves are scaled until the log-likelihood falls as far as the parabola at its end; a remaining difference is
    corrected as for a parabola.
    """
    move, fallen, wanted = start
    best: tuple[float, float] | None = None
    most_moves = 5  # along a profile
    least_drop = 0.2  # nats; a smaller drop does not determine the width
    settled = 0.15  # logarithm of this ratio, at which the end of the profile is accepted
    for _ in range(most_moves):
        if math.isfinite(fallen) and len(covariance) > 1:
            move, fallen = _settled(parameter, covariance, drop, (move, fallen))
        change = parameter.change(move)
        if change is not None and math.isfinite(fallen) and fallen > least_drop:
            off = abs(math.log(fallen / wanted))
            best = min(best or (math.inf, 0.0), (off, abs(change) / math.sqrt(2 * fallen)))
            if off < settled:
                break
        ratio = wanted / max(fallen, 0.25 * wanted) if math.isfinite(fallen) else 0.25
        move = move * max(math.sqrt(ratio), 0.5)
        fallen = drop(move)
    return None if best is None else best[1]


def _settled(
    parameter: ProfiledParameter, covariance: FloatArray, drop: Value, at: tuple[FloatArray, float]
) -> tuple[FloatArray, float]:
    """A Newton step of the other numbers towards their best values, with the parameter fixed."""
    move, fallen = at
    unit = np.eye(move.size) * _SLOPE
    pull = np.array([(drop(move - u) - drop(move + u)) / (2 * _SLOPE) for u in unit])
    slope = parameter.slope(move)
    along = covariance @ slope
    length = float(slope @ along)
    if not (np.isfinite(pull).all() and length > 0):
        return at
    step = covariance @ pull - along * float(along @ pull) / length
    for part in (1.0, 0.4):
        new = drop(move + part * step)
        if new < fallen:
            return move + part * step, new
    return at


def numeric(effect: Effect) -> dict[str, float]:
    """An effect's numbers by name."""
    return effect.numbers()


def standard_errors(numbers: Numbers, *, by_blocks: bool = True) -> dict[int, dict[str, float]]:
    """Standard errors of the effects' numbers, by their position in the state; also of a fixed pattern's spreads.

    The largest of three errors for each number: from the curvature (Fisher), from slopes summed over blocks of pixels,
    and from slopes summed over blocks of frames (the sandwich estimator). Under a fixed pattern, the errors from the
    curvature are averaged over its possible spreads, and blocks of pixels are not used, because they share the pattern.
    Without a pattern, errors are scaled if the profile likelihood is no parabola. Numbers at their bounds are taken as
    exact and have no error.

    Parameters
    ----------
    numbers : Numbers
        The numbers, at the top of the log-likelihood.
    by_blocks : bool
        Whether blocks of pixels and of frames count. Without them, errors are those of a model that is exact.

    References
    ----------
    White, Econometrica 50 (1982) 1; Liang and Zeger, Biometrika 73 (1986) 13, for blocks.
    """
    pattern = pattern_of(numbers.state)
    about = parabola(numbers)
    if about is None:
        bare = {} if pattern is None else standard_errors(replace(numbers, fits={}))
        return {number: {} for number in numbers.fits} | bare
    known = inverse(about.hessian)
    pixels, frames = _blocks(numbers.likelihood.evidence)
    found = [_sandwich(known, _summed(about.by_frame, frames))] if by_blocks else []
    out = {}
    if pattern is None:
        found += [known, *([_sandwich(known, _summed(about.by_pixel, pixels))] if by_blocks else [])]
    else:
        effect, hidden = pattern
        averaged = under_pattern(numbers, about, hidden.spreads(effect)).averaged()
        found.append(averaged.covariance)
        if effect in numbers.state.effects:
            errors = zip(hidden.numbers, averaged.spreads_mm.tolist(), strict=True)
            out[numbers.state.effects.index(effect)] = {name: error for name, error in errors if error > 0}
    start, amplitude, way = 0, _amplitudes(numbers), numbers.state.way
    for number, fitted in numbers.fits.items():
        own = slice(start, start + fitted.problem.parameters)
        start = own.stop
        out[number] = {}
        for name in numeric(fitted.effect):
            parameter = ProfiledParameter(name=name, fitted=fitted, own=own, steps=about.steps)
            largest = max(parabola_error(parameter, covariance) for covariance in found)
            known_shape = 1.0 if pattern is not None else stretch(parameter, known, partial(_value, numbers, about))
            if largest > 0:  # no error for a number at its bound, which is taken as exact
                out[number][name] = largest * known_shape
        if way is not None and fitted.effect.places_in_time():
            for name, error in out[number].items():
                out[number][name] = math.hypot(error, way.speed_error * numeric(fitted.effect)[name])
        for name, least in fitted.effect.least_errors(amplitude).items():
            out[number][name] = max(out[number].get(name, 0.0), least)
    return out


def _amplitudes(numbers: Numbers) -> FloatArray:
    """Amplitudes (n,) of the surfaces in the pixels of the scene."""
    mixture = numbers.likelihood.mixture(numbers.state)
    seen = 0.05  # share of the beam, from which a surface's amplitude is one of the scene
    return mixture.amplitude[mixture.lit & (mixture.weight > seen)]


def _value(numbers: Numbers, about: Parabola, move: FloatArray) -> float:
    """The log-likelihood if the numbers move by so many steps."""
    if not move.any():
        return about.top.total
    found = numbers.at(numbers.vector + move * about.steps)
    return -math.inf if found is None else found.total


def _blocks(evidence: Evidence) -> tuple[IntArray, IntArray]:
    """Block of each pixel, and of each frame."""
    row, col = np.divmod(np.arange(evidence.shape[1]), evidence.image[1])
    squares = row // BLOCK_PIXELS * (evidence.image[1] // BLOCK_PIXELS + 1) + col // BLOCK_PIXELS
    return squares, np.arange(evidence.shape[0]) // BLOCK_FRAMES


def _summed(slopes: FloatArray, block: IntArray) -> FloatArray:
    """Slopes (number, block) of blocks that are not all 0."""
    total = np.array([np.bincount(block, s) for s in slopes]).reshape(len(slopes), -1 if len(slopes) else 0)
    return np.asarray(total[:, (total != 0).any(axis=0)])


def _sandwich(covariance: FloatArray, slopes: FloatArray) -> FloatArray:
    blocks = slopes.shape[1]
    if blocks <= 1:
        return covariance
    centred = slopes - slopes.mean(axis=1, keepdims=True)
    return np.asarray(covariance @ (centred @ centred.T) @ covariance * blocks / (blocks - 1))
