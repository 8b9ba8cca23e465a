"""The memory of the noise: its coefficient, its gain, and its effect on means over frames.

The noise of each pixel is AR(1) from frame to frame. Rounding to whole mm adds noise without memory. Some samples are
random values, which do not interrupt the memory. So a filter predicts each sample from all earlier samples of its
pixel.

Products of samples at a distance of some frames, which show a memory.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtri, ndtr, ndtri

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.reconciliation.likelihood.joint import views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.effects.base import with_hidden
from tofmix.simulation.effects.hidden import RememberedNoise


def lag_product(
    values: Float32Array | FloatArray, valid: BoolArray, lag: int, frames: IntArray | None = None
) -> tuple[int, float]:
    """Number of pairs of valid samples of a pixel that are `lag` frames apart, and the sum of their products.

    Parameters
    ----------
    values : (frame, pixel) float32 or float64
        Samples; 0 where invalid.
    valid : (frame, pixel) bool
        Which are valid.
    lag : int
        Frames, at least 1.
    frames : (frame,) int64, optional
        Numbers of the frames, ascending; without them, no frame is missing.
    """
    if frames is None:
        pairs = int((valid[lag:] & valid[:-lag]).sum())
        return pairs, float((values[lag:] * values[:-lag]).sum(dtype=np.float64))
    now = np.flatnonzero(frames[lag:] - frames[:-lag] == lag)
    pairs = int((valid[now] & valid[now + lag]).sum())
    return pairs, float((values[now] * values[now + lag]).sum(dtype=np.float64))


_MAIN, _ALONE = 0.95, 0.9995  # share of the beam
_STRONG = 0.7  # coefficient
_MOST = 0.98  # coefficient
_FAR = 5.0  # sigma: beyond the model's noise, and not explained by its random values
_REACH = 7.0  # sigma, beyond which a sample is a random value for sure
_LEAST_CHANCE = 1e-15  # in either tail: a score of 7.9
_NUDGE = 0.01  # of the coefficient, for a curvature
_MANY_PAIRS = 1000  # of frames and pixels: a correlation is then known to 0.03
_LEAST_PAIRS = 100  # to 0.1
_SHOWING = 500  # pixels that show a memory well enough to count independent samples
_LEAST_POWER = 1e-6  # mean square of scores that are no mere rounding
_LAGS = 24  # frames
_WIDE = 0.7  # cells over sigma, above which their places count
_AT_ONCE = 1 << 12  # pixels
_ROOT_TWO_PI = math.sqrt(2 * math.pi)


def memory_of(state: ModelState) -> float:
    """The coefficient of a state's memory; 0 without one."""
    return next((hidden.coefficient(e) for e, hidden in with_hidden(state.linking, RememberedNoise)), 0.0)


def whitened(z: Float32Array, mixture: Mixture, coefficient: float) -> Float32Array:
    """Scores (frame, pixel) given all earlier samples, in pixels that see one surface.

    The noise of the next sample is predicted (`predicted_noise`); a random value keeps its score. If the memory is
    strong, pixels that see a little of another surface are NaN: their scores depend on the last sample in no simple
    way.
    """
    alone = one_surface(mixture)
    out = z.copy()
    if abs(coefficient) > _STRONG:
        out[:, alone & ~one_surface(mixture, _ALONE)] = np.nan
    for pixels in np.array_split(np.flatnonzero(alone), math.ceil(max(int(alone.sum()), 1) / _AT_ONCE)):
        random = random_values(mixture, pixels)
        u = noise_of(out[:, pixels].astype(np.float64), random)
        mean, variance = predicted_noise(u, coefficient, attenuation(mixture)[pixels], random)
        given = random.chance(u, ndtr((u - mean) / np.sqrt(variance)))
        sure = np.where(np.abs(u) < _REACH, given, ndtr(out[:, pixels]))
        out[:, pixels] = ndtri(np.clip(sure, 1e-9, 1 - 1e-9))
    return out


def attenuation(mixture: Mixture) -> FloatArray:
    """Share (pixel,) of the memory's coefficient by which scores correlate from frame to frame.

    A score is drawn within the cell of its stored value, so that its covariance with the noise is `cell_share`.
    """
    return np.asarray((cell_share(mixture) ** 2).mean(axis=0))


