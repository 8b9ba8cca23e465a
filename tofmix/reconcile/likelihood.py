"""Log-likelihood of a recording under a model with effects, with what links samples integrated out.

One compiled pass gives each pixel's and frame's log-likelihood with its slope and information against a bias. On
these stand the latent states: whether a frame is disturbed (hidden Markov chain), what bias a pixel has of its own
(Gaussian, by the Woodbury identity in `marginal_pattern`), which pixels are stuck, and the memory of the noise.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconcile.evidence import Evidence
from tofmix.reconcile.kernel import empty_sums, log_likelihood, transform
from tofmix.reconcile.mixture import Mixture, Scene
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.effects.interference import Interference

if TYPE_CHECKING:
    from numpy.typing import NDArray

_CHUNKS = 4  # fixed, so that sums do not depend on the number of threads
_THREADS = 2
_LEAST = 1.0e-100
_STEPS = 6  # of the iteration for pixels' biases

Part = tuple[IntArray, IntArray]
"""Frames and pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """The model as it stands: effects, and the latent states that were found for them.

    Parameters
    ----------
    effects : tuple of Effect
        Effects beyond those of the model.
    pixel_bias : (pixel,) float64
        Known bias of each pixel, mm.
    pixel_variance : (pixel,) float64
        Variance of what is known of it, mm2.
    stuck_mm : (pixel,) float64
        Value of stuck pixels, NaN for the others.
    disturbed : (frame,) float64
        Probability that a frame is disturbed; used for scores.
    """

    effects: tuple[Effect, ...]
    pixel_bias: FloatArray
    pixel_variance: FloatArray
    stuck_mm: FloatArray
    disturbed: FloatArray

    @property
    def working(self) -> BoolArray:
        """Pixels that are not stuck."""
        return np.isnan(self.stuck_mm)


@dataclass(slots=True, eq=False)
class Sums:
    """What a pass gives: columns are log-likelihood, slope (1/mm), information (1/mm2), valid samples."""

    by_pixel: FloatArray
    by_frame: FloatArray

    @property
    def total(self) -> float:
        """The log-likelihood."""
        return float(self.by_pixel[:, 0].sum())


