"""In how many ways two recordings of one scene differ.

Use `compare` for a list of statistics, each with its distance in units of what chance gives (1 where nothing
differs) and its z-score, and `gap` for their root mean square. The panel knows no model and no truth. Most of it is
free of distributions: the samples of a pixel from both recordings are ranked together, and the ranks' normal scores
are averaged over one recording; what such averages do by chance follows from the permutations of the samples.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from blind.camera import Recording
from blind.geometry import Array

_SHAPES = ("bias", "spread", "skew", "tails")
_LEAST = 20  # samples that a pixel must have in each recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """One line of the panel."""

    statistic: str
    axis: str
    """`statistic`, `axis`: what is compared, and over what; `map` is pixel by pixel."""
    distance: float
    """In units of its chance level: root mean square deviation over the bins; 1 by chance."""
    z: float
    """Standard normal by chance, large where the recordings differ."""


def compare(a: Recording, b: Recording, *, seed: int = 0) -> list[Statistic]:
    """Compare two recordings of the same size."""
    frames = min(len(a.range_mm), len(b.range_mm))
    pixels = a.range_mm[0].size
    rng = np.random.default_rng([seed, 71])
    x, y = (r.range_mm[:frames].reshape(frames, pixels).astype(np.float32) for r in (a, b))
    axes = _Axes(x, y, b, a.range_mm.shape[1:])
    out = list(_invalid(x, y, axes))
    out += _discreteness(x, y)
    x += rng.random(x.shape, dtype=np.float32) - np.float32(0.5)
    y += rng.random(y.shape, dtype=np.float32) - np.float32(0.5)
    usable = (np.isfinite(x).sum(axis=0) >= _LEAST) & (np.isfinite(y).sum(axis=0) >= _LEAST)
    axes.keep(usable)
    x, y = x[:, usable], y[:, usable]
    out += _wasserstein(x, y, axes, rng)
    out += _extremes(x, y)
    out += _shapes(x, y, axes)
    out += _in_time(x, y, usable, a.range_mm.shape[1:])
    return out


def gap(panel: list[Statistic]) -> float:
    """Root mean square of the distances: 1 by chance."""
    return float(np.sqrt(np.mean([s.distance**2 for s in panel])))


def _chi2(statistic: str, axis: str, chi2: float, dof: float, *, spread: float = 1.0) -> Statistic:
    """A chi-square's distance and (Wilson and Hilferty's) z; `spread`: variance in units of 2 dof."""
    if dof == 0:  # nothing to compare
        return Statistic(statistic=statistic, axis=axis, distance=1.0, z=0.0)
    ratio, part = chi2 / dof, 2 * spread / (9 * dof)
    z = (np.cbrt(ratio) - (1 - part)) / np.sqrt(part)
    return Statistic(statistic=statistic, axis=axis, distance=float(np.sqrt(ratio)), z=float(z))


def _normal(statistic: str, axis: str, z: float) -> Statistic:
    return Statistic(statistic=statistic, axis=axis, distance=abs(float(z)), z=abs(float(z)))


class _Axes:
    """Bins of pixels over range, amplitude, place and contrast; from both recordings alike."""

    def __init__(self, x: Array, y: Array, b: Recording, image: tuple[int, ...]) -> None:
        rows, cols = image
        with np.errstate(all="ignore"):
            middle = _median(np.concatenate([x[::4], y[::4]]))
        amplitude = np.nan_to_num(b.amplitude.mean(axis=0).ravel())
        row, col = np.divmod(np.arange(rows * cols), cols)
        radius = np.hypot(row - (rows - 1) / 2, col - (cols - 1) / 2)
        near = np.pad(middle.reshape(rows, cols), 1, mode="edge")
        center = near[1:-1, 1:-1]
        steps = [np.abs(near[i : i + rows, j : j + cols] - center) for i, j in ((0, 1), (2, 1), (1, 0), (1, 2))]
        contrast = np.max(steps, axis=0).ravel()
        self.bins = {
            "all": np.zeros(rows * cols, int),
            "range": _equal_parts(middle, 12),
            "amplitude": _equal_parts(amplitude, 10),
            "row": row * 8 // rows,
            "col": col * 8 // cols,
            "radius": _equal_parts(radius, 8),
            "neighbour_contrast": np.digitize(contrast, np.quantile(contrast, [0.5, 0.8, 0.9, 0.95])),
        }
        self.edges = contrast >= np.quantile(contrast, 0.9)

    def keep(self, usable: Array) -> None:
        self.bins = {axis: bins[usable] for axis, bins in self.bins.items()}
        self.edges = self.edges[usable]


def _median(values: Array) -> Array:
    """Median along frames, without NaN; 0 where nothing is valid."""
    values = np.sort(values, axis=0)
    count = np.isfinite(values).sum(axis=0)
    return np.asarray(np.nan_to_num(np.take_along_axis(values, np.maximum(count // 2, 0)[None] * (count > 0), 0)[0]))


def _equal_parts(values: Array, parts: int) -> Array:
    return np.asarray(np.digitize(values, np.quantile(values, np.arange(1, parts) / parts)))


def _invalid(x: Array, y: Array, axes: _Axes) -> Iterator[Statistic]:
    """Counts of lost samples: given their sum, either half is as likely."""
    lost = [np.isnan(v) for v in (x, y)]
    per_pixel = [v.sum(axis=0) for v in lost]
    for axis, bins in {**axes.bins, "map": np.arange(x.shape[1])}.items():
        yield _counts("invalid", axis, *(np.bincount(bins, v) for v in per_pixel))
    yield _counts("invalid", "frame", *(v.sum(axis=1) for v in lost))


def _counts(statistic: str, axis: str, a: Array, b: Array) -> Statistic:
    some = (a + b) > 0
    return _chi2(statistic, axis, float(((a - b)[some] ** 2 / (a + b)[some]).sum()), int(some.sum()))


def _discreteness(x: Array, y: Array) -> Iterator[Statistic]:
    """Fine structure of the values: each millimetre's count against its neighbours', in one recording and the other."""
    top = int(max(np.nanmax(x), np.nanmax(y))) + 3
    count = [
        np.bincount(np.maximum(v[np.isfinite(v)], 0).astype(np.int64), minlength=top).astype(float) for v in (x, y)
    ]
    curl = [h[1:-1] - (h[:-2] + h[2:]) / 2 for h in count]
    both = count[0] + count[1]
    variance = both[1:-1] + (both[:-2] + both[2:]) / 4
    full = variance >= 100
    chi2 = float(((curl[0] - curl[1])[full] ** 2 / variance[full]).sum())
    yield _chi2("discreteness", "all", chi2, int(full.sum()), spread=1.944)  # neighbours share counts


def _wasserstein(x: Array, y: Array, axes: _Axes, rng: np.random.Generator) -> Iterator[Statistic]:
    """Wasserstein distance of each pixel's two distributions, against that of two random halves of all its samples."""
    pooled = np.concatenate([x, y]).T
    label = np.zeros(pooled.shape, dtype=np.int8)
    label[:, : len(x)] = 1
    order = np.argsort(pooled, axis=1)
    pooled = np.take_along_axis(pooled, order, 1)
    label = np.take_along_axis(label, order, 1)
    valid = np.isfinite(pooled)
    step = np.where(valid[:, 1:], np.diff(np.where(valid, pooled, 0), axis=1), 0)
    scale = np.maximum(step.sum(axis=1), 1.0)

    def distance(first: Array) -> Array:
        a = np.cumsum(first * valid, axis=1, dtype=np.int32)[:, :-1]
        b = np.cumsum((1 - first) * valid, axis=1, dtype=np.int32)[:, :-1]
        full_a, full_b = np.maximum(a[:, -1:], 1), np.maximum(b[:, -1:], 1)
        return np.asarray((np.abs(a / full_a - b / full_b) * step).sum(axis=1) / scale)

    seen = distance(label)
    by_chance = [distance(_shuffled(label, valid, rng)) for _ in range(2)]
    for axis, part in (("map", np.ones(seen.size, dtype=bool)), ("neighbour_contrast", axes.edges)):
        null = np.concatenate([w[part] for w in by_chance])
        z = (seen[part].mean() - null.mean()) / (null.std() * np.sqrt(1.5 / part.sum()))
        level = np.sqrt((seen[part] ** 2).mean() / (null**2).mean())
        yield Statistic(statistic="wasserstein", axis=axis, distance=float(level), z=float(z))


