"""The memory of the noise: how strong it is, what it is worth, and what it does to means over frames."""

import math

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.joint import views
from tofmix.reconciliation.likelihood import Likelihood, Part, State
from tofmix.reconciliation.mixture import Mixture
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation

_MAIN, _ALONE = 0.95, 0.9995  # share of the beam
_STRONG = 0.7  # coefficient
_FAR = 5.0  # sigma: random values have no memory
_LEAST_PAIRS = 1000
_LAGS = 24  # frames

_Pairs = tuple[FloatArray, FloatArray, FloatArray]


def memory_of(state: State) -> float:
    """The coefficient of a state's memory; 0 where it has none."""
    return next((e.coefficient for e in state.linking if isinstance(e, TemporalCorrelation)), 0.0)


def whitened(z: Float32Array, mixture: Mixture, coefficient: float) -> Float32Array:
    """Scores (frame, pixel) given those of the frame before, where a pixel sees one surface.

    Whole mm add a noise that has no memory: the score of a sample of sigma s remembers its forerunner by
    rho s^2 / (s^2 + 1/12). A pixel that sees a little of another surface is left out, NaN, where memory is strong:
    its scores neither forget the last sample nor follow it.
    """
    rho = np.where(one_surface(mixture), coefficient * attenuation(mixture), 0.0).astype(np.float32)
    if abs(coefficient) > _STRONG:
        z = np.where(one_surface(mixture) & ~one_surface(mixture, _ALONE), np.float32(np.nan), z)
    before = np.vstack([np.full((1, z.shape[1]), np.nan, dtype=np.float32), z[:-1]])
    known = np.isfinite(before)
    return np.where(known, (z - rho * np.where(known, before, 0)) / np.sqrt(1 - rho**2), z).astype(np.float32)


def attenuation(mixture: Mixture) -> FloatArray:
    """Share (pixel,) of a score's variance that is the camera's, not that of whole mm."""
    cell = max(mixture.step, 1.0)
    sigma = mixture.of_main(mixture.sigma)
    return np.asarray(sigma**2 / (sigma**2 + cell**2 / 12))


def one_surface(mixture: Mixture, share: float = _MAIN) -> BoolArray:
    """Pixels (pixel,) that see one surface, of whose noise a score speaks and not of which surface was drawn."""
    return np.asarray(mixture.of_main(mixture.weight) > share * np.maximum(mixture.told, 1e-9))


def _pairs(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part) -> _Pairs:
    """Scores of a part's samples, those a frame before, and their attenuation; slow changes taken out."""
    found = [_pairs_of(z[view.frames], view.mixture, view.part) for view in views(likelihood, mixture, part)]
    now, before, near = (np.concatenate(values) for values in zip(*found, strict=True))
    return now, before, near


def _pairs_of(z: Float32Array, mixture: Mixture, part: Part) -> _Pairs:
    pixels = part[1][one_surface(mixture)[part[1]]]
    scores = z[:, pixels]
    ok = np.isfinite(scores)
    mean = np.nansum(scores, axis=0) / np.maximum(ok.sum(axis=0), 1)
    flat = np.where(ok, scores - mean, np.nan)
    count = np.maximum(np.isfinite(flat).sum(axis=1, keepdims=True), 1)
    flat = flat - np.nansum(flat, axis=1, keepdims=True) / count
    wanted = np.zeros(len(z), dtype=bool)
    wanted[part[0]] = True
    both = np.flatnonzero(wanted[1:] & wanted[:-1]) + 1
    now, before = flat[both], flat[both - 1]
    good = np.isfinite(now) & np.isfinite(before) & (np.abs(now) < _FAR) & (np.abs(before) < _FAR)
    near = np.broadcast_to(attenuation(mixture)[pixels], now.shape)
    return now[good].astype(np.float64), before[good].astype(np.float64), near[good]


