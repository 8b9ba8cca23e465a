"""The samples behind running means: y_t = (x_t + ... + x_(t-m+1)) / m, solved for x.

m (y_t - y_(t-1)) = x_t - x_(t-m), so the samples of each *chain*, the frames t, t + m, t + 2 m, ..., are known but for
one common offset, and any m consecutive samples have the mean y. The m - 1 unknown offsets are those that give all
chains the same density: every chain has samples of the same surfaces. They maximise the likelihood of each chain's
samples under a kernel density of the others', whose width is the noise of a sample.

Stored means are rounded: the errors of their differences add up along a chain, and its samples are whole multiples of m
steps apart. With the surfaces given, samples and rounding are Gaussian. Samples are drawn from their posterior, so that
they have the noise of samples.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.jit import jit

_NOTHING = 1e-9  # density that is left of kernels that were taken away
_REACH = 6  # bins on either side of a sample that its kernel reaches
_NARROW = 0.5  # of the noise that differences give


@jit
def samples_of_means(
    means: FloatArray, window: int, only_sure: bool, normal: FloatArray, noise: FloatArray
) -> FloatArray:
    """Samples (pixel, frame) of running means (pixel, frame) over `window` frames; NaN where they are not known.

    A run of valid means is solved by itself. It is unknown if it is short, and with `only_sure` if its samples are more
    probably others. `normal` (n,) are standard normal values, from which rounded samples are drawn: those from a place
    on that the means give. `noise` (pixel,) is the sd of a sample, 0 where it is not known.
    """
    pixels, frames = means.shape
    out = np.full((pixels, frames), np.nan)
    least_windows = 3  # a run of fewer windows has too few samples a chain: its samples are not sought
    for pixel in range(pixels):
        first = 0
        for t in range(frames + 1):
            if t == frames or not math.isfinite(means[pixel, t]):
                if t - first >= least_windows * window:
                    _solve(means[pixel, first:t], window, out[pixel, first:t], only_sure, normal, noise[pixel])
                first = t + 1
    return out


@jit
def _solve(means: FloatArray, m: int, out: FloatArray, only_sure: bool, normal: FloatArray, noise_mm: float) -> None:
    """Fill `out` with the samples of a run of means; `noise_mm` is 0 where it is not known."""
    n = len(means)
    for t in range(n):
        out[t] = 0.0 if t < m else out[t - m] + m * (means[t] - means[t - 1])
    changes = np.empty(n - m)
    for t in range(m, n):
        changes[t - m] = out[t] - out[t - m]
    sigma = _noise(changes)
    rounding = m * _step(means) / math.sqrt(12.0)  # sd of m times the rounding of a mean
    least_part = 0.1  # of the step of samples: no less noise is told
    own = math.sqrt(max(sigma * sigma - rounding * rounding, 12.0 * (least_part * rounding) ** 2))
    added = rounding * math.sqrt(n / (3.0 * m))  # sd of rounding that has added up, less the mean of a chain
    matters = added > least_part * sigma
    if sigma > 0.0:
        if matters:
            sigma = math.hypot(own, added)
        # Changes between near surfaces look like noise: the width of the kernels is the one of higher likelihood.
        noise, narrow = sigma, out.copy()
        probability, likelihood = _align(out, m, sigma)
        narrow_probability, narrow_likelihood = _align(narrow, m, _NARROW * sigma)
        if narrow_likelihood > likelihood:
            sigma *= _NARROW
            probability = narrow_probability
            out[:] = narrow
        _refine(out, m, sigma)
        # Samples that a chain has at least where samples are of several surfaces: fewer do not tell of which they are.
        least_of_several = 7
        gap = 4.0  # sigmas between neighbouring samples of two surfaces
        too_few = n < least_of_several * m and np.diff(np.sort(out)).max() > gap * noise
        # Samples are known if their chains are more probably where they are put than elsewhere. A chain whose samples
        # are all of one surface may be of another one instead.
        least_probability = 0.5
        if only_sure and (too_few or probability < least_probability):
            out[:] = np.nan
            return
    total = 0.0
    for t in range(m):
        total += out[t]
    shift = means[m - 1] - total / m
    for t in range(n):
        out[t] += shift
    if matters:
        near = max(sigma, own)
        _draw(means, m, out, own if noise_mm <= 0.0 else noise_mm, near, rounding, normal, noise_mm > 0.0)


@jit
def _noise(changes: FloatArray) -> float:
    """Sigma of a sample from the changes between samples of the same chain.

    Changes within a surface are Gaussian, others are anywhere up to twice the largest: EM of the two, from the
    smallest eighth on, as with three surfaces a third of the changes are within one.
    """
    size = np.sort(np.abs(changes))
    n, most = len(size), size[-1]
    if most == 0.0:
        return 0.0
    least = most
    for value in size:
        if value > 0.0:
            least = value
            break
    sigma, share = max(0.5 * size[n // 8] / 0.1573, least), 0.7
    em_steps = 20  # at most
    for _ in range(em_steps):
        weight, square = 0.0, 0.0
        for value in size:
            same = share * math.exp(-0.5 * (value / sigma) ** 2) / (sigma * 2.5066)
            other = (1.0 - share) / (4.0 * most)  # twice the largest changes: single surfaces keep their tails
            part = same / (same + other)
            weight += part
            square += part * value * value
        share = min(max(weight / n, 0.2), 0.99)
        new = max(math.sqrt(square / max(weight, 1e-12)), 0.4 * least)
        if abs(new - sigma) < 0.01 * sigma:
            sigma = new
            break
        sigma = new
    return float(sigma / math.sqrt(2.0))


class _Bins(NamedTuple):
    """Bins of ranges: that of each sample (frame,) in its chain; heights of a kernel; density; scores of a chain."""

    at: IntArray
    kernel: FloatArray
    density: FloatArray
    score: FloatArray


@jit
def _align(out: FloatArray, m: int, sigma: float) -> tuple[float, float]:
    """Move each chain of `out` to where the others' density explains it best, to half a sigma.

    Return the probability that all are right, and the log likelihood of all samples under the densities of the others.
    """
    n = len(out)
    low, span = np.empty(m), np.empty(m)
    for c in range(m):
        low[c] = out[c::m].min()
        span[c] = out[c::m].max() - low[c]
    most_bins = 20_000.0  # of all chains: an error of a sample may be as large as a range
    step = max(sigma / 2.0, span.sum() * 2.0 / most_bins)  # two bins of the density in a sigma
    bins = _new_bins(out, low, span, step, sigma)
    order = np.argsort(-span)  # chains of several surfaces come first
    place, best_place = np.zeros(m, dtype=np.int64), np.zeros(m, dtype=np.int64)
    best = -np.inf
    starts = 3  # chains that the others are put to in turn
    for start in range(min(starts, m)):
        _put_one_by_one(bins, order, start, place)
        total = _improve(bins, place)
        if total > best + _NOTHING:
            best = total
            best_place[:] = place
    for t in range(n):
        out[t] += best_place[t % m] * step - low[t % m]
    return _probability_of_all(bins, best_place), best - n * math.log(sigma)


@jit
def _new_bins(out: FloatArray, low: FloatArray, span: FloatArray, step: float, sigma: float) -> _Bins:
    """Bins for chains one beside the other: they cannot come farther apart."""
    m, n = len(low), len(out)
    size = 2 * (int(span.sum() / step) + m * (2 * _REACH + 2)) + 1
    at = np.empty(n, dtype=np.int64)
    for t in range(n):
        at[t] = int((out[t] - low[t % m]) / step + 0.5)
    kernel = np.empty(2 * _REACH + 1)
    for k in range(-_REACH, _REACH + 1):
        kernel[k + _REACH] = math.exp(-0.5 * (k * step / sigma) ** 2)
    return _Bins(at, kernel, np.zeros(size), np.zeros(size))


@jit
def _put_one_by_one(bins: _Bins, order: IntArray, start: int, place: IntArray) -> None:
    """Put one chain in the middle, and each of the others where those before explain it best; fill their places."""
    bins.density[:] = 0.0
    m = len(order)
    first = order[start]
    place[first] = len(bins.density) // 2
    _put(bins, first, m, place[first], 1.0)
    for c in order:
        if c != first:
            place[c], _ = _best_place(bins, c, m)
            _put(bins, c, m, place[c], 1.0)


@jit
def _improve(bins: _Bins, place: IntArray) -> float:
    """Move one chain after the other to where all others explain it best; return the log likelihood of all."""
    m, total = len(place), 0.0
    sweeps = 8  # of improving one offset after the other, at most
    for _ in range(sweeps):
        is_changed, total = False, 0.0
        for c in range(m):
            _put(bins, c, m, place[c], -1.0)
            new, gain = _best_place(bins, c, m)
            total += gain
            is_changed = is_changed or new != place[c]
            place[c] = new
            _put(bins, c, m, new, 1.0)
        if not is_changed:
            break
    return total


@jit
def _probability_of_all(bins: _Bins, place: IntArray) -> float:
    """Probability that every chain is where it is, the others given."""
    bins.density[:] = 0.0
    m, probability = len(place), 1.0
    for c in range(m):
        _put(bins, c, m, place[c], 1.0)
    for c in range(m):
        _put(bins, c, m, place[c], -1.0)
        probability *= _probability(bins, c, m, place[c])
        _put(bins, c, m, place[c], 1.0)
    return probability


@jit
def _put(bins: _Bins, c: int, m: int, place: int, sign: float) -> None:
    """Add the kernels of a chain's samples to the density, or take them away."""
    for t in range(c, len(bins.at), m):
        middle = place + bins.at[t]
        for k in range(-_REACH, _REACH + 1):
            bins.density[middle + k] += sign * bins.kernel[k + _REACH]