def _shuffled(label: Array, valid: Array, rng: np.random.Generator) -> Array:
    """Labels dealt out anew among each pixel's valid samples."""
    if valid.all():
        return np.asarray(rng.permuted(label, axis=1))
    key = np.where(valid, rng.random(label.shape, dtype=np.float32), np.float32(2.0))
    return np.take_along_axis(label, np.argsort(key, axis=1), 1)


def _extremes(x: Array, y: Array) -> Iterator[Statistic]:
    """Samples far outside their pixel's own spread (pixels with many are left out), and pixels without any spread."""
    pooled = np.concatenate([x, y])
    low, middle, high = np.nanquantile(pooled[::3], [0.25, 0.5, 0.75], axis=0)
    limit = 5.0 * np.maximum(high - low, 1.0) / 1.349
    far = [np.abs(v - middle) > limit for v in (x, y)]
    rare = (far[0].sum(axis=0) + far[1].sum(axis=0)) < 0.05 * len(pooled)
    yield _counts("tails", "extremes", *(np.array([v[:, rare].sum()]) for v in far))
    fixed = [np.array([(np.nanmax(v, axis=0) - np.nanmin(v, axis=0) < 1.5).sum()]) for v in (x, y)]
    yield _counts("pattern", "constant pixels", *fixed)


def _scores(pooled: Array) -> Array:
    """Normal scores (sample, pixel) of ranks within each pixel; NaN where invalid."""
    order = np.argsort(pooled, axis=0)
    rank = np.empty(pooled.shape, np.float32)
    np.put_along_axis(rank, order, np.arange(len(pooled), dtype=np.float32)[:, None], 0)
    valid = np.isfinite(pooled)
    score: Array = ndtri((np.where(valid, rank, 0) + np.float32(0.5)) / valid.sum(axis=0))
    score[~valid] = np.nan
    return score


