"""How a stored range depends on independent ones, where a camera filters its ranges over time.

Each class is one filter: the independent samples that it leaves, the number of independent frames that its frames are
worth, and its effect on fitted layers. `tofmix.recording` reads a recording by it;
`tofmix.estimation.filters` finds the filter of a recording. Noise with a memory is no filter: its pixels change from
one surface to another within a frame, and the memory is a part of the learnt noise.
"""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise, product
from typing import ClassVar, Protocol, Self

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray

SPAN_FRAMES = 100
"""About the frames of a span of running means: many a chain, few for the rounding of stored ranges to add up."""

_SPAN_WINDOWS = 12  # windows of a span at least: a chain's samples tell where it is
_DRAWN_FRAMES, _DRAWN_PIXELS, _SEED = 100, 4000, 20080922  # of the dependence of seen samples
_QUANTILES = 2001  # of the distribution of seen samples


class SampleNoise(Protocol):
    """Noise of samples before any filter, such as a `tofmix.sensor.NoiseCurve`."""

    def sigma(self, range_mm: FloatArray) -> FloatArray:
        """Sd of a sample at ranges of any shape, mm."""

    def scaled(self, factor: float) -> Self:
        """The same with every sd times `factor`."""


class TemporalFilter(Protocol):
    """A filter that acts on each pixel, frame by frame.

    Attributes
    ----------
    kind : str
        Its name in files.
    parameter : float
        Its number in files.
    keeps_values : bool
        Whether independent samples are stored values, and need no other frame.
    blends : bool
        Whether a stored range is of several samples.
    """

    keeps_values: ClassVar[bool]
    blends: ClassVar[bool]

    @property
    def kind(self) -> str:
        """Its name in files."""

    @property
    def parameter(self) -> float:
        """Its number in files."""

    @property
    def further(self) -> dict[str, float]:
        """Its other numbers in files, by the names that `make_filter` gives them."""

    @property
    def median(self) -> "RunningMedian | ApartMedians | None":
        """The median whose samples `independent` gives; None where those before any filter are given."""

    def spans(self, first: int, last: int, frames: int) -> list[slice]:
        """Stored frames of a recording of `frames` that have the samples of frames `first` to `last` - 1.

        Consecutive spans, of which each is given to `independent` by itself.
        """

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """Independent samples (frame, ...) float32 in mm of the stored ones of a span; NaN where a frame adds none.

        `first` is the number of the span's first frame in the recording.
        """

    def rounding_mm(self, step_mm: float) -> float:
        """Sd that a step of the stored ranges adds to independent samples, beyond the rounding of stored ones."""

    def for_noise(self) -> "TemporalFilter":
        """The filter by which noise is learnt: its samples have no memory, and may be fewer."""

    def with_noise(self, curve: SampleNoise | None) -> "TemporalFilter":
        """The filter, for samples whose noise before any filter is known."""

    def frames_apart(self) -> int:
        """Frames from one stored range to the next that shares nothing with it, or next to nothing."""

    def worth(self, frames: int) -> int:
        """Independent frames of the stored ranges' spread that tell as much as `frames` stored ones."""

    def words(self) -> str:
        """The filter in a few words."""


