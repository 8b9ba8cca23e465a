"""What all pixels of a recording do together, frame by frame: their level, a jump of it, and its jitter.

Use `frame_medians` for the level of each frame, in mm from medians, so that it has no reach as scores have. Use
`find_jump` and `jitter_mm` on it. A jump is one change within three frames, and no part of a smooth course: all courses
have one law of scatter. Each free number costs half the logarithm of the number of frames (BIC), and the frame of a
jump, one of as many, as much as two.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.found import ALIAS_NATS
from tofmix.reconciliation.likelihood.joint import RecordingView
from tofmix.reconciliation.likelihood.wander import frame_levels
from tofmix.simulation.measured_scene import LEAST_SAMPLES


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameMedians:
    """The median difference of frames from the model. Arrays are (frame,).

    Parameters
    ----------
    level_mm : measured minus predicted, mm; each pixel has its own level besides.
    error_mm : its standard error by the scatter of the frame's pixels, mm.
    frames : numbers of the frames.
    sigma_mm : typical standard deviation of a stored value, mm.
    """

    level_mm: FloatArray
    error_mm: FloatArray
    frames: IntArray
    sigma_mm: float


def frame_medians(view: RecordingView) -> FrameMedians:
    """The median difference of each frame from the model, of frames with a valid sample."""
    m, samples = view.mixture, view.evidence.samples
    use = np.flatnonzero(m.of_main(m.lit))
    pixels = 256  # enough for a median
    use = use[:: math.ceil(max(use.size, 1) / pixels)]
    off = m.near_turn(samples[:, use] - m.main_means(use))
    away = np.where(samples[:, use] > 0, off, np.nan)
    level = frame_levels(away)
    some = np.isfinite(level)
    if not some.any():
        none = np.zeros(0)
        return FrameMedians(level_mm=none, error_mm=none, frames=np.zeros(0, dtype=np.int64), sigma_mm=math.inf)
    away, level = away[some][:, np.isfinite(away).any(axis=0)] - level[some, None], level[some]
    cell = m.step / math.sqrt(12.0)  # medians of values on a grid are off by as much as single ones
    left = np.abs(away - np.nanmedian(away, axis=0))
    scatter = np.nanmedian(left, axis=1) / norm.ppf(0.75)
    count = np.isfinite(left).sum(axis=1)
    return FrameMedians(
        level_mm=level,
        error_mm=np.hypot(np.sqrt(0.5 * math.pi / count) * scatter, cell),
        frames=np.flatnonzero(some),
        sigma_mm=math.hypot(float(np.median(m.of_main(m.sigma)[use])), cell),
    )


class Jump(NamedTuple):
    """A sudden change of the ranges: the first frame after it, and the change in mm."""

    frame: int
    change_mm: float


def find_jump(found: FrameMedians, time_s: FloatArray) -> Jump | None:
    """The jump of the levels, if it is likelier than no change, than any smooth course and than two; None if not.

    Parameters
    ----------
    found : FrameMedians
        The levels.
    time_s : (frame,) float64
        Their times.
    """
    level, n = found.level_mm, found.level_mm.size
    if n < 2 * LEAST_SAMPLES:
        return None
    least = float(np.mean(found.error_mm**2))
    at = _best_step(level)
    jump = _evidence(level, _steps(n, at), 4, least)
    smooth = max(_evidence(level, columns, numbers, least) for columns, numbers in _smooth_courses(time_s, at))
    rest = level - _fitted(level, _steps(n, at))
    once_more = _evidence(level, np.column_stack([_steps(n, at), np.arange(n) >= _best_step(rest)]), 7, least)
    if jump < smooth + ALIAS_NATS or jump < once_more:
        return None
    return Jump(int(found.frames[at]), float(level[at:].mean() - level[:at].mean()))


def _steps(n: int, at: int) -> FloatArray:
    return np.column_stack([np.ones(n), np.arange(n) >= at])


def _best_step(level: FloatArray) -> int:
    """The first frame of the second part, where two means leave the least squares."""
    n = level.size
    before = np.arange(LEAST_SAMPLES, n - LEAST_SAMPLES + 1)
    total = np.cumsum(level)[before - 1]
    gain = (total - before * level.mean()) ** 2 / (before * (n - before))
    return int(before[gain.argmax()])


def _smooth_courses(time_s: FloatArray, at: int) -> Iterator[tuple[FloatArray, int]]:
    """Columns of smooth courses (frame, column), each with its free numbers: a constant, a way, a warm-up, a ramp."""
    n = time_s.size
    t = (time_s - time_s[0]) / max(float(time_s[-1] - time_s[0]), 1e-9)
    for degree in range(3):
        yield np.vander(t, degree + 1), degree + 1
    for constant in np.geomspace(1.0 / n, 1.0, 12):
        yield np.column_stack([np.ones(n), np.exp(-t / constant)]), 3
    half = 2.0  # frames: what takes less than four is a jump
    while half < n:
        yield np.column_stack([np.ones(n), np.clip((np.arange(n) - at + 0.5) / half, -1.0, 1.0)]), 5
        half *= 2.0


def _fitted(level: FloatArray, columns: FloatArray) -> FloatArray:
    return np.asarray(columns @ np.linalg.lstsq(columns, level, rcond=None)[0])


def _evidence(level: FloatArray, columns: FloatArray, numbers: int, least: float) -> float:
    """Log-likelihood, nats, with the price of the free numbers; levels scatter by their errors at least."""
    squares = float(((level - _fitted(level, columns)) ** 2).sum())
    variance = max(squares / level.size, least)
    return -0.5 * (level.size * math.log(variance) + squares / variance + numbers * math.log(level.size))


def jitter_mm(found: FrameMedians, alpha: float) -> float:
    """Standard deviation of the levels from frame to frame beyond their errors, mm; 0 if noise alone gives as much.

    From differences of consecutive frames, whose median no slow change, no jump and no burst of a few frames moves.

    Parameters
    ----------
    found : FrameMedians
        The levels.
    alpha : float
        Level of the test.
    """
    if found.level_mm.size <= LEAST_SAMPLES:
        return 0.0
    steps = np.diff(found.level_mm)
    differences = np.abs(steps - np.median(steps))  # without a steady way
    variance = 0.5 * (float(np.median(differences)) / norm.ppf(0.75)) ** 2
    noise = float(np.median(found.error_mm**2))
    relative = 2.0 * math.sqrt(1.5) * 1.17 / math.sqrt(differences.size)  # error of a squared median of differences
    if variance < noise * (1.0 + float(norm.isf(alpha)) * relative):
        return 0.0
    usual = differences[differences**2 < 2.0 * variance * norm.ppf(0.999) ** 2]  # a mean of squares is more precise
    return math.sqrt(max(0.5 * float(np.mean(usual**2)) - noise, 0.0))
