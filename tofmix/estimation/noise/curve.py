"""From the spreads of single-surface series to a curve sigma(r): bins of range, measured, smoothed and joined.

Use it through `noise`. Series come sorted by range. Each bin's sigma is that of its single series (`locate`); the bins
are then smoothed according to their scatter, so many narrow bins lose no precision where the curve is smooth.

The noise of groups of series of which some see more than one surface.

Use `locate` on the logarithms of their standard deviations, one group a range. Two surfaces that a series does not
separate make it wider, never narrower. So a series is either single, its variance chi-square about sigma^2, or wider by
an unknown factor. The share of wider series, their factor, and the spread of sigma between pixels come from all groups
together, because a single group has too few series.

The thresholds of the whole measurement stand here, as `NoiseSettings`; `measure_noise` takes them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray, IntArray
from tofmix.bounds import (
    AtLeastTwo,
    Count,
    Finite,
    NotNegative,
    Positive,
    RatioAbove1,
    Share,
    check_ascending,
    check_bounds,
)
from tofmix.sensor import AmplitudeLaw, NoiseCurve


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSettings:
    """The curve sigma(r) through bins of range.

    Parameters
    ----------
    least_in_bin : int
        Fewest series that determine a sigma.
    bin_target : int
        Series of a bin, where there are enough.
    most_bins : int
        Bins of range at most.
    wide, narrow : float
        Extent of a bin over its range: above the first it is split, below the second it never is.
    gap : float
        A step in range, over the range, that parts two bins.
    slopes : (float, float)
        Least and greatest power of range by which sigma is carried on past the outer bins.
    fill : float
        Ratio of neighbouring points of the curve where nothing was seen, above 1.
    least_smoothed : int
        Fewest bins that determine the smoothness of the curve.
    """

    least_in_bin: Count = 20
    bin_target: Count = 60
    most_bins: Count = 64
    wide: Positive = 0.12
    narrow: NotNegative = 0.02
    gap: Positive = 0.03
    slopes: tuple[Finite, Finite] = (-1.0, 4.0)
    fill: RatioAbove1 = 1.15
    least_smoothed: Count = 4

    def __post_init__(self) -> None:
        check_bounds(self)
        check_ascending(self, "slopes")


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeSettings:
    """How noise depends on amplitude.

    Parameters
    ----------
    exponents : (float, float)
        Least and greatest power by which noise falls with amplitude: shot noise gives 1, as does background light.
    pieces : tuple of int
        Powers of one law, each over its own part of the amplitudes: the numbers that are tried, ascending.
    ends : (float, float)
        Quantiles of the amplitudes between which a law is told.
    folds : int
        Parts of the pixels for cross-validation.
    least_gain : float
        Least gain of held-out likelihood, nat, of a law over the one with fewer pieces.
    least_errors : float
        The gain must also be that many of its standard errors over the series: a few of them must not decide.
    least_effect : float
        Least standard deviation of log sigma that a law makes among the series of a bin: 0.025 is 5 % from bright to
        dark.
    least_series, most_series : int
        Series with amplitudes: fewer are not asked for a law, and of more some are fitted, spread over all.
    """

    exponents: tuple[Finite, Finite] = (0.0, 2.0)
    pieces: tuple[Count, ...] = (1, 2, 3)
    ends: tuple[Share, Share] = (0.005, 0.995)
    folds: AtLeastTwo = 5
    least_gain: NotNegative = 10.0
    least_errors: NotNegative = 2.0
    least_effect: NotNegative = 0.025
    least_series: Count = 100
    most_series: Count = 20_000

    def __post_init__(self) -> None:
        check_bounds(self)
        check_ascending(self, "exponents", "pieces", "ends")


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlierSettings:
    """The share of random values.

    Parameters
    ----------
    far_sigmas : float
        Samples that are farther from the surface are no noise.
    neighbour_sigmas : float
        Two of them that are nearer to each other are a weak surface.
    cells : int
        Parts of the working range.
    least_in_cell : int
        Outliers a part on average, from which the median part tells.
    suspect_factor : float
        A series whose spread is that many times sigma(r) may see two surfaces.
    """

    far_sigmas: Positive = 5.0
    neighbour_sigmas: NotNegative = 3.0
    cells: Count = 20
    least_in_cell: Count = 5
    suspect_factor: Positive = 1.35

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseSettings:
    """All thresholds of the measurement of noise.

    Parameters
    ----------
    curve, amplitude, outliers
        Of these steps.
    strictness : float
        Share of Gaussian series that each test of shape turns away, 0 to 1: it costs no bias.
    least_fitting : float
        Share of series that must have the shape of one surface for the tests of shape to count, 0 to 1.
    pile_sigma : float
        Samples without a return with less than this share of their neighbour's sigma are a constant.
    """

    curve: CurveSettings = field(default_factory=CurveSettings)
    amplitude: AmplitudeSettings = field(default_factory=AmplitudeSettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    strictness: Share = 0.1
    least_fitting: Share = 0.1
    pile_sigma: NotNegative = 0.5

    def __post_init__(self) -> None:
        check_bounds(self)


DEFAULT_SETTINGS = NoiseSettings()


STEP = 0.005
"""Step of log sigma in all tables: half a per cent."""

GRID = np.arange(-1200, 1201)
"""Places, in steps, at which densities are kept."""

_CONTAMINATED = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])  # share of wider series
_EXCESS = (0.08, 0.25, 0.7)  # mean of the exponential log factor by which they are wider
_DISPERSION = (1.0, 0.6, 0.35, 0.2, 0.1)  # factors on the degrees of freedom: sigma itself differs between pixels


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Located:
    """Result of `locate`.

    `log_sigma` and its standard error `error`, both (group,); `chances` (mixture,) of the shares, excesses and
    dispersions that were tried, learned from all groups, for `single_share`.
    """

    log_sigma: FloatArray
    error: FloatArray
    chances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ScaleMixtures:
    """Densities of log(s / sigma) on `GRID`, for every share, excess and dispersion that is tried.

    `single` and `density` are (mixture, place): the share of single series times their density, and that of all.
    `degrees` (mixture,) are the degrees of freedom, less where sigma differs between pixels.
    """

    single: FloatArray
    density: FloatArray
    degrees: FloatArray

    @classmethod
    @cache
    def of(cls, degrees: int) -> Self:
        """Mixtures for variances of so many degrees of freedom."""
        single, density, left = [], [], []
        background = 0.002  # density of series that are neither, so that no single one decides
        for dispersion in _DISPERSION:
            one = np.exp(_log_density(STEP * GRID, dispersion * degrees))
            for excess in _EXCESS:
                steps = np.rint(-excess * np.log(1.0 - (np.arange(8) + 0.5) / 8) / STEP).astype(np.int64)
                wider = np.mean([np.exp(_log_density(STEP * (GRID - u), dispersion * degrees)) for u in steps], axis=0)
                for share in _CONTAMINATED:
                    single.append((1.0 - share) * one)
                    density.append(single[-1] + share * wider + background)
                    left.append(dispersion * degrees)
        return cls(np.array(single), np.array(density), np.array(left))


def locate(groups: Sequence[FloatArray], degrees: int) -> Located:
    """Log sigma of the single series in each group, at most 60 % of which see more than one surface.

    Parameters
    ----------
    groups : sequence of (n,) float64
        Half the logarithm of each series' variance, group by group; at least one group, none empty.
    degrees : int
        Degrees of freedom of the variances.

    Returns
    -------
    Located
        Means and standard deviations over all mixtures that are tried, by their likelihood and by how well they
        do in all groups (empirical Bayes).
    """
    log_density = np.log(ScaleMixtures.of(degrees).density)
    centre = [float(np.median(group)) for group in groups]
    reach = 0.45  # from the median down to the least sigma that is tried, and a third of it up
    shifts = np.arange(-int(reach / STEP), int(reach / STEP) // 3 + 1)
    tables = np.array([_likelihoods(g - c, shifts, log_density) for g, c in zip(groups, centre, strict=True)])
    tables -= tables.max(axis=(1, 2), keepdims=True)
    likelihood = np.exp(tables)
    evidence = likelihood.sum(axis=1)
    chances = np.full(evidence.shape[1], 1.0 / evidence.shape[1])
    rounds = 60  # EM steps for the chances of the mixtures
    prior_groups = 1.0  # weight of equal chances for all mixtures, in groups
    for _ in range(rounds):
        mine = evidence * chances
        mine /= mine.sum(axis=1, keepdims=True)
        chances = (mine.sum(axis=0) + prior_groups / len(chances)) / (len(groups) + prior_groups)
    weight = likelihood @ chances
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ shifts
    error = np.sqrt(np.maximum((weight * (shifts - mean[:, None]) ** 2).sum(axis=1), 1.0))
    return Located(log_sigma=np.array(centre) + STEP * mean, error=STEP * error, chances=chances)


def single_share(away: FloatArray, degrees: int, chances: FloatArray) -> FloatArray:
    """How surely each series is single; `away` is its log standard deviation less log sigma, any shape."""
    mixtures = ScaleMixtures.of(degrees)
    at = place(away)
    share: FloatArray = (chances @ mixtures.single)[at] / (chances @ mixtures.density)[at]
    return share


def place(away: FloatArray) -> IntArray:
    """Number of the nearest place of `GRID`; values beyond it are put at its ends."""
    steps = np.clip(np.rint(away / STEP), GRID[0], GRID[-1])
    return np.asarray(steps - GRID[0], dtype=np.int64)


def _likelihoods(away: FloatArray, shifts: IntArray, log_density: FloatArray) -> FloatArray:
    """Log likelihood (shift, mixture) of a group, `away` from its middle."""
    places, counts = np.unique(np.rint(away / STEP).astype(np.int64), return_counts=True)
    at = np.clip(places[None, :] - shifts[:, None], GRID[0], GRID[-1]) - GRID[0]
    total = np.zeros((len(shifts), len(log_density)))
    for k in range(len(log_density)):
        total[:, k] = log_density[k][at] @ counts
    return total


def _log_density(z: NDArray[np.floating], degrees: float) -> FloatArray:
    """Log density of z = log(s / sigma), s^2 / sigma^2 being chi-square over its degrees of freedom."""
    half = degrees / 2.0
    constant = math.log(2.0) + half * math.log(half) - math.lgamma(half)
    density: FloatArray = constant + degrees * z - half * np.exp(2.0 * z)
    return density


_ROUGHNESS = np.geomspace(1e-3, 1e5, 33)
"""Variances of the second derivative of log sigma by log range, with the whole range as unit, that are tried."""


class Point(NamedTuple):
    """A bin's series, their range from `low` to `high` (mm), and log sigma at `centre`."""

    members: slice
    low: float
    centre: float
    high: float
    log_sigma: float