@jit
def _score_places(bins: _Bins, c: int, m: int) -> tuple[int, int]:
    """Fill the log likelihood of a chain by the bin of its lowest sample, over that where it is alone.

    Return the first and last of these bins. Only bins where the density is not 0 add to it.
    """
    at, density, score = bins.at, bins.density, bins.score
    size, length = len(density), 0
    for t in range(c, len(at), m):
        length = max(length, at[t])
    score[:] = 0.0
    first, last = size, 0
    unknown = 0.01  # kernels' heights that the density has everywhere: a sample may be alone
    for i in range(size):
        if density[i] > _NOTHING:
            first, last = min(first, i), i
            gain = math.log1p(density[i] / unknown)
            for t in range(c, len(at), m):
                if i >= at[t]:
                    score[i - at[t]] += gain
    return max(first - length, _REACH), min(last, size - 1 - length - _REACH)


@jit
def _best_place(bins: _Bins, c: int, m: int) -> tuple[int, float]:
    """Bin of a chain's lowest sample at which the density explains the chain best, and its log likelihood over none."""
    first, last = _score_places(bins, c, m)
    score = bins.score
    best, found = -np.inf, len(score) // 2
    for place in range(first, last + 1):
        if score[place] > best:
            best, found = score[place], place
    return found, best