def cell_share(mixture: Mixture) -> FloatArray:
    """Variance (time, pixel) of the noise's mean given the cell of its stored value, over that of the noise.

    A bias that is known from stored values has this share of the information that samples would have, and the noise in
    it remembers by this share. It is that at some times, if surfaces move over cells that are wide against the noise.
    """
    sigma = mixture.of_main(mixture.sigma)
    cell = max(mixture.step, 1.0) / sigma
    frames = np.unique(np.linspace(0, mixture.key.size - 1, 10).astype(np.int64))
    out = np.broadcast_to(1.0 / (1.0 + cell**2 / 12.0), (frames.size, sigma.size)).copy()  # Sheppard
    wide = np.flatnonzero(cell > _WIDE)
    for number, frame in enumerate(frames if wide.size else ()):
        mean = _main_mean(mixture, int(frame))[wide] / sigma[wide]
        out[number, wide] = _of_wide_cells(mean, cell[wide])
    return out


def _main_mean(m: Mixture, frame: int) -> FloatArray:
    """Mean (pixel,) of the main components in a frame, mm."""
    t = m.key[frame]
    mean = m.mean[t] + m.rate[t] * m.since[frame] + m.frame_bias[frame]
    return np.asarray(np.take_along_axis(mean, m.main[None], axis=0)[0])


def _of_wide_cells(mean: FloatArray, cell: FloatArray) -> FloatArray:
    """The share (pixel,) for cells about multiples of their width; mean and width in units of the noise."""
    around = np.arange(-math.ceil(_REACH / _WIDE), math.ceil(_REACH / _WIDE) + 2)[:, None]
    edge = (np.rint(mean / cell) - 0.5 + around) * cell - mean
    height, below = np.exp(-0.5 * edge**2) / _ROOT_TWO_PI, ndtr(edge)
    return np.asarray((np.diff(height, axis=0) ** 2 / np.maximum(np.diff(below, axis=0), _LEAST_CHANCE)).sum(axis=0))


def one_surface(mixture: Mixture, share: float = _MAIN) -> BoolArray:
    """Pixels (pixel,) that see one surface, so that scores depend on noise and not on the surface that was drawn.

    `share` is the least share of the main component among samples without random values.
    """
    return np.asarray(mixture.of_main(mixture.weight) > share * np.maximum(mixture.weight[0].sum(axis=0), 1e-9))


def sees_one_surface(mixture: Mixture) -> BoolArray:
    """Pixels (pixel,) whose samples of surfaces are of one: biases and noise are told there, whatever lies beside it.

    Samples of no surface, as of the camera's own cover, make scores depend on where a sample is from.
    """
    of_surfaces = np.where(mixture.lit[0], mixture.weight[0], 0.0)
    return np.asarray(of_surfaces.max(axis=0) > _MAIN * np.maximum(of_surfaces.sum(axis=0), 1e-9))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomValues:
    """Random values among the valid samples of some pixels, in units of the noise.

    Parameters
    ----------
    share : (pixel,) float64
        Of the valid samples.
    below : (pixel,) float64
        Share of the random values that lie below the surface.
    density : (pixel,) float64
        Their density there, per sigma of the noise.
    """

    share: FloatArray
    below: FloatArray
    density: FloatArray

    def chance(self, u: FloatArray, noise: FloatArray) -> FloatArray:
        """Probability (frame, pixel) of a value below u sigma; `noise` is that of the noise alone."""
        return np.asarray(self.share * np.clip(self.below + self.density * u, 0, 1) + (1 - self.share) * noise)


def random_values(mixture: Mixture, pixels: IntArray) -> RandomValues:
    """The random values of a mixture in some pixels (pixel,), relative to each pixel's main surface."""
    width = max(mixture.high - mixture.low, 1.0)
    valid = np.maximum(1.0 - mixture.invalid[0][pixels], 1e-9)
    return RandomValues(
        share=np.clip(mixture.outlier[pixels] / valid, 0.0, 0.99),
        below=np.clip((mixture.of_main(mixture.mean)[pixels] - mixture.low) / width, 0.0, 1.0),
        density=mixture.of_main(mixture.sigma)[pixels] / width,
    )


