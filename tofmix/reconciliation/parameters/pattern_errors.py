"""Errors of effects with hidden states: of other numbers beside a fixed pattern, and of its spreads and links.

The effect of an unknown fixed pattern on the errors of other numbers, and the errors of its spreads.

An offset cannot be separated from the mean of the pattern's columns. So its error is mostly the spread of the columns
over the root of their number. Few columns and rows determine this spread, so errors are averaged over its possible
values.

Standard errors, in closed form, of effects that link samples.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.beats import FrameNoise, beat_errors
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.memory import fit_memory, inflation, memory_error
from tofmix.reconciliation.likelihood.pixel_pattern import PatternLines, pixel_biases, spreads_of, with_pattern
from tofmix.reconciliation.parameters.fits import SOFT, Numbers, Parabola, inverse
from tofmix.simulation.effects.base import Effect, with_hidden
from tofmix.simulation.effects.hidden import DisturbedFrames, PatternSpreads, PixelBias, RangeStep, RememberedNoise


def latent_errors(
    likelihood: Likelihood, state: ModelState, effect: Effect, seed: int
) -> tuple[Effect, dict[str, float]]:
    """An effect with latent states, fitted to all samples, and the standard errors of its numbers.

    Parameters
    ----------
    likelihood, state
        The refined model, with latent states from all frames.
    effect : Effect
        One of the state's.
    seed : int
        Seed of the draws for quantised samples.
    """
    frames, pixels = likelihood.evidence.shape
    hidden = effect.hidden
    if isinstance(hidden, DisturbedFrames):
        return _bursts(likelihood, state, effect, hidden)
    if isinstance(hidden, RememberedNoise):
        everything = np.arange(frames), np.arange(pixels)
        mixture = likelihood.mixture(state)
        z = likelihood.scores(state, everything, seed, mixture)
        found = fit_memory(likelihood, z, mixture, everything)
        refitted = effect if found is None else hidden.made(type(effect), (found,))
        error = memory_error(likelihood, z, mixture, everything, hidden.coefficient(refitted))
        return refitted, {hidden.numbers[0]: error}
    if isinstance(hidden, RangeStep):
        error = 0.5 * hidden.step_mm(effect) ** 2 / likelihood.scene.model.sensor.range_max_mm
        return effect, {hidden.numbers[0]: error}
    return effect, {}


def _bursts(
    likelihood: Likelihood, state: ModelState, effect: Effect, hidden: DisturbedFrames
) -> tuple[Effect, dict[str, float]]:
    """The share of disturbed frames, with errors from counts and from the curvature; of a beat, from the curvature."""
    chain = hidden.chain(effect)
    if chain.period_frames:
        everything = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
        noise = FrameNoise(likelihood, likelihood.mixture(state), state, everything)
        chain, errors = beat_errors(noise, chain)
        named = zip((*hidden.numbers[:2], hidden.period), errors, strict=True)
        return hidden.changed(effect, chain), {name: error for name, error in named if error}
    share = float(np.clip(state.disturbed.mean(), 1e-4, 0.99))
    frames = state.disturbed.size
    mixture = likelihood.mixture(state)
    likely = 0.5  # probability from which a frame counts as disturbed
    part = np.flatnonzero(state.disturbed > likely), np.arange(likelihood.evidence.shape[1])
    step = 0.02 * chain.sigma_mm
    bare = replace(state, effects=tuple(e for e in state.effects if e is not effect))

    def value(sigma: float) -> float:
        return likelihood.sums(mixture, bare, part, variance=np.full(frames, sigma**2)).total

    drop = (2 * value(chain.sigma_mm) - value(chain.sigma_mm + step) - value(chain.sigma_mm - step)) / step**2
    bursts = max(frames * share / chain.burst_frames, 1.0)
    errors = (
        share_error(share, frames / max(2 * chain.burst_frames * (1 - share) - 1, 1.0)),
        float(1 / np.sqrt(drop)) if drop > 0 else chain.sigma_mm,
        float(chain.burst_frames / np.sqrt(bursts)),
    )
    counted = hidden.changed(effect, chain._replace(probability=share))
    return counted, dict(zip(hidden.numbers, errors, strict=True))


def share_error(share: float, independent: float) -> float:
    """Standard error of a share among so many independent frames; with few frames the share is moved towards one half.

    References
    ----------
    Agresti and Coull, Am. Statistician 52 (1998) 119: two of each sort more.
    """
    nearer = (share * independent + 2) / (independent + 4)
    return float(np.sqrt(nearer * (1 - nearer) / independent))


_STATIC = 0.05  # least share of the curvature that does not come from static biases
_BELOW, _ABOVE, _CELLS = 4.0, 6.0, 13  # standard deviations about a spread's logarithm, and cells between


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Averaged:
    """Errors with the pattern's spreads by column and row integrated out.

    Parameters
    ----------
    covariance : (number, number) float64
        Of the numbers, in units of the parabola's steps.
    spreads_mm : (3,) float64
        Standard errors of the spreads by pixel, column and row.
    """

    covariance: FloatArray
    spreads_mm: FloatArray


def pattern_of(state: ModelState) -> tuple[Effect, PixelBias] | None:
    """The fixed pattern of which only the spreads are known, the model's own or an added one, and its declaration."""
    return next(with_hidden(state.linking, PixelBias), None)


