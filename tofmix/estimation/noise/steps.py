"""The step on which the ranges of a recording are stored.

Use `find_step` on samples of some pixels. Cameras store ranges as multiples of a step: of the phase's resolution, of a
unit of the depth along the axis, whose step in range is each pixel's own, of a code whose step grows with range, or of
a floating-point number of few bits, whose step doubles at each power of two of its unit. The values of a pixel then
repeat, and the distances of neighbouring values are whole multiples of the step. Distances of continuous values are
within a tenth of a whole multiple in a fifth of the cases.

Rounding in a conversion leaves values that differ by a small part of the step. So values that are close together are
one level; how close is tried, the smallest distance first.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.estimation.noise.series import read_runs
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.noise_shape import WHOLE_MM, RangeStep
from tofmix.recording import SampleSource, samples_a_frame

MOST_MULTIPLE = 4
"""Distances of more steps than this are no test: the step may differ between values, as after a correction."""

NEAR = 0.1
"""A distance within this part of the step of a whole multiple agrees with the step."""


LEAST_DISTANCES = 20
"""Fewest distances that tell a step: continuous values agree in 90 % of 20 with a probability below 1e-10."""

ALIKE = 0.01
"""Relative difference of two steps that are one."""


TOLERANCES = (4.0, 32.0, 256.0)
"""Distances within a level that are tried, in units of the resolution of float32 at the pixel's ranges."""

LARGEST_TOLERANCE = 0.1
"""Largest tolerance by the step that it gives."""


FIRST_FRAMES, MOST_VALUES = 100, 60_000
"""Frames of each pixel, and about the most samples, that are looked at first: continuous values are told from them."""

MOST_FRAMES, MOST_LOOKED_AT = 300, 600_000
"""Most frames of a recording, and about the most samples, that are looked at."""


LEAST_AT_RANGE = 5
"""Fewest pixels at each of them."""


class _Distances(NamedTuple):
    """Distances (n,), mm, of neighbouring levels, and the ranges (n,), mm, in the middle between these.

    `group` (n,) numbers the group of levels of each, and `pixel` (group,), `range_mm` (group,), mm, are the pixel of a
    group and the range of its smallest distance.
    """

    distance: FloatArray
    place: FloatArray
    group: IntArray
    pixel: IntArray
    range_mm: FloatArray


