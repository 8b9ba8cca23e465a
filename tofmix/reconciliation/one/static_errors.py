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
from scipy.sparse import coo_array, csr_array, hstack, vstack

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
    common : (k + lines, recording x pixel) sparse float64
        Columns of U, and columns and rows of the image, mm, with unit priors.
    of_model : int
        Number k of the columns of U.
    weight : (recording, pixel) float64
        Information of each bias, 1/mm2; 0 where it is unknown.
    own_variance : (pixel,) float64
        Variance of a pixel's own bias, mm2.
    logdet : float
        Log determinant of the covariance over that of the noise.
    """

    common: csr_array
    of_model: int
    weight: FloatArray
    own_variance: FloatArray
    logdet: float
    _shrink: FloatArray  # (pixel,): 1 / (1 + own variance x information)
    _root: Any  # Cholesky factor of the small matrix

    @classmethod
    def of(
        cls,
        low: csr_array,
        information: FloatArray,
        image: tuple[int, int],
        spreads: PatternSpreads = NO_PATTERN,
        more_variance: FloatArray | None = None,
    ) -> "StaticErrors":
        """The covariance for some information about each bias.

        Parameters
        ----------
        low : (k, recording x pixel) sparse float64
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
        lines = _lines(image, len(weight), spreads) if spreads.column_sigma_mm or spreads.row_sigma_mm else None
        common = low if lines is None else csr_array(vstack([low, lines]))
        return cls._made(common, low.shape[0], weight, own)

    @classmethod
    def _made(cls, common: csr_array, of_model: int, weight: FloatArray, own: FloatArray) -> "StaticErrors":
        shrink = 1.0 / (1.0 + own * weight.sum(axis=0))
        weighed = _times(common, weight.ravel())
        small = np.eye(common.shape[0]) + (weighed @ common.T).toarray()
        taken = own * shrink
        if taken.any():
            pixels = weight.shape[1]  # of all recordings, a pixel has one bias of its own
            by_pixel = csr_array((weighed.data, weighed.indices % pixels, weighed.indptr), (common.shape[0], pixels))
            small -= (_times(by_pixel, taken) @ by_pixel.T).toarray()
        root = cho_factor(small, lower=True, check_finite=False)
        logdet = float(-np.log(shrink).sum() + 2 * np.log(np.diag(root[0])).sum())
        return cls(common, of_model, weight, own, logdet, _shrink=shrink, _root=root)

    def weighed(self, factor: FloatArray) -> "StaticErrors":
        """The same errors with the information about each bias (recording, pixel) times a factor."""
        return self._made(self.common, self.of_model, self.weight * factor, self.own_variance)

    def products(self, vectors: FloatArray) -> FloatArray:
        """Products (n, n) of biases (n, recording, pixel), mm, by the inverse covariance."""
        weighed = self._weigh(vectors)
        pulled = self._pull(weighed)
        n = len(vectors)
        inner: FloatArray = weighed.reshape(n, self.weight.size) @ vectors.reshape(n, self.weight.size).T
        return inner - pulled.T @ cho_solve(self._root, pulled, check_finite=False)

    def square(self, bias_mm: FloatArray) -> float:
        """The square of one vector of biases (recording, pixel), mm, by the inverse covariance."""
        return float(self.products(bias_mm[None])[0, 0])

    def mean(self, bias_mm: FloatArray) -> FloatArray:
        """Posterior mean (recording, pixel) of the errors, mm, given measured biases."""
        common = (self.common.T @ self._coordinates(bias_mm)).reshape(self.weight.shape)
        left = (self.weight * (bias_mm - common)).sum(axis=0)
        return np.asarray(common + self.own_variance * self._shrink * left)

    def mean_of_model(self, bias_mm: FloatArray, most: float = math.inf) -> FloatArray:
        """Posterior mean (recording, pixel) of the errors of the model alone, U a, mm, each of at most so many sd."""
        own = np.zeros(self.common.shape[0])
        own[: self.of_model] = self.coordinates_of_model(bias_mm, most)
        return np.asarray((self.common.T @ own).reshape(self.weight.shape))

    def square_of_model(self, bias_mm: FloatArray) -> float:
        """The square of the posterior mean of the errors of the model alone, by their prior."""
        return float((self.coordinates_of_model(bias_mm) ** 2).sum())

    def coordinates_of_model(self, bias_mm: FloatArray, most: float = math.inf) -> FloatArray:
        """Posterior mean (k,) of the columns of U, in sd of their priors, each of at most so many."""
        return np.asarray(np.clip(self._coordinates(bias_mm)[: self.of_model], -most, most))

    def _coordinates(self, bias_mm: FloatArray) -> FloatArray:
        """Posterior mean (k + lines,) of the columns of U and the lines, in standard deviations of their priors."""
        return np.asarray(cho_solve(self._root, self._pull(self._weigh(bias_mm[None]))[:, 0], check_finite=False))

    def _weigh(self, vectors: FloatArray) -> FloatArray:
        """Vectors (n, recording, pixel) by the inverse covariance of own bias and noise of each pixel."""
        out: FloatArray = vectors * self.weight
        return np.asarray(out - self.weight * (self.own_variance * self._shrink * out.sum(axis=1))[:, None])

    def _pull(self, weighed: FloatArray) -> FloatArray:
        """Sums (k + lines, n) of weighed vectors over the columns of U and over lines."""
        return np.asarray(self.common @ weighed.reshape(len(weighed), self.weight.size).T)


def _times(rows: csr_array, factor: FloatArray) -> csr_array:
    """Rows (n, place), each place times a factor (place,)."""
    return csr_array((rows.data * factor[rows.indices], rows.indices, rows.indptr), rows.shape)


def _lines(image: tuple[int, int], recordings: int, spreads: PatternSpreads) -> csr_array:
    """Columns and rows (lines, recording x pixel) of an image, the same in all recordings, mm, with unit priors."""
    row, col = np.divmod(np.arange(image[0] * image[1]), image[1])
    values = np.repeat([spreads.column_sigma_mm, spreads.row_sigma_mm], row.size)
    places = np.concatenate([col, image[1] + row]), np.tile(np.arange(row.size), 2)
    one = coo_array((values, places), (image[1] + image[0], row.size))
    return csr_array(hstack([one] * recordings))


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