def spreads_of_pattern(state: ModelState) -> PatternSpreads | None:
    """The spreads of `pattern_of`."""
    found = pattern_of(state)
    return None if found is None else found[1].spreads(found[0])


def integrated(numbers: Numbers, spreads: PatternSpreads) -> float:
    """The objective of fits, with the pattern's values integrated out, for its present spreads."""
    likelihood, state = numbers.likelihood, numbers.state
    bare = state.unpatterned
    mixture = likelihood.mixture(state)
    found = pixel_biases(likelihood, mixture, bare, numbers.part)
    total = likelihood.marginal(mixture, bare, numbers.part).total + likelihood.outside(state)
    return total + with_pattern(found, likelihood.evidence.image, spreads)


class UnderPattern:
    """The log-likelihood of numbers and spreads, with each pixel's bias integrated out.

    Changes of the pixels' biases by the numbers have the covariance of pattern and noise. Other changes, in time or in
    spread, count as with a known pattern.

    Parameters
    ----------
    numbers : Numbers
        Numbers of a state with a fixed pattern and its values.
    about : Parabola
        The log-likelihood about them, the values given.
    spreads : PatternSpreads
        Those of the pattern.
    overstated : (pixel,) float64 or float
        Factor by which independent samples would overstate the information about a pixel's bias.
    """

    def __init__(
        self, numbers: Numbers, about: Parabola, spreads: PatternSpreads, overstated: FloatArray | float = 1.0
    ) -> None:
        self._spreads = spreads
        pulls, known = about.top.by_pixel[:, 1], about.top.by_pixel[:, 2]
        self._lines = PatternLines(known / overstated, numbers.likelihood.evidence.image, spreads.pixel_sigma_mm)
        use = self._lines.use
        noise = 1.0 / known[use]
        moved = about.cross[:, use] * noise
        biases = numbers.state.pixel_bias[use] + pulls[use] * noise
        vectors = np.vstack([biases, moved])
        weighted = vectors / self._lines.variance
        self._given = weighted @ vectors.T
        self._pulled = np.stack([self._lines.sums(w) for w in weighted], axis=1)
        self._slope = about.slope - moved @ pulls[use]  # of changes that are no static bias
        self._beside = _beside(about.hessian, about.cross[:, use] @ moved.T)

    def curvature(self, column_sigma_mm: float, row_sigma_mm: float) -> FloatArray:
        """Negative second derivatives (number, number) for given spreads."""
        return self._at(column_sigma_mm, row_sigma_mm)[0][1:, 1:] + self._beside

    def slope(self) -> FloatArray:
        """Slope (number,) for the pattern's own spreads."""
        products, _ = self._at(*self._spreads[1:])
        return products[1:, 0] + self._slope

    def averaged(self) -> Averaged:
        """Integrate over the spreads by column and row, weighted by their restricted likelihood.

        The prior of a line's whole variance, spread and noise, is flat in its logarithm. So for lines without noise the
        errors are those of Student's distribution: their squares are larger by (n - 1) / (n - 3). The spread by pixel
        is taken as fitted, because there are many pixels. In a single row or column, it is the only one: the bias of
        a row is an offset there, and that of a column is its pixel's.

        References
        ----------
        Box and Tiao, Bayesian Inference in Statistical Analysis, 1973, chapter 5. Kackar and Harville, J. Am. Stat.
        Assoc. 79 (1984) 853, on errors that take estimated variances as known.
        """
        fitted = self._spreads[1:]
        counts = (np.unique(self._lines.col).size, np.unique(self._lines.row).size)
        noise = float(self._lines.variance.mean()) / self._lines.use.size
        several = spreads_of((self._lines.rows, self._lines.cols)) > 1
        columns, rows = (
            _grid(s, noise * n, n) if several else (np.array([s]), 1.0) for s, n in zip(fitted, counts, strict=True)
        )
        pairs = np.array([(c, r) for c in columns[0] for r in rows[0]])
        found = [self._restricted(c, r) for c, r in pairs]
        chance = np.array([f[0] for f in found])
        weight = np.exp(chance - chance.max()) * np.outer(columns[1], rows[1]).ravel()
        weight /= weight.sum()
        moves = np.stack([f[1] for f in found])
        moves -= weight @ moves
        lines = np.sqrt(weight @ (pairs - np.array(fitted)) ** 2)
        free = max(self._lines.use.size - (sum(counts) if several else 1), 1)
        own = float(self._lines.variance.mean()) / math.sqrt(2 * free * self._lines.own)
        return Averaged(
            covariance=np.einsum("s,sij->ij", weight, np.stack([f[2] for f in found])) + (weight * moves.T) @ moves,
            spreads_mm=np.array([own, *lines]),
        )

    def _at(self, column_sigma_mm: float, row_sigma_mm: float) -> tuple[FloatArray, float]:
        """Products of biases and moves by the inverse covariance, and the covariance's log determinant."""
        root, logdet = self._lines.factor(column_sigma_mm, row_sigma_mm)
        return self._given - self._pulled.T @ root.solve(self._pulled), logdet

    def _restricted(self, column_sigma_mm: float, row_sigma_mm: float) -> tuple[float, FloatArray, FloatArray]:
        """Log-likelihood of the spreads with numbers integrated out; move of the numbers by the fit; covariance."""
        products, logdet = self._at(column_sigma_mm, row_sigma_mm)
        curvature = products[1:, 1:] + self._beside
        slope = products[1:, 0] + self._slope
        covariance = inverse(curvature)
        move = covariance @ slope
        volume = float(np.linalg.slogdet(curvature + SOFT * np.eye(slope.size))[1])
        value = -0.5 * (float(products[0, 0]) + logdet) + 0.5 * float(slope @ move) - 0.5 * volume
        return value, move, covariance


