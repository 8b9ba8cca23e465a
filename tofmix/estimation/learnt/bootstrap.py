"""Gains that the learnt noise alone reaches, drawn once for each noise: the thresholds of the count.

It is a parametric bootstrap. Pixels with one surface and without surfaces are drawn from the learnt model, for some
numbers of samples and shares of background, and rounded as the recording is. A trial (`trials`) fits one surface more
to each, and a jump in time. The tail of the gains falls exponentially, as that of likelihood ratios. It is fitted to
the largest twentieth of the gains (of background, 1 in 200), so that probabilities down to 10^-6 follow from some
thousand draws. The seed is fixed: the same model gives the same thresholds.

A cache of thresholds in this process: those of one noise are drawn once.

References
----------
McLachlan, Applied Statistics 36(3), 1987, doi:10.2307/2347790: the bootstrap of the likelihood ratio for mixtures.
"""

import dataclasses
import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from threading import Lock
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam, is_uniform
from tofmix.estimation.learnt.components import (
    Samples,
    copy_fit,
    fill_cells,
    fill_times,
    start_without_surface,
    take_samples,
)
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD, Law
from tofmix.estimation.learnt.model import GainThresholds, PixelNoise
from tofmix.estimation.learnt.trials import first_surface, gain_of_jump, new_workspace, try_one_more
from tofmix.estimation.mixture.counting import FALSE_ALARMS
from tofmix.estimation.noise.series import SEED
from tofmix.noise_shape import DRIFTS, TAIL_DEGREES

DRAWS = 6000, 20_000
"""Fewest and most pixels of each number of samples and share of background: the tail then has 300 gains or more."""

SHARES = (0.0, 0.02, 0.1, 0.3, 0.6, 0.85)
"""Shares of background that are drawn where each pixel has a share."""


