"""Static effects fitted together to the biases of all pixels, by generalised least squares.

The bias of each pixel, with its information, summarises all samples of the pixel. A fit of effects to biases needs no
samples and takes milliseconds. It fits several effects together; the covariance is the noise, with or without a fixed
pattern.

Whether the range axis folds: of two static biases that fit equally, the one of a turn is no bias.

A wall beyond the unambiguous range appears a turn nearer. A bias, a pose or a second path of metres fits such samples
as well, and the fold alone fits them badly where a pixel has a bias of several sigma. So both hypotheses are compared
with a bias of each pixel integrated out, whose spread is fitted: without the fold it is a turn, with it some mm.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.joint import views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import PatternLines, pixel_biases, with_pattern
from tofmix.reconciliation.parameters.fits import Fitted, fit
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.search import links
from tofmix.reconciliation.search.name import TriedEffect
from tofmix.simulation.effects import basic_kind
from tofmix.simulation.effects.base import Basic, Effect
from tofmix.simulation.effects.hidden import PatternSpreads

_TURNS = 3  # Gauss-Newton steps
_PARTS = (1.0, 0.3)  # of a step that are tried
_NUDGE = 0.05  # of a search's first step, for slopes


class StaticFits:
    """Fits of static effects to the biases that a recording has under a state.

    Parameters
    ----------
    likelihood : Likelihood
        Of one or several recordings: a pixel has a bias in each, and one pattern in all.
    state : ModelState
        The model with the effects added so far.
    mixture : Mixture
        Its prediction.
    part : (frames, pixels)
        Data of the fits.
    spreads : PatternSpreads, optional
        Of a pattern: they are added to the covariance of the noise.
    """

    def __init__(
        self,
        likelihood: Likelihood,
        state: ModelState,
        mixture: Mixture,
        part: Part,
        spreads: PatternSpreads | None = None,
    ) -> None:
        self._scene = likelihood.scene
        self._effects = state.effects
        seen = list(views(likelihood, mixture, part))
        found = [pixel_biases(likelihood, mixture, state, view.part_of_all) for view in seen]
        self._frames = [view.frames for view in seen]
        self._mixtures = [view.mixture for view in seen]
        self._use = [np.flatnonzero(f.information > 0) for f in found]
        self._pixel = np.concatenate(self._use)
        self._weight = np.concatenate([f.information[use] for f, use in zip(found, self._use, strict=True)])
        own = PatternSpreads(0.0, 0.0, 0.0) if spreads is None else spreads
        whole = np.sum([f.information for f in found], axis=0)
        self._lines = PatternLines(whole, likelihood.evidence.image, own[0])
        self._root = None if spreads is None else self._lines.factor(*own[1:])[0]
        self._bias = np.concatenate([f.bias[use] for f, use in zip(found, self._use, strict=True)])
        self._at_rest = self._means(state.effects)
        self._none = float(self._products(self._bias[None])[0, 0])

    def fitted(
        self, new: Fitted, old: Mapping[int, Fitted] | None = None, *, place: int | None = None
    ) -> tuple[float, Fitted, dict[int, Fitted]]:
        """Fit one more effect together with given effects of the state.

        Parameters
        ----------
        new : Fitted
            The effect, fitted alone.
        old : mapping of int to Fitted, optional
            Effects of the state by their number.
        place : int, optional
            Number of the effect in the state, if it is one of its effects.

        Returns
        -------
        gain : float
            Gain by the biases, nats.
        new, old : Fitted, dict of int to Fitted
            The fitted effects.
        """
        places, fits = [*(old or ()), len(self._effects) if place is None else place], [*(old or {}).values(), new]
        before = [f.vector for f in fits[:-1]]
        starts = [np.concatenate([*before, np.asarray(x, dtype=np.float64)]) for x in (new.vector, *new.problem.starts)]
        left, k = min((self._left(places, fits, x), k) for k, x in enumerate(starts))
        if not math.isfinite(left):
            return -math.inf, new, dict(old or {})
        x = starts[k]
        for _ in range(_TURNS):
            step = self._step(places, fits, x)
            if step is None:
                break
            value, part = min((self._left(places, fits, x + part * step), part) for part in _PARTS)
            if value >= left:
                break
            left, x = value, x + part * step
        ends = [replace(f, vector=v, effect=f.problem.make(v)) for f, v in zip(fits, _cut(fits, x), strict=True)]
        return 0.5 * (self._none - left), ends[-1], dict(zip(places[:-1], ends[:-1], strict=True))

    def _moves(self, places: Sequence[int], fits: Sequence[Fitted], x: FloatArray) -> FloatArray | None:
        """Change of the ranges of each recording's pixels (used pixel,), mm; None out of bounds."""
        try:
            made = [f.problem.make(v) for f, v in zip(fits, _cut(fits, x), strict=True)]
            for effect in made:
                effect.check(self._scene.model.sensor, self._scene.names)
        except ValueError:
            return None
        effects = dict(enumerate(self._effects)) | dict(zip(places, made, strict=True))
        moves = self._means(tuple(effects.values())) - self._at_rest
        return np.asarray(np.nan_to_num(moves))  # if the surface is out of the pixel, nothing is known

    def _means(self, effects: tuple[Effect, ...]) -> FloatArray:
        mixture = self._scene.mixture(effects)
        means = []
        for frames, other, use in zip(self._frames, self._mixtures, self._use, strict=True):
            means.append(_means_of(mixture.of_frames(frames), other)[use])
        return np.concatenate(means)

    def _left(self, places: Sequence[int], fits: Sequence[Fitted], x: FloatArray) -> float:
        """Chi-square of the biases without the changes by the numbers."""
        moves = self._moves(places, fits, x)
        return math.inf if moves is None else float(self._products((self._bias - moves)[None])[0, 0])

    def _step(self, places: Sequence[int], fits: Sequence[Fitted], x: FloatArray) -> FloatArray | None:
        """The step to the minimum for linear changes; None at a bound."""
        nudges = _NUDGE * np.diag([step for f in fits for step in f.problem.steps])
        here, ahead = self._moves(places, fits, x), [self._moves(places, fits, x + n) for n in nudges]
        inside = [a for a in ahead if a is not None]
        if here is None or len(inside) < len(ahead):
            return None
        slopes = np.stack(inside) - here
        products = self._products(np.vstack([self._bias - here, slopes]))
        step = np.linalg.lstsq(products[1:, 1:], products[1:, 0], rcond=1e-9)[0]
        return np.asarray(step @ nudges)

    def _products(self, vectors: FloatArray) -> FloatArray:
        """Products (n, n) of vectors (n, used pixel) by the inverse covariance.

        Biases of a pixel in several recordings differ by noise alone; their mean, weighted by information, contains the
        pattern.
        """
        if len(self._use) == 1:
            return self._products_of_means(vectors)
        size = self._lines.information.size
        sums = np.stack([np.bincount(self._pixel, self._weight * v, minlength=size) for v in vectors])
        means = sums[:, self._lines.use] / self._lines.information[self._lines.use]
        apart = vectors - np.stack([np.bincount(self._lines.use, m, minlength=size) for m in means])[:, self._pixel]
        return np.asarray((apart * self._weight) @ apart.T + self._products_of_means(means))

    def _products_of_means(self, vectors: FloatArray) -> FloatArray:
        weighted = vectors / self._lines.variance
        products = weighted @ vectors.T
        if self._root is not None:
            pulled = np.stack([self._lines.sums(w) for w in weighted], axis=1)
            products -= pulled.T @ self._root.solve(pulled)
        return np.asarray(products)


