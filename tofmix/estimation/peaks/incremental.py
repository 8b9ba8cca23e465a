"""The density of a live sequence: new frames are added, old ones are never touched again.

Use `IncrementalDensity` where frames arrive one after the other and the number of surfaces is wanted at any time. If
all samples are available, `tofmix.estimation.peaks.counters.Kde` finds the same peaks in less memory.

The sums of equation (4) are kept on a fixed grid. So a sample costs only the few dozen grid points within its kernel,
after any number of earlier samples.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray, IntArray
from tofmix.circle import fold
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import beam_of
from tofmix.estimation.peaks.counters import SIGMAS_BEYOND, Kde, Peaks, no_peaks
from tofmix.estimation.peaks.modes import BANDWIDTH, LONE_SAMPLES, PEAK_OF_SHARE, REACH, STEP, keep_peak
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.sensor import Sensor


@jit
def _add(
    block: FloatArray,
    grid: FloatArray,
    h: FloatArray,
    ends: tuple[FloatArray, FloatArray],
    sums: tuple[FloatArray, FloatArray],
    n_samples: IntArray,
) -> None:
    """Add the kernels of a block (frame, pixel) to the sums of e and e z, with z = (r - r_j) / h."""
    total, moment = sums
    lowest, highest = ends
    frames, pixels = block.shape
    for pixel in range(pixels):
        for frame in range(frames):
            sample = block[frame, pixel]
            if not abs(sample) <= FARTHEST_MM:  # true for NaN
                continue
            n_samples[pixel] += 1
            # The grid points that reach the sample are the run between these two, but for a jagged noise curve.
            first, stop = np.searchsorted(highest, sample), np.searchsorted(lowest, sample, side="right")
            for i in range(first, stop):
                z = (grid[i] - sample) / h[i]
                if abs(z) <= REACH:
                    kernel = math.exp(-0.5 * z * z)
                    total[pixel, i] += kernel
                    moment[pixel, i] += kernel * z


@jit
def _peaks(
    grid: FloatArray,
    h: FloatArray,
    total: FloatArray,
    moment: FloatArray,
    limits: tuple[float, float],
    place: FloatArray,
    height: FloatArray,
) -> int:
    """Test (5) on the grid, as `find_peaks` applies it along its walk: see there for the runs."""
    threshold, epsilon = limits
    count, in_run = 0, False
    at, top, flattest = 0.0, 0.0, math.inf
    best, before = 0, math.nan
    for i in range(len(grid)):
        slope = -moment[i] / total[i] if total[i] > 0.0 else math.nan  # dp/dr in units of p / h
        turns = before > 0.0 >= slope
        flat = abs(slope) < epsilon and _bends_down(h, total, moment, i)
        if turns or flat:
            if not in_run:
                in_run, top, flattest = True, 0.0, math.inf
            if turns:
                at, flattest = grid[i] - (grid[i] - grid[i - 1]) * slope / (slope - before), 0.0
            elif abs(slope) < flattest:
                at, flattest = grid[i], abs(slope)
            top = max(top, total[i])
        if total[i] > total[best]:
            best = i
        if in_run and not flat:
            in_run = False
            if top > threshold:  # p > gamma
                count = keep_peak(place, height, count, at, top)
        before = slope
    if in_run and top > threshold:
        count = keep_peak(place, height, count, at, top)
    if count == 0:
        place[0], height[0] = grid[best], total[best]
    return count


@jit
def _bends_down(h: FloatArray, total: FloatArray, moment: FloatArray, i: int) -> bool:
    """Whether d2p/dr2 < 0 at a grid point: with s = h p' / p, h^2 p'' / p is h s' + s^2."""
    if i == 0 or i == len(h) - 1 or total[i - 1] == 0.0 or total[i + 1] == 0.0:
        return False
    slope = -moment[i] / total[i]
    change = moment[i - 1] / total[i - 1] - moment[i + 1] / total[i + 1]
    return bool(change / (2.0 * STEP / BANDWIDTH) + slope * slope < 0.0)


def _grid(low: float, high: float, sigma: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Places from `low` to past `high`, sigma / 8 apart: the steps of the walk of `find_peaks`."""
    places = [low]
    while places[-1] < high:
        places.append(places[-1] + STEP * float(np.interp(places[-1], *sigma)))
    return np.array(places)