@dataclass(eq=False)
class Likelihood:
    """Evaluates states on parts of a recording.

    Parameters
    ----------
    evidence : Evidence
        The recording.
    scene : Scene
        The model's scene.
    """

    evidence: Evidence
    scene: Scene
    calls: int = field(default=0)

    def start(self) -> State:
        """No effects."""
        frames, pixels = self.evidence.shape
        return State(
            effects=(),
            pixel_bias=np.zeros(pixels),
            pixel_variance=np.zeros(pixels),
            stuck_mm=np.full(pixels, np.nan),
            disturbed=np.zeros(frames),
        )

    def sums(
        self, mixture: Mixture, state: State, part: Part, *, variance: FloatArray | None = None,
        bias: FloatArray | None = None,
    ) -> Sums:  # fmt: skip
        """One pass over a part, stuck pixels left out.

        Parameters
        ----------
        mixture : Mixture
            The prediction.
        state : State
            For its stuck pixels and pixels' biases.
        part : (frames, pixels)
            What to go over.
        variance : (frame,), optional
            Variance that each frame adds, mm2; that of the state's disturbed frames if left out.
        bias : (pixel,), optional
            Bias of each pixel, mm, in the place of the state's.
        """
        self.calls += 1
        frames, pixels = part
        pixels = pixels[state.working[pixels]]
        added = self._variance(state) if variance is None else variance
        shift = state.pixel_bias if bias is None else bias
        density = mixture.outlier / (mixture.high - mixture.low)
        run = partial(self._pass, mixture, pixels, (added, shift, density))
        with ThreadPoolExecutor(_THREADS) as pool:
            results = list(pool.map(run, np.array_split(frames, _CHUNKS)))
        out = Sums(*empty_sums(*self.evidence.shape))
        for by_pixel, by_frame in results:
            out.by_pixel += by_pixel
            out.by_frame += by_frame
        return out

    def _pass(self, m: Mixture, pixels: IntArray, more: tuple[Any, ...], frames: IntArray) -> tuple[Any, Any]:
        added, shift, density = more
        by_pixel, by_frame = empty_sums(*self.evidence.shape)
        log_likelihood(
            self.evidence.samples, pixels, frames, m.key, m.since, m.frame_bias, added, shift, m.weight, m.mean,
            m.sigma, m.rate, m.lit, m.invalid, density, m.step, m.period, by_pixel, by_frame,
        )  # fmt: skip
        return by_pixel, by_frame

    def _variance(self, state: State) -> FloatArray:
        for effect in state.effects:
            if isinstance(effect, Interference):
                return np.asarray(state.disturbed * effect.sigma_mm**2)
        return np.zeros(self.evidence.shape[0])

    def value(self, state: State, part: Part, mixture: Mixture | None = None) -> float:
        """Log-likelihood of a part; frames' disturbance integrated out."""
        mixture = self.scene.mixture(state.effects) if mixture is None else mixture
        for effect in state.effects:
            if isinstance(effect, Interference):
                return self._with_bursts(mixture, state, part, effect)
        return self.sums(mixture, state, part).total

    def _with_bursts(self, mixture: Mixture, state: State, part: Part, effect: Interference) -> float:
        return forward(*self.frame_pair(mixture, state, part, effect.sigma_mm), part[0], effect)[0]

    def frame_pair(self, mixture: Mixture, state: State, part: Part, sigma_mm: float) -> tuple[FloatArray, FloatArray]:
        """Log-likelihoods (n,) of the part's frames, quiet and disturbed."""
        frames = self.evidence.shape[0]
        quiet = self.sums(mixture, state, part, variance=np.zeros(frames)).by_frame[part[0], 0]
        loud = self.sums(mixture, state, part, variance=np.full(frames, sigma_mm**2)).by_frame[part[0], 0]
        return quiet, loud

    def scores(self, state: State, part: Part, seed: int, mixture: Mixture | None = None) -> Float32Array:
        """Standard normal scores (frame, pixel) if the model is right; NaN for invalid samples and outside the part."""
        m = self.scene.mixture(state.effects) if mixture is None else mixture
        frames, pixels = part
        pixels = pixels[state.working[pixels]]
        out: Float32Array = np.full(self.evidence.shape, np.nan, dtype=np.float32)
        added = self._variance(state)

        def run(some: IntArray) -> None:
            transform(
                self.evidence.samples, pixels, some, m.key, m.since, m.frame_bias, added, state.pixel_bias, m.weight,
                m.mean, m.sigma, m.rate, m.lit, m.outlier, m.low, m.high, m.step, m.period, seed, out,
            )  # fmt: skip

        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(run, np.array_split(frames, _CHUNKS)))
        for frame in range(len(out)):  # frame by frame: no second copy in double precision
            out[frame] = ndtri(np.clip(out[frame].astype(np.float64), 1e-9, 1 - 1e-9))
        return out


def forward(quiet: FloatArray, loud: FloatArray, frames: IntArray, effect: Interference) -> tuple[float, FloatArray]:
    """Log-likelihood of frames that a hidden Markov chain disturbs, and the probability (n,) that each one is.

    Parameters
    ----------
    quiet, loud : (n,) float64
        Log-likelihood of each frame in either state.
    frames : (n,) int64
        Their numbers, ascending; gaps are bridged by the chain.
    effect : Interference
        Share and length of the bursts.
    """
    p = min(max(effect.probability, 1e-6), 1 - 1e-6)
    stop = min(1 / effect.burst_frames, (1 - p) / p)
    start = min(stop * p / (1 - p), 1.0)
    step = np.array([[1 - start, start], [stop, 1 - stop]])
    emit = np.stack([quiet, loud], axis=1)
    top = emit.max(axis=1)
    emit = np.maximum(np.exp(emit - top[:, None]), _LEAST)  # no state is ever ruled out: nothing divides by 0
    step = (step + _LEAST) / (1 + 2 * _LEAST)
    gaps = np.diff(frames, prepend=frames[0])
    alpha = np.empty_like(emit)
    scale = np.empty(len(frames))
    belief = np.array([1 - p, p])
    powers = {int(g): np.linalg.matrix_power(step, int(g)) for g in np.unique(gaps)}
    for n, gap in enumerate(gaps):
        belief = (belief @ powers[int(gap)] if n else belief) * emit[n]
        scale[n] = belief.sum()
        belief = belief / scale[n]
        alpha[n] = belief
    beta = np.ones(2)
    posterior = np.empty(len(frames))
    for n in range(len(frames) - 1, -1, -1):
        both = alpha[n] * beta
        posterior[n] = both[1] / both.sum()
        if n:
            beta = powers[int(gaps[n])] @ (emit[n] * beta)
            beta /= beta.sum()
    return float(np.log(scale).sum() + top.sum()), posterior


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelBiases:
    """Each pixel's bias by itself: arrays (pixel,).

    Parameters
    ----------
    bias : most likely bias, mm.
    information : its information, 1/mm2; 0 where there is none.
    gain : log-likelihood there over that without it.
    """

    bias: FloatArray
    information: FloatArray
    gain: FloatArray


