"""From a recording to a camera that carries its noise, and the line that says what was found."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import CAMERA, KNOWN, LOW_MM, SIGMA_MM, TOP_MM, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.bootstrap import calibrate
from tofmix.estimation.learnt.recordings import (
    FoundNoise,
    calibrated,
    learn_instead,
    learn_noise,
    share_of_outliers,
)
from tofmix.estimation.noise.curve_check import is_contradicted
from tofmix.estimation.noise.measurement import MeasuredNoise
from tofmix.estimation.noise.training_pixels import Pixels, pixels_of, scatters
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

COLS = 15


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thresholds from a few hundred draws a cell: near enough where none is asked to hold a promise."""
    fewer = functools.partial(calibrate, draws=300)
    monkeypatch.setattr("tofmix.estimation.learnt.recordings.known_thresholds", fewer)


def _recording(samples: FloatArray, sensor: Sensor = CAMERA) -> ArrayRecording:
    """A recording of samples (frame, pixel), fifteen columns wide."""
    return ArrayRecording(samples.reshape(len(samples), -1, COLS), sensor)


def _learnt(samples: FloatArray) -> tuple[FoundNoise, Layers]:
    found = learn_noise(_recording(samples), window_frames=len(samples))
    return found, layer_pixels(samples, found.sensor)


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_line_describes_the_learnt_noise(rng: np.random.Generator) -> None:
    share = rng.uniform(0.1, 0.6, 300)
    samples = surfaces(rng, (80, 300), (2000.0,), errors=KNOWN["skewed"].draw, background=share)
    found, layers = _learnt(samples)
    said = re.fullmatch(
        r"sigma (\d+\.?\d*)( to \d+\.?\d*)? mm, skewed \((\d\.\d)\), background (\d+) to (\d+) % by pixel,"
        r" widths alike; learnt from 300 pixels",
        found.line(),
    )
    assert said is not None, found.line()
    assert float(said[1]) == pytest.approx(SIGMA_MM, rel=0.1)
    assert float(said[3]) == pytest.approx(1.0, abs=0.4)
    low, high = np.quantile(share, [0.05, 0.95])
    assert int(said[4]) == pytest.approx(100 * low, abs=8)
    assert int(said[5]) == pytest.approx(100 * high, abs=8)
    assert not found.is_gaussian
    # The map of background is that of the pixels, and what the layers say of them too.
    assert found.sensor.noise is not None
    assert found.sensor.noise.background is not None
    assert np.corrcoef(found.sensor.noise.background.ravel(), share)[0, 1] > 0.9
    assert np.corrcoef(layers.weight_outlier, share)[0, 1] > 0.9
    assert (layers.n_modes == 1).mean() > 0.98


@pytest.mark.slow
def test_gaussian_noise_needs_no_thresholds_and_is_counted_as_ever(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (60, 300), (2000.0,))
    found = learn_noise(_recording(samples), window_frames=60)
    assert found.is_gaussian
    assert found.sensor.learnt is None
    assert re.fullmatch(r"sigma [\d.]+( to [\d.]+)? mm, Gaussian, widths alike; learnt from 300 pixels", found.line())


