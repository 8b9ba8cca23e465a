"""How a stored range depends on independent ones, where a camera filters its ranges over time.

Each class is one filter: the independent samples that it leaves, the number of independent frames that its frames are
worth, and its effect on fitted layers. `tofmix.independent_samples` reads a recording by it;
`tofmix.estimation.filters` finds the filter of a recording. Noise with a memory is no filter: its pixels change from
one surface to another within a frame, and the memory is a part of the learnt noise.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Protocol

import numpy as np

from tofmix.arrays import Float32Array, FloatArray

MOST_WINDOW = 99
"""Longest window of a median or a mean, frames."""

_QUADRATURE = 200  # points of the integral of a part of a median's distribution


class TemporalFilter(Protocol):
    """A filter that acts on each pixel, frame by frame.

    Attributes
    ----------
    kind : str
        Its name in files.
    parameter : float
        Its number in files.
    reach : int
        Earlier stored frames that an independent sample needs.
    separates : bool
        Whether the independent samples are of one surface each; if not, pixels of several surfaces are undecided.
    """

    kind: ClassVar[str]
    separates: ClassVar[bool]

    @property
    def parameter(self) -> float:
        """Its number in files."""

    @property
    def reach(self) -> int:
        """Earlier stored frames that an independent sample needs."""

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """Independent samples (frame, ...) float32 in mm of stored ones; NaN where a frame adds none.

        `first` is the number of the first stored frame in the recording. The first `reach` frames may be NaN because
        earlier ones are missing.
        """

    def worth(self, frames: int) -> int:
        """Independent frames of the stored ranges' spread that tell as much as `frames` stored ones."""

    def words(self) -> str:
        """The filter in a few words."""


@dataclass(frozen=True, slots=True)
class ExponentialAverage:
    """y_t = a x_t + (1 - a) y_(t-1): its inverse gives every sample x_t again.

    Parameters
    ----------
    parameter : float
        a, the share of the new sample, in (0, 1).

    Raises
    ------
    ValueError
        If it is out of its bounds.
    """

    parameter: float
    kind: ClassVar[str] = "exponential_average"
    separates: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not 0 < self.parameter < 1:
            raise ValueError(f"temporal filter: the share of the new sample, {self.parameter:g}, is not in (0, 1)")

    @property
    def reach(self) -> int:
        """Earlier stored frames that an independent sample needs."""
        return 1

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:  # noqa: ARG002  any frame will do
        """x_t = y_(t-1) + (y_t - y_(t-1)) / a; NaN in the first frame, and after a lost sample."""
        out = np.full(stored_mm.shape, np.nan, dtype=np.float32)
        before = stored_mm[:-1].astype(np.float64)
        out[1:] = before + (stored_mm[1:] - before) / self.parameter
        return out

    def worth(self, frames: int) -> int:
        """The variance of a mean of AR(1) noise is (2 - a) / a times that of independent samples."""
        return max(1, round(frames * self.parameter / (2.0 - self.parameter)))

    def words(self) -> str:
        """The filter in a few words."""
        return f"exponential average, {self.parameter:.3g} of the new sample"


def _check_window(window: float, what: str) -> None:
    if not 2 <= window <= MOST_WINDOW or window != int(window):  # noqa: PLR2004  a window of one frame is no filter
        raise ValueError(f"temporal filter: {what} of {window:g} frames; expected 2 to {MOST_WINDOW}")


def _every(stored_mm: Float32Array, first: int, window: int) -> Float32Array:
    """One frame of each `window`: their windows have no sample in common."""
    out = np.full(stored_mm.shape, np.nan, dtype=np.float32)
    start = -first % window
    out[start::window] = stored_mm[start::window]
    return out