def cut_into_bins(range_mm: FloatArray, settings: CurveSettings) -> list[slice]:
    """Cut ascending ranges into bins: at gaps, then in halves while they are too wide or hold more than they need."""
    if range_mm.size == 0:
        return []
    scale = np.maximum(np.abs(range_mm), 1.0)
    cuts = np.flatnonzero(np.diff(range_mm) > settings.gap * scale[1:]) + 1
    target = max(settings.bin_target, range_mm.size // settings.most_bins)
    waiting = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), range_mm.size])]
    bins = []
    while waiting:
        part = waiting.pop()
        count = part.stop - part.start
        extent = (range_mm[part.stop - 1] - range_mm[part.start]) / scale[part.start]
        many = extent > settings.wide or (count >= 2 * target and extent > settings.narrow)
        if count >= 2 * settings.least_in_bin and many:
            middle = (part.start + part.stop) // 2
            waiting += [slice(part.start, middle), slice(middle, part.stop)]
        elif count >= settings.least_in_bin and extent <= 2 * settings.wide:
            bins.append(part)
    return sorted(bins, key=lambda part: part.start)


def measure_bins(
    range_mm: FloatArray, log_sigma: FloatArray, bins: Sequence[slice], degrees: int, settings: CurveSettings
) -> tuple[list[Point], Located]:
    """Measure the bins, three times: the slope of the curve within each is taken out by the curve before.

    Parameters
    ----------
    range_mm, log_sigma : (series,) float64
        Range, ascending, and half the logarithm of the variance of each series.
    bins : sequence of slice
        From `cut_into_bins`, at least one.
    degrees : int
        Degrees of freedom of the variances.

    Returns
    -------
    list of Point
        One a bin.
    Located
        The last measurement, before it was smoothed.
    """
    centres = np.array([np.median(range_mm[members]) for members in bins])
    points: list[Point] = []
    for _ in range(3):
        slope = log_curve(points, range_mm, settings) if points else np.zeros(len(range_mm))
        at_centre = log_curve(points, centres, settings) if points else np.zeros(len(centres))
        level = log_sigma - slope
        found = locate([level[members] + at_centre[b] for b, members in enumerate(bins)], degrees)
        smoothed = smooth(np.log(np.maximum(centres, 1.0)), found.log_sigma, found.error, settings.least_smoothed)
        points = [
            Point(members, float(range_mm[members][0]), float(centre), float(range_mm[members][-1]), float(value))
            for members, centre, value in zip(bins, centres, smoothed, strict=True)
        ]
    return points, found


