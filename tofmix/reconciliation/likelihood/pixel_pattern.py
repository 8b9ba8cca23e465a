"""The bias of each pixel: the hidden state of a pattern, estimated by pixel and integrated out together."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part, Sums
from tofmix.reconciliation.likelihood.memory import inflation, sees_one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture

_LEAST_INFORMATION = 1e-10  # 1/mm2: a bias with less information is unknown
_LEAST_MM = 1e-6  # a spread that counts as none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelBiases:
    """The bias of each pixel: arrays (pixel,).

    Parameters
    ----------
    bias : most likely bias, mm.
    information : its information, 1/mm2; 0 where there is none.
    gain : log-likelihood there over that without it.
    overstated : factor by which independent samples would overstate both, if the noise has a memory.
    """

    bias: FloatArray
    information: FloatArray
    gain: FloatArray
    overstated: FloatArray | float = 1.0


def pixel_biases(likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part) -> PixelBiases:
    """Estimate each pixel's bias by expectation maximisation, in addition to the state's.

    A bias of many sigma cannot be reached step by step, so the median of a pixel's samples is another start. If the
    noise has a memory, information and gain are divided by the factor on the variance of a mean over frames. They are
    those about a bias of the camera: a measured scene has errors of its own.
    """
    first = likelihood.sums(mixture, state, part)
    far = state.pixel_bias + _median_bias(likelihood, mixture, state, part)
    other = likelihood.sums(mixture, state, part, bias=far)
    better = other.by_pixel[:, 0] > first.by_pixel[:, 0]
    bias = np.where(better, far, state.pixel_bias)
    sums = Sums(np.where(better[:, None], other.by_pixel, first.by_pixel), first.by_frame)
    for _ in range(6):  # steps of the iteration for pixels' biases
        bias = bias + sums.by_pixel[:, 1] / np.maximum(sums.by_pixel[:, 2], 1e-12)
        sums = likelihood.sums(mixture, state, part, bias=bias)
    inside = np.zeros(bias.size, dtype=bool)
    inside[part[1]] = True
    inside &= state.working & (sums.by_pixel[:, 2] > _LEAST_INFORMATION)
    overstated = inflation(likelihood, mixture, state, part)
    information = sums.by_pixel[:, 2] / overstated
    scene = 1.0 if state.errors is None else 1.0 / (1.0 + information * state.pixel_variance)
    return PixelBiases(
        bias=np.where(inside, bias - state.pixel_bias, 0.0),
        information=np.where(inside, information * scene, 0.0),
        gain=np.where(inside, (sums.by_pixel[:, 0] - first.by_pixel[:, 0]) / overstated * scene, 0.0),
        overstated=overstated,
    )


def _median_bias(likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part) -> FloatArray:
    """Median of a pixel's samples minus the mean of the surface that each may be of, mm; the mean over recordings.

    0 if the pixel has no return or no sample.
    """
    total, count = np.zeros(state.pixel_bias.size), np.zeros(state.pixel_bias.size)
    for view in views(likelihood, mixture, part):
        own, usable = _medians(view.evidence, view.mixture, view.part)
        total += np.where(usable, own - state.pixel_bias, 0.0)
        count += usable
    return total / np.maximum(count, 1)


def _medians(evidence: Evidence, mixture: Mixture, part: Part) -> tuple[FloatArray, BoolArray]:
    frames, pixels = part
    values = evidence.samples[frames][:, pixels].astype(np.float32)
    values -= mixture.frame_bias[frames, None].astype(np.float32)
    values = _off(mixture, values, pixels)
    valid = evidence.samples[frames][:, pixels] > 0
    middle = np.zeros(evidence.shape[1])
    some = valid.any(axis=0)
    middle[pixels[some]] = np.nanmedian(np.where(valid, values, np.nan)[:, some], axis=0)
    known = np.zeros(middle.size, dtype=bool)
    known[pixels[some]] = True
    usable = known & mixture.of_main(mixture.lit).astype(bool)
    return middle, usable


def _off(mixture: Mixture, values: Float32Array, pixels: IntArray) -> Float32Array:
    """Samples (frame, n) of pixels less the mean of their main surface, mm; where there are several, of the nearest."""
    out = mixture.near_turn(values - mixture.of_main(mixture.mean)[pixels].astype(np.float32))
    seen = (mixture.lit[0] & (mixture.weight[0] > 0))[:, pixels]
    several = np.flatnonzero(seen.sum(axis=0) > 1)
    for mean, own in zip(mixture.mean[0][:, pixels[several]], seen[:, several], strict=True):
        away = mixture.near_turn(values[:, several] - mean.astype(np.float32))
        nearer = own & (np.abs(away) < np.abs(out[:, several]))
        out[:, several] = np.where(nearer, away, out[:, several])
    return np.asarray(out, dtype=np.float32)


def spreads_of(image: tuple[int, int]) -> int:
    """Number of spreads that an image (rows, columns) can show: by pixel; by column and row if there are several."""
    return 3 if min(image) > 1 else 1


def marginal_pattern(
    found: PixelBiases, image: tuple[int, int], sigmas_mm: tuple[float, float, float]
) -> tuple[float, FloatArray]:
    """Gain of a Gaussian pattern with its values integrated out, and the posterior mean of its values.

    Parameters
    ----------
    found : PixelBiases
        Bias and information of each pixel.
    image : (int, int)
        Rows, columns.
    sigmas_mm : (float, float, float)
        Standard deviations by pixel, column and row.

    Returns
    -------
    gain : float
        Nats.
    pattern : (pixel,) float64
        Posterior mean, mm: the biases shrunk by their noise.

    References
    ----------
    Woodbury matrix identity, for the covariance D + U U' of pixels (D), columns and rows (U).
    """
    at = PatternLines(found.information, image, sigmas_mm[0])
    b, d = found.bias[at.use], at.variance
    pulled = at.sums(b / d)
    root, logdet = at.factor(sigmas_mm[1], sigmas_mm[2])
    lines = root.solve(pulled)
    quadratic = float((b * b / d).sum() - pulled @ lines)
    gain = float(found.gain[at.use].sum()) - 0.5 * (quadratic + logdet)
    stripes = lines[at.col] + lines[at.cols + at.row]
    pattern = np.zeros(found.bias.size)
    pattern[at.use] = stripes + at.own / d * (b - stripes)
    return gain, pattern


def with_pattern(found: PixelBiases, image: tuple[int, int], sigmas_mm: tuple[float, float, float]) -> float:
    """Difference that a pattern, integrated out, makes to the log-likelihood; comparable between predictions.

    The maximum of each pixel counts as for independent samples, like all log-likelihoods; its width follows the memory
    of the noise.
    """
    return marginal_pattern(found, image, sigmas_mm)[0] + float((found.gain * (found.overstated - 1)).sum())


class PatternLines:
    """The covariance of pixels' biases and their noise, for one spread by pixel and any spreads by column and row.

    Parameters
    ----------
    information : (pixel,) float64
        Of each pixel's bias, 1/mm2; 0 where there is none.
    image : (int, int)
        Rows, columns.
    pixel_sigma_mm : float
        Standard deviation by pixel.
    """

    def __init__(self, information: FloatArray, image: tuple[int, int], pixel_sigma_mm: float) -> None:
        self.rows, self.cols = image
        self.information = information
        self.use = np.flatnonzero(information > _LEAST_INFORMATION)
        self.row, self.col = np.divmod(self.use, self.cols)
        self.noise = 1.0 / information[self.use]
        self.own = max(float(pixel_sigma_mm), _LEAST_MM) ** 2
        self.variance = self.own + self.noise
        self._logdet = float(np.log(self.variance / self.noise).sum())
        weight = 1.0 / self.variance
        self._cross: FloatArray = np.zeros((self.cols, self.rows))
        self._cross[self.col, self.row] = weight
        self._weight = self.sums(weight)

    def sums(self, values: FloatArray) -> FloatArray:
        """Sums (column and row,) of values of the used pixels."""
        by_col = np.bincount(self.col, values, minlength=self.cols)
        return np.concatenate([by_col, np.bincount(self.row, values, minlength=self.rows)])

    def factor(self, column_sigma_mm: float, row_sigma_mm: float) -> tuple["LinesFactor", float]:
        """The factor of the matrix in Woodbury's identity; log determinant of the covariance over that of the noise."""
        by_col, by_row = (max(float(s), _LEAST_MM) ** 2 for s in (column_sigma_mm, row_sigma_mm))
        prior = np.concatenate([np.full(self.cols, by_col), np.full(self.rows, by_row)])
        root = LinesFactor(1.0 / prior + self._weight, self._cross)
        return root, self._logdet + root.logdet + float(np.log(prior).sum())