SAMPLES = (3, 6, 12, 25, 50, 100, 200, 400, 1000)
"""Numbers of samples that are drawn, as far as pixels of the recording have them; the gains of the last hold beyond."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cell:
    """Draws of one number of samples, with one surface on a share of background; without surfaces where it is None."""

    samples: int
    background: float | None
    number: int


def calibrate(
    noise: PixelNoise,
    beam: Beam,
    ranges_mm: FloatArray,
    *,
    samples: tuple[int, int],
    pixel_effects: FloatArray | None = None,
    rounding_mm: float = 0.0,
    draws: int | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> GainThresholds:
    """Draw the gains that noise alone exceeds.

    Parameters
    ----------
    noise : PixelNoise
        The learnt noise.
    beam : Beam
        The fixed part of equation (1).
    ranges_mm : (n,) float64
        Ranges of surfaces of the recording, mm: draws take them in turn.
    samples : (int, int)
        Fewest and most valid samples of the recording's pixels in a window.
    pixel_effects : (n, 1 + DRIFTS) float64, optional
        Log width and drift, mm, of pixels of the recording: draws take them at random. Default: draws of the priors.
    rounding_mm : float
        Step of the stored ranges, mm: draws are rounded to it, or to the beam's steps, where it has some.
    draws : int, optional
        Pixels of each number of samples and share; default: within `DRAWS`, 120,000 in all.
    workers : int
        Threads; the table does not depend on them.
    progress : callable, optional
        Is called with the numbers of finished and of all parts of the table.

    Returns
    -------
    Thresholds
        For `count_surfaces`.
    """
    numbers = _numbers(*samples)
    shares = [beam.p_outlier] if noise.background is None else _shares(noise.background)
    cells = [
        _Cell(samples=n, background=share, number=number)
        for number, (n, share) in enumerate(product(numbers, [*shares, None]))
    ]
    count = draws or min(max(DRAWS[0], 120_000 // len(cells)), DRAWS[1])  # 120,000 in all, within these bounds
    laws = noise.laws()
    # Part of the gains that the tail is fitted to. Clumps of two to four samples of background have gains of their own:
    # the tail is then exponential from about one in 200 on. Fitted to a twentieth, the gain that one pixel in 1000
    # reaches was up to 2 nat too low.
    tail = 0.05 if noise.background is None else 0.005
    draw = _Drawing(noise, beam, ranges_mm, pixel_effects, rounding_mm)

    def gains(cell: _Cell) -> FloatArray:
        block = draw.block(cell, count)
        out = np.zeros(count)
        _gains(block, cell.background is None, laws, beam, out)
        return _tail(out, tail)

    rows, done = [], 0
    with ThreadPoolExecutor(workers, thread_name_prefix="tofmix") as pool:
        for row in pool.map(gains, cells):
            rows.append(row)
            done += 1
            if progress is not None:
                progress(done, len(cells))
    table = np.array(rows).reshape(len(numbers), len(shares) + 1, len(FALSE_ALARMS))
    return GainThresholds(
        log_n=np.log(np.array(numbers, dtype=np.float64)),
        background=np.array(shares),
        more=np.ascontiguousarray(table[:, :-1]),
        first=np.ascontiguousarray(table[:, -1]),
    )


def _shares(prior: tuple[float, float]) -> list[float]:
    """Return the `SHARES` that enclose all but rare shares of the prior."""
    from scipy.special import betaincinv

    # Part of the pixels whose share of background may lie beyond those that are drawn, at either end.
    rare_share = 1.0e-3
    low, high = betaincinv(*prior, [rare_share, 1.0 - rare_share])
    first = max((i for i, share in enumerate(SHARES) if share <= low), default=0)
    last = min((i for i, share in enumerate(SHARES) if share >= high), default=len(SHARES) - 1)
    return list(SHARES[first : max(last, first) + 1])


def _numbers(least: int, most: int) -> list[int]:
    """Return the numbers of samples to draw, ascending: those of `SAMPLES` between the ends, and the ends."""
    low, high = max(least, SAMPLES[0]), min(max(most, SAMPLES[0]), SAMPLES[-1])
    low = min(low, high)
    return sorted({low, high, *(n for n in SAMPLES if low < n < high)})


def _tail(gains: FloatArray, part: float) -> FloatArray:
    """Gains that are exceeded with each probability of `FALSE_ALARMS`: quantiles to `part`, and an exponential tail.

    The mean excess over the start of the tail is the maximum-likelihood scale of an exponential.
    """
    ordered = np.sort(np.maximum(gains, 0.0))
    start = float(np.quantile(ordered, 1.0 - part))
    beyond = ordered[ordered > start]
    scale = float(beyond.mean() - start) if beyond.size else 1.0
    out = []
    for probability in FALSE_ALARMS:
        if probability >= part:
            out.append(max(float(np.quantile(ordered, 1.0 - probability)), 0.0))
        else:
            out.append(start + scale * math.log(part / probability))
    # Probabilities are interpolated between the gains, which must ascend.
    return np.maximum.accumulate(np.array(out) + 1e-9 * np.arange(len(out)))


class _Drawing:
    """Draws of pixels from the learnt model."""

    def __init__(
        self, noise: PixelNoise, beam: Beam, ranges_mm: FloatArray, pixel_effects: FloatArray | None, rounding_mm: float
    ) -> None:
        self._noise, self._beam, self._rounding_mm = noise, beam, rounding_mm
        self._ranges = np.asarray(ranges_mm, dtype=np.float64)
        self._effects = None if pixel_effects is None or len(pixel_effects) == 0 else pixel_effects

    def block(self, cell: _Cell, count: int) -> FloatArray:
        """Draw samples (pixel, frame), mm."""
        rng = np.random.default_rng([SEED, cell.number, cell.samples])
        n, beam, noise = cell.samples, self._beam, self._noise
        if cell.background is None:
            return self._random(rng, (count, n))
        place = self._ranges[np.arange(count) % len(self._ranges)]
        effects = self._draw_effects(rng, count)
        z = _standardised(rng, noise, (count, n))
        out = place[:, None] + np.exp(effects[:, :1]) * noise.curve.sigma(place)[:, None] * z
        out += effects[:, 1:] @ np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), DRIFTS)[:, 1:].T
        random = rng.random((count, n)) < cell.background
        out[random] = self._random(rng, (int(random.sum()),))
        if len(beam.steps.step_mm):
            step = np.interp(place, beam.steps.range_mm, beam.steps.step_mm)[:, None]
            out = step * np.rint(out / step)
        elif self._rounding_mm > 0.0:
            out = np.clip(self._rounding_mm * np.rint(out / self._rounding_mm), beam.range_min, beam.range_top)
        return np.asarray(out, dtype=np.float64)

    def _random(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Draw random values, mm."""
        density = self._noise.curve.background_density
        if density is None or is_uniform(self._beam):
            return rng.uniform(self._beam.range_min, self._beam.range_top, shape)
        return density.quantile(rng.random(shape))

    def _draw_effects(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw log width and drift, mm, of `count` pixels: (count, 1 + DRIFTS)."""
        if self._effects is not None:
            return self._effects[rng.integers(len(self._effects), size=count)]
        spread = SCALE_OF_SPREAD * self._noise.curve.width_spread
        log_width = spread * np.clip(rng.standard_t(TAIL_DEGREES, (count, 1)), -4.0, 4.0)
        drift = self._noise.drift_mm * np.clip(rng.standard_t(TAIL_DEGREES, (count, DRIFTS)), -6.0, 6.0)
        return np.hstack([log_width, drift])


def _standardised(rng: np.random.Generator, noise: PixelNoise, shape: tuple[int, int]) -> FloatArray:
    """Draw standardised errors with the learnt shape and memory: a Gaussian copula of AR(1) noise."""
    from scipy.special import ndtr

    z = rng.standard_normal(shape)
    if noise.memory > 0:
        fresh = math.sqrt(1.0 - noise.memory**2)
        for j in range(1, shape[1]):
            z[:, j] = noise.memory * z[:, j - 1] + fresh * z[:, j]
    if noise.curve.shape is not None:
        z = noise.curve.shape.quantile(ndtr(z))
    return np.asarray(z, dtype=np.float64)


@jit
def _gains(block: FloatArray, empty: bool, laws: tuple[Law, Law], beam: Beam, out: FloatArray) -> None:
    """Fill `out` (pixel,) with gains, nat: of the first surface in empty pixels, else of a second one or a jump."""
    pixels, frames = block.shape
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(3, frames, 1)
    least_worth = 1.0  # gain bound, nat, from which on a trial is made: smaller gains are no part of the tail
    for pixel in range(pixels):
        n = take_samples(block[pixel].astype(np.float32), value, time)
        data = Samples(value[:n], time[:n])
        fill_times(data, work.scratch)
        fill_cells(data, beam, work.scratch)
        start_without_surface(data.value, work.fit, beam)
        gain, _ = first_surface(data, work, laws[0], beam)
        if empty:
            out[pixel] = gain
        elif gain > 0.0:
            copy_fit(work.best, work.fit)
            jump = gain_of_jump(data, work.fit, laws[0], beam, work.scratch)
            more = try_one_more(data, 1, work, laws[0], beam, least_worth)
            if jump > more:
                # A jump alone splits no pixel: without drift, a further surface must gain as much too.
                start_without_surface(data.value, work.fit, beam)
                first_surface(data, work, laws[1], beam)
                copy_fit(work.best, work.fit)
                more = min(jump, try_one_more(data, 1, work, laws[1], beam, least_worth))
            out[pixel] = more


class KnownThresholds:
    """Thresholds by all that they depend on; those used last are kept, a few kilobytes each.

    The seed of a bootstrap is fixed, and its workers do not change it. So its arguments are the key.

    Parameters
    ----------
    draw : callable
        Draws a table, as `calibrate` does.
    most : int
        Tables that are kept.
    """

    def __init__(self, draw: Callable[..., GainThresholds] = calibrate, *, most: int = 32) -> None:
        self._draw, self._most = draw, most
        self._tables: OrderedDict[bytes, GainThresholds] = OrderedDict()
        self._lock = Lock()

    def __call__(
        self,
        noise: PixelNoise,
        beam: Beam,
        ranges_mm: FloatArray,
        *,
        samples: tuple[int, int],
        pixel_effects: FloatArray | None = None,
        rounding_mm: float = 0.0,
        workers: int = 1,
        progress: Callable[[int, int], None] | None = None,
    ) -> GainThresholds:
        """Return the thresholds of the noise, drawn or known. `progress` is called where they are drawn.

        Parameters
        ----------
        noise, beam, ranges_mm, samples, pixel_effects, rounding_mm, workers, progress
            As for `calibrate`.

        Returns
        -------
        Thresholds
            For `count_surfaces`.
        """
        key = _digest((noise, beam, ranges_mm, samples, pixel_effects, rounding_mm))
        with self._lock:
            if key in self._tables:
                self._tables.move_to_end(key)
                return self._tables[key]
        table = self._draw(
            noise,
            beam,
            ranges_mm,
            samples=samples,
            pixel_effects=pixel_effects,
            rounding_mm=rounding_mm,
            workers=workers,
            progress=progress,
        )
        with self._lock:
            self._tables[key] = table
            while len(self._tables) > self._most:
                self._tables.popitem(last=False)
        return table


def _digest(value: tuple[Any, ...]) -> bytes:
    """SHA-256 of all numbers in tuples, dataclasses and arrays."""
    found = hashlib.sha256()

    def take(value: Any) -> None:  # noqa: ANN401  any part of the arguments
        if isinstance(value, np.ndarray):
            found.update(repr((value.dtype.str, value.shape)).encode())
            found.update(np.ascontiguousarray(value).tobytes())
        elif dataclasses.is_dataclass(value):
            take(tuple(getattr(value, field.name) for field in dataclasses.fields(value)))
        elif isinstance(value, tuple):
            found.update(f"{len(value)}:".encode())
            for part in value:
                take(part)
        elif value is None or isinstance(value, bool | int | float | str | np.generic):
            found.update(f"{value!r};".encode())
        else:
            raise TypeError(f"a {type(value).__name__} has no digest")

    take(value)
    return found.digest()


known_thresholds = KnownThresholds()
"""The cache of this process."""