def pixel_biases(likelihood: Likelihood, mixture: Mixture, state: State, part: Part) -> PixelBiases:
    """Find each pixel's bias by expectation maximisation, on top of the state's.

    A bias of many sigma cannot be reached step by step: the median of a pixel's samples is another start.
    """
    first = likelihood.sums(mixture, state, part)
    far = state.pixel_bias + _median_bias(likelihood.evidence, mixture, state, part)
    other = likelihood.sums(mixture, state, part, bias=far)
    better = other.by_pixel[:, 0] > first.by_pixel[:, 0]
    bias = np.where(better, far, state.pixel_bias)
    sums = Sums(np.where(better[:, None], other.by_pixel, first.by_pixel), first.by_frame)
    for _ in range(_STEPS):
        bias = bias + sums.by_pixel[:, 1] / np.maximum(sums.by_pixel[:, 2], 1e-12)
        sums = likelihood.sums(mixture, state, part, bias=bias)
    inside = np.zeros(bias.size, dtype=bool)
    inside[part[1]] = True
    inside &= state.working & (sums.by_pixel[:, 2] > 0)
    return PixelBiases(
        bias=np.where(inside, bias - state.pixel_bias, 0.0),
        information=np.where(inside, sums.by_pixel[:, 2], 0.0),
        gain=np.where(inside, sums.by_pixel[:, 0] - first.by_pixel[:, 0], 0.0),
    )


def _median_bias(evidence: Evidence, mixture: Mixture, state: State, part: Part) -> FloatArray:
    """Median of a pixel's samples less what its main surface has, mm; 0 where it has no return or no sample."""
    frames, pixels = part
    values = evidence.samples[frames][:, pixels].astype(np.float32)
    values -= mixture.frame_bias[frames, None].astype(np.float32)
    valid = evidence.samples[frames][:, pixels] > 0
    middle = np.zeros(evidence.shape[1])
    some = valid.any(axis=0)
    middle[pixels[some]] = np.nanmedian(np.where(valid, values, np.nan)[:, some], axis=0)
    known = np.zeros(middle.size, dtype=bool)
    known[pixels[some]] = True
    usable = known & mixture.of_main(mixture.lit).astype(bool)
    return np.where(usable, middle - mixture.of_main(mixture.mean) - state.pixel_bias, 0.0)


def marginal_pattern(
    found: PixelBiases, image: tuple[int, int], sigmas_mm: tuple[float, float, float]
) -> tuple[float, FloatArray]:
    """Gain of a Gaussian pattern over none, all patterns integrated out, and the pattern's mean given the data.

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
    rows, cols = image
    use = np.flatnonzero(found.information > 0)
    row, col = np.divmod(use, cols)
    b, noise = found.bias[use], 1.0 / found.information[use]
    own, by_col, by_row = (max(float(s), 1e-6) ** 2 for s in sigmas_mm)
    d = own + noise
    cross: NDArray[np.float64] = np.zeros((cols + rows, cols + rows))
    np.add.at(cross, (col, cols + row), 1.0 / d)
    cross += cross.T
    cross[np.arange(cols), np.arange(cols)] = np.bincount(col, 1.0 / d, minlength=cols)
    cross[cols + np.arange(rows), cols + np.arange(rows)] = np.bincount(row, 1.0 / d, minlength=rows)
    prior = np.concatenate([np.full(cols, by_col), np.full(rows, by_row)])
    inner = np.diag(1.0 / prior) + cross
    pulled = np.concatenate([np.bincount(col, b / d, minlength=cols), np.bincount(row, b / d, minlength=rows)])
    root = cho_factor(inner, lower=True, check_finite=False)
    lines = cho_solve(root, pulled, check_finite=False)
    quadratic = float((b * b / d).sum() - pulled @ lines)
    logdet = float(np.log(d / noise).sum() + 2 * np.log(np.diag(root[0])).sum() + np.log(prior).sum())
    gain = float(found.gain[use].sum()) - 0.5 * (quadratic + logdet)
    stripes = lines[col] + lines[cols + row]
    pattern = np.zeros(found.bias.size)
    pattern[use] = stripes + own / d * (b - stripes)
    return gain, pattern