def _hermite(score: Array) -> Iterator[Array]:
    square = score**2
    yield score
    yield (square - 1) / np.sqrt(2.0)
    yield (square - 3) * score / np.sqrt(6.0)
    yield (square * (square - 6) + 3) / np.sqrt(24.0)


def _shapes(x: Array, y: Array, axes: _Axes) -> Iterator[Statistic]:
    """Location, spread, skew and tails of the normal scores: by pixel, and summed over bins of pixels."""
    score = _scores(np.concatenate([x, y]))
    frames = len(x)
    for name, power in zip(_SHAPES, _hermite(score), strict=True):
        n_a, n_b = (np.isfinite(part).sum(axis=0) for part in (power[:frames], power[frames:]))
        difference = np.nanmean(power[:frames], axis=0) - np.nanmean(power[frames:], axis=0)
        n = n_a + n_b
        variance = np.nanvar(power, axis=0) * n / (n - 1) * (1 / n_a + 1 / n_b)
        yield _chi2(name, "map", float((difference**2 / variance).sum()), difference.size)
        for axis, bins in axes.bins.items():
            total, noise = np.bincount(bins, difference), np.bincount(bins, variance)
            some = noise > 0
            yield _chi2(name, axis, float((total[some] ** 2 / noise[some]).sum()), int(some.sum()))


def _in_time(x: Array, y: Array, usable: Array, image: tuple[int, ...]) -> Iterator[Statistic]:
    """Memory, trend, common mode, bursts and neighbours: each recording by itself, then one against the other."""
    found = []
    for v in (x, y):
        score = np.nan_to_num(_scores(v)).astype(np.float32)
        score -= score.mean(axis=0)
        score /= np.maximum(score.std(axis=0), 0.1)
        found.append((_series(score), _moments(score, usable, image)))
    (series_a, moments_a), (series_b, moments_b) = found
    for (name, axis), (a, variance, dof) in series_a.items():
        b, other, _ = series_b[name, axis]
        chi2 = float(((a - b) ** 2 / (variance + other)).sum() / dof * a.size)
        yield _chi2(name, axis, chi2, a.size)
    for (name, axis), (value, chance) in moments_a.items():
        again, chance_b = moments_b[name, axis]
        apart = np.log(value / again) if (name, axis) in _VARIANCES else value - again
        yield _normal(name, axis, apart / np.sqrt(chance + chance_b))


_VARIANCES = (("common_mode", "frame"), ("bursts", "frame"), ("common_mode", "row"))  # compared by their ratio
_Series = dict[tuple[str, str], tuple[Array, Array, float]]


def _series(score: Array) -> _Series:
    """Means over a tenth of the frames, all pixels; slopes of each pixel. Values, variances, degrees of freedom."""
    frames, pixels = score.shape
    part = np.arange(frames) * 10 // frames
    size = np.bincount(part)
    now = np.linspace(-1, 1, frames, dtype=np.float32)
    square = (score**2 - 1) / np.sqrt(2.0)
    slope = now @ score / np.sqrt((now**2).sum())
    out: _Series = {("trend", "map"): (slope, np.ones(pixels), float(pixels))}
    for name, values in (("trend", score), ("spread", square)):
        frame = values.mean(axis=1)
        noise = (np.diff(frame) ** 2).mean() / 2  # frames may jitter together; a slow trend does not count as noise
        out[name, "frame"] = (np.bincount(part, frame) / size, noise / size, 9.0)
    return out


def _moments(score: Array, usable: Array, image: tuple[int, ...]) -> dict[tuple[str, str], tuple[float, float]]:
    """Second moments with their variances by chance."""
    frames, pixels = score.shape
    n = score.size
    square = score**2 - 1
    square /= square.std()
    out = {
        ("memory", "lag 1"): (float((score[1:] * score[:-1]).sum() / n), 1 / n),
        ("memory", "lag 2"): (float((score[2:] * score[:-2]).sum() / n), 1 / n),
        ("common_mode", "frame"): (float((score.mean(axis=1) ** 2).mean() * pixels), 2 / frames),
        ("bursts", "frame"): (float((square.mean(axis=1) ** 2).mean() * pixels), 2 / frames),
    }
    cube = np.zeros((frames, *image), np.float32)
    cube.reshape(frames, -1)[:, usable] = score
    rows = cube.mean(axis=2)
    there = usable.reshape(image).sum(axis=1) / image[1]
    level = (rows - rows.mean(axis=1, keepdims=True)) ** 2 * image[1] / np.maximum(there, 1 / image[1])
    out["common_mode", "row"] = (float(level[:, there > 0].mean()), 2 / (frames * (there > 0).sum()))
    out["neighbour_correlation", "col"] = (float((cube[:, :, 1:] * cube[:, :, :-1]).sum() / n), 1 / n)
    out["neighbour_correlation", "row"] = (float((cube[:, 1:] * cube[:, :-1]).sum() / n), 1 / n)
    return out