@jit
def _probability(bins: _Bins, c: int, m: int, place: int) -> float:
    """Probability that a chain is within two reaches of a kernel of its place, if all places are as probable."""
    first, last = _score_places(bins, c, m)
    score = bins.score
    best, near, every = score[place], 0.0, 0.0
    for other in range(first, last + 1):
        part = math.exp(min(score[other] - best, 50.0))
        every += part
        near += part if abs(other - place) <= 2 * _REACH else 0.0
    return near / every


@jit
def _refine(out: FloatArray, m: int, sigma: float) -> None:
    """Move chains by the mean distance of their samples from the mean of all samples near them, until they rest."""
    n = len(out)
    steps = 12  # of the continuous refinement, at most
    near = 2.5  # sigmas around a sample whose mean it is compared with
    for _ in range(steps):
        ordered = np.sort(out)
        upto = np.zeros(n + 1)
        for j in range(n):
            upto[j + 1] = upto[j] + ordered[j]
        most = 0.0
        moves = np.zeros(m)
        for c in range(m):
            total, count = 0.0, 0
            for t in range(c, n, m):
                a = np.searchsorted(ordered, out[t] - near * sigma, side="left")
                b = np.searchsorted(ordered, out[t] + near * sigma, side="right")
                total += (upto[b] - upto[a]) / (b - a) - out[t]
                count += 1
            moves[c] = total / count
            most = max(most, abs(moves[c]))
        for t in range(n):
            out[t] += moves[t % m]
        if most < 0.01 * sigma:
            break


@jit
def _step(means: FloatArray) -> float:
    """Step of stored means: the least difference of two in turn, if other small ones are its multiples; else 0."""
    resolution = 5e-7 * np.abs(means).max()  # four units of float32
    least = np.inf
    for t in range(1, len(means)):
        size = abs(means[t] - means[t - 1])
        if resolution < size < least:
            least = size
    if not math.isfinite(least):
        return 0.0
    tests, multiples, small, near = 0, 0, 10.0, 0.1  # steps of a small difference; of one that is a multiple
    for t in range(1, len(means)):
        steps = abs(means[t] - means[t - 1]) / least
        if steps < small:
            tests += 1
            multiples += abs(steps - round(steps)) < near
    agreeing = 0.9
    return least if multiples > agreeing * tests else 0.0


