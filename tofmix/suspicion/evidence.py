"""From the samples of pixels to the evidence of suspicions: layers that come close in time, and the chance of that.

Use `gather_evidence` where the samples are in memory; the results travel with the layers of a block until the image is
whole. Each pixel is a pure function of its samples: frames in which it has none tell nothing of a layer.

Of n frames, m show a layer. If each set of m frames is as probable as any other, the chance (`log_chance`) that they
lie within some l frames is a number of sets; where a few of them lie outside, Bonferroni's inequality bounds it.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.layers import Layers
from tofmix.suspicion.frame_kinds import is_sampled
from tofmix.suspicion.scene import LONGEST, MOST_OUTSIDE, WindowSamples


@borrowing
def log_choose(n: float, k: float) -> float:
    """Log of the binomial coefficient, for real numbers; minus infinity where k is not within 0 and n."""
    if k < 0.0 or k > n:
        return -math.inf
    return math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k + 1.0)


@borrowing
def log_chance(frames: float, samples: float, outside: float, length: float) -> float:
    """Log of (a bound of) the chance that all but `outside` of the samples lie within some `length` frames.

    Parameters
    ----------
    frames, samples : float
        n and m; numbers of independent ones where frames have a memory.
    outside : float
        Samples outside the interval.
    length : float
        Length of the interval, frames.

    Returns
    -------
    float
        At most 0. The bounds for 0, 1, 2, ... samples outside are weighted by 1/2, 1/4, 1/8, ...: over all of them the
        chance of a false alarm is no larger than that of one.
    """
    weight = (outside + 1.0) * math.log(2.0)
    whole = log_choose(frames, samples)
    if outside <= 0.0:
        # Sets within the first l frames, and those that end at a later one.
        first = log_choose(length, samples) - whole
        later = log_choose(length - 1.0, samples - 1.0) - whole
        chance = math.exp(first) + max(frames - length, 0.0) * math.exp(later)
        return min(0.0, weight + math.log(chance)) if chance > 0.0 else -700.0
    total, missing = 0.0, outside
    while missing >= 0.0:
        inside = log_choose(length, samples - missing) + log_choose(frames - length, missing) - whole
        total += math.exp(inside)
        missing -= 1.0
    total *= frames - length + 1.0
    return min(0.0, weight + math.log(total)) if total > 0.0 else -700.0


@borrowing
def layer_of(
    value: float, count: int, mean: Float32Array, sigma: Float32Array, weight: Float32Array, circle: float
) -> int:
    """The layer that a sample is most probably of; -1 if it is far from all.

    `count` layers (layer,) are there; `circle` is the length of the circle that ranges are on, mm, or 0.
    """
    best, chosen = -math.inf, -1
    farthest_sigmas = 5.0  # a sample farther from a layer than this many of its sigma is not of it
    for i in range(count):
        away = value - mean[i]
        if circle > 0.0:
            away -= circle * round(away / circle)
        z = abs(away) / sigma[i]
        if z <= farthest_sigmas:
            density = math.log(max(weight[i], 1.0e-12) / sigma[i]) - 0.5 * z * z
            if density > best:
                best, chosen = density, i
    return chosen


WORTH_KEEPING = math.log(0.2)
"""Log of the chance from which on a layer is kept as a cluster in time: passing layers beside it may support it."""


def gather_evidence(
    range_mm: NDArray[np.floating],
    layers: Layers,
    *,
    targets: int = 1,
    circle_mm: float | None = None,
    place: tuple[int, int] = (0, 0),
    image: tuple[int, int] | None = None,
) -> WindowSamples:
    """Evidence of the samples of a block.

    Parameters
    ----------
    range_mm : (sample, row, col) array of float
        Samples, mm, not finite where invalid; the targets of a frame follow each other.
    layers : Layers
        Of the leading shape (row, col).
    targets : int
        Samples of a frame.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    place : (int, int)
        Row and column of the block's first pixel in the image.
    image : (int, int), optional
        Rows and columns of the image; without it, the block is the image.
    """
    shape, pixels = layers.shape, math.prod(layers.shape)
    samples = np.ascontiguousarray(range_mm, np.float32).reshape(-1, pixels)
    flat = layers.reshaped((pixels,))
    of_layers = flat.n_modes, flat.range, flat.sigma, flat.weight
    circle = 0.0 if circle_mm is None else float(circle_mm)
    with np.errstate(invalid="ignore"):
        # Share of a layer above which its frames are not looked at: with more it is not in less than half of them.
        most_share = 0.75
        found = np.flatnonzero((flat.weight <= most_share).any(-1))
    clusters, memory = _clusters(samples, found, targets, *of_layers, circle)
    row, col = np.divmod(clusters[:, 0], shape[1])
    sampled = _sampled(samples, flat.n_modes, targets, shape, place, image or (shape[0], shape[1]))
    return WindowSamples(np.column_stack([row, col, clusters[:, 1:]]), memory, sampled)


def _sampled(
    samples: Float32Array,
    n_modes: NDArray[np.uint8],
    targets: int,
    shape: tuple[int, ...],
    place: tuple[int, int],
    image: tuple[int, int],
) -> Float32Array:
    """Row, column and samples (n, 2 + frame) of the sampled pixels with more than one layer; the nearest of targets."""
    row, col = np.divmod(np.flatnonzero(n_modes > 1), shape[1])
    chosen = is_sampled(image, row + place[0], col + place[1])
    row, col = row[chosen], col[chosen]
    of_pixels = samples[:, row * shape[1] + col].reshape(len(samples) // targets, targets, len(row))
    nearest = np.fmin.reduce(of_pixels, axis=1)  # NaN only where all targets of a frame are
    return np.column_stack([row, col, nearest.T]).astype(np.float32)


@borrowing
def _signed(count: int) -> int:
    """A count of 8 bits as a signed number: numba takes a difference of signed and unsigned ones for a float."""
    return np.int64(count)  # type: ignore[return-value]  # an int to the compiler


@jit
def _clusters(
    samples: Float32Array,
    pixels: NDArray[np.int64],
    targets: int,
    n_modes: NDArray[np.uint8],
    mean: Float32Array,
    sigma: Float32Array,
    weight: Float32Array,
    circle: float,
) -> tuple[FloatArray, FloatArray]:
    """Layers of some pixels whose samples come close in time, and the memory (4,) of samples.

    A line (n, 8) of the former is the pixel, and `CLUSTER_FIELDS` from the layer on.
    """
    frames, most = samples.shape[0] // targets, mean.shape[1]
    rank = np.empty(frames, np.int64)
    where, count = np.empty((most, frames), np.int64), np.zeros(most, np.int64)
    found, memory = np.empty((len(pixels) * most, 8)), np.zeros(4)
    kept = 0
    for pixel in pixels:
        k = _signed(n_modes[pixel])
        used = float(_rank_frames(samples[:, pixel], targets, rank))
        of_pixel = mean[pixel], sigma[pixel], weight[pixel]
        _sort_by_layer(samples[:, pixel], targets, k, of_pixel, circle, rank, where, count, memory)
        for i in range(k):
            m = count[i]
            if m < 2 or m > LONGEST * used:  # noqa: PLR2004  one sample is no group
                continue
            line = found[kept]
            line[0], line[1], line[2], line[3] = pixel, i, used, m
            if _shortest(rank, where[i], m, line):
                kept += 1
                start = 0
                while where[i, start] < line[6]:
                    start += 1
                _add_pairs(rank, where[i], start, m - int(line[4]), memory)
            else:
                _add_pairs(rank, where[i], 0, m, memory)
    return found[:kept].copy(), memory


@borrowing
def _sort_by_layer(
    series: Float32Array,
    targets: int,
    k: int,
    of_pixel: tuple[Float32Array, Float32Array, Float32Array],
    circle: float,
    rank: NDArray[np.int64],
    where: NDArray[np.int64],
    count: NDArray[np.int64],
    memory: FloatArray,
) -> None:
    """Fill `where` (layer, frame) and `count` (layer,) with the frames that show each layer; add to the memory."""
    mean, sigma, weight = of_pixel
    main = 0
    for i in range(k):
        count[i] = 0
        if weight[i] > weight[main]:
            main = i
    before, at = 0.0, -2
    for t in range(len(series)):
        value = series[t]
        i = layer_of(value, k, mean, sigma, weight, circle) if math.isfinite(value) else -1
        frame = t // targets
        if i >= 0 and (count[i] == 0 or where[i, count[i] - 1] != frame):
            where[i, count[i]] = frame
            count[i] += 1
        if i == main:
            away = value - mean[i]
            if circle > 0.0:
                away -= circle * round(away / circle)
            away /= sigma[i]
            memory[1] += away * away
            if rank[frame] == at + 1:
                memory[0] += before * away
            before, at = away, rank[frame]


@borrowing
def _shortest(rank: NDArray[np.int64], where: NDArray[np.int64], m: int, line: FloatArray) -> bool:
    """Write the least probable interval of a layer's m frames to its line; False if none is worth keeping."""
    best = WORTH_KEEPING
    for outside in range(min(int(MOST_OUTSIDE * m), m - 2) + 1):
        for start in range(outside + 1):
            first, last = where[start], where[start + m - outside - 1]
            length = rank[last] - rank[first] + 1
            if length <= LONGEST * line[2]:
                chance = log_chance(line[2], float(m), float(outside), float(length))
                if chance < best:
                    best = chance
                    line[4], line[5], line[6], line[7] = outside, length, first, last
    return best < WORTH_KEEPING


