"""Learn the noise of a recording: read pixels, learn the noise from them, and draw the thresholds of the count.

`warm_up` compiles the kernels of learnt noise, or loads them from the cache: each runs once on some made-up pixels.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.beam import COARSE, Beam, all_steps, beam_of, step_matters, steps_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.background import background_counts, background_shares, pixel_widths, smooth_density
from tofmix.estimation.learnt.bootstrap import calibrate, known_thresholds
from tofmix.estimation.learnt.clusters import cluster_likelihoods, find_clusters, fit_clusters
from tofmix.estimation.learnt.folds import MAX_LAYERS, flat_thresholds, held_out_scores
from tofmix.estimation.learnt.law import precision_of_t
from tofmix.estimation.learnt.learning import LearntModel, learn_pixel_noise
from tofmix.estimation.learnt.model import PixelNoise, noise_words
from tofmix.estimation.learnt.parts import beta_prior
from tofmix.estimation.learnt.population import LOG_WIDTHS, ONE_SURFACE, population_likelihoods
from tofmix.estimation.noise.measurement import MeasuredNoise, measure_noise
from tofmix.estimation.noise.series import sigma_from_differences
from tofmix.estimation.noise.training_pixels import (
    MOST_FRAMES,
    Pixels,
    medians,
    pixels_of,
    sample_numbers,
    scatters,
)
from tofmix.noise_shape import DRIFTS, RangeStep
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.sensor import DEFAULT_OUTLIER_PROBABILITY, NoiseCurve, Sensor
from tofmix.wording import counted

LEAST_IN_PIXEL, LEAST_IN_ALL = 5, 100
"""Least valid samples for one sigma: in some pixel, and in all pixels. Its standard error is then 7 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundNoise:
    """The noise of a recording.

    Parameters
    ----------
    sensor : Sensor
        The recording's, with the noise curve, and with `learnt` where the noise is not Gaussian alone.
    measured : MeasuredNoise or None
        The curve by pixels of one surface (`noise.measurement`); None where there are too few.
    model : LearntModel or None
        The learnt model; None where the samples of most pixels are equal.
    """

    sensor: Sensor
    measured: MeasuredNoise | None
    model: LearntModel | None

    @property
    def is_gaussian(self) -> bool:
        """Whether the noise is a curve alone."""
        return self.sensor.learnt is None

    def line(self) -> str:
        """The noise in one line, for a user."""
        said = noise_words(self.sensor)
        if self.model is None:
            return f"{', '.join(said)}; the samples of most pixels are all equal"
        told = f"{', '.join(said)}; learnt from {counted(self.model.pixels, 'pixel')}"
        if self.model.shapes_differ:
            told += "; the shape of the error differs between pixels, and one is used for all"
        background = self.sensor.learnt is not None and self.sensor.learnt.background is not None
        if self.measured is not None and not background:
            share = self.sensor.outlier_probability
            if share == self.measured.outlier_probability:
                told += f"; {100 * share:.2g} % of the samples are random values"
        return told + self._disagreement()

    def _disagreement(self) -> str:
        """Sigma by pixels of one surface, in words, where it differs from the learnt one."""
        curve = self.sensor.noise
        if self.measured is None or curve is None:
            return ""
        other = self.measured.curve
        wide = 1.0 if curve.shape is None else curve.shape.moments()[1]
        ratio = float(np.exp(np.median(np.log(other.sigma_mm / (wide * curve.sigma(other.range_mm))))))
        # Ratio of two measurements of sigma from which on both are reported: drifts and shapes change it by less.
        disagree = 1.25
        if max(ratio, 1.0 / ratio) < disagree:
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
    density: bool = True,
    instead_of: NoiseCurve | None = None,
    step: RangeStep | None = None,
    step_of_type: bool = False,
    min_samples: int = 3,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> FoundNoise:
    """Learn a recording's noise.

    Parameters
    ----------
    source : SampleSource
        The recording. Of its sensor the working range is used, and not the curve.
    window_frames, stride_frames : int
        Frames of a window, and from one window to the next.
    shape : bool
        Whether the error may have another shape than a Gaussian's.
    widths : bool, optional
        Whether each pixel has a width; None: where the samples show it.
    drift : bool
        Whether a pixel's ranges may drift within a window.
    density : bool
        Whether background may have a density over range; on a circle of ranges it is uniform.
    instead_of : NoiseCurve, optional
        A Gaussian curve that is kept if it predicts held-out pixels as well. Without it, the share of outliers is
        learnt too (`share_of_outliers`).
    step : RangeStep, optional
        Step of the stored ranges. Where it is no small part of sigma, the noise is integrated over it, and surfaces are
        counted with `learnt` even if the noise is a curve alone. Default: a common one, from the samples.
    step_of_type : bool
        Whether it is the step of the stored type: then it is used only where it is no small part of sigma.
    min_samples : int
        Fewest samples of a fitted pixel.
    workers : int
        Threads; the result does not depend on them.
    progress : callable, optional
        Is called with the numbers of finished and of all steps of the bootstrap.

    Returns
    -------
    FoundNoise
        It depends on the samples and the options alone. Where `instead_of` is kept, its sensor is the recording's.

    Raises
    ------
    ValueError
        If the samples are too few, or all equal.
    """
    measured = _measured(source, None if step_of_type else step)
    targets = samples_a_frame(source)
    window, stride = window_frames * targets, (stride_frames or window_frames) * targets
    sensor = replace(source.sensor, noise=None, learnt=None, range_step_mm=None)
    if instead_of is None and measured is not None:
        sensor = replace(sensor, outlier_probability=share_of_outliers(sensor, measured))
    pixels = _pixels(source, window, stride, None if step_of_type else step, measured)
    if step is not None and step_of_type and _matters(step, pixels, measured, of_type=True):
        measured = _measured(source, step)
        pixels = pixels_of(source, window, stride, step=step)
    filled = np.isfinite(pixels.samples).sum(axis=1)
    if filled.max(initial=0) < LEAST_IN_PIXEL or filled.sum() < LEAST_IN_ALL:
        raise ValueError(
            f"noise: {counted(int(filled.sum()), 'valid sample')}, {int(filled.max(initial=0))} in a pixel at most; at"
            f" least {LEAST_IN_ALL} and {LEAST_IN_PIXEL} are needed to tell one sigma"
        )
    if pixels.step is None and not scatters(pixels):
        if measured is None:
            raise ValueError("noise: the samples of most pixels are all equal, and tell no sigma")
        kept = source.sensor if instead_of is not None else replace(sensor, noise=measured.curve)
        return FoundNoise(sensor=kept, measured=measured, model=None)
    model = learn_pixel_noise(
        pixels,
        sensor,
        None if measured is None else measured.curve,
        shape=shape,
        widths=widths,
        drift=drift,
        density=density,
        instead_of=instead_of,
        workers=workers,
    )
    noise = model.noise
    if model.given_holds:
        return FoundNoise(sensor=source.sensor, measured=measured, model=model)
    if noise.is_gaussian and pixels.step is None:
        curve = _without_spread(noise.curve, pixels.rounding_mm)
        if measured is not None and model.kept_start and pixels.rounding_mm < COARSE * curve.sigma_mm.min():
            curve = measured.curve
        return FoundNoise(sensor=replace(sensor, noise=curve), measured=measured, model=model)
    if noise.is_gaussian and measured is not None and model.kept_start and not pixels.is_coarse(measured.curve, COARSE):
        noise = replace(noise, curve=measured.curve)  # where pixels of several surfaces are many, it is less wrong
    steps = None if pixels.step is None else pixels.step.without_pixels()
    beam = beam_of(replace(sensor, noise=noise.curve))._replace(steps=steps_of(steps, noise.curve))
    thresholds = known_thresholds(
        noise,
        beam,
        model.ranges_mm,
        samples=sample_numbers(pixels, min_samples, window),
        pixel_effects=model.pixel_effects,
        rounding_mm=pixels.rounding_mm,
        workers=workers,
        progress=progress,
    )
    curve = noise.curve
    if noise.background is not None:
        curve = replace(curve, background=background_map(source, noise, beam, window))
    return FoundNoise(
        sensor=replace(sensor, noise=curve, learnt=noise.learnt_with(thresholds)), measured=measured, model=model
    )


