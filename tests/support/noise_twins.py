"""Twin of the kernel of `series`, all series at once, in NumPy: for where kernels run as plain Python.

`test_noise.py` holds the kernel against it; `conftest.py` puts it in the kernel's place with the JIT off: the limits of
shape alone are of tens of thousands of simulated series.
"""

import numpy as np
from numpy.typing import NDArray

from tofmix.compiled.robust import MAD_TO_SIGMA
from tofmix.estimation.noise.series import (
    CLIP_SIGMAS,
    LEAST_KEPT,
    LEAST_SAMPLES,
    TREND_DEGREES,
    SeriesStatistics,
)
from tofmix.estimation.samples import FARTHEST_MM

ROUNDS = 4


def series_statistics(samples: NDArray[np.float32], step: float) -> SeriesStatistics:
    """Statistics about a polynomial that is fitted to each series, again and again without what is far from it."""
    count, frames = samples.shape
    x = samples.astype(np.float64)
    there = np.abs(x) <= FARTHEST_MM
    valid = there.sum(axis=1)
    enough = np.flatnonzero(valid >= LEAST_SAMPLES)
    out = SeriesStatistics(valid, np.zeros(count, dtype=np.int64), *np.zeros((5, count)))
    time = 2.0 * np.arange(frames) / frames - 1.0
    degree_of = np.array([next((d for least, d in TREND_DEGREES if n >= least), 1) for n in valid])
    for degree in np.unique(degree_of[enough]):
        some = enough[degree_of[enough] == degree]
        order = np.argsort(~there[some], axis=1, kind="stable")  # those that there are, in their order, come first
        here, n = np.take_along_axis(there[some], order, 1), valid[some][:, None]
        powers = np.vander(time, degree + 1, increasing=True)[order]
        values = np.where(here, np.take_along_axis(x[some], order, 1), np.nan)
        centre = np.nanmedian(values, axis=1, keepdims=True)
        values, trend = values - centre, np.zeros(here.shape)
        for _ in range(ROUNDS):
            rest = values - trend
            away = np.abs(rest - np.nanmedian(rest, axis=1, keepdims=True))
            spread = MAD_TO_SIGMA * np.nanmedian(away, axis=1, keepdims=True)
            keep = here & (away <= np.maximum(CLIP_SIGMAS * spread * (1.0 + 5.0 / n), 2.0 * step))
            kept = powers * keep[..., None]
            normal = kept.swapaxes(1, 2) @ powers + 1e-9 * np.eye(degree + 1)
            right = kept.swapaxes(1, 2) @ np.where(keep, values, 0.0)[..., None]
            trend = (powers @ np.linalg.solve(normal, right))[..., 0]
        rest, left = np.where(keep, values - trend, 0.0), keep.sum(axis=1)
        m2, m3, m4 = ((rest**power).sum(axis=1) for power in (2, 3, 4))
        place = centre[:, 0] + np.nanmedian(np.where(keep, values, np.nan), axis=1)
        good = left >= np.maximum(degree + 3, LEAST_KEPT * valid[some])
        out.kept[some[good]], out.range_mm[some[good]] = left[good], place[good]
        out.variance[some[good]] = (m2 / (left - degree - 1))[good]
        good &= m2 > 0
        k, mean_square = some[good], (m2 / left)[good]
        out.skewness[k], out.kurtosis[k] = (m3 / left)[good] / mean_square**1.5, (m4 / left)[good] / mean_square**2
        out.memory[k] = ((rest[:, 1:] * rest[:, :-1]).sum(axis=1) / np.maximum(m2, 1e-300))[good]
    return out
