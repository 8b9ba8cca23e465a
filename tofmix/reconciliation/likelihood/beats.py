"""Frames whose noise rises and falls with a period: the exposures of two cameras slide over each other.

The log-likelihood of each frame is computed once for a grid of added noises. A beat is then fitted to these curves,
which needs no samples. Its phase is estimated; `ModelState.disturbed` has the square of each frame's overlap.
"""

import math
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.effects.hidden import FrameChain

_SIZES = np.concatenate([[0.0], 2.0 ** np.arange(-2.0, 5.25, 0.5)])
"""Added noise of the grid, over the typical noise."""

_FINE = 60  # added noises of a frame's own estimate
_LEAST_PERIOD = 4.0  # frames: a shorter beat is one of single frames
_LEAST_PERIODS = 1.5  # in the recording: of fewer, nothing repeats
_FINER = 4  # frequencies for each that the recording's length separates
_PEAKS, _STARTS = 3, 4  # periods that are tried, and best starts from which a fit begins
_SHARES = (0.25, 0.5, 0.95)  # of the frames, where fits begin
_LOUD = (0.7, 1.0, 1.4)  # starts of the noise, over the largest of the frames' own estimates
_PHASES = 200  # that are tried, before finer ones
_BEYOND = 0.1  # least part of a beat's gain that noise in all frames does not reach
_NUDGES = np.array([0.02, 0.02, 0.002, 0.005])  # for curvature: share, log noise, log period, phase
_Beat = tuple[FrameChain, float]


class FrameNoise:
    """The log-likelihood of some frames by the noise that is added to each.

    Parameters
    ----------
    likelihood, mixture, state
        The recording, and the model without the noise.
    part : (frames, pixels)
        The samples.
    """

    def __init__(self, likelihood: Likelihood, mixture: Mixture, state: ModelState, part: Part) -> None:
        lit = mixture.of_main(mixture.lit).astype(bool)
        sigmas = mixture.of_main(mixture.sigma)
        self.sigma_mm = float(np.median(sigmas[lit] if lit.any() else sigmas))
        self.frame: IntArray = likelihood.evidence.frame_number[part[0]]
        frames = likelihood.evidence.shape[0]

        def value(size: float) -> FloatArray:
            added = np.full(frames, (size * self.sigma_mm) ** 2)
            values: FloatArray = likelihood.sums(mixture, state, part, variance=added).by_frame[part[0], 0]
            return values

        self._knots = np.log1p(_SIZES**2)
        self._pieces = CubicSpline(self._knots, np.stack([value(size) for size in _SIZES])).c

    def of(self, added_mm: FloatArray) -> FloatArray:
        """Log-likelihood of all frames (n,) for noises (n, frame), mm."""
        at = np.minimum(np.log1p((added_mm / self.sigma_mm) ** 2), self._knots[-1])
        piece = np.clip(np.searchsorted(self._knots, at, side="right") - 1, 0, self._knots.size - 2)
        cubic = self._pieces[:, piece, np.arange(self.frame.size)]
        x = at - self._knots[piece]
        return np.asarray((((cubic[0] * x + cubic[1]) * x + cubic[2]) * x + cubic[3]).sum(axis=-1))

    def of_beat(self, chain: FrameChain, phase: float) -> float:
        """Log-likelihood with a beat."""
        return float(self.of(chain.sigma_mm * chain.overlap(self.frame, phase)[None])[0])

    def own(self) -> FloatArray:
        """The most likely noise (frame,) of each frame by itself, mm."""
        at = np.linspace(0, self._knots[-1], _FINE)
        added = self.sigma_mm * np.sqrt(np.expm1(at))
        piece = np.clip(np.searchsorted(self._knots, at, side="right") - 1, 0, self._knots.size - 2)
        x = (at - self._knots[piece])[:, None]
        cubic = self._pieces[:, piece]
        return np.asarray(added[(((cubic[0] * x + cubic[1]) * x + cubic[2]) * x + cubic[3]).argmax(axis=0)])

    @property
    def alike(self) -> tuple[float, float]:
        """Log-likelihood without noise, and with the same noise in all frames."""
        each = self.of(np.repeat((self.sigma_mm * _SIZES)[:, None], self.frame.size, axis=1))
        return float(each[0]), float(each.max())