def share_of_outliers(sensor: Sensor, measured: MeasuredNoise) -> float:
    """p(c_r) for learning: the sensor's, or the counted one where nothing is stated and the count contradicts it.

    A sensor that states nothing has `DEFAULT_OUTLIER_PROBABILITY`. Counted outliers contradict it where their number is
    1000 times as likely under their own share. Under too small a share, two of them that lie together pass
    for a surface. Parts of the noise do not show such shares: `held_out.SURPRISES` is mixed into all models.
    """
    assumed, counted_share = sensor.outlier_probability, measured.outlier_probability
    if assumed != DEFAULT_OUTLIER_PROBABILITY or counted_share <= assumed:
        return assumed
    count = measured.outlier_samples
    samples = (count + 0.5) / counted_share
    gain = count * math.log(counted_share / assumed) - samples * (counted_share - assumed)
    # probability by chance, as of a part of the noise (`candidates.held_out_gain`)
    return counted_share if gain > -math.log(1.0e-3) else assumed


def _pixels(
    source: SampleSource, window: int, stride: int, step: RangeStep | None, measured: MeasuredNoise | None
) -> Pixels:
    """Pixels that teach; their samples are as stored where the step is no small part of sigma."""
    pixels = pixels_of(source, window, stride, step=step)
    return pixels if step is None or _matters(step, pixels, measured) else pixels.with_fine_step()