@dataclass(frozen=True, slots=True)
class ExponentialAverage:
    """y_t = a x_t + (1 - a) y_(t-1): its inverse gives every sample x_t again.

    A camera may take a jump at once: y_t = x_t where x_t is farther than a threshold d from y_(t-1). Then no step
    y_t - y_(t-1) is between a d and d, so that its length tells which it was.

    Parameters
    ----------
    parameter : float
        a, the share of the new sample, in (0, 1).
    threshold_mm : float
        d, above 0; infinite where no jump is taken at once.

    Raises
    ------
    ValueError
        If one is out of its bounds.
    """

    parameter: float
    threshold_mm: float = math.inf
    kind: ClassVar[str] = "exponential_average"
    keeps_values: ClassVar[bool] = False
    blends: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not 0 < self.parameter < 1:
            raise ValueError(f"temporal filter: the share of the new sample, {self.parameter:g}, is not in (0, 1)")
        if not self.threshold_mm > 0:
            raise ValueError(f"temporal filter: the jump taken at once, {self.threshold_mm:g} mm, is not above 0")

    @property
    def resets(self) -> bool:
        """Whether jumps are taken at once."""
        return math.isfinite(self.threshold_mm)

    @property
    def edge_mm(self) -> float:
        """Length of a step y_t - y_(t-1) from which on it is a jump: amid a d and d, rounding changes it least."""
        return math.sqrt(self.parameter) * self.threshold_mm

    @property
    def further(self) -> dict[str, float]:
        """The jump that is taken at once."""
        return {"threshold_mm": self.threshold_mm} if self.resets else {}

    @property
    def median(self) -> None:
        """No median."""
        return None

    def spans(self, first: int, last: int, frames: int) -> list[slice]:  # noqa: ARG002  it does not matter
        """The frames themselves and the one before."""
        return [slice(max(first - 1, 0), last)]

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:  # noqa: ARG002  any frame will do
        """x_t = y_(t-1) + (y_t - y_(t-1)) / a; NaN in the first frame, and after a lost sample."""
        out = np.full(stored_mm.shape, np.nan, dtype=np.float32)
        before = stored_mm[:-1].astype(np.float64)
        step = stored_mm[1:] - before
        averaged = before + step / self.parameter
        out[1:] = np.where(np.abs(step) > self.edge_mm, stored_mm[1:], averaged)
        return out

    def for_noise(self) -> TemporalFilter:
        """Noise is learnt from the same samples."""
        return self

    def rounding_mm(self, step_mm: float) -> float:
        """Sd that a step of the stored ranges adds to independent samples: their inverse enlarges its rounding."""
        return step_mm / math.sqrt(12.0) * math.hypot(1.0, 1.0 - self.parameter) / self.parameter

    def with_noise(self, curve: SampleNoise | None) -> Self:  # noqa: ARG002  its samples do not depend on noise
        """The same filter."""
        return self

    def frames_apart(self) -> int:
        """Frames in which the share of an older sample falls to next to nothing."""
        return _frames_to_forget(1.0 - self.parameter)

    def worth(self, frames: int) -> int:
        """The variance of a mean of AR(1) noise is (2 - a) / a times that of independent samples."""
        return max(1, round(frames * self.parameter / (2.0 - self.parameter)))

    def words(self) -> str:
        """The filter in a few words."""
        at_once = f", jumps of more than {self.threshold_mm:.3g} mm at once" if self.resets else ""
        return f"exponential average, {self.parameter:.3g} of the new sample{at_once}"


def _frames_to_forget(kept: float) -> int:
    """Frames in which a correlation that falls by a factor a frame is next to nothing."""
    least = 0.05  # a correlation that is next to nothing
    return max(2, math.ceil(math.log(least) / math.log(kept)))


def _check_window(window: float, what: str) -> None:
    most_window = 99  # longest window of a median or a mean, frames
    if not 2 <= window <= most_window or window != int(window):  # noqa: PLR2004  a window of one frame is no filter
        raise ValueError(f"temporal filter: {what} of {window:g} frames; expected 2 to {most_window}")


