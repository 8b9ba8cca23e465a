"""Effects beside a fixed pattern: fitted to biases that it may have, and judged with its values integrated out.

A fixed pattern can stand for any static bias. An effect that is fitted without it follows its columns and rows as if
they were its own, and one that is then judged beside it has the wrong numbers. So the numbers are fitted to the
biases of all pixels by generalised least squares, with the pattern and the noise as covariance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconcile import links
from tofmix.reconcile.fits import Fitted
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.mixture import Mixture
from tofmix.reconcile.name import PRICE_NATS, Candidate, Trial
from tofmix.reconcile.pixel_pattern import PatternLines, PixelBiases, pixel_biases, with_pattern
from tofmix.reconcile.searches import Problem
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.effects.fixed_pattern import FixedPattern

STATIC = ("range_offset", "surface_pose", "wiggling", "amplitude_walk", "scattering", "multipath", FixedPattern.kind)
"""Kinds that give each pixel a bias that stays."""

ALIAS_NATS = 6.0
"""Gains that are nearer are not told apart."""

_TURNS = 3  # of the iteration of Gauss and Newton
_PARTS = (1.0, 0.3)  # of a step that are tried
_NUDGE = 0.05  # of a search's first step, for slopes
_TRIED = 3  # of the best by biases, and as many of the best by themselves
_CLEAR_NATS, _CLEAR_SHARE = 10.0, 0.0001  # beyond what the pattern gains, for an effect that is put before it


def worth(
    likelihood: Likelihood, state: State, mixture: Mixture, parts: tuple[Part, Part], *, patterned: bool
) -> float:
    """Log-likelihood of what no fit has seen, a pattern of free spreads integrated out.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : State
        Without a pattern.
    mixture : Mixture
        Its prediction.
    parts : two of (frames, pixels)
        What fits may see, and what they may not, of all pixels: laws of few numbers need none held out.
    patterned : bool
        Whether there is a pattern.
    """
    fit, test = parts
    out = likelihood.value(state, test, mixture)
    pattern = links.fit_pattern(likelihood, mixture, state, fit) if patterned else None
    if pattern is not None:
        biases = pixel_biases(likelihood, mixture, state, test)
        out += with_pattern(biases, likelihood.evidence.image, spreads(pattern[0]))
    return out


def spreads(effect: FixedPattern) -> tuple[float, float, float]:
    """Standard deviations by pixel, column and row, mm."""
    return effect.pixel_sigma_mm, effect.column_sigma_mm, effect.row_sigma_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beside:
    """What a round found beside a fixed pattern.

    Parameters
    ----------
    first : Candidate
        The best effect beside it, with the numbers that it has there.
    patterned : bool
        Whether the pattern still gains beside it.
    rivals : tuple of Candidate
        Those of other kinds that gain there as much, but for `ALIAS_NATS`.
    """

    first: Candidate
    patterned: bool
    rivals: tuple[Candidate, ...]


def best_beside(trial: Trial, found: Sequence[Candidate], parts: tuple[Part, Part], near: State) -> Beside | None:
    """The effect that gains most beside a fixed pattern; None if none clearly does.

    Parameters
    ----------
    trial : Trial
        The round.
    found : sequence of Candidate
        Its candidates, a fixed pattern first.
    parts : two of (frames, pixels)
        As `worth` takes them.
    near : State
        The model within its tolerance, where it fits best: what it explains beside the pattern needs no effect.
    """
    likelihood = trial.likelihood
    pattern, others = found[0], [c for c in found[1:] if c.fitted is not None]
    nothing = worth(likelihood, trial.state, trial.mixture, parts, patterned=False)
    alone, tolerable = (
        worth(likelihood, state, likelihood.scene.mixture(state.effects), parts, patterned=True)
        for state in (trial.state, near)
    )
    tried: list[tuple[float, Candidate]] = []
    for other in _worth_a_look(trial, others, pattern, parts[0]):
        price = PRICE_NATS * other.parameters
        needed = price + _CLEAR_NATS + _CLEAR_SHARE * max(alone - nothing, 0.0)
        likelihood.scene.anchor(other.state.effects)  # a pose has edges of its own
        mixture = likelihood.scene.mixture(other.state.effects)
        value = worth(likelihood, other.state, mixture, parts, patterned=True)
        if value - alone > needed and value - price > tolerable:
            tried.append((value - price, other))
    likelihood.scene.anchor(trial.state.effects)
    if not tried:
        return None
    top, first = max(tried, key=lambda pair: pair[0])
    as_good = {c.kind: c for value, c in tried if value > top - ALIAS_NATS and c.kind != first.kind}
    return Beside(first=first, patterned=_still_gains(trial, first, parts), rivals=tuple(as_good.values()))


def _still_gains(trial: Trial, other: Candidate, parts: tuple[Part, Part]) -> bool:
    """Whether a pattern clearly gains beside an effect, which has the numbers for that."""
    likelihood = trial.likelihood
    likelihood.scene.anchor(other.state.effects)
    mixture = likelihood.scene.mixture(other.state.effects)
    without, with_ = (
        worth(likelihood, other.state, mixture, parts, patterned=patterned) for patterned in (False, True)
    )
    likelihood.scene.anchor(trial.state.effects)
    return with_ - without > 3 * PRICE_NATS + _CLEAR_NATS


def _worth_a_look(trial: Trial, others: Sequence[Candidate], pattern: Candidate, part: Part) -> list[Candidate]:
    """The best by themselves, and the best by biases beside a pattern, with their numbers there."""
    alone = [c for c in others if c.gain > PRICE_NATS * c.parameters + _CLEAR_NATS][:_TRIED]
    if len(trial.likelihood.scene.members) > 1:
        return alone  # biases differ from scene to scene, which tells a pattern from all else
    fits = _Biases(trial, pattern, part)
    moved = []
    for other in others:
        if other.fitted is not None and other.kind in STATIC:
            gain, fitted = fits.fitted(other.fitted)
            state = replace(other.state, effects=(*trial.state.effects, fitted.effect))
            moved.append((gain, replace(other, effect=fitted.effect, fitted=fitted, state=state)))
    moved.sort(key=lambda pair: PRICE_NATS * pair[1].parameters - pair[0])
    return [c for gain, c in moved[:_TRIED] if gain > PRICE_NATS * c.parameters] + alone


class _Biases:
    """The biases of all pixels, a pattern and noise about what effects make of them."""

    def __init__(self, trial: Trial, pattern: Candidate, part: Part) -> None:
        self._trial = trial
        found: PixelBiases = pixel_biases(trial.likelihood, trial.mixture, trial.state, part)
        fitted = links.fit_spreads(found, trial.likelihood.evidence.image)
        by_pixel, *by_line = spreads(cast("FixedPattern", pattern.effect) if fitted is None else fitted[0])
        self._lines = PatternLines(found.information, trial.likelihood.evidence.image, by_pixel)
        self._root = self._lines.factor(*by_line)[0]
        self._bias = found.bias[self._lines.use]
        self._at_rest = self._means(trial.state.effects)
        self._none = float(self._products(self._bias[None])[0, 0])

    def fitted(self, start: Fitted) -> tuple[float, Fitted]:
        """What an effect gains by the biases, nats, and its fit with the numbers that do."""
        problem = start.problem
        starts = [np.asarray(x, dtype=np.float64) for x in (start.vector, *problem.starts)]
        left, k = min((self._left(problem, x), k) for k, x in enumerate(starts))
        if not math.isfinite(left):
            return -math.inf, start
        x = starts[k]
        for _ in range(_TURNS):
            step = self._step(problem, x)
            if step is None:
                break
            value, part = min((self._left(problem, x + part * step), part) for part in _PARTS)
            if value >= left:
                break
            left, x = value, x + part * step
        return 0.5 * (self._none - left), replace(start, vector=x, effect=problem.make(x))

    def _moves(self, problem: Problem, x: FloatArray) -> FloatArray | None:
        """What an effect moves the pixels by (used pixel,), mm; None out of its bounds."""
        scene = self._trial.likelihood.scene
        try:
            effect = problem.make(x)
            effect.check(scene.model.sensor, scene.names)
        except ValueError:
            return None
        return self._means((*self._trial.state.effects, effect)) - self._at_rest

    def _means(self, effects: tuple[Effect, ...]) -> FloatArray:
        mixture = self._trial.likelihood.scene.mixture(effects)
        main = self._trial.mixture.main
        return np.asarray(np.take_along_axis(mixture.mean[0], main[None], axis=0)[0][self._lines.use])

    def _left(self, problem: Problem, x: FloatArray) -> float:
        """Twice the nats that the biases are from what an effect makes of them."""
        moves = self._moves(problem, x)
        return math.inf if moves is None else float(self._products((self._bias - moves)[None])[0, 0])

    def _step(self, problem: Problem, x: FloatArray) -> FloatArray | None:
        """The step that ends at the least, were the moves linear; None at a bound."""
        nudges = _NUDGE * np.diag(problem.steps)
        here, ahead = self._moves(problem, x), [self._moves(problem, x + n) for n in nudges]
        inside = [a for a in ahead if a is not None]
        if here is None or len(inside) < len(ahead):
            return None
        slopes = np.stack(inside) - here
        products = self._products(np.vstack([self._bias - here, slopes]))
        step = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=1e-9)[0]
        return np.asarray(step @ nudges)

    def _products(self, vectors: FloatArray) -> FloatArray:
        """Products (n, n) of vectors (n, used pixel) by the inverse covariance."""
        weighted = vectors / self._lines.variance
        pulled = np.stack([self._lines.sums(w) for w in weighted], axis=1)
        return np.asarray(weighted @ vectors.T - pulled.T @ self._root.solve(pulled))