def _matters(step: RangeStep, pixels: Pixels, measured: MeasuredNoise | None, *, of_type: bool = False) -> bool:
    """Whether the step is no small part of the sigma of pixels, as measured or by differences of samples."""
    if measured is not None:
        return step_matters(step, measured.curve, of_type=of_type)
    found = sigma_from_differences(pixels.smooth)
    return found is None or step_matters(step, NoiseCurve(*found), of_type=of_type)


def _measured(source: SampleSource, step: RangeStep | None) -> MeasuredNoise | None:
    """Noise by pixels of one surface; None where they are too few."""
    try:
        return measure_noise(source, step=step)
    except ValueError:
        return None


def learn_instead(source: SampleSource, *, window_frames: int, **choices: Any) -> FoundNoise | None:  # noqa: ANN401  those of `learn_noise`
    """Learn the noise in place of the sensor's Gaussian curve, which the samples contradict (`noise.curve_check`).

    Parameters
    ----------
    source : SampleSource
        The recording, with a curve.
    window_frames, **choices
        As for `learn_noise`.

    Returns
    -------
    FoundNoise or None
        None where no model predicts held-out pixels better than the curve.
    """
    found = learn_noise(source, window_frames=window_frames, instead_of=source.sensor.noise, **choices)
    return None if found.model is None or found.model.given_holds else found


def _without_spread(curve: NoiseCurve, rounding_mm: float) -> NoiseCurve:
    """The curve without the uniform noise that `pixels_of` adds; the rounding itself stays."""
    variance = curve.sigma_mm**2 - rounding_mm**2 / 12.0
    return replace(curve, sigma_mm=np.sqrt(np.maximum(variance, rounding_mm**2 / 12.0)))


