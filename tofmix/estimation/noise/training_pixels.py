"""Pixels that the noise is learnt from, read from a recording."""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.noise.series import quantisation_step, read_runs
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.recording import AmplitudeSource, SampleSource, amplitude_source

MANY_PIXELS = 900
"""From so many pixels on, one third of them judges all models: its standard error is small enough."""

MOST_PIXELS = 3000
"""Most pixels, each in one window, that the noise is learnt from."""

MOST_SAMPLES = 300_000
"""Most samples that the noise is learnt from, in `MANY_PIXELS` pixels or more."""

MOST_FRAMES = 1000
"""Most frames of a window, its first ones, that the noise is learnt from."""

FEW_PIXELS = 0.02
"""Part of the pixels whose number of samples may lie beyond those that gains are drawn for, at either end."""

_SEED = 20080922
"""Seed of the noise that is added over the rounding: the same recording gives the same noise."""


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
        Step of the stored ranges, mm.
    """

    samples: Float32Array
    amplitude: Float32Array | None = None
    rounding_mm: float = 0.0

    def chosen(self, which: BoolArray) -> "Pixels":
        """Return the pixels for which `which` (pixel,) is true."""
        light = None if self.amplitude is None else np.ascontiguousarray(self.amplitude[which])
        return Pixels(samples=np.ascontiguousarray(self.samples[which]), amplitude=light, rounding_mm=self.rounding_mm)

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


def pixels_of(source: SampleSource, window_frames: int, stride_frames: int, *, most: int = MOST_PIXELS) -> Pixels:
    """Read up to `most` pixels, evenly spread over the image and the windows; fewer where `MOST_SAMPLES` are more.

    Uniform noise is added over the step of the stored ranges, because equal samples determine no width.

    Parameters
    ----------
    source : SampleSource
        The recording.
    window_frames, stride_frames : int
        Samples of a pixel in a window, and from one window to the next.
    most : int
        Most pixels.
    """
    frames, rows, cols = source.shape
    length = min(window_frames, MOST_FRAMES, frames)
    most = min(most, max(MANY_PIXELS, MOST_SAMPLES // length))
    count = max(1, 1 + (frames - window_frames) // stride_frames) if frames >= window_frames else 1
    some = min(count, max(1, most // (rows * cols)))
    starts = np.unique(np.linspace(0, count - 1, some).astype(int)) * stride_frames
    step = max(1, math.floor(math.sqrt(rows * cols / most)))
    chosen = np.arange(min(step // 2, (rows - 1) // 2), rows, step)  # an image of few rows keeps its middle one
    series = read_runs(source, starts.tolist(), length, chosen, None)
    keep = np.unique(np.linspace(0, len(series.samples) - 1, min(len(series.samples), most)).astype(int))
    samples = series.samples[keep]
    with np.errstate(invalid="ignore"):
        samples[~(np.abs(samples) <= FARTHEST_MM)] = np.nan
    light = None
    if (amplitudes := amplitude_source(source)) is not None:
        light = read_runs(_AmplitudesAsRanges(amplitudes, source), starts.tolist(), length, chosen, None).samples[keep]
    rounding = quantisation_step(samples)
    rng = np.random.default_rng(_SEED)
    smooth = samples + rng.uniform(-0.5 * rounding, 0.5 * rounding, samples.shape)
    return Pixels(samples=np.ascontiguousarray(smooth, dtype=np.float32), amplitude=light, rounding_mm=float(rounding))


class _AmplitudesAsRanges:
    """Amplitudes as a source that `read_runs` reads like ranges."""

    def __init__(self, amplitudes: AmplitudeSource, source: SampleSource) -> None:
        self._amplitudes = amplitudes
        self.shape, self.row_step, self.frame_step, self.sensor = (
            source.shape, source.row_step, source.frame_step, source.sensor
        )  # fmt: skip

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes of some frames and rows."""
        return self._amplitudes.read_amplitude(frames, rows)


def scatters(pixels: Pixels) -> bool:
    """Whether the samples of most pixels differ by more than their rounding."""
    known = np.isfinite(pixels.samples)
    high = np.where(known, pixels.samples, -np.inf).max(axis=1)
    low = np.where(known, pixels.samples, np.inf).min(axis=1)
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