@dataclass(frozen=True, slots=True)
class RunningMedian:
    """y_t is the median of the last m samples: the values that differ are samples, each taken once.

    A sample at the quantile u of its distribution F is a median where, in one of the m windows that hold it, as many
    samples are below it as above. Others are below it with probability u, independently: this gives the probability
    q(u) that the sample is seen (`seen`), and seen samples have the density q(F(x)) f(x) over the integral of q. So
    the shares and ranges of surfaces follow from those of seen samples (`shares_of_samples`, `moments`).

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
    keeps_values: ClassVar[bool] = False
    blends: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_window(self.parameter, "a median")
        most_median = 9  # longest window of a median, frames: the arrangements of its neighbours are counted one by one
        if self.parameter % 2 == 0 or self.parameter > most_median:
            raise ValueError(
                f"temporal filter: a median of {self.parameter:g} frames; expected an odd number up to {most_median}"
            )

    @property
    def window(self) -> int:
        """Frames of a median."""
        return int(self.parameter)

    @property
    def further(self) -> dict[str, float]:
        """No other number."""
        return {}

    @property
    def median(self) -> Self:
        """The filter itself."""
        return self

    def spans(self, first: int, last: int, frames: int) -> list[slice]:  # noqa: ARG002  it does not matter
        """The frames themselves and m - 1 before."""
        return [slice(max(first - self.window + 1, 0), last)]

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:  # noqa: ARG002  any frame will do
        """The medians that differ from those of the m - 1 frames before."""
        repeated = np.zeros(stored_mm.shape, dtype=np.bool_)
        for lag in range(1, self.window):
            repeated[lag:] |= stored_mm[lag:] == stored_mm[:-lag]
        return np.where(repeated, np.float32(np.nan), stored_mm)

    def rounding_mm(self, step_mm: float) -> float:  # noqa: ARG002  samples are stored ones
        """No more than that of stored ranges."""
        return 0.0

    def for_noise(self) -> TemporalFilter:
        """One median of each m, of no common sample: seen samples have a memory."""
        return ApartMedians(self.parameter)

    def with_noise(self, curve: SampleNoise | None) -> Self:  # noqa: ARG002  its samples do not depend on noise
        """The same filter."""
        return self

    def frames_apart(self) -> int:
        """Its window."""
        return max(2, math.ceil(self.parameter))

    def worth(self, frames: int) -> int:
        """Samples that are seen in so many frames."""
        return max(1, round(frames * float(_cumulated(self)[-1])))

    def words(self) -> str:
        """The filter in a few words."""
        return f"median of {self.window}"

    def tie(self, lag: int) -> float:
        """Probability that medians `lag` frames apart are the same sample, for continuous samples.

        The sample is one of those that both windows hold, and has as many below it as above in each of them.
        """
        common, half = self.window - lag, (self.window - 1) // 2
        total = 0.0
        for below in range(max(common, 0)):
            alone = half - below
            if 0 <= alone <= lag:
                ways = math.comb(common - 1, below) * math.comb(lag, alone) ** 2
                under = below + 2 * alone
                over = common - 1 - below + 2 * (lag - alone)
                total += ways * math.exp(math.lgamma(under + 1) + math.lgamma(over + 1) - math.lgamma(under + over + 2))
        return common * total

    def returns(self) -> float:
        """Probability that a median is that of two frames before, and not that of the frame before."""
        return _returns(self)

    def seen(self, quantile: FloatArray) -> FloatArray:
        """Probability q(u) that a sample at a quantile u of its distribution is a median."""
        u = np.asarray(quantile, dtype=np.float64)
        others = 2 * self.window - 2
        return np.asarray(
            sum(ways * u**below * (1.0 - u) ** (others - below) for below, ways in enumerate(_seen_ways(self.window)))
        )

    def shares_of_samples(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shares of samples (pixel, n), near to far, from those of seen samples; and their slopes.

        A slope is the change of a share with that of seen samples: standard errors take it as a factor.
        """
        return _shares_of_samples(self, shares)

    def moments(self, below: float, above: float) -> tuple[float, float]:
        """Mean and sd of a surface's seen samples in its sigmas; shares before and with it are `below` and `above`."""
        return _moments(self, round(below, 3), round(above, 3))

    def dependence(self) -> float:
        """Variance of the mean of seen samples of one surface, over that of as many independent samples of their sd.

        Seen samples are different samples, but neighbours among them are seen for the same reason.
        """
        return _dependence(self)


@lru_cache(maxsize=8)
def _seen_ways(window: int) -> tuple[int, ...]:
    """Number of arrangements of the 2 m - 2 neighbours of a sample in which it is a median, by how many are below."""
    ways = [0] * (2 * window - 1)
    for arrangement in product((0, 1), repeat=2 * window - 2):
        if any(2 * sum(arrangement[k : k + window - 1]) == window - 1 for k in range(window)):
            ways[sum(arrangement)] += 1
    return tuple(ways)


@lru_cache(maxsize=8)
def _cumulated(median: "RunningMedian | ApartMedians") -> FloatArray:
    """Integral of `seen` from 0 to each of evenly spaced quantiles up to 1."""
    edges = np.linspace(0.0, 1.0, _QUANTILES)
    middle = median.seen(0.5 * (edges[1:] + edges[:-1]))
    return np.concatenate([[0.0], np.cumsum(middle) / (_QUANTILES - 1)])