def test_few_pixels_give_one_sigma(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (30, 12), (2000.0,))
    found = learn_noise(ArrayRecording(samples.reshape(30, 3, 4), CAMERA), window_frames=30)
    assert re.fullmatch(r"sigma [\d.]+ mm, Gaussian, widths alike; learnt from 12 pixels", found.line())
    assert found.sensor.noise is not None
    assert found.sensor.noise.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.15)
    layers = layer_pixels(samples, found.sensor)
    np.testing.assert_array_equal(layers.n_modes, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_order_of_frames_changes_no_layer_where_noise_does_not_drift(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (60, 300), (2000.0,), errors=KNOWN["skewed"].draw).astype(np.float32).astype(np.float64)
    found, layers = _learnt(samples)
    assert found.sensor.learnt is not None
    assert not found.sensor.learnt.drift_mm.any()
    again = layer_pixels(samples[rng.permutation(60)], found.sensor)
    for a, b in zip(layers.arrays(), again.arrays(), strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_step_in_mid_window_stays_two_layers_among_drifting_pixels(rng: np.random.Generator) -> None:
    frames, pixels = 100, 300
    time = np.linspace(-1.0, 1.0, frames)[:, np.newaxis]
    drift = 1.5 * SIGMA_MM * rng.choice([-1.0, 1.0], pixels) * time
    drift[:, :15] = np.where(time < 0.1, 0.0, 6.0 * SIGMA_MM)
    found, layers = _learnt(surfaces(rng, (frames, pixels), (2000.0,), drift_mm=drift))
    assert "pixels drift by" in found.line()
    np.testing.assert_array_equal(layers.n_modes[:15], 2)
    assert (layers.n_modes[15:] == 1).mean() >= 0.99


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_recording_of_background_alone_has_no_surface(rng: np.random.Generator) -> None:
    _, layers = _learnt(rng.uniform(LOW_MM, TOP_MM, (60, 300)))
    assert (layers.n_modes > 0).mean() <= 0.02


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_samples_in_steps_of_two_sigma_teach_without_failure(rng: np.random.Generator) -> None:
    step = 2.0 * SIGMA_MM
    place = rng.uniform(-300.0, 300.0, 300)
    found, layers = _learnt(step * np.rint(surfaces(rng, (60, 300), (2000.0,), drift_mm=place) / step))
    assert found.sensor.noise is not None
    # Between the camera's noise, and that with the spread of its steps and of what stands in for them.
    sigma = float(found.sensor.noise.sigma(2000.0))
    assert 0.9 * SIGMA_MM <= sigma <= 1.1 * np.sqrt(SIGMA_MM**2 + step**2 / 6.0)
    assert (layers.n_modes >= 1).all()
    assert (layers.n_modes == 1).mean() >= 0.85


def test_constant_samples_are_reported_and_are_one_surface() -> None:
    samples = np.full((60, 300), 2000.0)
    found = learn_noise(_recording(samples), window_frames=60)
    assert found.line().endswith("the samples of most pixels are all equal")
    np.testing.assert_array_equal(layer_pixels(samples, found.sensor).n_modes, 1)


@pytest.mark.parametrize(
    ("samples", "text"),
    [
        (np.full((3, 300), 2000.0) + np.arange(3)[:, np.newaxis], "900 valid samples, 3 in a pixel at most"),
        (np.where(np.arange(300) < 3, 1.0, np.nan) * np.linspace(1990.0, 2010.0, 30)[:, np.newaxis], "90 valid"),
        (np.full((30, 300), np.nan), "0 valid samples, 0 in a pixel at most"),
    ],
    ids=["three samples a pixel", "three pixels", "none"],
)
def test_too_few_samples_are_refused_with_their_number(samples: FloatArray, text: str) -> None:
    with pytest.raises(ValueError, match=f"noise: {text}.*at least 100 and 5 are needed to tell one sigma"):
        learn_noise(_recording(samples), window_frames=len(samples))


def test_pixels_to_learn_from_are_spread_over_the_image_and_the_windows(rng: np.random.Generator) -> None:
    samples = np.rint(surfaces(rng, (40, 60), (2000.0,)))
    samples += 1000.0 * (np.arange(40) // 10)[:, np.newaxis]
    samples[5] = np.inf
    pixels = pixels_of(_recording(samples), 10, 10)
    assert pixels.samples.shape == (240, 10)
    assert pixels.rounding_mm == 1.0
    windows = np.bincount(np.rint(np.nanmedian(pixels.samples, axis=1) / 1000.0).astype(int))
    np.testing.assert_array_equal(windows[windows > 0], 60)
    assert np.isnan(pixels.samples).sum() == 60
    # A sample's rounding is spread over its step, and no farther.
    some = pixels_of(_recording(samples), 10, 10, most=24)
    assert len(some.samples) <= 24
    first = pixels.samples[:60].T
    assert np.nanmax(np.abs(first - samples[:10])[np.isfinite(first)]) <= 0.5 + 1e-3


@pytest.mark.parametrize(
    ("samples", "does"),
    [
        (np.full((20, 30), 2000.0), False),
        (np.full((20, 30), 2000.0) + 30.0 * (np.arange(30) % 7), True),
        (np.where(np.arange(20)[:, np.newaxis] < 15, 2000.0, 2000.0 + 30.0 * (np.arange(30) % 7)), False),
        (np.full((20, 30), np.nan), True),
    ],
    ids=["equal", "spread", "most equal", "none"],
)
def test_pixels_scatter_where_most_differ_by_more_than_their_step(samples: FloatArray, does: bool) -> None:
    assert scatters(Pixels(samples=samples.astype(np.float32), rounding_mm=1.0)) is does


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "kept"), [(SIGMA_MM, True), (2.0 * SIGMA_MM, False)])
def test_a_files_curve_is_replaced_only_where_samples_contradict_it(
    sigma: float, kept: bool, rng: np.random.Generator
) -> None:
    sensor = replace(CAMERA, noise=NoiseCurve(np.array([2000.0]), np.array([sigma])))
    source = _recording(surfaces(rng, (50, 120), (2000.0,)), sensor)
    assert is_contradicted(source, window_frames=50) is not kept
    found = learn_instead(source, window_frames=50)
    assert (found is None) is kept
    if found is not None:
        assert found.sensor.noise is not None
        assert found.sensor.noise.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.1)