class LinesFactor:
    """The inverse of a matrix that is diagonal among columns and among rows.

    The larger of the two blocks is eliminated. The dense matrix that remains has the size of the smaller block: a tenth
    of the work, and too small for a library to use threads.

    Parameters
    ----------
    diagonal : (column and row,) float64
        Of the whole matrix.
    cross : (column, row) float64
        Its block off the diagonal.
    """

    def __init__(self, diagonal: FloatArray, cross: FloatArray) -> None:
        first = cross.shape[0]
        self._wide = first >= cross.shape[1]
        self._cross = cross if self._wide else cross.T  # (larger, smaller)
        self._first = first
        large, small = self._parts(diagonal)
        self._large = large
        self._scaled = self._cross / large[:, None]
        self._root = cho_factor(np.diag(small) - self._cross.T @ self._scaled, lower=True, check_finite=False)
        self.logdet = float(np.log(large).sum() + 2 * np.log(np.diag(self._root[0])).sum())

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for the right side (column and row,) or (column and row, n)."""
        large, small = self._parts(right)
        x = cho_solve(self._root, small - self._scaled.T @ large, check_finite=False)
        scale = self._large if right.ndim == 1 else self._large[:, None]
        y = large / scale - self._scaled @ x
        return np.concatenate([y, x] if self._wide else [x, y])

    def _parts(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The parts of the larger and of the smaller block."""
        columns, rows = values[: self._first], values[self._first :]
        return (columns, rows) if self._wide else (rows, columns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingBiases:
    """The biases of one recording. Arrays are (pixel,).

    Parameters
    ----------
    view : RecordingView
        The recording, and the prediction of the model.
    used : pixels that see one surface and have data; the others have no information.
    bias_mm : bias of the mean against the prediction, mm.
    information : its information, 1/mm2.
    """

    view: RecordingView
    used: BoolArray
    bias_mm: FloatArray
    information: FloatArray

    @property
    def surfaces(self) -> Iterator[tuple[str, BoolArray]]:
        """Each surface's name, and the pixels (pixel,) with data that see it."""
        m = self.view.mixture
        seen = m.of_main(m.surface)
        for number, name in enumerate(self.view.scene.names):
            own = self.used & (seen == number)
            if own.any():
                yield name, own


def biases_of_recordings(likelihood: Likelihood, state: ModelState, part: Part) -> list[RecordingBiases]:
    """The biases that a part of each recording has, relative to a state."""
    mixture = likelihood.mixture(state)
    out = []
    for view in views(likelihood, mixture, part):
        found, m = pixel_biases(likelihood, mixture, state, view.part_of_all), view.mixture
        used = sees_one_surface(m) & m.of_main(m.lit).astype(bool) & (found.information > 0)
        out.append(RecordingBiases(view=view, used=used, bias_mm=found.bias, information=found.information))
    return out