def step_of_recording(source: SampleSource) -> RangeStep | None:
    """Find the step of a recording's ranges: in some of its pixels, and in all where each has its own.

    Of a recording with several targets, a step of each pixel is not looked for.
    """
    frames, rows, cols = source.shape
    length = min(frames, MOST_FRAMES)
    every = max(1, rows * cols * length // MOST_LOOKED_AT)
    chosen = np.arange(0, rows, every)
    series = read_runs(source, [0], length, chosen, None)
    found = find_step(series.samples)
    if found is None or found.own_mm is None:
        return found
    if samples_a_frame(source) > 1:
        return None
    own = np.full(rows * cols, np.nan)
    band = max(1, source.row_step)
    for first in range(0, rows, band):
        some = read_runs(source, [0], length, np.arange(first, min(first + band, rows)), None)
        own[some.pixel] = _own_steps(some.samples, found.typical())
    return RangeStep.of_pixels(own)


def _own_steps(samples: Float32Array, typical_mm: float) -> FloatArray:
    """Step of each pixel (pixel,), mm, where all are about `typical_mm`; NaN where a pixel shows none."""
    pixel, value, resolution = _sorted(samples)
    fine = [tolerance for tolerance in TOLERANCES if tolerance * resolution.max() <= LARGEST_TOLERANCE * typical_mm]
    out = np.full(len(samples), np.nan)
    first = _first_of_levels(pixel, value, (fine or TOLERANCES)[-1] * resolution)
    found = _distances(pixel[first], _levels(value, first))
    if found is not None:
        step, _ = _refined(found, _smallest(found))
        _fill_pixels(found, step, _of_one_size(step, typical_mm), out)
    return out


def find_step(samples_mm: Float32Array) -> RangeStep | None:
    """Find the step on which the samples of pixels lie.

    Parameters
    ----------
    samples_mm : (pixel, frame) float32
        Samples, mm, NaN where invalid.

    Returns
    -------
    RangeStep or None
        None where the values are continuous, or too few repeat. The step of whole mm is one; that of float32 is none.
    """
    some = samples_mm[:, :FIRST_FRAMES]
    some = some[:: max(1, some.size // MOST_VALUES)]
    if some.size < samples_mm.size:
        found = _find(some)
        # Whole numbers lie on no step finer than 1, and these on no wider one
        is_one = found is not None and found.is_common and found.typical() == WHOLE_MM
        if found is None or (is_one and np.array_equal(samples_mm, np.rint(samples_mm), equal_nan=True)):
            return found
    return _find(samples_mm)


def _find(samples: Float32Array) -> RangeStep | None:
    pixel, value, resolution = _sorted(samples)
    for tolerance in TOLERANCES if value.size else ():
        found = _step_at(pixel, value, tolerance * resolution, len(samples))
        if found is not None:
            return found
    return None


def _sorted(samples: Float32Array) -> tuple[IntArray, FloatArray, FloatArray]:
    """Valid samples by pixel and ascending: pixel (n,), value (n,), mm, and the resolution of float32 there, mm."""
    with np.errstate(invalid="ignore"):
        pixel, frame = np.nonzero(np.abs(samples) <= FARTHEST_MM)
    value = samples[pixel, frame]
    order = np.lexsort((value, pixel))
    value = value[order]
    return pixel[order], value.astype(np.float64), np.spacing(np.abs(value)).astype(np.float64)


def _step_at(pixel: IntArray, value: FloatArray, tolerance: FloatArray, pixels: int) -> RangeStep | None:
    """Step if samples within `tolerance` (n,), mm, of their neighbour are one level."""
    first = _first_of_levels(pixel, value, tolerance)
    # Part of the samples that repeat a level, at least: with fewer, a step tells nothing of sigma.
    least_repeated = 0.02
    if len(first) > (1.0 - least_repeated) * len(value):
        return None
    found = _distances(pixel[first], _levels(value, first))
    if found is None:
        return None
    smallest = _smallest(found)
    refined, middle = _refined(found, smallest)
    widest = np.interp(found.range_mm, *_limits(value, tolerance))
    if np.median(refined) * LARGEST_TOLERANCE < np.median(widest):
        return None
    return _chosen(found, refined, middle, pixels, repeated=1.0 - len(first) / len(value))


def _first_of_levels(pixel: IntArray, value: FloatArray, tolerance: FloatArray) -> IntArray:
    """Index of the first sample of each level of ascending values (n,), mm."""
    apart = np.ones(len(value), dtype=np.bool_)
    apart[1:] = (pixel[1:] != pixel[:-1]) | (value[1:] - value[:-1] > tolerance[1:])
    return np.flatnonzero(apart)


def _levels(value: FloatArray, first: IntArray) -> FloatArray:
    """Mean of the samples of each level, mm."""
    return np.asarray(np.add.reduceat(value, first) / np.diff(first, append=len(value)))


def _of_one_size(step: FloatArray, typical_mm: float) -> BoolArray:
    """Whether steps (n,), mm, are within a factor of two of the typical one."""
    return np.asarray(np.abs(np.log(step / typical_mm)) <= math.log(2.0))


def _fill_pixels(found: _Distances, step: FloatArray, good: BoolArray, out: FloatArray) -> None:
    """Fill `out` (pixel,) with the good ones of the steps (group,); a pixel has that of the most distances."""
    order = np.argsort(np.bincount(found.group), kind="stable")
    order = order[good[order]]
    out[found.pixel[order]] = step[order]


def _limits(value: FloatArray, tolerance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tolerance by value, ascending."""
    order = np.argsort(value)
    return value[order], tolerance[order]


def _distances(pixel: IntArray, level: FloatArray) -> _Distances | None:
    """Distances within groups of levels: a pixel is cut where a distance is far above its smallest."""
    inside = pixel[1:] == pixel[:-1]
    distance = (level[1:] - level[:-1])[inside]
    owner, place = pixel[1:][inside], (0.5 * (level[1:] + level[:-1]))[inside]
    if distance.size == 0:
        return None
    least = np.full(int(owner[-1]) + 1, np.inf)
    np.minimum.at(least, owner, distance)
    kept = distance <= 4.0 * MOST_MULTIPLE * least[owner]
    # Levels on both sides of a long distance are of two surfaces, whose steps may differ.
    group = np.cumsum(np.concatenate([[0], (owner[1:] != owner[:-1]) | ~kept[1:]]))
    _, number = np.unique(group[kept], return_inverse=True)
    smallest = np.lexsort((distance[kept], number))[np.searchsorted(number, np.arange(number[-1] + 1))]
    return _Distances(distance[kept], place[kept], number, owner[kept][smallest], place[kept][smallest])


def _smallest(found: _Distances) -> FloatArray:
    """Smallest distance of each group (group,), mm."""
    least = np.full(len(found.pixel), np.inf)
    np.minimum.at(least, found.group, found.distance)
    return least


def _multiples(found: _Distances, step: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Distances (n,) in steps (group,), the nearest whole numbers, and whether they test the step."""
    ratio = found.distance / step[found.group]
    whole = np.maximum(np.rint(ratio), 1.0)
    return ratio, whole, ratio < MOST_MULTIPLE + 0.5


def _refined(found: _Distances, smallest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Step of each group by all its distances near a whole multiple: least squares; and the range at which it is.

    Distances w_j s(r_j) of a step s that is linear in range give s at the mean of r_j with the weights w_j^2.
    """
    ratio, whole, used = _multiples(found, smallest)
    used &= np.abs(ratio - whole) <= NEAR
    group, whole = found.group[used], whole[used]
    count = len(found.pixel)
    weight = np.bincount(group, whole * whole, count)
    step = np.bincount(group, found.distance[used] * whole, count) / weight
    return step, np.bincount(group, found.place[used] * whole * whole, count) / weight


def _chosen(
    found: _Distances, step: FloatArray, middle_mm: FloatArray, pixels: int, *, repeated: float
) -> RangeStep | None:
    """The simplest form that predicts the steps of the groups (group,) at their ranges, mm."""
    forms = itertools.chain(
        ((found.range_mm, form) for form in _by_octave(found, step)),
        ((middle_mm, form) for form in _by_range(middle_mm, step)),
    )
    least_alike = 0.9  # part of the pixels whose steps are predicted by one number, or by range
    for at_mm, (range_mm, by_range) in forms:
        predicted = np.interp(at_mm, range_mm, by_range)
        ratio = step / predicted
        multiple = np.maximum(np.rint(ratio), 1.0)  # few samples may show no two neighbouring values
        alike = np.abs(ratio / multiple - 1.0) <= ALIKE
        if alike.mean() >= least_alike and _agrees(found, predicted, other=False):
            return RangeStep(range_mm, by_range)
    alike = _of_one_size(step, float(np.median(step)))
    # Part of the samples that repeat a level from which on two levels tell a step: values of surfaces repeat alike.
    most_repeated = 0.8
    two_levels = repeated >= most_repeated and len(step) >= LEAST_DISTANCES
    if alike.mean() < least_alike or not (two_levels or _agrees(found, step, other=True)):
        return None
    out = np.full(pixels, np.nan)
    _fill_pixels(found, step, alike, out)
    return RangeStep.of_pixels(out)


def _by_octave(found: _Distances, step: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Step to try of floating-point numbers of few bits: it doubles at ranges that double; none of a single step.

    A group whose step is 2^j of the middle one, at the range r, says that log2 of the first end lies in
    (log2 r - j - 1, log2 r - j]. The end is one on which most groups agree; and a power of two times the step, if one
    is there.
    """
    middle = float(np.median(step))
    octave = np.rint(np.log2(step / middle))
    fine = np.abs(step / (middle * 2.0**octave) - 1.0) <= ALIKE
    octave, place = octave[fine], np.log2(found.range_mm[fine])
    several = [float(j) for j in np.unique(octave) if (octave == j).sum() >= LEAST_AT_RANGE]
    if len(several) <= 1:
        return
    low, high = np.sort(place - octave - 1.0), np.sort(place - octave)
    # Of sorted ends, the count of intervals that hold a point grows at each low one, and falls at each high one.
    count = np.arange(1, len(low) + 1) - np.searchsorted(high, low, side="right")
    best = int(count.argmax())
    # Part of the pixels, at least, whose steps double at the same ranges, where the values are floating-point numbers.
    octaves_alike = 0.95
    if count[best] < octaves_alike * len(step):
        return
    first, last = float(low[best]), float(high[np.searchsorted(high, low[best], side="right")])
    unit = math.log2(middle)
    exact = unit + math.ceil(first - unit)
    start = exact if exact <= last else 0.5 * (first + last)
    ends = 2.0 ** (start + np.arange(several[0], several[-1] + 2.0))
    sizes = middle * 2.0 ** np.arange(several[0], several[-1] + 1.0)
    below = 1.0e-9  # part of a range by which a range counts as below it
    yield np.stack([ends[:-1], ends[1:] * (1.0 - below)], axis=-1).ravel(), np.repeat(sizes, 2)


def _by_range(group_mm: FloatArray, step: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Steps by range to try, ranges and steps, mm: one number; then those of groups (group,) of about one range, mm.

    In sparse samples, most groups show multiples of the step only; so a low quantile is tried after the median.
    """
    low = 0.1  # part of the groups whose smallest distance is the step, at least, where one step is common
    for part in (0.5, low):
        yield np.array([np.median(group_mm)]), np.array([np.quantile(step, part, method="lower")])
    ranges = 24  # most points of a step by range
    points = min(ranges, len(step) // LEAST_AT_RANGE)
    if points > 1:
        order = np.argsort(group_mm, kind="stable")
        parts = np.array_split(order, points)
        at = np.array([np.median(group_mm[some]) for some in parts])
        at, where = np.unique(at, return_index=True)
        yield _to_the_ends(group_mm, at, np.array([np.median(step[some]) for some in parts])[where])


def _to_the_ends(group_mm: FloatArray, at: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Continue a step by range to the nearest and farthest group: cells that are too narrow leave gaps between them."""
    if len(at) == 1:
        return at, step
    ends = np.array([group_mm.min(), group_mm.max()])
    slope = np.array([(step[1] - step[0]) / (at[1] - at[0]), (step[-1] - step[-2]) / (at[-1] - at[-2])])
    first, last = np.maximum(step[[0, -1]] + slope * (ends - at[[0, -1]]), 0.5 * step[[0, -1]])
    return np.concatenate([ends[:1], at, ends[1:]]), np.concatenate([[first], step, [last]])


def _agrees(found: _Distances, step: FloatArray, *, other: bool) -> bool:
    """Whether nearly all distances are whole multiples of the steps of their groups (group,).

    With `other`, the smallest distance of each group is no test, because the step was taken from it.
    """
    ratio, whole, tests = _multiples(found, step)
    near = np.abs(ratio - whole) <= NEAR
    tested, agreeing = int(tests.sum()), int((tests & near).sum())
    if other:
        tested, agreeing = tested - len(step), agreeing - len(step)
    # Part of the distances that agree with a step, at least: outliers and other surfaces may lie between two levels.
    least_agreeing = 0.9
    return tested >= LEAST_DISTANCES and agreeing >= least_agreeing * tested