def _shares_of_samples(median: "RunningMedian | ApartMedians", shares: FloatArray) -> tuple[FloatArray, FloatArray]:
    cumulated = _cumulated(median)
    quantiles = np.linspace(0.0, 1.0, len(cumulated))
    ends = np.interp(np.cumsum(shares, axis=1), cumulated / cumulated[-1], quantiles)
    ends[:, -1] = 1.0
    below = np.concatenate([np.zeros((len(shares), 1)), ends[:, :-1]], axis=1)
    inner, outer = (
        np.where((end > 0.0) & (end < 1.0), median.seen(end) / cumulated[-1], np.inf) for end in (below, ends)
    )
    slope = 1.0 / np.minimum(inner, outer)
    return ends - below, np.where(slope > 0.0, slope, 1.0)


def _drawn_medians(median: RunningMedian) -> Float32Array:
    """Running medians (frame, pixel) of drawn samples."""
    rng = np.random.default_rng(_SEED)
    drawn = rng.standard_normal((_DRAWN_FRAMES, _DRAWN_PIXELS)).astype(np.float32)
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(drawn, median.window, axis=0), axis=-1))


@lru_cache(maxsize=8)
def _returns(median: RunningMedian) -> float:
    medians = _drawn_medians(median)
    return float(np.mean((medians[2:] == medians[:-2]) & (medians[1:-1] != medians[:-2])))


@lru_cache(maxsize=8)
def _dependence(median: RunningMedian) -> float:
    medians = _drawn_medians(median)
    seen = median.independent(medians, 0)
    return float(np.nanmean(seen, axis=0).var() * np.isfinite(seen).sum(axis=0).mean() / np.nanvar(seen))


@lru_cache(maxsize=4096)
def _moments(median: "RunningMedian | ApartMedians", below: float, above: float) -> tuple[float, float]:
    from scipy.special import ndtri

    quadrature = 200  # points of the integral over a surface's samples
    part = (np.arange(quadrature) + 0.5) / quadrature
    weight, z = median.seen(below + (above - below) * part), ndtri(part)
    mean = float((weight * z).sum() / weight.sum())
    return mean, math.sqrt(float((weight * (z - mean) ** 2).sum() / weight.sum()))


@lru_cache(maxsize=1)
def _normal_values() -> FloatArray:
    """Standard normal values, from which samples of rounded means are drawn."""
    return np.random.default_rng(_SEED).standard_normal(20_011)  # a prime: no place repeats soon