@pytest.mark.usefixtures("few_draws")
def test_a_curve_that_states_parts_gets_the_gains_of_its_own_noise(rng: np.random.Generator) -> None:
    noise = pixel_noise("skewed")
    assert noise.curve.has_parts
    assert not pixel_noise().curve.has_parts
    samples = surfaces(rng, (40, 60), (2000.0,), errors=KNOWN["skewed"].draw)
    sensor = calibrated(_recording(samples, replace(CAMERA, noise=noise.curve)), window_frames=40)
    assert sensor.noise is noise.curve
    assert sensor.learnt is not None
    assert sensor.learnt.gain_samples[-1] == pytest.approx(40.0)
    assert (layer_pixels(samples, sensor).n_modes == 1).mean() >= 0.95
    with pytest.raises(ValueError, match="no noise curve"):
        calibrated(_recording(samples), window_frames=40)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_images_of_few_rows_are_learnt_from(rows: int, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (20, 20_000 // rows * rows), (2000.0,)).reshape(20, rows, -1)
    source = ArrayRecording(samples.astype(np.float32), CAMERA)
    assert len(pixels_of(source, 20, 20, most=100).samples) >= 50


@pytest.mark.parametrize(
    ("stated", "count", "samples", "replaced"),
    [
        (1e-4, 600, 30_000, True),  # 3 would be expected
        (1e-4, 5, 30_000, False),
        (1e-4, 0, 30_000, False),
        (5e-3, 600, 30_000, False),  # what a file states is believed
    ],
)
def test_share_of_outliers_is_the_counted_one_where_nothing_is_stated_and_chance_gives_fewer(
    stated: float, count: int, samples: int, replaced: bool
) -> None:
    counted = (count + 0.5) / (samples + 1.0)
    measured = MeasuredNoise(
        curve=pixel_noise().curve,
        pixels=np.ones(1, dtype=np.int64),
        outlier_probability=counted,
        outlier_samples=count,
        step_mm=1.0,
    )
    found = share_of_outliers(replace(CAMERA, outlier_probability=stated), measured)
    assert found == (counted if replaced else stated)