@dataclass(frozen=True, slots=True)
class RunningMedian:
    """y_t is the median of the last m samples: one frame of m is independent of the others.

    A median of odd m is one of the samples. Let F be the distribution of a sample; that of a median is
    I_F((m + 1) / 2, (m + 1) / 2), the regularised incomplete beta function. So the shares and ranges of surfaces follow
    from those of medians (`layers_of_samples`).

    Parameters
    ----------
    parameter : float
        m, odd, at least 3.

    Raises
    ------
    ValueError
        If it is not.
    """

    parameter: float
    kind: ClassVar[str] = "running_median"
    separates: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_window(self.parameter, "a median")
        if self.parameter % 2 == 0:
            raise ValueError(f"temporal filter: a median of {self.parameter:g} frames; expected an odd number")

    @property
    def window(self) -> int:
        """Frames of a median."""
        return int(self.parameter)

    @property
    def reach(self) -> int:
        """Earlier stored frames that an independent sample needs."""
        return 0

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """One median of each m."""
        return _every(stored_mm, first, self.window)

    def worth(self, frames: int) -> int:
        """Medians without a common sample."""
        return max(1, frames // self.window)

    def words(self) -> str:
        """The filter in a few words."""
        return f"median of {self.window}"

    def tie(self, lag: int) -> float:
        """Probability that medians `lag` frames apart are the same sample, for continuous samples.

        The sample is one of those that both windows hold, and has as many below it as above in each of them.
        """
        common, half = self.window - lag, (self.window - 1) // 2
        if common < 1:
            return 0.0
        total = 0.0
        for below in range(common):
            alone = half - below
            if 0 <= alone <= lag:
                ways = math.comb(common - 1, below) * math.comb(lag, alone) ** 2
                under = below + 2 * alone
                over = common - 1 - below + 2 * (lag - alone)
                total += ways * math.exp(math.lgamma(under + 1) + math.lgamma(over + 1) - math.lgamma(under + over + 2))
        return common * total

    def samples_shares(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shares of the samples, of which `shares` (pixel, n) of medians, near to far, follow; and their slopes.

        A slope is the change of a share with that of the medians: standard errors take it as a factor.
        """
        from scipy.special import betaincinv

        a = 0.5 * (self.window + 1)
        ends = np.clip(np.cumsum(shares, axis=1), 0.0, 1.0)
        whole = betaincinv(a, a, ends)
        whole[:, -1] = 1.0
        below = np.concatenate([np.zeros((len(shares), 1)), whole[:, :-1]], axis=1)
        inner = np.where((below > 0.0) & (below < 1.0), self._density(below), np.inf)
        outer = np.where((whole > 0.0) & (whole < 1.0), self._density(whole), np.inf)
        slope = 1.0 / np.minimum(inner, outer)
        return whole - below, np.where(slope > 0.0, slope, 1.0)

    def _density(self, share: FloatArray) -> FloatArray:
        """Density of the beta distribution of the medians' F."""
        half = (self.window - 1) // 2
        log_norm = math.lgamma(2 * half + 2) - 2.0 * math.lgamma(half + 1)
        return np.asarray(math.exp(log_norm) * (share * (1.0 - share)) ** half)

    def moments(self, below: float, above: float) -> tuple[float, float]:
        """Mean and sd, in sigmas of the samples, of medians in a surface with cumulated shares `below` to `above`."""
        return _moments(self.window, round(below, 3), round(above, 3))


@lru_cache(maxsize=4096)
def _moments(window: int, below: float, above: float) -> tuple[float, float]:
    from scipy.special import ndtri

    part = (np.arange(_QUADRATURE) + 0.5) / _QUADRATURE
    share = below + (above - below) * part
    weight = (share * (1.0 - share)) ** ((window - 1) // 2)
    z = ndtri(part)
    mean = float((weight * z).sum() / weight.sum())
    return mean, math.sqrt(float((weight * (z - mean) ** 2).sum() / weight.sum()))


@dataclass(frozen=True, slots=True)
class RunningMean:
    """y_t is the mean of the last m samples: one frame of m is independent, but may be of several surfaces.

    Its inverse is not stable, so that pixels of several surfaces are undecided.

    Parameters
    ----------
    parameter : float
        m, at least 2.

    Raises
    ------
    ValueError
        If it is not.
    """

    parameter: float
    kind: ClassVar[str] = "running_mean"
    separates: ClassVar[bool] = False

    def __post_init__(self) -> None:
        _check_window(self.parameter, "a mean")

    @property
    def reach(self) -> int:
        """Earlier stored frames that an independent sample needs."""
        return 0

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """One mean of each m."""
        return _every(stored_mm, first, int(self.parameter))

    def worth(self, frames: int) -> int:
        """Means without a common sample."""
        return max(1, frames // int(self.parameter))

    def words(self) -> str:
        """The filter in a few words."""
        return f"mean of {self.parameter:g}"


FILTERS: dict[str, type[ExponentialAverage] | type[RunningMedian] | type[RunningMean]] = {
    filter_.kind: filter_ for filter_ in (ExponentialAverage, RunningMedian, RunningMean)
}
"""Filters by their name in files."""


def make_filter(kind: str, parameter: float) -> TemporalFilter:
    """The filter of a kind.

    Raises
    ------
    ValueError
        If the kind is not known, or the parameter is out of its bounds.
    """
    if kind not in FILTERS:
        raise ValueError(f"temporal filter: {kind!r} is not known; known: {', '.join(FILTERS)}")
    return FILTERS[kind](parameter)