def _beside(hessian: FloatArray, static: FloatArray) -> FloatArray:
    """The curvature by changes that are no static bias; 0 for the remainder of two nearly equal numbers."""
    rest = hessian - 0.5 * (static + static.T)
    none = np.diag(rest) < _STATIC * np.diag(hessian)
    rest[none] = 0.0
    rest[:, none] = 0.0
    return np.asarray(rest)


def _grid(sigma_mm: float, noise: float, count: int) -> tuple[FloatArray, float]:
    """Spreads (cell,) even in the logarithm of the variance of a line's mean, and the cells' width.

    Parameters
    ----------
    sigma_mm : float
        Spread as fitted.
    noise : float
        Variance of a line's mean without it, mm2.
    count : int
        Lines.
    """
    width = 1.0 / math.sqrt(2.0 * max(count - 1, 1))
    middle, least = 0.5 * math.log(sigma_mm**2 + noise), 0.5 * math.log(noise)
    edges = np.linspace(max(middle - _BELOW * width, least), middle + _ABOVE * width, _CELLS + 1)
    whole = np.exp(edges[1:] + edges[:-1])
    return np.sqrt(whole - noise), float(edges[1] - edges[0])


def under_pattern(numbers: Numbers, about: Parabola, spreads: PatternSpreads) -> UnderPattern:
    """The numbers about a parabola, with the values of a pattern of these spreads integrated out."""
    mixture = numbers.likelihood.mixture(numbers.state)
    overstated = inflation(numbers.likelihood, mixture, numbers.state, numbers.part)
    return UnderPattern(numbers, about, spreads, overstated)
