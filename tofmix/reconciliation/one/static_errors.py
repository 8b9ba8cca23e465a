"""Static errors of pixels, integrated out: those of any model within its tolerance, and those of a fixed pattern.

The bias of a pixel in a recording is U a + column + row + own + noise, each part with a normal prior. U holds the
errors that every model may have; column, row and own belong to the camera and are the same in all recordings. One form
serves fits of samples, proposals from summaries, and the posterior mean.

References
----------
Woodbury matrix identity, in two steps: first the own bias of each pixel, then the columns of U and the lines.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.simulation.effects.hidden import PatternSpreads

LEAST_INFORMATION = 1e-10
"""Information of a bias, 1/mm2, below which it is unknown."""

DISCREPANCY = 0.25
"""Of the tolerance: prior of a tilt, and of a smooth error of a surface's ranges."""

_SMOOTH = 3  # functions along each side of a surface

NO_PATTERN = PatternSpreads(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class StaticErrors:
    """The covariance of the biases of pixels. Use `StaticErrors.of`.

    Parameters
    ----------
    low : (k, recording, pixel) float64
        Columns of U, mm, with unit priors.
    image : (int, int)
        Rows, columns.
    weight : (recording, pixel) float64
        Information of each bias, 1/mm2; 0 where it is unknown.
    own_variance : (pixel,) float64
        Variance of a pixel's own bias, mm2.
    by_column_mm, by_row_mm : float
        Standard deviations of lines.
    logdet : float
        Log determinant of the covariance over that of the noise.
    """

    low: FloatArray
    image: tuple[int, int]
    weight: FloatArray
    own_variance: FloatArray
    by_column_mm: float
    by_row_mm: float
    logdet: float
    _shrink: FloatArray  # (pixel,): 1 / (1 + own variance x information)
    _root: Any  # Cholesky factor of the small matrix

    @classmethod
    def of(
        cls,
        low: FloatArray,
        information: FloatArray,
        image: tuple[int, int],
        spreads: PatternSpreads = NO_PATTERN,
        more_variance: FloatArray | None = None,
    ) -> "StaticErrors":
        """The covariance for some information about each bias.

        Parameters
        ----------
        low : (k, recording, pixel) float64
            Columns of U, mm, with unit priors.
        information : (recording, pixel) float64
            Information of each bias, 1/mm2; what is below `LEAST_INFORMATION` is unknown.
        image : (int, int)
            Rows, columns.
        spreads : PatternSpreads
            Of a fixed pattern.
        more_variance : (pixel,) float64, optional
            Variance of a pixel's own bias beyond that of the pattern, mm2.
        """
        weight = np.where(information > LEAST_INFORMATION, information, 0.0)
        own = spreads.pixel_sigma_mm**2 + (np.zeros(weight.shape[1]) if more_variance is None else more_variance)
        return cls._made(low, image, weight, own, spreads.column_sigma_mm, spreads.row_sigma_mm)

    @classmethod
    def _made(
        cls,
        low: FloatArray,
        image: tuple[int, int],
        weight: FloatArray,
        own: FloatArray,
        by_column_mm: float,
        by_row_mm: float,
    ) -> "StaticErrors":
        total = weight.sum(axis=0)
        shrink = 1.0 / (1.0 + own * total)
        k, lines = len(low), (image[1] + image[0] if by_column_mm or by_row_mm else 0)
        small = np.eye(k + lines)
        weighed = _weighed(low, weight, own * shrink)
        small[:k, :k] += weighed.reshape(k, weight.size) @ low.reshape(k, weight.size).T
        if lines:
            pulled = _line_sums(weighed.sum(axis=1), image, by_column_mm, by_row_mm)
            small[:k, k:], small[k:, :k] = pulled, pulled.T
            grid = (total * shrink).reshape(image)
            c, r = slice(k, k + image[1]), slice(k + image[1], None)
            small[c, c] += np.diag(grid.sum(axis=0) * by_column_mm**2)
            small[r, r] += np.diag(grid.sum(axis=1) * by_row_mm**2)
            small[r, c] = grid * by_column_mm * by_row_mm
            small[c, r] = small[r, c].T
        root = cho_factor(small, lower=True, check_finite=False)
        logdet = float(-np.log(shrink).sum() + 2 * np.log(np.diag(root[0])).sum())
        return cls(low, image, weight, own, by_column_mm, by_row_mm, logdet, _shrink=shrink, _root=root)

    def weighed(self, factor: FloatArray) -> "StaticErrors":
        """The same errors with the information about each bias (recording, pixel) times a factor."""
        return self._made(
            self.low, self.image, self.weight * factor, self.own_variance, self.by_column_mm, self.by_row_mm
        )

    def products(self, vectors: FloatArray) -> FloatArray:
        """Products (n, n) of biases (n, recording, pixel), mm, by the inverse covariance."""
        weighed = self._weigh(vectors)
        pulled = self._pull(weighed)
        n = len(vectors)
        size = self.weight.size
        inner: FloatArray = weighed.reshape(n, size) @ vectors.reshape(n, size).T
        return inner - pulled @ cho_solve(self._root, pulled.T, check_finite=False)

    def square(self, bias_mm: FloatArray) -> float:
        """The square of one vector of biases (recording, pixel), mm, by the inverse covariance."""
        return float(self.products(bias_mm[None])[0, 0])

    def mean(self, bias_mm: FloatArray) -> FloatArray:
        """Posterior mean (recording, pixel) of the errors, mm, given measured biases."""
        common = self._common(bias_mm, lines=True)
        left = (self.weight * (bias_mm - common)).sum(axis=0)
        return np.asarray(common + self.own_variance * self._shrink * left)

    def of_model(self, bias_mm: FloatArray, most: float = math.inf) -> FloatArray:
        """Posterior mean (recording, pixel) of the errors of the model alone, U a, mm, each of at most so many sd."""
        return self._common(bias_mm, lines=False, most=most)

    def square_of_model(self, bias_mm: FloatArray) -> float:
        """The square of the posterior mean of the errors of the model alone, by their prior."""
        return float((self._coordinates(bias_mm)[: len(self.low)] ** 2).sum())

    def coordinates_of_model(self, bias_mm: FloatArray, most: float = math.inf) -> FloatArray:
        """Posterior mean (k,) of the columns of U, in sd of their priors, each of at most so many."""
        return np.asarray(np.clip(self._coordinates(bias_mm)[: len(self.low)], -most, most))

    def _coordinates(self, bias_mm: FloatArray) -> FloatArray:
        """Posterior mean (k + lines,) of the columns of U and the lines, in standard deviations of their priors."""
        return np.asarray(cho_solve(self._root, self._pull(self._weigh(bias_mm[None]))[0], check_finite=False))

    def _weigh(self, vectors: FloatArray) -> FloatArray:
        return _weighed(vectors, self.weight, self.own_variance * self._shrink)

    def _pull(self, weighed: FloatArray) -> FloatArray:
        """Sums (n, k + lines) of weighed vectors over the columns of U and over lines."""
        n, k = len(weighed), len(self.low)
        out: FloatArray = weighed.reshape(n, self.weight.size) @ self.low.reshape(k, self.weight.size).T
        if not (self.by_column_mm or self.by_row_mm):
            return out
        lines = _line_sums(weighed.sum(axis=1), self.image, self.by_column_mm, self.by_row_mm)
        return np.concatenate([out, lines], axis=1)

    def _common(self, bias_mm: FloatArray, *, lines: bool, most: float = math.inf) -> FloatArray:
        a = self._coordinates(bias_mm)
        k, cols = len(self.low), self.image[1]
        common = np.tensordot(np.clip(a[:k], -most, most), self.low, axes=1)
        if lines and (self.by_column_mm or self.by_row_mm):
            by_line = self.by_row_mm * a[k + cols :, None] + self.by_column_mm * a[None, k : k + cols]
            common = common + by_line.ravel()
        return np.asarray(common)


def _weighed(vectors: FloatArray, weight: FloatArray, taken: FloatArray) -> FloatArray:
    """Vectors (n, recording, pixel) by the inverse covariance of own bias and noise of each pixel."""
    out: FloatArray = vectors * weight
    if not taken.any():
        return out
    return np.asarray(out - weight * (taken * out.sum(axis=1))[:, None])


def _line_sums(values: FloatArray, image: tuple[int, int], by_column_mm: float, by_row_mm: float) -> FloatArray:
    """Sums (n, columns and rows) of values (n, pixel), times the standard deviation of a line."""
    grid = values.reshape(len(values), *image)
    return np.concatenate([grid.sum(axis=1) * by_column_mm, grid.sum(axis=2) * by_row_mm], axis=1)


def across_surface(place: IntArray, own: BoolArray) -> FloatArray:
    """Coordinates (pixel,) that run from -1 to 1 over a surface."""
    low, high = float(place[own].min()), float(place[own].max())
    return np.asarray(2 * (place - low) / max(high - low, 1.0) - 1)


def hats(u: FloatArray, v: FloatArray) -> Iterator[FloatArray]:
    """Products (pixel,) of linear splines over -1 to 1 in both directions."""
    knots = np.linspace(-1, 1, _SMOOTH)
    width = 2 / (_SMOOTH - 1)
    for a in knots:
        for b in knots:
            yield np.clip(1 - np.abs(u - a) / width, 0, None) * np.clip(1 - np.abs(v - b) / width, 0, None)