def _means_of(mixture: Mixture, other: Mixture) -> FloatArray:
    """Mean (pixel,) of the main surface of another mixture, also if its edges have moved; NaN without it."""
    place = mixture.main_of(other)
    mean = np.take_along_axis(mixture.mean[0], np.maximum(place, 0)[None], axis=0)[0]
    return np.asarray(np.where(place < 0, np.nan, mean))


def _cut(fits: Sequence[Fitted], x: FloatArray) -> list[FloatArray]:
    """The numbers of each fit."""
    return np.split(x, np.cumsum([f.problem.parameters for f in fits])[:-1])


def fold(likelihood: Likelihood, state: ModelState, part: Part) -> TriedEffect | None:
    """The fold of the camera's phase as a candidate, with its gain in nats over the state; None if there is none.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        The model with the effects added so far.
    part : (frames, pixels)
        The samples.
    """
    mixture = likelihood.mixture(state)
    if mixture.period > 0:
        return None
    for problem in problems(basic_kind(Basic.FOLD).kind, likelihood, mixture):
        fitted = fit(problem, likelihood, state, part)
        folded = replace(state, effects=(*state.effects, fitted.effect))
        gain = _with_biases(likelihood, folded, part) - _with_biases(likelihood, state, part)
        if np.isfinite(gain) and gain > 0:
            return TriedEffect(
                effect=fitted.effect, gain=gain, parameters=problem.parameters, state=folded, fitted=fitted
            )
    return None


def _with_biases(likelihood: Likelihood, state: ModelState, part: Part) -> float:
    """Log-likelihood of a part with a bias of each pixel integrated out, of normal spreads that are fitted."""
    mixture = likelihood.mixture(state)
    found = pixel_biases(likelihood, mixture, state, part)
    bare = likelihood.marginal(mixture, state, part).total
    pattern = links.fit_spreads(found, likelihood.evidence.image)
    return bare if pattern is None else bare + with_pattern(found, likelihood.evidence.image, pattern[0])