@dataclass(frozen=True, slots=True)
class ApartMedians:
    """One median of each m, whose noise is that of the median of m independent samples (`RunningMedian.for_noise`).

    The others share samples with it.

    Parameters
    ----------
    parameter : float
        m.
    """

    parameter: float
    kind: ClassVar[str] = "apart_medians"
    keeps_values: ClassVar[bool] = True
    blends: ClassVar[bool] = True

    @property
    def further(self) -> dict[str, float]:
        """No other number."""
        return {}

    @property
    def median(self) -> Self:
        """The filter itself."""
        return self

    def spans(self, first: int, last: int, frames: int) -> list[slice]:  # noqa: ARG002  it does not matter
        """The frames themselves."""
        return [slice(first, last)]

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """One frame of each m."""
        window = int(self.parameter)
        out = np.full(stored_mm.shape, np.nan, dtype=np.float32)
        out[-first % window :: window] = stored_mm[-first % window :: window]
        return out

    def rounding_mm(self, step_mm: float) -> float:  # noqa: ARG002  samples are stored ones
        """No more than that of stored ranges."""
        return 0.0

    def for_noise(self) -> Self:
        """Noise is learnt from the same samples."""
        return self

    def with_noise(self, curve: SampleNoise | None) -> Self:  # noqa: ARG002  its samples do not depend on noise
        """The same filter."""
        return self

    def frames_apart(self) -> int:
        """Its window."""
        return max(2, math.ceil(self.parameter))

    def worth(self, frames: int) -> int:
        """Frames without a common sample."""
        return max(1, frames // int(self.parameter))

    def words(self) -> str:
        """The filter in a few words."""
        return f"median of {self.parameter:g}"

    def sd(self) -> float:
        """Sd of a median of m Gaussian samples of sd 1."""
        from scipy.special import ndtri

        u = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
        weight = self.seen(u)
        return math.sqrt(float((weight * ndtri(u) ** 2).sum() / weight.sum()))

    def seen(self, quantile: FloatArray) -> FloatArray:
        """Density of a median at a quantile of the samples' distribution, over a constant."""
        u = np.asarray(quantile, dtype=np.float64)
        return np.asarray((4.0 * u * (1.0 - u)) ** ((int(self.parameter) - 1) // 2))

    def shares_of_samples(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shares of samples (pixel, n), near to far, from those of medians; and their slopes."""
        return _shares_of_samples(self, shares)

    def moments(self, below: float, above: float) -> tuple[float, float]:
        """Mean and sd of a surface's medians in its sigmas; shares before and with it are `below` and `above`."""
        return _moments(self, round(below, 3), round(above, 3))

    def dependence(self) -> float:
        """No two have a common sample."""
        return 1.0


@dataclass(frozen=True, slots=True)
class RunningMean:
    """y_t is the mean of the last m samples: x_t = x_(t-m) + m (y_t - y_(t-1)).

    The m - 1 samples that the first ones follow from are those with which all have the same density
    (`tofmix.compiled.running_mean`). They are sought in each span of frames by itself, so that the rounding of y adds
    up over few frames; what it leaves unknown is drawn, from the same values for the same means.

    Parameters
    ----------
    parameter : float
        m, at least 2.
    noise : SampleNoise, optional
        That of samples. Without it each pixel's own is told by its means, and rounding hides a part of it.

    Raises
    ------
    ValueError
        If m is below 2.
    """

    parameter: float
    noise: SampleNoise | None = field(default=None, compare=False)
    kind: ClassVar[str] = "running_mean"
    keeps_values: ClassVar[bool] = False
    blends: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_window(self.parameter, "a mean")

    @property
    def window(self) -> int:
        """Frames of a mean."""
        return int(self.parameter)

    @property
    def further(self) -> dict[str, float]:
        """No other number."""
        return {}

    @property
    def median(self) -> None:
        """No median."""
        return None

    def spans(self, first: int, last: int, frames: int) -> list[slice]:
        """Spans of equal length, about `SPAN_FRAMES` or so many windows."""
        return _even_spans(first, last, frames, max(SPAN_FRAMES, _SPAN_WINDOWS * self.window))

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:  # noqa: ARG002  any frame will do
        """Samples by their differences; NaN in runs of valid means that do not tell them."""
        return self.likeliest(stored_mm, only_sure=True)

    def likeliest(self, stored_mm: Float32Array, *, only_sure: bool = False) -> Float32Array:
        """The same, in all but the shortest runs: also where others are as likely."""
        from tofmix.compiled.running_mean import samples_of_means

        frames, *image = stored_mm.shape
        means = np.ascontiguousarray(stored_mm.reshape(frames, -1).T, dtype=np.float64)
        return (
            samples_of_means(means, self.window, only_sure, _normal_values(), self._noise_mm(means))
            .T.astype(np.float32)
            .reshape(frames, *image)
        )

    def _noise_mm(self, means: FloatArray) -> FloatArray:
        """Sd of a sample (pixel,) at the mean of the valid means (pixel, frame); 0 where it is not known."""
        if self.noise is None:
            return np.zeros(len(means))
        valid = np.isfinite(means)
        at = np.where(valid, means, 0.0).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
        return self.noise.sigma(at)

    def with_noise(self, curve: SampleNoise | None) -> Self:
        """Samples are drawn with this noise."""
        return replace(self, noise=curve)

    def rounding_mm(self, step_mm: float) -> float:  # noqa: ARG002  their rounding is integrated out
        """None: samples of rounded means are drawn with the noise of samples."""
        return 0.0

    def for_noise(self) -> TemporalFilter:
        """Noise is learnt from the same samples."""
        return self

    def frames_apart(self) -> int:
        """Its window."""
        return max(2, math.ceil(self.parameter))

    def worth(self, frames: int) -> int:
        """Frames without a common sample."""
        return max(1, frames // self.window)

    def words(self) -> str:
        """The filter in a few words."""
        return f"mean of {self.parameter:g}"


@dataclass(frozen=True, slots=True)
class AveragedMedians:
    """An average of running medians: its inverse gives the medians again, of which one in m is taken.

    Parameters
    ----------
    average : ExponentialAverage or RunningMean
        The average.
    window : int
        m, odd, at least 3.

    Raises
    ------
    ValueError
        If the window is not.
    """

    average: ExponentialAverage | RunningMean
    window: int
    keeps_values: ClassVar[bool] = False
    blends: ClassVar[bool] = True

    def __post_init__(self) -> None:
        RunningMedian(float(self.window))  # refuses others

    @property
    def kind(self) -> str:
        """That of the average."""
        return self.average.kind

    @property
    def parameter(self) -> float:
        """That of the average."""
        return self.average.parameter

    @property
    def median(self) -> ApartMedians:
        """The medians that are taken."""
        return ApartMedians(float(self.window))

    @property
    def further(self) -> dict[str, float]:
        """Those of the average, and the window of the median."""
        return self.average.further | {"median": float(self.window)}

    def spans(self, first: int, last: int, frames: int) -> list[slice]:
        """Those of the average."""
        return self.average.spans(first, last, frames)

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """One median of each m, by the inverse of the average."""
        return self.median.independent(self.average.independent(stored_mm, first), first)

    def rounding_mm(self, step_mm: float) -> float:
        """That of the average."""
        return self.average.rounding_mm(step_mm)

    def for_noise(self) -> TemporalFilter:
        """Noise is learnt from the same samples."""
        return self

    def with_noise(self, curve: SampleNoise | None) -> Self:
        """The average has the noise of medians."""
        of_medians = None if curve is None else curve.scaled(self.median.sd())
        return replace(self, average=self.average.with_noise(of_medians))

    def frames_apart(self) -> int:
        """Those of the average, and of the samples of a median."""
        return self.average.frames_apart() + self.window - 1

    def worth(self, frames: int) -> int:
        """Medians without a common sample."""
        return max(1, frames // self.window)

    def words(self) -> str:
        """The filter in a few words."""
        return f"median of {self.window}, then {self.average.words()}"


@dataclass(frozen=True, slots=True)
class HeldValues:
    """y_t is y_(t-1) with probability s, and else a new sample: a driver that is read faster than the camera measures.

    A stored value that equals the one before is a new sample of a value of probability p with probability
    (1 - s) p / (s + (1 - s) p). As many of these are kept in each span of frames, evenly spaced: without them, the
    samples of ranges on coarse steps would spread too widely. p follows from the samples of the pixel in that span, by
    expectation-maximisation.

    Parameters
    ----------
    parameter : float
        s, in (0, 1).

    Raises
    ------
    ValueError
        If it is out of its bounds.
    """

    parameter: float
    kind: ClassVar[str] = "held_values"
    keeps_values: ClassVar[bool] = True
    blends: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not 0 < self.parameter < 1:
            raise ValueError(f"temporal filter: the share of held values, {self.parameter:g}, is not in (0, 1)")

    @property
    def further(self) -> dict[str, float]:
        """No other number."""
        return {}

    @property
    def median(self) -> None:
        """No median."""
        return None

    def spans(self, first: int, last: int, frames: int) -> list[slice]:
        """Spans of equal length, about `SPAN_FRAMES`: the same for any frames that are read."""
        return _even_spans(first, last, frames, SPAN_FRAMES)

    def independent(self, stored_mm: Float32Array, first: int) -> Float32Array:
        """The new samples. Of a span's first frame it is not known whether they are, but in the first span."""
        flat = stored_mm.reshape(len(stored_mm), -1)
        repeats = np.zeros(flat.shape, dtype=np.bool_)
        repeats[1:] = flat[1:] == flat[:-1]
        taken = np.isfinite(flat) & (~repeats | self._kept(flat, repeats))
        taken[0] &= first == 0
        return np.where(taken, flat, np.float32(np.nan)).reshape(stored_mm.shape)

    def _kept(self, flat: Float32Array, repeats: BoolArray) -> BoolArray:
        """Repeats (frame, pixel) that stand for those by chance."""
        if not repeats.any():
            return repeats
        rounds = 8  # of expectation-maximisation: p of a value that fills half of the samples is right to 1 %
        value, new, share = _equal_values(flat), (np.isfinite(flat) & ~repeats).astype(np.float64), self.parameter
        chance = np.zeros(flat.shape)
        for _ in range(rounds):
            drawn = new + chance
            of_value = np.bincount(value.ravel(), drawn.ravel())[value]
            others = np.maximum(drawn.sum(axis=0) - 1.0, 1.0)
            p = np.clip((of_value - 1.0) / others, 0.0, 1.0)  # another sample's chance to have this value
            chance = np.where(repeats, (1.0 - share) * p / (share + (1.0 - share) * p), 0.0)
        return np.diff(np.rint(np.cumsum(chance, axis=0)), axis=0, prepend=0.0) > 0.0

    def rounding_mm(self, step_mm: float) -> float:  # noqa: ARG002  samples are stored ones
        """No more than that of stored ranges."""
        return 0.0

    def for_noise(self) -> TemporalFilter:
        """Noise is learnt from the same samples."""
        return self

    def with_noise(self, curve: SampleNoise | None) -> Self:  # noqa: ARG002  its samples do not depend on noise
        """The same filter."""
        return self

    def frames_apart(self) -> int:
        """Frames in which the share of an older sample falls to next to nothing."""
        return _frames_to_forget(self.parameter)

    def worth(self, frames: int) -> int:
        """New samples in so many frames."""
        return max(1, round(frames * (1.0 - self.parameter)))

    def words(self) -> str:
        """The filter in a few words."""
        return f"{100.0 * self.parameter:.0f} % of the values held"


def _equal_values(flat: Float32Array) -> IntArray:
    """A number for each value of each pixel (frame, pixel); those of different pixels differ."""
    order = np.argsort(flat, axis=0, kind="stable")
    differs = np.diff(np.take_along_axis(flat, order, axis=0), axis=0, prepend=np.nan) != 0.0
    number = np.empty(flat.shape, dtype=np.int64)
    np.put_along_axis(number, order, np.cumsum(differs.T.ravel()).reshape(differs.T.shape).T, axis=0)
    return number


def _even_spans(first: int, last: int, frames: int, length: int) -> list[slice]:
    """Spans of a recording of `frames`, about `length` each, that have the frames `first` to `last` - 1."""
    count = max(1, round(frames / length))
    ends = [frames * k // count for k in range(count + 1)]
    return [slice(a, b) for a, b in pairwise(ends) if a < last and b > first]


FILTERS: dict[str, type[ExponentialAverage] | type[RunningMedian] | type[RunningMean] | type[HeldValues]] = {
    filter_.kind: filter_ for filter_ in (ExponentialAverage, RunningMedian, RunningMean, HeldValues)
}
"""Filters by their name in files."""


def make_filter(
    kind: str, parameter: float, *, threshold_mm: float | None = None, median: float | None = None
) -> TemporalFilter:
    """The filter of a kind.

    Parameters
    ----------
    kind : str
        One of `FILTERS`.
    parameter : float
        Its number.
    threshold_mm : float, optional
        Of an exponential average that takes jumps at once.
    median : float, optional
        Frames of the median before an average.

    Raises
    ------
    ValueError
        If the kind is not known, or a number is out of its bounds or of another kind.
    """
    if kind not in FILTERS:
        raise ValueError(f"temporal filter: {kind!r} is not known; known: {', '.join(FILTERS)}")
    found = FILTERS[kind](parameter)
    if threshold_mm is not None:
        if not isinstance(found, ExponentialAverage):
            raise ValueError(f"temporal filter: {kind} has no jump that is taken at once")
        found = replace(found, threshold_mm=threshold_mm)
    if median is None:
        return found
    if not isinstance(found, (ExponentialAverage, RunningMean)):
        raise ValueError(f"temporal filter: {kind} has no median before it")  # noqa: TRY004  a value of a file
    if not float(median).is_integer():
        raise ValueError(f"temporal filter: a median of {median:g} frames")
    return AveragedMedians(found, int(median))