def fit_memory(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part) -> TemporalCorrelation | None:
    """The correlation of neighbours in time."""
    now, before, near = _pairs(likelihood, z, mixture, part)
    if now.size < _LEAST_PAIRS:
        return None
    spread = float((now**2).mean() + (before**2).mean()) / 2
    if spread * float((near**2).sum()) == 0:
        return None
    rho = float((near * now * before).sum() / (near**2).sum()) / spread
    rho += (1 + rho) * len(likelihood.evidence.starts) / len(z)  # Nickell's bias: many pixels, each mean taken out
    return TemporalCorrelation(coefficient=min(max(rho, -0.98), 0.98))


def memory_gain(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part, coefficient: float) -> float:
    """Nats that the last frame's noise is worth for the prediction of the next."""
    now, before, near = _pairs(likelihood, z, mixture, part)
    spread = float((now**2).mean())
    rho = coefficient * near
    residual = (now - rho * before) ** 2 / (spread * (1 - rho**2))
    return float(0.5 * (now**2 / spread - residual - np.log(1 - rho**2)).sum())


def memory_left(likelihood: Likelihood, state: State, coefficient: float, seed: int) -> float:
    """Largest correlation of scores that a memory of one frame leaves, at any lag, less four standard errors of chance.

    Noise that is averaged over n frames is left with one at lag n, whatever the coefficient.
    """
    mixture = likelihood.mixture(state)
    frames, pixels = (np.arange(n) for n in likelihood.evidence.shape)
    z = likelihood.scores(state, (frames, pixels), seed, mixture)
    return max(_left(z[v.frames], v.mixture, coefficient) for v in views(likelihood, mixture, (frames, pixels)))


def _left(z: Float32Array, mixture: Mixture, coefficient: float) -> float:
    flat = whitened(z, mixture, coefficient)[:, one_surface(mixture)]
    ok = np.isfinite(flat) & (np.abs(flat) < _FAR)
    for axis in (0, 1):  # pixels' own means, and frames'
        mean = np.where(ok, flat, 0).sum(axis=axis, keepdims=True) / np.maximum(ok.sum(axis=axis, keepdims=True), 1)
        flat = np.where(ok, flat - mean, 0)
    power = float((flat**2).sum(dtype=np.float64)) / max(int(ok.sum()), 1)
    most = 0.0
    for lag in range(1, min(_LAGS, len(flat) // 4) + 1):
        pairs = int((ok[lag:] & ok[:-lag]).sum())
        if pairs >= _LEAST_PAIRS and power > 0:
            size = abs(float((flat[lag:] * flat[:-lag]).sum(dtype=np.float64))) / (pairs * power)
            most = max(most, size - 4 / math.sqrt(pairs))
    return most


def memory_error(likelihood: Likelihood, z: Float32Array, mixture: Mixture, part: Part) -> float:
    """Standard error of the coefficient."""
    _, _, near = _pairs(likelihood, z, mixture, part)
    return 1.0 / math.sqrt(max(float((near**2).sum()), 1.0))


def inflation(likelihood: Likelihood, mixture: Mixture, state: State, part: Part) -> FloatArray:
    """By how much the memory raises the variance (pixel,) of a pixel's mean over the part's frames; 1 without one.

    Two samples of a mixed pixel share a surface, and so the noise, by chance.
    """
    coefficient = memory_of(state)
    out = np.ones(likelihood.evidence.shape[1])
    if coefficient == 0:
        return out
    seen = [(_linked(view.part[0], coefficient), view) for view in views(likelihood, mixture, part)]
    frames = sum(view.part[0].size for _, view in seen)
    for linked, view in seen:
        m = view.mixture
        alike = (m.weight[0] ** 2).sum(axis=0) / np.maximum(m.weight[0].sum(axis=0), 1e-9) ** 2
        out += 2 * linked / frames * alike * attenuation(m)
    return out


def _linked(frames: IntArray, coefficient: float) -> float:
    """Sum of the correlations of all pairs of frames."""
    total = before = 0.0
    for gap in np.diff(np.sort(frames)):
        before = (before + 1) * coefficient ** int(gap)
        total += before
    return total