@borrowing
def _add_pairs(rank: NDArray[np.int64], where: NDArray[np.int64], first: int, count: int, memory: FloatArray) -> None:
    """Add the pairs of consecutive frames among `count` frames from `first` on, beyond those of chance."""
    pairs = 0
    for at in range(first, first + count - 1):
        if rank[where[at + 1]] == rank[where[at]] + 1:
            pairs += 1
    length = rank[where[first + count - 1]] - rank[where[first]] + 1
    expected = count * (count - 1.0) / length
    memory[2] += pairs - expected
    memory[3] += count - 1.0 - expected


@borrowing
def _rank_frames(series: Float32Array, targets: int, rank: NDArray[np.int64]) -> int:
    """Fill `rank` (frame,) with how many frames before each have a sample; return how many have one."""
    used = 0
    for frame in range(len(rank)):
        rank[frame] = used
        for t in range(frame * targets, (frame + 1) * targets):
            if math.isfinite(series[t]):
                used += 1
                break
    return used


def warm_up(max_layers: int) -> None:
    """Compile the kernels, or load them from their cache."""
    layers = Layers.empty((1, 1), max_layers)
    samples: Any = np.full((3, 1, 1), 1000.0, np.float32)
    gather_evidence(samples, layers)
    log_chance(10.0, 3.0, 0.0, 4.0)  # as `passing` calls it
