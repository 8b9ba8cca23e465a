"""Whether the samples of a pixel visibly come from one surface or from two: a rule that does not call the package.

Use `judge_recording` to sort the pixels of a real recording, whose truth nobody knows, into single and double ones. It
is no estimator: surfaces closer than about 3 half-widths look like one cluster, and are taken for one.

The rule, for samples without a frame of reference but the recording itself:

1. **Scale.** Half the width of the central 68 % of a pixel's main cluster; its median over the pixels is the half-width
   w of the recording. The search for it starts at the length whose fullest interval is the least likely by chance.
2. **Clusters.** The interval of 6 w with the most samples is a cluster unless uniform background explains it: of m
   samples spread over the length S, m P(Binomial(m - 1, 6 w / S) >= c - 1) or fewer intervals hold c samples by chance
   (a bound on the scan statistic). At 0.001 or more the search ends. The interval is taken away and the rest searched
   again; samples within 3 w of earlier clusters are their tails and do not count as background. So background makes
   no cluster, however much there is. A cluster has at least 3 samples.
3. **Gaps.** Clusters closer than 6 half-widths are one: half-widths of the recording, or the clusters' own, if these
   are larger, up to 2 w. So tails, drifts and pixels of more width stay one cluster.
4. **Within a cluster** the excess mass of two intervals over one (twice the dip) decides: 1 % of uniform samples have
   more than is allowed. That is less than 1 % of any other unimodal shape, skewed or long-tailed. A straight drift over
   the frames is taken out before, unless one step in time explains more of the variance: a step makes two surfaces.

A pixel is single if it has one cluster that passes 4, and double if it has two that pass. Every other pixel is
undecided: no cluster, a cluster that does not pass, or more than two.

The rule errs to one side: it needs a chance below 0.001 for a cluster, so that a surface of few samples is not seen,
and its pixel counts as single, or as double where it has three. Such pixels are marked as faint where the chance is
0.001 to 0.05. `Judged.clear` leaves them out: they do not visibly see one surface, nor two.

References
----------
Mueller and Sawitzki, JASA 86 (1991), 738: excess mass. Hartigan and Hartigan, Ann. Stat. 13 (1985), 70: the dip, and
uniform samples as the hardest null. Naus, JASA 60 (1965), 532: intervals with the most samples.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.stats import binom

from tofmix.arrays import BoolArray, FloatArray, IntArray

GAP = 6.0
"""Half-widths without a sample that part two clusters; also the length of the interval that is searched for."""

REACH = 3.0
"""Half-widths past a cluster's ends to which samples are its members: its tails."""

MOST_OWN = 2.0
"""Half-widths of the recording that a cluster's own may have in the rule of gaps: few samples tell it badly."""

LEAST_SAMPLES = 3
"""One sample far away is an outlier, and two may be two of them."""

BY_CHANCE = 1e-3
"""Chance that background alone makes a cluster in a pixel."""

FAINT = 0.05
"""With less than this chance an interval may be a surface of few samples: such pixels are marked."""

DIP_LEVEL = 0.01
"""Share of uniform clusters that the test within a cluster takes for more than one."""

LEAST_SPAN = 100.0
"""Half-widths that background is spread over at least, where a recording shows one narrow range alone."""

CENTRAL = (0.158655253931457, 0.841344746068543)
"""Chances that a Gaussian number is below -1 and 1: between them lie the central 68 %."""

LEVELS = np.geomspace(0.01, 3.0, 48)
"""Densities at which excess mass is taken, in samples' share per half-width; a Gaussian's peak is 0.4."""

NULL_SAMPLES = (4, 6, 8, 12, 20, 40, 80, 160, 320, 640)
NULL_DRAWS = 2000
NULL_SEED = 91

SCALE_PIXELS = 400
"""Pixels, spread over the recording, that are looked at for a first scale."""

SCALE_STEPS = 24
"""Lengths from the step of ranges, or a millionth of the span, to a twentieth of it: first scales."""

BEST_LENGTH = 2.8
"""Sigmas of the interval that stands out most from little background: it holds 84 % of a Gaussian surface."""

SCALE_ROUNDS = 4


class Kind(StrEnum):
    """What the rule says of a pixel."""

    SINGLE = "single"
    DOUBLE = "double"
    UNDECIDED = "undecided"


