"""Pixels that the noise is learnt from, read from a recording."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.noise.series import SEED, quantisation_step, read_runs
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.noise_shape import RangeStep
from tofmix.recording import AmplitudeSource, SampleSource, amplitude_source
from tofmix.sensor import NoiseCurve

MANY_PIXELS = 900
"""From so many pixels on, one third of them judges all models: its standard error is small enough."""

MOST_SAMPLES = 300_000
"""Most samples that the noise is learnt from, in `MANY_PIXELS` pixels or more."""

MOST_FRAMES = 1000
"""Most frames of a window, its first ones, that the noise is learnt from."""

FEW_PIXELS = 0.02
"""Part of the pixels whose number of samples may lie beyond those that gains are drawn for, at either end."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pixels:
    """Samples of some pixels, each in one window.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples in the order of frames, mm, NaN where invalid. Their rounding is spread evenly over its step.
    amplitude : (pixel, frame) float32, optional
        Their amplitudes, in the unit of the recording.
    rounding_mm : float
        Step of the stored ranges, mm; the median one where there are several.
    step : RangeStep, optional
        The step, if fits integrate the noise over it: `samples` are then as they were stored.
    spread : (pixel, frame) float32, optional
        Then the samples with their rounding spread over its step.
    """

    samples: Float32Array
    amplitude: Float32Array | None = None
    rounding_mm: float = 0.0
    step: RangeStep | None = None
    spread: Float32Array | None = None

    def chosen(self, which: BoolArray) -> "Pixels":
        """Return the pixels for which `which` (pixel,) is true."""
        light, spread = (
            None if values is None else np.ascontiguousarray(values[which]) for values in (self.amplitude, self.spread)
        )
        return Pixels(
            samples=np.ascontiguousarray(self.samples[which]),
            amplitude=light,
            rounding_mm=self.rounding_mm,
            step=None if self.step is None else self.step.chosen(which),
            spread=spread,
        )

    @property
    def smooth(self) -> Float32Array:
        """Samples (pixel, frame), mm, with their rounding spread over its step."""
        return self.samples if self.spread is None else self.spread

    def is_coarse(self, curve: NoiseCurve, sigmas: float = 2.0) -> bool:
        """Whether the step is above so many sigmas at some range; above 2, most samples have one or two values."""
        return self.step is not None and bool((self.step.at(curve.range_mm) > sigmas * curve.sigma_mm).any())

    def with_fine_step(self) -> "Pixels":
        """Return the pixels with their rounding spread over its step, for fits that do not integrate over it."""
        return replace(self, samples=self.smooth, step=None, spread=None)

    def least_sigma(self, range_mm: ArrayLike) -> FloatArray:
        """Least sigma, mm, that the step tells at ranges, mm; 0 where fits do not integrate over it."""
        return np.zeros(np.shape(range_mm)) if self.step is None else self.step.least_sigma(range_mm)

    def some(self, most: int) -> "Pixels":
        """Return at most `most` pixels, evenly spread."""
        count = len(self.samples)
        if count <= most:
            return self
        which = np.zeros(count, dtype=np.bool_)
        which[np.linspace(0, count - 1, most).astype(int)] = True
        return self.chosen(which)


def medians(samples: Float32Array) -> FloatArray:
    """Median of the valid samples (pixel, frame) of each pixel that has one, mm; pixels without one are left out."""
    return np.array([float(np.median(row[np.isfinite(row)])) for row in samples if np.isfinite(row).any()])


def pixels_of(
    source: SampleSource,
    window_frames: int,
    stride_frames: int,
    *,
    most: int = 3000,
    step: RangeStep | None = None,
) -> Pixels:
    """Read up to `most` pixels, evenly spread over the image and the windows; fewer where `MOST_SAMPLES` are more.

    Uniform noise is added over the step of the stored ranges, because equal samples determine no width.

    Parameters
    ----------
    window_frames, stride_frames : int
        Samples of a pixel in a window, and from one window to the next.
    most : int
        Most pixels, each in one window.
    step : RangeStep, optional
        Step of the stored ranges; the result then has the samples as they were stored, too. Default: a common one, from
        the samples.
    """
    frames, rows, cols = source.shape
    length = min(window_frames, MOST_FRAMES, frames)
    most = min(most, max(MANY_PIXELS, MOST_SAMPLES // length))
    count = max(1, 1 + (frames - window_frames) // stride_frames) if frames >= window_frames else 1
    some = min(count, max(1, most // (rows * cols)))
    starts = np.unique(np.linspace(0, count - 1, some).astype(int)) * stride_frames
    every = max(1, math.floor(math.sqrt(rows * cols / most)))
    chosen = np.arange(min(every // 2, (rows - 1) // 2), rows, every)  # an image of few rows keeps its middle one
    series = read_runs(source, starts.tolist(), length, chosen, None)
    keep = np.unique(np.linspace(0, len(series.samples) - 1, min(len(series.samples), most)).astype(int))
    samples = series.samples[keep]
    with np.errstate(invalid="ignore"):
        samples[~(np.abs(samples) <= FARTHEST_MM)] = np.nan
    light = None
    if (amplitudes := amplitude_source(source)) is not None:
        light = read_runs(_AmplitudesAsRanges(amplitudes, source), starts.tolist(), length, chosen, None).samples[keep]
    rng = np.random.default_rng(SEED)
    if step is None:
        rounding = quantisation_step(samples)
        smooth = samples + rng.uniform(-0.5 * rounding, 0.5 * rounding, samples.shape)
        spread = np.ascontiguousarray(smooth, dtype=np.float32)
        return Pixels(samples=spread, amplitude=light, rounding_mm=float(rounding))
    own = step.chosen(series.pixel[keep])
    pixel = np.broadcast_to(np.arange(len(samples))[:, None], samples.shape)
    smooth = samples + own.at(samples, pixel) * rng.uniform(-0.5, 0.5, samples.shape)
    return Pixels(
        samples=np.ascontiguousarray(samples, dtype=np.float32),
        amplitude=light,
        rounding_mm=step.typical(),
        step=own,
        spread=np.ascontiguousarray(smooth, dtype=np.float32),
    )


class _AmplitudesAsRanges:
    """Amplitudes as a source that `read_runs` reads like ranges."""

    def __init__(self, amplitudes: AmplitudeSource, source: SampleSource) -> None:
        self._amplitudes = amplitudes
        self.shape, self.row_step, self.frame_step, self.sensor = (
            source.shape,
            source.row_step,
            source.frame_step,
            source.sensor,
        )

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes of some frames and rows."""
        return self._amplitudes.read_amplitude(frames, rows)


def scatters(pixels: Pixels) -> bool:
    """Whether the samples of most pixels differ by more than their rounding."""
    known = np.isfinite(pixels.smooth)
    high = np.where(known, pixels.smooth, -np.inf).max(axis=1)
    low = np.where(known, pixels.smooth, np.inf).min(axis=1)
    seen = known.sum(axis=1) > 1
    return not seen.any() or bool(np.median((high - low)[seen]) > pixels.rounding_mm)


def sample_numbers(pixels: Pixels, min_samples: int, window: int) -> tuple[int, int]:
    """Fewest and most valid samples of pixels with `min_samples` or more, without the `FEW_PIXELS` at either end."""
    number = np.isfinite(pixels.samples).sum(axis=1)
    known = number[number >= min_samples]
    if known.size == 0:
        return min_samples, window
    low, high = np.quantile(known, (FEW_PIXELS, 1.0 - FEW_PIXELS))
    return int(low), math.ceil(high)
