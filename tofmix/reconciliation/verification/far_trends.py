"""Ranges that change in time by more than scores can show: something moves through the scene, or the camera does.

Scores end at four sigma, so a surface that comes 30 mm nearer with each frame looks like a bias of every later frame.
Use `far_trends` to place such a change. It takes medians of ranges, so random values do not matter.
"""

import math

import numpy as np
from scipy.stats import kruskal

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.comparison.compare import FARTHEST_SCORE, SMALLEST_P, Place
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState

_PARTS = 10  # of the time
_LEAST_FRAMES = 3  # of a part, for a median with a scatter
_PIXELS = 256  # enough for a median
_POLISHED = 30  # turns of the levels of pixels and frames


def far_trends(likelihood: Likelihood, state: ModelState, alpha: float) -> list[Place]:
    """The change in time of each recording whose ranges leave the reach of scores; none for most recordings.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        A model: the change is that of the differences from it.
    alpha : float
        Level of the test that parts of the time differ, after correction for the recordings.

    References
    ----------
    Kruskal and Wallis, J. American Statistical Association 47 (1952) 583.
    """
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    seen = list(views(likelihood, likelihood.mixture(state), whole))
    found = (_far_trend(view, alpha / len(seen)) for view in seen)
    return [place for place in found if place is not None]


def _far_trend(view: RecordingView, alpha: float) -> Place | None:
    medians, frames, sigma = _medians(view)
    parts = min(_PARTS, medians.size // _LEAST_FRAMES)
    if parts < 2:  # noqa: PLR2004  two parts of the time to compare
        return None
    part = np.arange(medians.size) * parts // medians.size
    level = np.array([np.median(medians[part == k]) for k in range(parts)])
    first, last = sorted((int(level.argmin()), int(level.argmax())))
    change = float(level[last] - level[first])
    if abs(change) < FARTHEST_SCORE * sigma:
        return None
    p = float(kruskal(*(medians[part == k] for k in range(parts))).pvalue)
    if not p < alpha:
        return None
    now = view.evidence.time_s[frames]
    return Place(
        axis="time",
        statistic="trend",
        interval=(float(now[part == first][0]), float(now[part == last][-1])),
        size=change,
        unit="mm",
        p_value=max(p, SMALLEST_P),
        z=abs(change) / sigma,
        recording=view.number,
    )


def _medians(view: RecordingView) -> tuple[FloatArray, IntArray, float]:
    """Median difference from the model of some frames, mm; the frames; and the typical sigma, mm.

    Each pixel has its own level, found together with those of the frames: it does not matter which pixels are valid
    when.

    References
    ----------
    Tukey, Exploratory Data Analysis, 1977, chapter 11: median polish.
    """
    m, samples = view.mixture, view.evidence.samples
    use = np.flatnonzero(m.of_main(m.lit))
    use = use[:: math.ceil(max(use.size, 1) / _PIXELS)]
    off = m.near_turn(samples[:, use] - m.of_main(m.mean)[use])
    away = np.where(samples[:, use] > 0, off, np.nan)
    some = np.isfinite(away).any(axis=1)
    if not some.any():
        return np.zeros(0), np.zeros(0, dtype=np.int64), math.inf
    away = away[some][:, np.isfinite(away).any(axis=0)]
    level = np.zeros(len(away))
    for _ in range(_POLISHED):
        own = np.nanmedian(away - level[:, None], axis=0)
        level = np.nanmedian(away - own, axis=1)
    return level, np.flatnonzero(some), float(np.median(m.of_main(m.sigma)[use]))