@jit
def _draw(
    means: FloatArray,
    m: int,
    out: FloatArray,
    own: float,
    sigma: float,
    rounding: float,
    normal: FloatArray,
    is_known: bool,
) -> None:
    """Draw the samples of a run of rounded means, near those that are given, of some noise (`own`) about surfaces.

    `sigma` is the noise of the given samples, which their rounding adds to. Each chain keeps its likeliest mean. Where
    the noise is not known, it is the likeliest, by expectation-maximisation: the scatter of drawn samples then differs
    more between runs than that of samples does.
    """
    n = len(out)
    surface, found, error, sums = np.empty(n), np.empty(n), np.empty(n), m * means
    near = 2.0 * sigma
    noises, rounds = 4, 4  # of the noise; of surfaces and samples in turn
    for _ in range(1 if is_known else noises):
        factor = _factor(n, m, own, rounding)
        for _ in range(rounds):
            _fill_surfaces(out, near, surface)
            _fill_likeliest(factor, m, surface, sums, own, rounding, found)
            out[:] = found
            near = max(own, 0.7 * near)
        _fill_errors(means, m, own, rounding, factor, normal, error)
        if not is_known:
            own = math.sqrt(((out - surface) ** 2).mean() + (error * error).mean())
    for c in range(m):
        out[c::m] += error[c::m] - error[c::m].mean()


@jit
def _fill_errors(
    means: FloatArray, m: int, own: float, rounding: float, factor: FloatArray, normal: FloatArray, out: FloatArray
) -> None:
    """Fill errors of the likeliest samples: drawn samples less the likeliest ones of their rounded means.

    Added to the likeliest samples they make a draw from the posterior (Papandreou and Yuille 2010).
    """
    n, size = len(means), len(normal)
    place = int(abs(means.sum() * 0.6180339887) % 1.0 * size)
    drawn, sums = np.empty(n), np.zeros(n)
    for t in range(n):
        drawn[t] = own * normal[(place + t) % size]
    for t in range(m - 1, n):
        sums[t] = drawn[t - m + 1 : t + 1].sum() + rounding * normal[(place + n + t) % size]
    _fill_likeliest(factor, m, np.zeros(n), sums, own, rounding, out)
    out[:] = drawn - out


@jit
def _factor(n: int, m: int, own: float, rounding: float) -> FloatArray:
    """Cholesky factor (frame, m) of the precision of samples: own noise, and sums of m of them with their rounding.

    Element [i, k] is that of row i and column i - k.
    """
    out = np.zeros((n, m))
    for i in range(n):
        for k in range(min(m, i + 1)):
            windows = min(i - k + m, n) - max(i, m - 1)  # that have both samples
            out[i, k] = max(windows, 0) / rounding**2
        out[i, 0] += 1.0 / own**2
    for i in range(n):
        for k in range(min(m - 1, i), -1, -1):
            j = i - k
            value = out[i, k]
            for other in range(max(0, i - m + 1), j):
                value -= out[i, i - other] * out[j, j - other]
            out[i, k] = math.sqrt(value) if k == 0 else value / out[j, 0]
    return out


@jit
def _fill_likeliest(
    factor: FloatArray, m: int, surface: FloatArray, sums: FloatArray, own: float, rounding: float, out: FloatArray
) -> None:
    """Fill the likeliest samples, given the surface of each, and the rounded sums of m of them."""
    n = len(out)
    for t in range(n):
        total = 0.0
        for s in range(max(t, m - 1), min(t + m, n)):
            total += sums[s]
        out[t] = surface[t] / own**2 + total / rounding**2
    for i in range(n):
        for k in range(1, min(m, i + 1)):
            out[i] -= factor[i, k] * out[i - k]
        out[i] /= factor[i, 0]
    for i in range(n - 1, -1, -1):
        for k in range(1, min(m, n - i)):
            out[i] -= factor[i + k, k] * out[i + k]
        out[i] /= factor[i, 0]


@jit
def _fill_surfaces(samples: FloatArray, sigma: float, out: FloatArray) -> None:
    """Fill the surface of each sample: the mean of all samples near it, then of those near that mean, and so on."""
    n = len(samples)
    steps = 8  # of the mean
    near = 2.5  # sigmas around a mean
    ordered = np.sort(samples)
    upto = np.zeros(n + 1)
    for j in range(n):
        upto[j + 1] = upto[j] + ordered[j]
    for t in range(n):
        at = samples[t]
        for _ in range(steps):
            a = np.searchsorted(ordered, at - near * sigma, side="left")
            b = np.searchsorted(ordered, at + near * sigma, side="right")
            if b > a:
                at = (upto[b] - upto[a]) / (b - a)
        out[t] = at
