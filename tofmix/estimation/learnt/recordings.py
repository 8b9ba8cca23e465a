"""Learn the noise of a recording: its pixels are read, the noise is learnt and calibrated, and told in a line."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt.curve_check import doubts
from tofmix.estimation.learnt.folds import MANY_PIXELS, MAX_LAYERS
from tofmix.estimation.learnt.held_out import flat_thresholds
from tofmix.estimation.learnt.known_thresholds import known_thresholds
from tofmix.estimation.learnt.learning import LearntModel, learn_pixel_noise
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.parts import beta_prior
from tofmix.estimation.learnt.shares import background_shares
from tofmix.estimation.learnt.training_pixels import Pixels, medians
from tofmix.estimation.learnt.words import noise_words
from tofmix.estimation.noise.measurement import MeasuredNoise, measure_noise
from tofmix.estimation.noise.series import quantisation_step, read_runs
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.learnt_noise import DRIFTS
from tofmix.recording import AmplitudeSource, SampleSource, amplitude_source, samples_a_frame
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.wording import counted

MOST_PIXELS = 3000
"""Pixels, each of one window, that teach; more tell little more."""

MOST_SAMPLES = 300_000
"""Samples that teach, in `MANY_PIXELS` pixels or more: with many frames, fewer pixels tell as much."""

MOST_FRAMES = 1000
"""Frames of a window that teach, its first ones: a longer one is drift within these."""

LEAST_IN_PIXEL, LEAST_IN_ALL = 5, 100
"""Valid samples that tell one sigma: in some pixel, and in all together, which makes it right to 7 %."""

QUESTIONED_PIXELS = 1000
"""Pixels by which a file's curve is held against the samples."""

COARSE = 1.0
"""Steps of the stored ranges, in sigmas, from which on rounding is a part of the noise that samples show."""

DISAGREE = 1.25
"""Ratio of two measurements of sigma from which on the other is said: drifts and shapes move it by less."""

FEW_PIXELS = 0.02
"""Share of the pixels whose number of samples may lie outside those that gains are drawn for, at either end."""

_SEED = 20080922  # of the noise that replaces the rounding, so that the same recording gives the same noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundNoise:
    """The noise that a recording shows.

    Parameters
    ----------
    sensor : Sensor
        The recording's, with the noise curve, and `learnt` where the noise is not a Gaussian's alone.
    measured : MeasuredNoise or None
        What clusters of one Gaussian surface tell (`noise.measurement`); None where they tell nothing.
    model : LearntModel or None
        What was learnt; None where most pixels do not scatter.
    """

    sensor: Sensor
    measured: MeasuredNoise | None
    model: LearntModel | None

    @property
    def is_gaussian(self) -> bool:
        """Whether a curve is all there is."""
        return self.sensor.learnt is None

    def line(self) -> str:
        """What was found, for a user."""
        said = noise_words(self.sensor)
        if self.model is None:
            return f"{', '.join(said)}; the samples of most pixels are all equal"
        told = f"{', '.join(said)}; learnt from {counted(self.model.pixels, 'pixel')}"
        if self.model.shapes_differ:
            told += "; the shape of the error differs between pixels, and one is used for all"
        return told + self._disagreement()

    def _disagreement(self) -> str:
        """What pixels that seem to see one surface tell of sigma, where that differs from the learnt one."""
        curve = self.sensor.noise
        if self.measured is None or curve is None:
            return ""
        other = self.measured.curve
        wide = 1.0 if curve.shape is None else curve.shape.moments()[1]
        ratio = float(np.exp(np.median(np.log(other.sigma_mm / (wide * curve.sigma(other.range_mm))))))
        if max(ratio, 1.0 / ratio) < DISAGREE:
            return ""
        low, high = float(other.sigma_mm.min()), float(other.sigma_mm.max())
        return f"; pixels taken for one surface alone would give sigma {low:.3g} to {high:.3g} mm"