def calibrated(
    source: SampleSource,
    *,
    window_frames: int,
    step: RangeStep | None = None,
    min_samples: int = 3,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Sensor:
    """Return the recording's sensor with the gains that its own noise alone reaches.

    Parameters
    ----------
    source : SampleSource
        The recording; its curve has a shape, widths or a background, or its step is no small part of sigma.
    window_frames, step, min_samples, workers, progress
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
    window = window_frames * samples_a_frame(source)
    pixels = pixels_of(source, window, window, step=step)
    beam = beam_of(replace(sensor, range_step_mm=None))
    if step is not None:
        beam = beam._replace(steps=steps_of(step.without_pixels(), sensor.noise))
    ranges = np.sort(medians(pixels.samples))
    thresholds = known_thresholds(
        noise,
        beam,
        ranges if ranges.size else np.array(sensor.noise.range_mm),
        samples=sample_numbers(pixels, min_samples, window),
        rounding_mm=pixels.rounding_mm,
        workers=workers,
        progress=progress,
    )
    return replace(sensor, learnt=noise.learnt_with(thresholds))


def background_map(source: SampleSource, noise: PixelNoise, beam: Beam, window_frames: int) -> FloatArray:
    """Share of background (row, col) in the first window; the mean of the prior in pixels without a surface."""
    frames, rows, cols = source.shape
    length = min(window_frames, MOST_FRAMES, frames)
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


_RANGE_MM, _SIGMA_MM = 1000.0, 10.0
_FRAMES, _PIXELS = 20, 3
"""Range, sigma and size of the made-up samples."""


def warm_up() -> None:
    """Run each kernel once."""
    warm_up_first()
    warm_up_later()


def warm_up_first() -> None:
    """Run the kernels that learn sigma, drift and shape."""
    samples, sensor, noise = _made_up()
    laws, beam = noise.laws(), beam_of(sensor)
    fit_clusters(samples, find_clusters(samples, beam), laws[0], beam, True)  # noqa: FBT003  a kernel's flag
    held_out_scores(samples, laws, beam, flat_thresholds(), 2)
    precision_of_t(0.0, 1.0)


def warm_up_later() -> None:
    """Run the kernels that count surfaces, draw the gains of noise alone, and weigh sigmas of samples on a step."""
    samples, sensor, noise = _made_up()
    laws, beam, thresholds = noise.laws(), beam_of(sensor), flat_thresholds()
    clusters = find_clusters(samples, beam)
    fits = fit_clusters(samples, clusters, laws[0], beam, True)  # noqa: FBT003  a kernel's flag
    stepped = beam._replace(steps=all_steps(RangeStep.common(1.0)))
    cluster_likelihoods(samples, clusters, fits.place, fits.support, np.ones(len(fits.place)), laws[1], stepped)
    background_shares(samples, laws, beam, thresholds, 2)
    background_counts(samples, laws, beam, thresholds, 2, np.array([0.0, 2.0 * _RANGE_MM]))
    smooth_density(np.array([1.0, 9.0]), np.array([0.0, _RANGE_MM, 2.0 * _RANGE_MM]))
    pixel_widths(samples, laws, laws[0], beam, thresholds, 2)
    none = np.zeros(1)
    population_likelihoods(np.zeros((1, _FRAMES)), none, none + 0.1, none + 1.0, laws[0], ONE_SURFACE, LOG_WIDTHS)
    gains = calibrate(noise, beam, np.array([_RANGE_MM]), samples=(_FRAMES, _FRAMES), draws=_FRAMES)
    layer_pixels(samples.T, replace(sensor, learnt=noise.learnt_with(gains)))


def _made_up() -> tuple[Float32Array, Sensor, PixelNoise]:
    """Samples (pixel, frame), mm, their camera, and its noise."""
    samples = np.random.default_rng(1).normal(_RANGE_MM, _SIGMA_MM, (_PIXELS, _FRAMES)).astype(np.float32)
    curve = NoiseCurve(np.array([_RANGE_MM]), np.array([_SIGMA_MM]))
    sensor = Sensor(name="warm-up", range_min_mm=0.0, range_max_mm=2.0 * _RANGE_MM, noise=curve)
    return samples, sensor, PixelNoise.gaussian(curve, sensor.outlier_probability)