def noise_of(z: FloatArray, random: RandomValues) -> FloatArray:
    """The noise (frame, pixel), in units of its sigma, of samples with these scores; random values are far from 0.

    Solves share (below + density u) + (1 - share) Phi(u) = Phi(z) for u by substitution, because the first term hardly
    changes over the width of the noise: exact to 0.01 up to 3.2 sigma; beyond, a sample may as well be a random value.
    """
    if not random.share.any():
        return z
    wanted, u = ndtr(z), z
    for _ in range(3):  # of the fixed point of the gain: each halves its error
        stray = random.share * np.clip(random.below + random.density * u, 0.0, 1.0)
        u = ndtri(np.clip((wanted - stray) / (1 - random.share), _LEAST_CHANCE, 1 - _LEAST_CHANCE))
    return np.asarray(u)


def predicted_noise(
    u: FloatArray, coefficient: float, camera: FloatArray, random: RandomValues
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance (frame, pixel) of each sample's noise, given all earlier samples of its pixel.

    Parameters
    ----------
    u : (frame, pixel) float64
        Noise in units of its sigma; NaN where nothing is known of it.
    coefficient : float
        rho of e_t = rho e_(t-1) + sqrt(1 - rho^2) w_t.
    camera : (pixel,) float64
        Share of the noise's variance that remembers; the rest is that of whole mm.
    random : RandomValues
        Which of the samples may be no noise at all.

    References
    ----------
    Kalman, J. Basic Eng. 82 (1960) 35. A sample that is noise and one that is not give two Gaussians, which are put
    together by their moments: Bar-Shalom and Tse, Automatica 11 (1975) 451.
    """
    u = np.ascontiguousarray(u)
    mean, variance = np.empty_like(u), np.empty_like(u)
    _filter(u, coefficient, camera, random.share, random.density, mean, variance)
    return mean, variance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Noise:
    """The noise of one recording's pixels that see one surface: slow changes taken out, at unit variance.

    Parameters
    ----------
    u : (pixel, frame) float64
        Units of sigma; NaN where nothing is known of it.
    camera : (pixel,) float64
        As of `predicted_noise`.
    random : RandomValues
        In these pixels.
    scored : (pixel, frame) bool
        Samples that are part of the gain.
    """

    u: FloatArray
    camera: FloatArray
    random: RandomValues
    scored: BoolArray

    def gain(self, coefficient: float) -> float:
        """Gain, nats, by the samples before in the prediction of each sample."""
        return float(_gain(self.u, coefficient, self.camera, self.random.share, self.random.density, self.scored))

    def gain_at_own_widths(self, coefficient: float) -> float:
        """The same with the noise of each pixel as wide as is most likely, with a memory and without one."""
        own = _own_gain(self.u, coefficient, self.camera, self.random.share, self.random.density, self.scored)
        return float(own)

    def products(self, coefficient: float) -> tuple[float, float]:
        """Sums of squares of what tells the coefficient: the part of a sample that is new, times the sample before.

        First of its sums over the pixels of a frame, then of single samples: equal if pixels are independent.
        """
        told = np.where(self.scored, self.u, 0.0)
        before = np.zeros_like(told)
        before[:, 1:] = np.where(self.scored[:, 1:], self.u[:, :-1], 0.0)
        count = np.maximum(self.scored.sum(axis=1, keepdims=True), 1)
        power = (told**2).sum(axis=1, keepdims=True) / count  # of each pixel: no predicted width counts
        product = (told - coefficient * before) * before / np.maximum(power, _LEAST_POWER)
        product -= np.where(self.scored, product.sum() / max(int(self.scored.sum()), 1), 0.0)  # of another coefficient
        return float((product.sum(axis=0) ** 2).sum()), float((product**2).sum())


def _noises(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part) -> list[_Noise]:
    """The noise of each recording in the part's pixels; scored samples are in its frames and have a frame before."""
    return [_noise(z[view.frames], view.mixture, view.part) for view in views(likelihood, mixture, part)]


def _noise(z: Float32Array, mixture: Mixture, part: Part) -> _Noise:
    alone = one_surface(mixture, _ALONE)[part[1]]
    pixels = part[1][alone if alone.sum() * len(part[0]) >= _MANY_PAIRS else one_surface(mixture)[part[1]]]
    random = random_values(mixture, pixels)
    u = noise_of(z[:, pixels].astype(np.float64), random)
    good = np.abs(u) < _FAR
    for axis in (0, 1):  # slow changes: each pixel's mean, then each frame's
        mean = np.where(good, u, 0).sum(axis=axis, keepdims=True) / np.maximum(good.sum(axis=axis, keepdims=True), 1)
        u = u - mean
    good &= np.abs(u) < _FAR
    power = float((u**2)[good].sum()) / max(int(good.sum()), 1)
    u = np.where(good, u / math.sqrt(power) if power > _LEAST_POWER else 0.0, np.nan)
    wanted = np.zeros(len(z), dtype=bool)
    wanted[part[0]] = True
    scored = good & wanted[:, None]
    scored[0] = False
    scored[1:] &= good[:-1]
    turned, asked = np.ascontiguousarray(u.T), np.ascontiguousarray(scored.T)
    return _Noise(u=turned, camera=attenuation(mixture)[pixels], random=random, scored=asked)


def fit_memory(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part) -> float | None:
    """The most likely coefficient of a part's samples; None if too few samples have a frame before."""
    noises = _noises(likelihood, z, mixture, part)
    if sum(int(n.scored.sum()) for n in noises) < _LEAST_PAIRS or not any(np.nan_to_num(n.u).any() for n in noises):
        return None
    found = minimize_scalar(
        lambda rho: -sum(n.gain(rho) for n in noises), bounds=(-_MOST, _MOST), method="bounded", options={"xatol": 1e-4}
    )
    rho = float(found.x)
    rho += (1 + rho) * len(likelihood.evidence.starts) / len(z)  # Nickell's bias, of many pixels without their means
    return min(max(rho, -_MOST), _MOST)


def memory_gain(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part, coefficient: float) -> float:
    """Gain, nats, by earlier frames in the prediction of a part's samples; what pixels share counts once."""
    noises = _noises(likelihood, z, mixture, part)
    return sum(n.gain(coefficient) for n in noises) / _together(noises, coefficient)


def memory_gain_at_own_widths(
    likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part, coefficient: float
) -> float:
    """As `memory_gain`, with the noise of each pixel as wide as is most likely: it depends on no predicted width."""
    noises = _noises(likelihood, z, mixture, part)
    return sum(n.gain_at_own_widths(coefficient) for n in noises) / _together(noises, coefficient)


def _together(noises: Sequence[_Noise], coefficient: float) -> float:
    """How many samples count as one, as they are alike within a frame; 1 for pixels that are independent.

    The variance of the products of a frame's samples with those of the frame before, summed over pixels, over the sum
    of the pixels' own.

    References
    ----------
    Liang and Zeger, Biometrika 73 (1986) 13: errors of dependent samples by their clusters, here the frames. Chandler
    and Bate, Biometrika 94 (2007) 167: their likelihood.
    """
    by_frame, by_sample = (sum(part) for part in zip(*(n.products(coefficient) for n in noises), strict=True))
    return max(by_frame / by_sample, 1.0) if by_sample > 0 else 1.0


def memory_left(likelihood: Likelihood, state: ModelState, coefficient: float, seed: int) -> float:
    """Largest correlation of scores at any lag after a memory of one frame, minus four standard errors.

    Noise that is averaged over n frames keeps a correlation at lag n, for any coefficient.
    """
    mixture = likelihood.mixture(state)
    frames, pixels = (np.arange(n) for n in likelihood.evidence.shape)
    z = likelihood.scores(state, (frames, pixels), seed, mixture)
    return max(_left(z[v.frames], v.mixture, coefficient) for v in views(likelihood, mixture, (frames, pixels)))


def _left(z: Float32Array, mixture: Mixture, coefficient: float) -> float:
    flat = whitened(z, mixture, coefficient)[:, one_surface(mixture)]
    ok = np.isfinite(flat) & (np.abs(flat) < _FAR)
    for axis in (0, 1):  # means of pixels and of frames
        mean = np.where(ok, flat, 0).sum(axis=axis, keepdims=True) / np.maximum(ok.sum(axis=axis, keepdims=True), 1)
        flat = np.where(ok, flat - mean, 0)
    power = float((flat**2).sum(dtype=np.float64)) / max(int(ok.sum()), 1)
    most = 0.0
    for lag in range(1, min(_LAGS, len(flat) // 2) + 1):
        pairs, product = lag_product(flat, ok, lag)
        if pairs >= _LEAST_PAIRS and power > 0:
            most = max(most, abs(product) / (pairs * power) - 4 / math.sqrt(pairs))
    return most


def memory_error(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part, coefficient: float) -> float:
    """Standard error of the coefficient, by the curvature of the log-likelihood at each pixel's own width.

    What pixels share counts once.
    """
    noises = _noises(likelihood, z, mixture, part)
    middle = min(max(coefficient, -_MOST + _NUDGE), _MOST - _NUDGE)
    below, here, above = (sum(n.gain_at_own_widths(middle + step) for n in noises) for step in (-_NUDGE, 0.0, _NUDGE))
    curvature = (2 * here - below - above) / _NUDGE**2
    return math.sqrt(_together(noises, middle) / max(curvature, 1.0))


@borrowing
def _told(x: float, at: float, spread: float, camera: float, share: float, density: float) -> tuple[float, float]:
    """Mean and variance of the remembered noise once a sample is known, given those that were expected of it."""
    seen = math.sqrt(camera)
    width = camera * spread + 1 - camera
    off = x - seen * at
    noise = 1.0
    if share > 0:
        likely = (1 - share) * math.exp(-0.5 * off * off / width) / math.sqrt(width)
        noise = likely / (likely + share * density * _ROOT_TWO_PI + 1e-300)
    pull = seen * spread / width
    step = pull * off
    # of both cases together: mean, and variance within and between them
    return at + noise * step, spread - noise * pull * seen * spread + noise * (1 - noise) * step * step


@jit
def _filter(
    u: FloatArray,
    coefficient: float,
    camera: FloatArray,
    share: FloatArray,
    density: FloatArray,
    mean: FloatArray,
    variance: FloatArray,
) -> None:
    """Kalman's filter over the frames of u (frame, pixel); `mean` and `variance` are its predictions."""
    frames, pixels = u.shape
    for p in range(pixels):
        at, spread = 0.0, 1.0
        for t in range(frames):
            mean[t, p], variance[t, p] = math.sqrt(camera[p]) * at, camera[p] * spread + 1 - camera[p]
            if not math.isnan(u[t, p]):
                at, spread = _told(u[t, p], at, spread, camera[p], share[p], density[p])
            at, spread = coefficient * at, coefficient * coefficient * spread + 1 - coefficient * coefficient


@jit
def _gain(
    u: FloatArray, coefficient: float, camera: FloatArray, share: FloatArray, density: FloatArray, scored: BoolArray
) -> float:
    """Log-likelihood of the scored samples of u (pixel, frame) by the filter, less that without a memory."""
    pixels, frames = u.shape
    total = 0.0
    for p in range(pixels):
        stray = share[p] * density[p] * _ROOT_TWO_PI
        at, spread = 0.0, 1.0
        for t in range(frames):
            x = u[p, t]
            if scored[p, t]:
                width = camera[p] * spread + 1 - camera[p]
                off = x - math.sqrt(camera[p]) * at
                if share[p] > 0:
                    held = stray + (1 - share[p]) * math.exp(-0.5 * off * off / width) / math.sqrt(width)
                    bare = stray + (1 - share[p]) * math.exp(-0.5 * x * x)
                    total += math.log(held / bare)
                else:
                    total += 0.5 * (x * x - off * off / width - math.log(width))
            if not math.isnan(x):
                at, spread = _told(x, at, spread, camera[p], share[p], density[p])
            at, spread = coefficient * at, coefficient * coefficient * spread + 1 - coefficient * coefficient
    return total


@jit
def _own_gain(
    u: FloatArray, coefficient: float, camera: FloatArray, share: FloatArray, density: FloatArray, scored: BoolArray
) -> float:
    """As `_gain`, at the most likely width of each pixel, with a memory and without one.

    n samples of width s whose squares add up to s^2 S have the log-likelihood -n log s - S / 2, with its top at
    s^2 = S / n, so that the gain is n log(S / Q) / 2, less the logarithms of the predictions' widths, if Q are the
    squares about the predictions. A sample counts by the probability that it is noise.
    """
    pixels, frames = u.shape
    total = 0.0
    for p in range(pixels):
        stray = share[p] * density[p] * _ROOT_TWO_PI
        at, spread, count, bare, held, widths = 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
        for t in range(frames):
            x = u[p, t]
            if scored[p, t]:
                width = camera[p] * spread + 1 - camera[p]
                off = x - math.sqrt(camera[p]) * at
                likely = (1 - share[p]) * math.exp(-0.5 * off * off / width) / math.sqrt(width)
                noise = likely / (likely + stray) if share[p] > 0 else 1.0
                count += noise
                bare += noise * x * x
                held += noise * off * off / width
                widths += noise * math.log(width)
            if not math.isnan(x):
                at, spread = _told(x, at, spread, camera[p], share[p], density[p])
            at, spread = coefficient * at, coefficient * coefficient * spread + 1 - coefficient * coefficient
        if bare > _LEAST_POWER * count and held > _LEAST_POWER * count:
            total += 0.5 * (count * math.log(bare / held) - widths)
    return total


def inflation(likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part) -> FloatArray:
    """Factor (pixel,) by which the memory raises the variance of a pixel's mean over the part's frames; 1 without one.

    Two samples of a mixed pixel share the noise only if they are of the same surface.
    """
    return _inflation(likelihood, mixture, memory_of(state), part)


def _inflation(likelihood: Likelihood, mixture: Mixture, coefficient: float, part: Part) -> FloatArray:
    """As `inflation`, for a coefficient."""
    out = np.ones(likelihood.evidence.shape[1])
    if coefficient == 0:
        return out
    seen = [(_linked(view.part[0], coefficient), view) for view in views(likelihood, mixture, part)]
    frames = sum(view.part[0].size for _, view in seen)
    for linked, view in seen:
        m = view.mixture
        alike = (m.weight[0] ** 2).sum(axis=0) / np.maximum(m.weight[0].sum(axis=0), 1e-9) ** 2
        out += 2 * linked / frames * alike * cell_share(m).mean(axis=0)
    return out


def independent(likelihood: Likelihood, state: ModelState, alpha: float, seed: int) -> float:
    """Number of independent samples that a pixel's samples are worth for a mean, over their number.

    1 without a memory, and less with one: a pixel's samples resemble those before. Without a memory in the state, the
    one that the scores show counts, because held-out frames of a short recording may not show it.

    Parameters
    ----------
    likelihood, state
        The recordings, and the model with its effects.
    alpha : float
        Level at which a memory outside the state counts.
    seed : int
        Of the scores.
    """
    frames, pixels = likelihood.evidence.shape
    part = np.arange(frames), np.arange(pixels)[:: 1 + pixels // _SHOWING]
    mixture = likelihood.mixture(state)
    if not memory_of(state):
        z = likelihood.scores(state, part, seed, mixture)
        shown = fit_memory(likelihood, z, mixture, part)
        if shown is None or shown <= 0:
            return 1.0
        if memory_gain(likelihood, z, mixture, part, shown) < 0.5 * chdtri(1, alpha):
            return 1.0
    else:
        shown = memory_of(state)
    seen = (mixture.weight[0] * mixture.lit[0]).sum(axis=0)[part[1]] > 0  # of other pixels no sample is compared
    return 1.0 / float(np.median(_inflation(likelihood, mixture, shown, part)[part[1]][seen])) if seen.any() else 1.0


def _linked(frames: IntArray, coefficient: float) -> float:
    """Sum of the correlations of all pairs of frames."""
    total = before = 0.0
    for gap in np.diff(np.sort(frames)):
        before = (before + 1) * coefficient ** int(gap)
        total += before
    return total