class IncrementalDensity:
    """Kernel density of a block of pixels, equation (4), that takes frames as they come.

    The grid goes over the working range in steps of sigma(r) / 8, and 4 sigma beyond its ends. Samples
    farther outside count in `n_samples` and are in no peak. The order of the frames, and how they are split
    into blocks, change the sums by rounding only.

    Memory: two float64 sums for each pixel and place of the grid. The SR-3000 at 1.2 ms has about 920 places:
    15 kB a pixel, 370 MB for all of its pixels. Where that is too much, keep one for each band of rows.

    Parameters
    ----------
    sensor : Sensor
        Noise curve and working range.
    pixels : int
        Pixels of a block, at least 1.
    unambiguous_range_mm : float, optional
        Length of the circle that ranges are on, mm. The grid then goes once round it, from 0 on, samples are folded,
        and none is outside.

    Raises
    ------
    ValueError
        If there is no pixel, the sensor has no noise curve or no working range, or the circle is too short for it.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, section IV c, equations (4) and (5), and Fig. 7.
    """

    def __init__(self, sensor: Sensor, pixels: int, *, unambiguous_range_mm: float | None = None) -> None:
        if pixels < 1:
            raise ValueError(f"pixels: {pixels} is not at least 1")
        self._length = unambiguous_range_mm
        # The grid is no interval of random values: extreme samples may lie anywhere, and each place takes memory.
        known = replace(sensor, sample_min_mm=None, sample_max_mm=None)
        beam = beam_of(known, unambiguous_range_mm)
        curve = beam.curve_range, beam.curve_sigma
        if unambiguous_range_mm is None:
            below = SIGMAS_BEYOND * float(np.interp(beam.range_min, *curve))
            beyond = SIGMAS_BEYOND * beam.sigma_max
            self._range_mm = _grid(beam.range_min - below, beam.range_top + beyond, curve)
        else:
            round_it = _grid(0.0, unambiguous_range_mm, curve)
            self._range_mm = round_it[:-1] * (unambiguous_range_mm / round_it[-1])
        self._h = BANDWIDTH * np.interp(self._range_mm, *curve)
        # Both ascend, as searching needs: h may fall with range faster than the grid rises.
        lowest = np.minimum.accumulate((self._range_mm - REACH * self._h)[::-1])[::-1].copy()
        self._ends = lowest, np.maximum.accumulate(self._range_mm + REACH * self._h)
        self._sums = np.zeros((pixels, len(self._range_mm))), np.zeros((pixels, len(self._range_mm)))
        self._n_samples = np.zeros(pixels, dtype=np.int64)
        for values in (self._range_mm, self._n_samples):
            values.setflags(write=False)

    @property
    def range_mm(self) -> FloatArray:
        """The grid (place,), mm; read-only."""
        return self._range_mm

    @property
    def n_samples(self) -> IntArray:
        """Valid samples so far (pixel,)."""
        return self._n_samples.copy()

    def add(self, block: ArrayLike) -> None:
        """Add new frames; the cost is that of their samples alone.

        Parameters
        ----------
        block : (frame, pixel) array_like of float
            Samples, mm; values that are not finite, or beyond 10^9 mm, are skipped.

        Raises
        ------
        ValueError
            If the block has not these pixels.
        """
        values = np.ascontiguousarray(block, dtype=np.float64)
        dimensions = 2  # (frame, pixel)
        if values.ndim != dimensions or values.shape[1] != len(self._n_samples):
            raise ValueError(f"block: expected (frame, {len(self._n_samples)}), got shape {values.shape}")
        n_samples = self._n_samples.copy()
        if self._length is not None:
            values = fold(np.where(np.abs(values) <= FARTHEST_MM, values, np.nan), self._length)
            self._add_across_the_fold(values, self._length)
        _add(values, self._range_mm, self._h, self._ends, self._sums, n_samples)
        self._n_samples = n_samples

    def _add_across_the_fold(self, values: FloatArray, length: float) -> None:
        """Add the parts of the kernels of folded samples beyond the fold."""
        reach, uncounted = REACH * float(self._h.max()), self._n_samples.copy()
        for image in (
            np.where(values < reach, values + length, np.nan),
            np.where(values > length - reach, values - length, np.nan),
        ):
            _add(image, self._range_mm, self._h, self._ends, self._sums, uncounted)

    def density(self) -> FloatArray:
        """Return p(r) (pixel, place) in 1/mm on the grid, equation (4); zero where a pixel has no sample yet."""
        n = np.maximum(self._n_samples, 1)[:, np.newaxis]
        return np.asarray(self._sums[0] / (n * self._h * math.sqrt(2.0 * math.pi)))  # eq. (4)

    def modes(self, *, gamma: float = 0.02, epsilon: float = 0.01) -> Peaks:
        """Find the peaks so far by test (5).

        Parameters
        ----------
        gamma, epsilon : float
            As for `tofmix.estimation.peaks.counters.Kde`.

        Returns
        -------
        Peaks
            Of each pixel. `Kde` finds the same from all samples, but where two maxima, or a maximum and a
            shoulder, are within a step, or a height is next to gamma: 1 to 2 pixels of 100 with three surfaces.

        Raises
        ------
        ValueError
            If a value is out of its bounds.
        """
        limits = Kde(gamma=gamma, epsilon=epsilon)
        out = no_peaks(len(self._n_samples))
        for pixel, n in enumerate(self._n_samples.tolist()):
            if n > 0:
                threshold = max(limits.gamma * n, LONE_SAMPLES) * PEAK_OF_SHARE
                sums = self._sums[0][pixel], self._sums[1][pixel]
                tests = float(threshold), float(limits.epsilon)
                place, height = out.place[pixel], out.height[pixel]
                if self._length is None:
                    out.found[pixel] = _peaks(self._range_mm, self._h, *sums, tests, place, height)
                else:
                    out.found[pixel] = self._peaks_round(sums, tests, place, height, self._length)
                height /= n * PEAK_OF_SHARE
        return out

    def _peaks_round(
        self,
        sums: tuple[FloatArray, FloatArray],
        tests: tuple[float, float],
        place: FloatArray,
        height: FloatArray,
        length: float,
    ) -> int:
        """Find the peaks on a circle: as on a line that starts where the density is lowest, and ends there."""
        start = int(np.argmin(sums[0]))
        round_it = np.r_[start : len(self._h), 0 : start + 1]
        grid = self._range_mm[round_it]
        grid[len(self._h) - start :] += length
        found = _peaks(grid, self._h[round_it], sums[0][round_it], sums[1][round_it], tests, place, height)
        order = np.argsort(fold(place[:found], length))
        place[: max(found, 1)] = fold(place[: max(found, 1)], length)
        place[:found], height[:found] = place[order], height[order]
        return found