def fit_beat(noise: FrameNoise) -> _Beat | None:
    """The most likely beat and its phase; None if the same noise in all frames is nearly as likely, or nothing repeats.

    Starts are the strongest periods of the frames' own noise.
    """
    own = noise.own()
    if not own.any():
        return None
    starts = [
        (noise.of_beat(_beat(x), x[3]), x)
        for period, phase in _periods(noise.frame, own)
        for share in _SHARES
        for loud in _LOUD
        for x in [np.array([share, math.log(loud * own.max()), math.log(period), phase])]
    ]
    if not starts:
        return None
    starts.sort(key=lambda start: -start[0])
    options: Any = {"maxfev": 600, "xatol": 1e-4, "fatol": 0.02}

    def cost(x: FloatArray) -> float:
        return -noise.of_beat(_beat(x), x[3])

    ends = []
    for _, x in starts[:_STARTS]:
        simplex = np.vstack([x, x + np.diag([0.1, 0.2, 0.02, 0.05])])
        ends.append(minimize(cost, x, method="Nelder-Mead", options=options | {"initial_simplex": simplex}))
    best = min(ends, key=lambda end: end.fun)
    calm, loud = noise.alike
    gain = -float(best.fun) - calm
    longest = (float(np.ptp(noise.frame)) + 1) / _LEAST_PERIODS
    chain = _beat(best.x)
    if -best.fun - loud <= _BEYOND * gain or not _LEAST_PERIOD <= chain.period_frames <= longest:
        return None
    return chain, float(best.x[3])


def overlaps(noise: FrameNoise, chain: FrameChain) -> FloatArray:
    """Square (frame,) of each frame's overlap in a beat of unknown phase: the most likely one."""
    return np.asarray(chain.overlap(noise.frame, _phase(noise, chain)) ** 2)


def of_unknown_phase(noise: FrameNoise, chain: FrameChain) -> tuple[float, FloatArray]:
    """Log-likelihood with a beat whose phase is integrated out, and the square (frame,) of each frame's overlap.

    References
    ----------
    MacKay, Information Theory, Inference, and Learning Algorithms, chapter 27, for the volume about the likely phase.
    """
    phase, step = _phase(noise, chain), _NUDGES[3]
    here, *sides = (noise.of_beat(chain, phase + move) for move in (0.0, -step, step))
    curvature = (2 * here - sum(sides)) / step**2
    volume = min(math.sqrt(2 * math.pi / curvature), 1.0) if curvature > 0 else 1.0  # periods
    return here + math.log(volume), np.asarray(chain.overlap(noise.frame, phase) ** 2)


def _phase(noise: FrameNoise, chain: FrameChain) -> float:
    """The most likely phase of a beat, periods."""
    phase, step = 0.0, 1.0
    for count in (_PHASES, _FINE):
        tried = phase + step * np.linspace(-1, 1, count)
        added = chain.sigma_mm * chain.overlap(noise.frame, tried[:, None])
        phase, step = float(tried[int(noise.of(added).argmax())]), 2 * step / count
    return phase


def beat_errors(noise: FrameNoise, chain: FrameChain) -> tuple[FrameChain, tuple[float, float, float]]:
    """The beat that fits frames best, and the errors of share, noise and period, by the curvature; phase unknown.

    A share of 1 is at its bound: its error is 0.
    """
    chain, phase = fit_beat(noise) or (chain, _phase(noise, chain))
    x = np.array([chain.probability, math.log(chain.sigma_mm), math.log(chain.period_frames), phase])
    free = np.flatnonzero(np.array([chain.probability + _NUDGES[0] < 1.0, True, True, True]))
    unit = np.diag(_NUDGES)[free]

    def at(y: FloatArray) -> float:
        return noise.of_beat(_beat(y), y[3])

    drop = [[at(x + a - b) + at(x - a + b) - at(x + a + b) - at(x - a - b) for b in unit] for a in unit]
    curvature = np.array(drop) / 4 / np.outer(_NUDGES[free], _NUDGES[free])
    errors = np.zeros(x.size)
    errors[free] = np.sqrt(np.maximum(np.diag(np.linalg.pinv(curvature, hermitian=True)), 0.0))
    share, loud, period, _ = errors.tolist()
    return chain, (share, loud * chain.sigma_mm, period * chain.period_frames)


def _beat(x: FloatArray) -> FrameChain:
    share = min(max(float(x[0]), 0.02), 1.0)
    return FrameChain(share, math.exp(min(float(x[1]), 9.0)), 1.0, math.exp(min(max(float(x[2]), 0.7), 13.0)))


def _periods(frame: IntArray, own: FloatArray) -> list[tuple[float, float]]:
    """The strongest periods, frames, of a course over frames, each with its phase."""
    first, length = int(frame.min()), int(np.ptp(frame)) + 1
    placed = np.zeros(length)
    placed[frame - first] = own - own.mean()
    size = 1 << math.ceil(math.log2(_FINER * length))
    wave = np.fft.rfft(placed, size)
    frequency = np.arange(wave.size) / size
    power = np.where((frequency >= _LEAST_PERIODS / length) & (frequency <= 1 / _LEAST_PERIOD), np.abs(wave), 0.0)
    found = []
    for _ in range(_PEAKS):
        k = int(power.argmax())
        if power[k] <= 0:
            break
        found.append((1 / frequency[k], float(np.angle(wave[k])) / (2 * math.pi) - first * frequency[k]))
        power[max(k - _FINER, 0) : k + _FINER + 1] = 0.0
    return found
