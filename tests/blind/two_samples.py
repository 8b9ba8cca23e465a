"""Two tests of whether two recordings are of one distribution, which know neither model nor panel.

Use `two_samples` beside `blind.panel`, whose statistics are much like those of the command that it judges. One test is
the energy distance of each pixel's samples, the other asks how well a classifier tells the samples of the recordings
apart from what one sample, the one before it and its neighbours say. Both have a null by permutation: the recordings
swap whole blocks of frames, all pixels at once, and where noise has a memory the first frames of each block are left
out. So what pixels of a frame share, what lasts for some frames and what both recordings do at the same time belong to
the null. What lasts longer than a twentieth of the recording does not.

Use them not to say what differs, and not where fewer than 32 frames are there.

References
----------
Szekely and Rizzo (2013), Energy statistics. https://doi.org/10.1016/j.jspi.2013.03.018
Lopez-Paz and Oquab (2017), Revisiting classifier two-sample tests. https://arxiv.org/abs/1610.06545
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from blind.camera import Recording
from blind.geometry import Array

PERMUTATIONS = 99
"""A statistic above all of them is above the null's 99 % quantile."""

_LEAST_BLOCK = 5  # frames, or a part of the recording
_MOST_BLOCKS = 32
_BLOCKS = 16  # at least so many, which can be swapped in 2^15 ways
_GONE = 0.02  # autocorrelation that counts as none
_FOLDS = 4
_SAMPLES = 200_000  # that the classifier sees, of both recordings
_LEAST_SCALE = 0.5  # mm: below it the samples' whole millimetres rule
_NOTHING = 1e-6  # squared counts: pixels whose samples never differ
_CHUNK = 64  # pixels at a time: what fits in a processor's memory
_FAR = 6.0  # residuals are cut there
_RIDGE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Test:
    """One two-sample test."""

    __test__ = False  # for pytest

    name: str
    """`energy`: mean over the pixels; `energy_pixel`: the pixel that differs most; `classifier`."""
    value: float
    """Energy distances: without bias (0 by chance), in standard deviations of the null for `energy`, in median
    magnitudes under the swaps for `energy_pixel`. The classifier's area under the curve (0.5)."""
    limit: float
    """99 % quantile of the null, in the same unit."""
    p: float
    """Share of the permutations, the recordings as they are among them, that reach the value."""

    @property
    def differs(self) -> bool:
        """Whether the recordings differ at the level of 1 %."""
        return self.value > self.limit


def two_samples(a: Recording, b: Recording, *, seed: int = 0, permutations: int = PERMUTATIONS) -> list[Test]:
    """Compare two recordings of the same image; frames that only one of them has are left out."""
    frames = min(len(a.range_mm), len(b.range_mm))
    rng = np.random.default_rng([seed, 72])
    pair = np.stack([a.range_mm[:frames], b.range_mm[:frames]]).astype(np.float32)
    residual, valid, middle = _residuals(pair)
    length, gap = blocks_of(residual)
    block = np.arange(frames) // length
    swaps = np.ones((permutations + 1, int(block[-1]) + 1), dtype=np.int8)  # row 0: the recordings as they are
    swaps[1:] = rng.choice(np.array([-1, 1], dtype=np.int8), size=swaps[1:].shape)
    apart = np.arange(frames) % length >= gap
    tests = list(_energy(pair[:, apart], valid[:, apart], middle, block[apart], swaps))
    inside = np.flatnonzero(np.arange(frames) % length >= max(gap, 1))  # the frame before is of the same block
    return [*tests, _classifier(residual, valid, middle, inside, block[inside], swaps, rng)]