def learn_noise(
    source: SampleSource,
    *,
    window_frames: int,
    stride_frames: int | None = None,
    shape: bool = True,
    widths: bool | None = None,
    drift: bool = True,
    instead_of: NoiseCurve | None = None,
    min_samples: int = 3,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> FoundNoise:
    """Learn a recording's noise.

    Parameters
    ----------
    source : SampleSource
        The recording. Its sensor's curve is not looked at; its working range is.
    window_frames, stride_frames : int
        Frames of a window, and from one to the next: what a pixel is.
    shape : bool
        Whether the error may have a shape other than a Gaussian's.
    widths : bool, optional
        Whether pixels have widths of their own; None: as the samples say.
    drift : bool
        Whether a pixel's ranges may drift within a window.
    instead_of : NoiseCurve, optional
        A Gaussian curve that the learnt noise must beat, on pixels that no fit has seen, to be used.
    min_samples : int
        Fewest samples that a pixel is fitted with.
    workers : int
        Threads; nothing depends on it.
    progress : callable, optional
        Told the steps of the calibration that are done, and all.

    Returns
    -------
    FoundNoise
        It depends on the samples and the options alone. Its sensor is the recording's own where `instead_of` holds.

    Raises
    ------
    ValueError
        If nothing of the noise can be told.
    """
    try:
        measured = measure_noise(source)
    except ValueError:
        measured = None
    targets = samples_a_frame(source)
    window, stride = window_frames * targets, (stride_frames or window_frames) * targets
    pixels = pixels_of(source, window, stride)
    sensor = replace(source.sensor, noise=None, learnt=None)
    filled = np.isfinite(pixels.samples).sum(axis=1)
    if filled.max(initial=0) < LEAST_IN_PIXEL or filled.sum() < LEAST_IN_ALL:
        raise ValueError(
            f"noise: {counted(int(filled.sum()), 'valid sample')}, {int(filled.max(initial=0))} in a pixel at most; at"
            f" least {LEAST_IN_ALL} and {LEAST_IN_PIXEL} are needed to tell one sigma"
        )
    if not scatters(pixels):
        if measured is None:
            raise ValueError("noise: the samples of most pixels are all equal, and tell no sigma")
        kept = source.sensor if instead_of is not None else replace(sensor, noise=measured.curve)
        return FoundNoise(sensor=kept, measured=measured, model=None)
    model = learn_pixel_noise(
        pixels, sensor, None if measured is None else measured.curve, shape=shape, widths=widths,
        drift=drift, instead_of=instead_of,
        workers=workers,
    )  # fmt: skip
    noise = model.noise
    if model.given_holds:
        return FoundNoise(sensor=source.sensor, measured=measured, model=model)
    if noise.is_gaussian:
        curve = _without_spread(noise.curve, pixels.rounding_mm)
        if measured is not None and model.kept_start and pixels.rounding_mm < COARSE * curve.sigma_mm.min():
            curve = measured.curve
        return FoundNoise(sensor=replace(sensor, noise=curve), measured=measured, model=model)
    beam = beam_of(replace(sensor, noise=noise.curve))
    thresholds = known_thresholds(
        noise, beam, model.ranges_mm, samples=_numbers(pixels, min_samples, window), pixel_effects=model.pixel_effects,
        rounding_mm=pixels.rounding_mm, workers=workers, progress=progress,
    )  # fmt: skip
    curve = noise.curve
    if noise.background is not None:
        curve = replace(curve, background=background_map(source, noise, sensor, window))
    return FoundNoise(
        sensor=replace(sensor, noise=curve, learnt=noise.learnt_with(thresholds)), measured=measured, model=model
    )


def learn_if_contradicted(
    source: SampleSource,
    *,
    window_frames: int,
    stride_frames: int | None = None,
    **choices: Any,  # noqa: ANN401  those of `learn_noise`
) -> FoundNoise | None:
    """The noise to use instead of the Gaussian curve that the recording's sensor has.

    Parameters
    ----------
    source : SampleSource
        The recording, with a curve.
    window_frames, stride_frames : int
        The windows, in frames.
    **choices
        As for `learn_noise`.

    Returns
    -------
    FoundNoise or None
        None where the samples do not contradict the curve, or nothing predicts pixels that no fit has seen better.

    Raises
    ------
    ValueError
        If the sensor has no curve.
    """
    targets = samples_a_frame(source)
    stride = (stride_frames or window_frames) * targets
    pixels = pixels_of(source, window_frames * targets, stride, most=QUESTIONED_PIXELS)
    if not scatters(pixels) or not doubts(pixels, source.sensor):
        return None
    found = learn_noise(
        source, window_frames=window_frames, stride_frames=stride_frames, instead_of=source.sensor.noise, **choices
    )
    return None if found.model is None or found.model.given_holds else found


def _without_spread(curve: NoiseCurve, rounding_mm: float) -> NoiseCurve:
    """The curve without the even spread over a step that samples were given to teach; the rounding itself stays."""
    variance = curve.sigma_mm**2 - rounding_mm**2 / 12.0
    return replace(curve, sigma_mm=np.sqrt(np.maximum(variance, rounding_mm**2 / 12.0)))


def has_parts(curve: NoiseCurve) -> bool:
    """Whether a file's curve says more than sigma by range and amplitude."""
    return curve.shape is not None or curve.width_spread > 0 or curve.background is not None


def calibrated(
    source: SampleSource,
    *,
    window_frames: int,
    min_samples: int = 3,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Sensor:
    """The recording's sensor with the gains that the noise it states reaches by chance.

    Parameters
    ----------
    source : SampleSource
        The recording; its curve has a shape, widths or a background.
    window_frames, min_samples, workers, progress
        As for `learn_noise`.

    Raises
    ------
    ValueError
        If it has no curve.
    """
    sensor = source.sensor
    if sensor.noise is None:
        raise ValueError("the sensor has no noise curve")
    background = None
    if sensor.noise.background is not None:
        shares = np.ravel(sensor.noise.background)
        background = beta_prior(shares, np.full(shares.shape, np.inf))
    noise = PixelNoise(
        curve=sensor.noise, p_outlier=sensor.outlier_probability, background=background, drift_mm=np.zeros(DRIFTS)
    )
    pixels = pixels_of(source, window_frames * samples_a_frame(source), window_frames * samples_a_frame(source))
    ranges = np.sort(medians(pixels.samples))
    thresholds = known_thresholds(
        noise,
        beam_of(sensor),
        ranges if ranges.size else np.array(sensor.noise.range_mm),
        samples=_numbers(pixels, min_samples, window_frames * samples_a_frame(source)),
        rounding_mm=pixels.rounding_mm,
        workers=workers,
        progress=progress,
    )
    return replace(sensor, learnt=noise.learnt_with(thresholds))


def scatters(pixels: Pixels) -> bool:
    """Whether the samples of most pixels differ by more than their rounding: else they are stuck, or coarse."""
    known = np.isfinite(pixels.samples)
    high = np.where(known, pixels.samples, -np.inf).max(axis=1)
    low = np.where(known, pixels.samples, np.inf).min(axis=1)
    seen = known.sum(axis=1) > 1
    return not seen.any() or bool(np.median((high - low)[seen]) > pixels.rounding_mm)


def _numbers(pixels: Pixels, min_samples: int, window: int) -> tuple[int, int]:
    """Fewest and most valid samples that all but a few of the pixels have which can be fitted."""
    number = np.isfinite(pixels.samples).sum(axis=1)
    known = number[number >= min_samples]
    if known.size == 0:
        return min_samples, window
    low, high = np.quantile(known, (FEW_PIXELS, 1.0 - FEW_PIXELS))
    return int(low), math.ceil(high)


def pixels_of(source: SampleSource, window_frames: int, stride_frames: int, *, most: int = MOST_PIXELS) -> Pixels:
    """Up to `most` pixels, evenly spread over the image and the windows; fewer of more than `MOST_SAMPLES` in all.

    Rounding is spread evenly over the step of stored ranges: equal samples tell no width.
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
        light = read_runs(_Light(amplitudes, source), starts.tolist(), length, chosen, None).samples[keep]
    rounding = quantisation_step(samples)
    rng = np.random.default_rng(_SEED)
    smooth = samples + rng.uniform(-0.5 * rounding, 0.5 * rounding, samples.shape)
    return Pixels(samples=np.ascontiguousarray(smooth, dtype=np.float32), amplitude=light, rounding_mm=float(rounding))


class _Light:
    """Amplitudes, read as ranges are."""

    def __init__(self, amplitudes: AmplitudeSource, source: SampleSource) -> None:
        self._amplitudes = amplitudes
        self.shape, self.row_step, self.frame_step, self.sensor = (
            source.shape, source.row_step, source.frame_step, source.sensor
        )  # fmt: skip

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes of some frames and rows."""
        return self._amplitudes.read_amplitude(frames, rows)


def background_map(source: SampleSource, noise: PixelNoise, sensor: Sensor, window_frames: int) -> FloatArray:
    """Share (row, col) of background of each pixel in the first window; the prior's mean where none shows a surface."""
    frames, rows, cols = source.shape
    length = min(window_frames, MOST_FRAMES, frames)
    beam = beam_of(replace(sensor, noise=noise.curve))
    near, far = noise.background or (0.0, 1.0)
    out = np.full((rows, cols), near / (near + far))
    band = max(1, source.row_step)
    for first in range(0, rows, band):
        block = source.read_range(slice(0, length), slice(first, min(first + band, rows)))
        samples = np.ascontiguousarray(block.reshape(length, -1).T.astype(np.float32))
        share, number = background_shares(samples, noise.laws(), beam, flat_thresholds(), MAX_LAYERS)
        part = out[first : first + band].reshape(-1)
        known = number > 0
        part[known] = (share[known] * number[known] + near) / (number[known] + near + far)
        out[first : first + band] = part.reshape(-1, cols)
    return np.asarray(np.minimum(out, 0.999), dtype=np.float64)