def smooth(x: FloatArray, y: FloatArray, error: FloatArray, least: int) -> FloatArray:
    """Smooth values with known errors by cubic splines, according to their scatter.

    A spline is the mean of a process whose second derivative is white noise. Its variance is integrated out by the
    restricted likelihood of the values, so kinks remain, and straight curves pool the values.

    Parameters
    ----------
    x, y, error : (n,) float64
        Ascending places, values there, and their standard errors, above 0.
    least : int
        Fewest values that determine their smoothness.

    Returns
    -------
    (n,) float64
        Smoothed values; as they are where there are fewer than `least`.

    References
    ----------
    Wahba, J. Royal Statistical Society B 40 (1978), 364; Wecker and Ansley, JASA 78 (1983), 81.
    """
    if len(x) < least or not x[-1] > x[0]:
        return y
    u = (x - x[0]) / (x[-1] - x[0])
    low, high = np.minimum.outer(u, u), np.maximum.outer(u, u)
    kernel = low**2 * (3.0 * high - low) / 6.0
    line = np.stack([np.ones_like(u), u], axis=1)
    fits, likelihood = [], []
    for roughness in _ROUGHNESS:
        lower = np.linalg.cholesky(roughness * kernel + np.diag(error**2))
        basis, values = np.linalg.solve(lower, line), np.linalg.solve(lower, y)
        normal = basis.T @ basis
        straight = np.linalg.solve(normal, basis.T @ values)
        rest = values - basis @ straight
        fits.append(line @ straight + roughness * kernel @ np.linalg.solve(lower.T, rest))
        likelihood.append(-0.5 * rest @ rest - np.log(np.diag(lower)).sum() - 0.5 * float(np.linalg.slogdet(normal)[1]))
    weight = np.exp(np.array(likelihood) - max(likelihood))
    return np.asarray(weight @ np.array(fits) / weight.sum(), dtype=np.float64)