def blocks_of(residual: Array) -> tuple[int, int]:
    """Length of the blocks, frames, and how many frames at the begin of each are left out.

    These are as many as the difference of two recordings' residuals (2, frame, row, col) remembers, so that blocks are
    independent. Looked at are the samples themselves, and the frames' mean and mean magnitude, for what pixels share.
    """
    frames = residual.shape[1]
    difference = (residual[0] - residual[1]).reshape(frames, -1)
    size = np.abs(residual).mean(axis=(2, 3))
    series = [
        (difference, _GONE),
        (difference.mean(axis=1, keepdims=True), max(_GONE, 3 / np.sqrt(frames))),
        ((size[0] - size[1])[:, None], max(_GONE, 3 / np.sqrt(frames))),
    ]
    longest = max(2, frames // _BLOCKS)
    lag = max(_memory(values, limit, longest) for values, limit in series)
    length = min(longest, max(_LEAST_BLOCK, frames // _MOST_BLOCKS, 3 * lag))
    return length, min(lag, length // 2)


def _memory(values: Array, limit: float, longest: int) -> int:
    """The last lag before the autocorrelation (frame, series) first falls below a limit."""
    values = values - values.mean(axis=0)
    power = max(float((values**2).sum()), 1e-30)
    for lag in range(1, longest):
        if float((values[lag:] * values[:-lag]).sum()) < limit * power:
            return lag - 1
    return longest


def _residuals(pair: Array) -> tuple[Array, Array, Array]:
    """Residuals (2, frame, row, col) from each pixel's median in units of its noise, which are valid, and the medians.

    Median and noise are of both recordings together; a lost sample has the residual 0.
    """
    valid = np.isfinite(pair)
    merged = np.sort(pair.reshape(-1, *pair.shape[2:]), axis=0)  # NaN last
    count = valid.sum(axis=(0, 1))

    def quantile(share: float) -> Array:
        index = np.clip((share * count).astype(np.int64), 0, len(merged) - 1)
        return np.asarray(np.nan_to_num(np.take_along_axis(merged, index[None], 0)[0]))

    middle = quantile(0.5)
    scale = np.maximum((quantile(0.84) - quantile(0.16)) / 2, np.float32(_LEAST_SCALE))
    residual = np.where(valid, np.clip((pair - middle) / scale, -_FAR, _FAR), 0).astype(np.float32)
    return residual, valid, middle


def _energy(pair: Array, valid: Array, middle: Array, block: Array, swaps: Array) -> Iterator[Test]:
    """Energy distances of all pixels under all swaps.

    In one dimension the energy distance is twice the integral of the squared difference of the distribution functions,
    which is a quadratic form in the signs of the blocks. Squares of the signs are left out, as no swap changes them:
    what remains has the mean 0 by chance. A lost sample stands at the pixel's median and adds the distance of the
    shares that are lost.
    """
    frames, blocks = pair.shape[1], swaps.shape[1]
    samples = np.where(valid, pair, middle).reshape(2 * frames, -1).T
    lost = np.repeat([1, -1], frames)[:, None] * (~valid).reshape(2 * frames, -1)
    lost = np.stack([lost[np.tile(block == k, 2)].sum(axis=0) for k in range(blocks)]).astype(np.float32)
    first, second = np.triu_indices(blocks, 1)
    both = (swaps[:, first] * swaps[:, second]).astype(np.float32)
    distance = np.empty((len(swaps), len(samples)), np.float32)
    for start in range(0, len(samples), _CHUNK):
        part = slice(start, start + _CHUNK)
        form = _forms(samples[part], block, blocks)[:, first, second] + (lost[first, part] * lost[second, part]).T
        distance[:, part] = both @ form.T
    spread = np.median(np.abs(distance), axis=0)  # of all swaps: one that stands out does not hide itself
    some = spread > _NOTHING
    ratio = distance[:, some] / spread[some] if some.any() else np.zeros((len(swaps), 1))
    yield _result("energy", ratio.mean(axis=1), unit=float(ratio[1:].mean(axis=1).std()))
    yield _result("energy_pixel", ratio.max(axis=1))


def _forms(samples: Array, block: Array, blocks: int) -> Array:
    """The quadratic form (pixel, block, block) of each pixel's energy distance, in units of its samples' spread."""
    pixels, count = samples.shape
    order = np.argsort(samples, axis=1)
    step = np.diff(np.take_along_axis(samples, order, 1), axis=1)
    place = np.arange(1, count, dtype=np.float32)
    spread = 2 * (step @ (place * (count - place))) / count**2  # mean distance of two samples
    step /= np.maximum(spread, _LEAST_SCALE)[:, None]
    apart = np.zeros((pixels, blocks, count), np.float32)
    sign = np.where(order < len(block), np.float32(1), np.float32(-1))
    apart[np.arange(pixels)[:, None], np.tile(block, 2)[order], np.arange(count)] = sign
    apart = np.cumsum(apart, axis=2, dtype=np.float32)[:, :, :-1]
    return np.asarray((apart * step[:, None]) @ apart.transpose(0, 2, 1))


def _result(name: str, values: Array, *, unit: float = 1.0) -> Test:
    """A test from its values under all swaps; the first is that of the recordings."""
    value, null = float(values[0]), np.sort(values[1:])
    limit = null[min(int(np.ceil(0.99 * (len(null) + 1))), len(null)) - 1]
    unit = unit if unit > 0 else 1.0
    p = (1 + (null >= value).sum()) / (1 + len(null))
    return Test(name=name, value=value / unit, limit=float(limit) / unit, p=float(p))


def _classifier(
    residual: Array,
    valid: Array,
    middle: Array,
    inside: Array,
    block: Array,
    swaps: Array,
    rng: np.random.Generator,
) -> Test:
    """Area under the curve of a logistic regression, in blocks of frames that it has not seen.

    `inside` are the frames whose samples it sees, `block` is which block each of them is of. The regression is one
    Newton step from zero, which is Fisher's discriminant: a swap of labels costs no new fit.
    """
    count = min(middle.size, max(1, _SAMPLES // (2 * inside.size)))
    chosen = np.sort(rng.choice(middle.size, count, replace=False))
    seen_by = features(residual, valid, middle, chosen)
    x = np.stack([feature[:, inside] for feature in seen_by], axis=-1)  # (2, frame, pixel, feature)
    kinds = x.shape[-1]
    x -= x.mean(axis=(0, 1, 2))
    x /= np.maximum(x.std(axis=(0, 1, 2)), 1e-6)
    change = x[0].sum(axis=1) - x[1].sum(axis=1)  # (frame, feature)
    sums = np.stack([change[block == k].sum(axis=0) for k in range(swaps.shape[1])])
    area = np.zeros(len(swaps))
    for fold in range(_FOLDS):
        held = block * _FOLDS // swaps.shape[1] == fold
        seen = x[:, ~held].reshape(-1, kinds)
        gram = (seen.T @ seen).astype(np.float64) + _RIDGE * len(seen) * np.eye(kinds)
        towards = (swaps * (np.arange(swaps.shape[1]) * _FOLDS // swaps.shape[1] != fold)).astype(np.float64) @ sums
        weights = np.linalg.solve(gram, towards.T).astype(np.float32)
        score = (x[:, held].reshape(-1, kinds) @ weights).T
        label = np.repeat(swaps[:, block[held]], count, axis=1) > 0
        label = np.concatenate([label, ~label], axis=1)
        area += [_area(*swap) for swap in zip(score, label, strict=True)]
    area /= _FOLDS
    return _result("classifier", area)


def _area(score: Array, first: Array) -> float:
    """Area under the receiver operating characteristic."""
    ranked = first[np.argsort(score)]
    behind = np.cumsum(~ranked)
    return float(behind[ranked].sum() / max(int(ranked.sum()) * int(behind[-1]), 1))


def features(residual: Array, valid: Array, middle: Array, chosen: Array) -> Iterator[Array]:
    """What the classifier sees of the samples of the chosen pixels, each (2, frame, pixel).

    The residual and its powers, the change from the frame before, the neighbours, what is lost; residual and magnitude
    over range, place and time; and their products with the frame's mean residual and magnitude, for what pixels share.
    """
    rows, cols = middle.shape

    def pick(image: Array) -> Array:
        return np.asarray(image.reshape(*image.shape[:-2], -1)[..., chosen])

    u, here = pick(residual), pick(valid).astype(np.float32)
    size, near = np.abs(u), pick(_neighbours(residual))
    there = pick(_neighbours(valid.astype(np.float32)))
    common = residual.mean(axis=(2, 3))[..., None]
    loud = np.abs(residual).mean(axis=(2, 3))[..., None]
    before = np.concatenate([u[:, :1], u[:, :-1]], axis=1)
    yield from (u, size, u**2, u**3, (size > 3).astype(np.float32), (size >= _FAR).astype(np.float32))
    yield from (before, np.abs(u - before), u * before)
    yield from (near, np.abs(near), u * near, u * common, (size - size.mean(axis=(0, 1))) * (loud - loud.mean()))
    yield from (here, there, here * there)
    row, col = (x.ravel() for x in np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij"))
    rank = np.argsort(np.argsort(middle.ravel())) / max(middle.size - 1, 1) - 0.5
    time = np.linspace(-1, 1, u.shape[1])[:, None]
    for over in (row[chosen], col[chosen], np.hypot(row, col)[chosen], rank[chosen], rank[chosen] ** 2, time):
        yield u * over.astype(np.float32)
        yield size * over.astype(np.float32)


def _neighbours(image: Array) -> Array:
    """Mean of the four neighbours (2, frame, row, col), the edge repeated."""
    wide = np.pad(image, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")
    out: Array = wide[..., :-2, 1:-1] + wide[..., 2:, 1:-1] + wide[..., 1:-1, :-2] + wide[..., 1:-1, 2:]
    return out / np.float32(4)