class Cluster(NamedTuple):
    """Ends of a cluster, mm, and half the width of the central 68 % of its samples, background taken off, mm."""

    low_mm: float
    high_mm: float
    half_width_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What the rule says of a recording."""

    kind: IntArray
    """(pixel,) str. A `Kind` for each pixel."""
    clusters: list[list[Cluster]]
    """Clusters of each pixel, near to far."""
    half_width_mm: float
    """w of the recording."""
    step_mm: float
    """Step of the stored ranges."""
    background: FloatArray
    """(pixel,) float64. Samples of each pixel that no cluster explains, per mm."""
    faint: BoolArray
    """(pixel,) bool. Whether further samples stand together that background explains with a chance of 0.001 to 0.05
    alone: a single pixel of them may see a second surface of few samples."""

    def pixels(self, kind: Kind) -> IntArray:
        """Numbers of the pixels of a kind."""
        return np.flatnonzero(self.kind == list(Kind).index(kind))

    def clear(self, kind: Kind) -> IntArray:
        """Numbers of the pixels of a kind beside which no further cluster is likely."""
        return np.flatnonzero((self.kind == list(Kind).index(kind)) & ~self.faint)


def judge_recording(
    samples: FloatArray, *, range_min_mm: float | None = None, range_max_mm: float | None = None
) -> Judged:
    """Judge every pixel of samples (frame, pixel), mm, NaN where invalid.

    The working range, where it is known, is the length that background is spread over; without it, the range of all
    samples is. The order of frames matters for drifts alone.
    """
    ordered = np.sort(np.asarray(samples, dtype=np.float64), axis=0).T
    counts = np.isfinite(ordered).sum(axis=1)
    pixels = [row[:n] for row, n in zip(ordered, counts, strict=True)]
    step = step_of(ordered)
    low = float(np.nanmin(ordered)) if range_min_mm is None else range_min_mm
    high = float(np.nanmax(ordered)) if range_max_mm is None else range_max_mm
    width = common_half_width(pixels, step, max(high - low, step, 1e-6))
    span = max(high - low, LEAST_SPAN * width)
    searched = [_clusters(x, width, span) for x in pixels]
    found = [own for own, _ in searched]
    background = np.array([_background(x, own, span) for x, own in zip(pixels, found, strict=True)])
    kind = np.full(len(pixels), list(Kind).index(Kind.UNDECIDED))
    passed = _pass_within(samples, found, step)
    for pixel, own in enumerate(found):
        if own and passed[pixel] and len(own) <= len((Kind.SINGLE, Kind.DOUBLE)):
            kind[pixel] = list(Kind).index((Kind.SINGLE, Kind.DOUBLE)[len(own) - 1])
    return Judged(
        kind=kind,
        clusters=found,
        half_width_mm=width,
        step_mm=step,
        background=background,
        faint=np.array([faint for _, faint in searched]),
    )


def step_of(samples: FloatArray) -> float:
    """Step of the stored ranges, mm: the least difference of two samples; 0 where they are as good as continuous."""
    values = np.unique(samples[np.isfinite(samples)])
    if values.size < 2:
        return 0.0
    step = float(np.diff(values).min())
    on_steps = np.abs(values / step - np.rint(values / step)) < 1e-3
    return step if on_steps.all() else 0.0


def common_half_width(pixels: list[FloatArray], step: float, span: float) -> float:
    """Median over pixels of the half-width of the main cluster, mm, of sorted samples of each pixel."""
    usable = [x for x in pixels if x.size >= LEAST_SAMPLES]
    if not usable:
        raise ValueError(f"no pixel has {LEAST_SAMPLES} samples")
    floor = max(0.5 * step, 1e-6)
    width = max(_first_length(usable, max(step, 1e-6 * span), span) / BEST_LENGTH, floor)
    for _ in range(SCALE_ROUNDS):
        own = [_main_half_width(x, width) for x in usable]
        width = max(float(np.median(own)), floor)
    return width


def _first_length(pixels: list[FloatArray], least: float, span: float) -> float:
    """Length whose fullest interval is the least likely by chance, by the median over some pixels."""
    some = [pixels[k] for k in np.unique(np.linspace(0, len(pixels) - 1, SCALE_PIXELS).astype(np.int64))]
    lengths = np.geomspace(least, max(span / 20.0, 2.0 * least), SCALE_STEPS)
    size = np.array([x.size for x in some])
    number = np.array([[_densest(x, length)[2] for x in some] for length in lengths])
    by_chance = np.log(size) + binom.logsf(number - 2, size - 1, np.minimum(lengths / span, 1.0)[:, None])
    return float(lengths[np.argmin(np.median(by_chance, axis=1))])


def _main_half_width(x: FloatArray, width: float) -> float:
    low, high, _ = _densest(x, GAP * width)
    near = x[(x >= low - REACH * width) & (x <= high + REACH * width)]
    reach = high - low + 2.0 * REACH * width
    outside = x.size - near.size
    rate = outside / max(float(x[-1] - x[0]) - reach, LEAST_SPAN * width)
    return half_width(near, rate)


def _densest(x: FloatArray, length: float) -> tuple[float, float, int]:
    """First and last of the most sorted samples that lie within a length, and their number."""
    last = np.searchsorted(x, x + length, side="right")
    number = last - np.arange(x.size)
    # Of several such intervals the middle one: on whole mm they are many.
    best = np.flatnonzero(number == number.max())
    at = int(best[best.size // 2])
    return float(x[at]), float(x[last[at] - 1]), int(number[at])


def half_width(values: FloatArray, background: float = 0.0) -> float:
    """Half the width of the central 68 % of values, of which `background` per unit are uniform over their range.

    Quantiles are those of rank (k - 1/3) / (n + 1/3), whose median is right for any distribution (Hyndman and Fan,
    1996, number 8).
    """
    x = np.sort(values)
    if x.size < LEAST_SAMPLES:
        return 0.0
    rank = x.size * (np.arange(1, x.size + 1) - 1.0 / 3.0) / (x.size + 1.0 / 3.0)
    uniform = min(background, 0.9 * x.size / max(float(x[-1] - x[0]), 1e-9))
    surface = np.maximum.accumulate(rank - uniform * (x - x[0]))
    total = x.size - uniform * (x[-1] - x[0])
    low, high = np.interp(np.array(CENTRAL) * total, surface, x)
    return 0.5 * float(high - low)


def _clusters(x: FloatArray, width: float, span: float) -> tuple[list[Cluster], bool]:
    """Clusters of the sorted samples of a pixel, and whether one more is likely but not sure."""
    found: list[tuple[float, float]] = []
    while (interval := _next_interval(x, found, width, span)).by_chance < BY_CHANCE:
        found.append((interval.low_mm, interval.high_mm))
    merged = [_measured(x, low, high, width, span) for low, high in sorted(found)]
    while len(merged) > 1:
        gaps = [
            (b.low_mm - a.high_mm) / max(width, min(max(a.half_width_mm, b.half_width_mm), MOST_OWN * width))
            for a, b in pairwise(merged)
        ]
        closest = int(np.argmin(gaps))
        if gaps[closest] > GAP:
            break
        low, high = merged[closest].low_mm, merged[closest + 1].high_mm
        merged[closest : closest + 2] = [_measured(x, low, high, width, span)]
    return merged, interval.by_chance < FAINT


class _Interval(NamedTuple):
    """Ends of an interval, mm, and the number of those with as many samples that background makes in a pixel."""

    low_mm: float = 0.0
    high_mm: float = 0.0
    by_chance: float = np.inf


def _next_interval(x: FloatArray, found: list[tuple[float, float]], width: float, span: float) -> _Interval:
    """The interval least explained by background: of those away from earlier ones, and those beside them."""
    taken, tail = np.zeros(x.size, dtype=bool), np.zeros(x.size, dtype=bool)
    for low, high in found:
        taken |= (x >= low) & (x <= high)
        tail |= members(x, low, high, width)
    length = GAP * width
    share = min(length / max(span - length * len(found), 2.0 * length), 1.0)
    best = _Interval()
    for left in (x[~tail], x[~taken]):
        if left.size < LEAST_SAMPLES:
            continue
        low, high, number = _densest(left, length)
        background = int((~tail | (~taken & (x >= low) & (x <= high))).sum())
        by_chance = background * float(binom.sf(number - 2, background - 1, share))
        if number >= LEAST_SAMPLES and by_chance < best.by_chance:
            best = _Interval(low, high, by_chance)
    return best


def _measured(x: FloatArray, low: float, high: float, width: float, span: float) -> Cluster:
    near = members(x, low, high, width)
    rate = (x.size - near.sum()) / max(span - (high - low) - 2.0 * REACH * width, width)
    return Cluster(low, high, half_width(x[near], rate))


def members(x: FloatArray, low_mm: float, high_mm: float, width: float) -> BoolArray:
    """Which samples belong to a cluster with these ends, tails included."""
    return np.asarray((x >= low_mm - REACH * width) & (x <= high_mm + REACH * width))


def _background(x: FloatArray, found: list[Cluster], span: float) -> float:
    """Samples per mm in no cluster."""
    outside = x.size - sum(int(((x >= c.low_mm) & (x <= c.high_mm)).sum()) for c in found)
    free = span - sum(c.high_mm - c.low_mm for c in found)
    return outside / max(free, 0.1 * span)


def _pass_within(samples: FloatArray, found: list[list[Cluster]], step: float) -> BoolArray:
    """Whether each cluster of each pixel is one by its excess mass."""
    rng = np.random.default_rng(NULL_SEED)
    owner, parts = [], []
    for pixel, own in enumerate(found):
        x = samples[:, pixel]
        for cluster in own:
            inside = (x >= cluster.low_mm) & (x <= cluster.high_mm)
            # Ties are steps, not modes: samples are spread evenly over their step.
            spread = x[inside] + step * rng.uniform(-0.5, 0.5, int(inside.sum()))
            owner.append(pixel)
            parts.append(np.sort(_without_drift(np.flatnonzero(inside), spread, unless_step=True)))
    passed = np.ones(samples.shape[1], dtype=bool)
    np.logical_and.at(passed, np.array(owner, dtype=np.int64), is_one_mode(parts))
    return passed


def _without_drift(frame: IntArray, values: FloatArray, *, unless_step: bool) -> FloatArray:
    """Values, in the order of time, less a straight line over their frames; `unless_step`: if no step explains more."""
    if values.size <= LEAST_SAMPLES:
        return values
    time, away = frame - frame.mean(), values - values.mean()
    slope = (time @ away) / (time @ time)
    before = np.arange(1, values.size)
    of_step = (np.cumsum(away)[:-1] ** 2 * values.size / (before * (values.size - before))).max()
    return values if unless_step and of_step > slope**2 * (time @ time) else away - slope * time


def is_one_mode(parts: list[FloatArray]) -> BoolArray:
    """Whether the sorted samples of each part have one mode, at `DIP_LEVEL` of uniform ones."""
    if not parts:
        return np.zeros(0, dtype=bool)
    sizes = np.array([part.size for part in parts])
    number, most = _most_allowed()
    allowed = np.interp(np.sqrt(sizes), np.sqrt(number), most) / np.sqrt(sizes)
    out = np.empty(len(parts), dtype=bool)
    for group in np.array_split(np.argsort(sizes, kind="stable"), max(1, len(parts) // 500)):
        values = np.full((group.size, sizes[group].max()), np.nan)
        for row, part in enumerate(group):
            values[row, : sizes[part]] = parts[part]
        out[group] = excess_mass(values) <= allowed[group]
    return out


def excess_mass(values: FloatArray) -> FloatArray:
    """The most that two intervals gain over one in share of samples less level times length, over all levels.

    `values` (part, sample) float64: sorted samples, NaN past the last.
    Returns (part,) float64: 0 for one mode; twice the dip.
    """
    count = np.isfinite(values).sum(axis=1)
    scale = np.array([half_width(row[:n]) for row, n in zip(values, count, strict=True)])
    level = LEVELS / np.maximum(scale, 1e-9)[:, None]
    each = (1.0 / count)[:, None]
    one = np.zeros(level.shape)
    first, between, second, two = (np.full(level.shape, -np.inf) for _ in range(4))
    gaps = np.diff(values, axis=1, prepend=values[:, :1])
    for k in range(values.shape[1]):
        # Best sums that end in a first interval at this sample, after it, and in a second one.
        cost = np.nan_to_num(gaps[:, k], nan=np.inf)[:, None] * level
        here = (k < count)[:, None]
        started = np.maximum(between, first)
        extended = np.maximum(first - cost, 0.0) + each
        second = np.where(here, np.maximum(second - cost, started) + each, second)
        first = np.where(here, extended, first)
        between = np.where(here, started, between)
        one, two = np.maximum(one, first), np.maximum(two, second)
    return np.asarray(np.maximum(two - one, 0.0).max(axis=1))


@cache
def _most_allowed() -> tuple[FloatArray, FloatArray]:
    """Numbers of samples, and sqrt(n) times the excess mass that `DIP_LEVEL` of uniform samples exceed."""
    rng = np.random.default_rng(NULL_SEED)
    most = [
        np.sqrt(n) * np.quantile(excess_mass(np.sort(rng.random((NULL_DRAWS, n)), axis=1)), 1.0 - DIP_LEVEL)
        for n in NULL_SAMPLES
    ]
    return np.array(NULL_SAMPLES, dtype=np.float64), np.array(most)


def half_width_without_drift(samples: FloatArray, judged: Judged, pixel: int) -> float:
    """Half the width of the central 68 % of a single pixel, a straight drift over frames and background taken off, mm.

    `samples` (frame, pixel) float64: samples in the order of time.
    `judged`: what the rule says of them.
    `pixel`: a single one.
    """
    (cluster,) = judged.clusters[pixel]
    x = samples[:, pixel]
    near = members(x, cluster.low_mm, cluster.high_mm, judged.half_width_mm)
    frame, value = np.flatnonzero(near), x[near]
    spread = value + judged.step_mm * np.random.default_rng([NULL_SEED, pixel]).uniform(-0.5, 0.5, value.size)
    width = half_width(_without_drift(frame, spread, unless_step=False), judged.background[pixel])
    # A slope was fitted; the spread over a step has the variance step^2 / 12.
    free = width**2 * value.size / max(value.size - 1, 1)
    return float(np.sqrt(max(free - judged.step_mm**2 / 12.0, 0.0)))
