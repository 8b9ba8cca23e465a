"""Fit all numbers together: Newton's steps to the top of the log-likelihood, with hidden states fitted between them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.found import TriedEffect
from tofmix.reconciliation.likelihood.hidden_states import latent_states
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.parameters.fits import Numbers, inverse, parabola
from tofmix.reconciliation.parameters.pattern_errors import integrated, pattern_of, spreads_of_pattern, under_pattern
from tofmix.simulation.effects.hidden import PatternSpreads

_PARTS = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
_DAMPINGS = (0.0, 0.1, 1.0, 10.0)  # in units of a number's own curvature


def numbers_of(likelihood: Likelihood, state: ModelState, chosen: Sequence[TriedEffect], part: Part) -> Numbers:
    """The effects with numbers as one vector.

    Parameters
    ----------
    likelihood, state
        The refined model.
    chosen : sequence of TriedEffect
        The state's effects, in its order.
    part : (frames, pixels)
        Data of the fits.
    """
    fits = {k: c.fitted for k, c in enumerate(chosen) if c.fitted is not None and c.fitted.problem.steps}
    return Numbers(likelihood=likelihood, state=state, fits=fits, part=part)


def settle(numbers: Numbers) -> Numbers:
    """Move all numbers together to the top of the log-likelihood, then fit latent states.

    Numbers and a fixed pattern's spreads alternate until the numbers converge.
    """
    most_turns = 8  # of numbers and latent states
    for _ in range(most_turns):
        last = polish(numbers)
        if last is numbers:
            break
        numbers = replace(last, state=latent_states(last.likelihood, last.state, last.part[0]))
        if pattern_of(numbers.state) is None:
            break
    return numbers


def polish(numbers: Numbers) -> Numbers:
    """Newton steps for all numbers together, to the top of the log-likelihood; no step lowers it.

    Under a fixed pattern its values are integrated out of the log-likelihood, and one step is made; the values are
    fitted after the step.
    """
    spreads = spreads_of_pattern(numbers.state)
    most_steps = 4  # of Newton's to the top
    enough = 0.01  # nats: a smaller gain needs no step
    for _ in range(most_steps if spreads is None else 1):
        about = parabola(numbers)
        if about is None:
            break
        slope, curvature = about.slope, about.hessian
        if spreads is not None:
            under = under_pattern(numbers, about, spreads)
            slope, curvature = under.slope(), under.curvature(spreads.column_sigma_mm, spreads.row_sigma_mm)
        if 0 <= 0.5 * float(slope @ inverse(curvature) @ slope) < enough:  # below 0: far from any top
            break
        better = _climbed(numbers, about.steps, (slope, curvature), spreads)
        if better is None:
            break
        numbers = better
    return numbers


def _climbed(
    numbers: Numbers, steps: FloatArray, about: tuple[FloatArray, FloatArray], spreads: PatternSpreads | None
) -> Numbers | None:
    """A Newton step, damped if the whole step does not climb, as far from the top; None if none climbs.

    References
    ----------
    Levenberg, Quart. Appl. Math. 2 (1944) 164.
    """
    slope, curvature = about
    for damping in _DAMPINGS:
        move = inverse(curvature + damping * np.eye(slope.size)) @ slope
        better = _better(_Line(numbers, move * steps, spreads), 0.5 * float(slope @ move))
        if better is not None:
            return better
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """The numbers along a step, and the objective of fits there."""

    numbers: Numbers
    move: FloatArray
    spreads: PatternSpreads | None

    def at(self, part: float) -> tuple[float, Numbers]:
        """The objective and the numbers after a part of the step; minus infinity out of bounds."""
        try:
            moved = self.numbers.moved(self.numbers.vector + part * self.move)
        except ValueError:
            return -math.inf, self.numbers
        if self.spreads is not None:
            return integrated(moved, self.spreads), moved
        found = moved.at(moved.vector)
        return -math.inf if found is None else found.total, moved


def _better(line: _Line, gain: float) -> Numbers | None:
    """A step, or a part of it, that raises the log-likelihood; a better part if the values indicate one.

    Parameters
    ----------
    line : _Line
        The step.
    gain : float
        Gain by half the slope along the step, nats. A parabola of this slope through any point gives the next part.
    """
    top, _ = line.at(0.0)
    off = 0.1  # relative difference of parts, from which another part is tried
    for part in _PARTS:
        height, found = line.at(part)
        if height > top:
            bend = 2 * gain * part - (height - top)
            near = gain * part**2 / bend if bend > 0 else part
            other, nearer = line.at(near) if abs(near / part - 1) > off else (-math.inf, found)
            return nearer if other > height else found
    return None
