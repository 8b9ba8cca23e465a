"""Noise that falls with amplitude: measured, chosen or not, and used pixel by pixel."""

import numpy as np
import pytest
from numpy.typing import NDArray
from support.cameras import camera_of
from support.sizes import sized

from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.noise.amplitude import pixel_curves
from tofmix.estimation.noise.curve import smooth
from tofmix.estimation.noise.measurement import MeasuredNoise, measure_noise
from tofmix.grid import plan_windows
from tofmix.recording import ArrayRecording, amplitude_source
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor

BARE = Sensor(name="no curve", range_min_mm=300.0, range_max_mm=6000.0)
ROWS, COLS = 40, 60


def reflective(
    rng: np.random.Generator, exponent: float, *, frames: int = 60, multi: float = 0.3, sigma_mm: float = 12.0
) -> tuple[ArrayRecording, NDArray[np.float64], NDArray[np.float64]]:
    """A recording whose sigma is sigma_mm (amplitude / 300)^-exponent; first range and amplitude of each pixel too.

    Reflectivity is a pattern of squares; amplitude goes as reflectivity / r^2, with 5 % of noise of its own.
    """
    seen = np.linspace(900.0, 2400.0, COLS)[None, :] + rng.uniform(0.0, 40.0, (ROWS, COLS))
    squares = (np.arange(ROWS)[:, None] // 4 + np.arange(COLS)[None, :] // 3) % 4
    light = 1000.0 * np.array([0.08, 0.2, 0.45, 0.9])[squares] * (1000.0 / seen) ** 2
    behind, dim = seen + rng.uniform(20.0, 300.0, seen.shape), light * rng.uniform(0.3, 3.0, seen.shape)
    share = np.where(rng.random(seen.shape) < multi, rng.uniform(0.1, 0.9, seen.shape), 1.0)
    first = rng.random((frames, *seen.shape)) < share
    amplitude = np.where(first, light, dim)
    sigma = sigma_mm * (amplitude / 300.0) ** -exponent
    samples = np.rint(np.where(first, seen, behind) + sigma * rng.standard_normal(first.shape))
    recorded = amplitude * (1.0 + 0.05 * rng.standard_normal(first.shape))
    return ArrayRecording(samples, BARE, recorded), seen, light


def errors(
    measured: MeasuredNoise, seen: NDArray[np.float64], true: NDArray[np.float64], light: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Relative errors of sigma, pixel by pixel."""
    return np.asarray(measured.curve.sigma(seen, light) / true - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [0.7, 0.85, 1.0])
def test_sigma_by_range_and_amplitude_is_measured(rng: np.random.Generator, exponent: float) -> None:
    recording, seen, light = reflective(rng, exponent)
    measured = measure_noise(recording)
    assert measured.curve.law is not None
    assert measured.law_gain is not None
    assert measured.law_gain > 100
    away = errors(measured, seen, 12.0 * (light / 300.0) ** -exponent, light)
    inside = (light > measured.curve.law.amplitude[0]) & (light < measured.curve.law.amplitude[-1])
    assert inside.mean() > 0.95
    assert np.abs(away[inside]).max() < 0.08
    assert np.abs(away).mean() < 0.03
    alone = measure_noise(ArrayRecording(recording.read_range(slice(None), slice(None)), BARE))
    assert alone.curve.law is None
    assert np.abs(errors(alone, seen, 12.0 * (light / 300.0) ** -exponent, light)).mean() > 0.2


@pytest.mark.slow
@pytest.mark.parametrize("multi", [0.0, 0.4])
def test_amplitude_without_effect_changes_no_curve(rng: np.random.Generator, multi: float) -> None:
    recording, _, _ = reflective(rng, 0.0, multi=multi)
    measured = measure_noise(recording)
    assert measured.curve.law is None
    alone = measure_noise(ArrayRecording(recording.read_range(slice(None), slice(None)), BARE))
    np.testing.assert_array_equal(measured.curve.range_mm, alone.curve.range_mm)
    np.testing.assert_array_equal(measured.curve.sigma_mm, alone.curve.sigma_mm)
    assert measured.outlier_probability == alone.outlier_probability


def test_a_bend_is_measured(rng: np.random.Generator) -> None:
    light = np.geomspace(50.0, 5000.0, 4000)
    sigma = np.hypot(4.0, 4.0 * 600.0 / light)  # shot noise above a floor: no single power
    samples = 1500.0 + sigma * rng.standard_normal((60, 4000))
    recording = ArrayRecording(
        samples.reshape(60, 40, 100), BARE, np.broadcast_to(light, samples.shape).reshape(60, 40, 100)
    )
    measured = measure_noise(recording)
    assert measured.curve.law is not None
    falls = measured.curve.law.exponents()
    assert len(falls) > 1
    assert (np.diff(falls) < 0).all()
    assert np.abs(measured.curve.sigma(1500.0, light) / sigma - 1.0)[50:-50].max() < 0.15


LAW = AmplitudeLaw(np.full(2, 100.0), np.array([10.0, 1000.0]), np.array([10.0, 0.1]))
CAMERA = camera_of([1000.0, 3000.0], [10.0, 30.0], LAW, reach_mm=(300.0, 6000.0), outlier_probability=0.0)


def test_each_surface_of_a_pixel_has_its_own_sigma(rng: np.random.Generator) -> None:
    far = rng.random((200, 3)) < 0.5
    light = np.where(far, [400.0, 25.0, 100.0], [25.0, 400.0, 100.0]).astype(np.float32)
    samples = np.where(far, 3000.0, 1000.0) * (1.0 + 0.0001 * rng.standard_normal(far.shape))
    assert CAMERA.noise is not None
    curves = pixel_curves(samples.astype(np.float32), light, CAMERA.noise)
    for pixel, (near, back) in enumerate([(40.0, 7.5), (2.5, 120.0), (10.0, 30.0)]):
        size = curves.size[pixel]
        at = curves.range_mm[pixel, :size]
        assert (np.diff(at) > 0).all()
        np.testing.assert_allclose(
            np.interp([1000.0, 3000.0], at, curves.sigma_mm[pixel, :size]), (near, back), rtol=0.01
        )


def test_unknown_amplitudes_leave_the_curve(rng: np.random.Generator) -> None:
    samples = (2000.0 + 20.0 * rng.standard_normal((100, 4))).astype(np.float32)
    light = np.tile(np.array([0.0, np.nan, np.inf, -5.0], np.float32), (100, 1))
    found = layer_pixels(samples, CAMERA, amplitude=light)
    plain = layer_pixels(samples, CAMERA)
    np.testing.assert_allclose(found.range, plain.range, rtol=1e-6)
    np.testing.assert_allclose(found.sigma, plain.sigma, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.compiled("a frequency over 4000 pixels")
@pytest.mark.parametrize("light", [25.0, 100.0, 400.0])
def test_one_surface_stays_one_at_any_amplitude(rng: np.random.Generator, light: float) -> None:
    assert CAMERA.noise is not None
    sigma = float(CAMERA.noise.sigma(2000.0, light))
    assert sigma == pytest.approx(20.0 * 100.0 / light)
    samples = 2000.0 + sigma * rng.standard_normal((100, 4000))
    recorded = light * (1.0 + 0.1 * rng.standard_normal(samples.shape))
    found = layer_pixels(samples, CAMERA, amplitude=recorded)
    # 0.1 % are asked for; 20 of 4000 would be eight standard deviations above.
    assert (found.n_modes > 1).sum() < 20
    np.testing.assert_allclose(found.sigma[:, 0].mean(), sigma, rtol=0.05)
    if light != 100.0:
        wrong = layer_pixels(samples[:, :200], CAMERA)
        assert abs(float(np.nanmean(wrong.sigma[:, 0])) / sigma - 1.0) > 0.1


def test_order_of_frames_does_not_change_the_curve(rng: np.random.Generator) -> None:
    shape = 50, sized(40, 3)
    samples = np.rint(rng.choice([1500.0, 1560.0, 2500.0], shape) + 15.0 * rng.standard_normal(shape))
    light = rng.uniform(20.0, 800.0, samples.shape)
    order = rng.permutation(50)
    one, other = (layer_pixels(samples[k], CAMERA, amplitude=light[k]) for k in (np.arange(50), order))
    for a, b in zip(one.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_windows_read_their_own_amplitudes(rng: np.random.Generator) -> None:
    light = np.repeat([25.0, 400.0], 40)[:, None, None] * np.ones((80, 6, 5))
    samples = 2000.0 + 20.0 * 100.0 / light * rng.standard_normal(light.shape)
    found = estimate_layers(ArrayRecording(samples, CAMERA, light), windows=plan_windows(80, window=40))
    for window in range(2):
        part = slice(40 * window, 40 * window + 40)
        alone = layer_pixels(samples[part].astype(np.float32), CAMERA, amplitude=light[part])
        np.testing.assert_array_equal(found.sigma[window], alone.sigma)
    assert np.nanmedian(found.sigma[0]) > 5 * np.nanmedian(found.sigma[1])


def test_mismatched_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="differs from range"):
        layer_pixels(np.ones((5, 4)), CAMERA, amplitude=np.ones((5, 3)))
    with pytest.raises(ValueError, match="differs from range"):
        ArrayRecording(np.ones((5, 4, 4)), CAMERA, np.ones((5, 4)))
    with pytest.raises(ValueError, match="no law"):
        pixel_curves(np.ones((2, 2), np.float32), np.ones((2, 2), np.float32), NoiseCurve(np.ones(1), np.ones(1)))
    with pytest.raises(ValueError, match="no amplitudes"):
        ArrayRecording(np.ones((5, 4, 4)), CAMERA).read_amplitude(slice(None), slice(None))
    assert amplitude_source(ArrayRecording(np.ones((5, 4, 4)), CAMERA)) is None


def test_smoothing_pools_a_line_and_keeps_a_kink(rng: np.random.Generator) -> None:
    x = np.linspace(0.0, 2.0, 40)
    error = np.full(40, 0.03)
    line = np.array([smooth(x, 2.0 * x + error * rng.standard_normal(40), error, 4) - 2.0 * x for _ in range(50)])
    assert line.std() < 0.012  # a line through 40 points has 0.03 / sqrt(20) = 0.007
    kink = np.where(x < 1.0, 0.0, 5.0 * (x - 1.0))
    assert np.abs(smooth(x, kink, error, 4) - kink).max() < 0.05
    np.testing.assert_array_equal(smooth(x[:3], kink[:3], error[:3], 4), kink[:3])