def log_curve(points: Sequence[Point], range_mm: FloatArray, settings: CurveSettings) -> FloatArray:
    """Log sigma at any range: a power law from point to point, carried on past the outer ones by their neighbours'."""
    x = np.log(np.maximum(range_mm, 1.0))
    at = np.log(np.maximum([p.centre for p in points], 1.0))
    values = np.array([p.log_sigma for p in points])
    distinct = np.concatenate([[True], np.diff(at) > 0])
    at, values = at[distinct], values[distinct]
    if len(at) == 1:
        return np.full(x.shape, values[0])
    slopes = np.clip(np.diff(values) / np.diff(at), *settings.slopes)
    log_sigma: FloatArray = np.interp(x, at, values)
    log_sigma += slopes[0] * np.minimum(x - at[0], 0.0) + slopes[-1] * np.maximum(x - at[-1], 0.0)
    return log_sigma


def join(points: Sequence[Point], settings: CurveSettings) -> NoiseCurve:
    """Curve through the points, the ends of their bins, and the power law where nothing was seen."""
    ends = {round(value, 1) for p in points for value in (p.low, p.centre, p.high)}
    knots = sorted(ends)
    filled = [knots[0]]
    for before, after in pairwise(knots):
        if before >= 1.0 and after > settings.fill * before:
            pieces = math.ceil(math.log(after / before) / math.log(settings.fill))
            filled += [round(before * (after / before) ** (k / pieces), 1) for k in range(1, pieces)]
        filled.append(after)
    range_mm = np.unique(np.array(filled))
    return NoiseCurve(range_mm, np.exp(log_curve(points, range_mm, settings)))


def reference_at(law: AmplitudeLaw, centres: FloatArray, range_mm: FloatArray) -> FloatArray:
    """Reference amplitude at any range: a power of range between the law's `centres`, mm, constant past them."""
    at, x = np.log(np.maximum(centres, 1.0)), np.log(np.maximum(range_mm, 1.0))
    return np.asarray(np.exp(np.interp(x, at, np.log(law.reference))), dtype=np.float64)


def with_law(curve: NoiseCurve, law: AmplitudeLaw, centres: FloatArray) -> NoiseCurve:
    """The curve of noise at the law's factor 1, as one at its references, which are at `centres`, mm."""
    reference = reference_at(law, centres, curve.range_mm)
    sigma_mm = curve.sigma_mm * np.exp(law.log_factor(reference))
    return NoiseCurve(curve.range_mm, sigma_mm, AmplitudeLaw(reference, law.amplitude, law.factor))
