"""From a recording to a camera that carries its noise: each part is learnt where it is there, and dropped where not."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from support.learnt_pixels import CAMERA, KNOWN, SIGMA_MM, camera_with, flat, pixel_noise, surfaces

import tofmix as tm
from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.folds import whole_fold
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD
from tofmix.estimation.learnt.learning import (
    LearntModel,
    NoiseCandidate,
    held_out_gain,
    learn_pixel_noise,
    mean_difference,
)
from tofmix.estimation.learnt.model import SURE_SAMPLES, PixelNoise, thresholds_of
from tofmix.estimation.learnt.parts import with_part
from tofmix.estimation.learnt.recordings import FoundNoise, calibrated, learn_instead, learn_noise, share_of_outliers
from tofmix.estimation.learnt.sigma_curve import with_sigma
from tofmix.estimation.noise.curve_check import is_contradicted
from tofmix.estimation.noise.measurement import MeasuredNoise
from tofmix.estimation.noise.training_pixels import Pixels, pixels_of, scatters
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

COLS = 15


def _recording(samples: FloatArray, sensor: Sensor = CAMERA) -> ArrayRecording:
    """A recording of samples (frame, pixel), fifteen columns wide."""
    return ArrayRecording(samples.reshape(len(samples), -1, COLS), sensor)


def _learnt(samples: FloatArray, sensor: Sensor = CAMERA) -> tuple[FoundNoise, Layers]:
    found = learn_noise(_recording(samples, sensor), window_frames=len(samples))
    return found, layer_pixels(samples, found.sensor)


@pytest.mark.compiled("learns the noise of 18 pixels")
@pytest.mark.usefixtures("few_draws")
def test_a_few_far_pixels_have_the_sigma_of_their_range_and_one_surface_each(rng: np.random.Generator) -> None:
    # A zone sensor on the ground: most zones that return light see it at 3 cm, a few see a wall at 2.9 m.
    near, far = rng.uniform(25.0, 35.0, 13), rng.uniform(2820.0, 2900.0, 5)
    place, sigma = np.concatenate([near, far]), np.repeat([0.8, 22.0], [13, 5])
    samples = np.full((45, 30), np.nan)
    samples[:, 4:22] = place + sigma * rng.standard_normal((45, 18))
    found, layers = _learnt(samples, replace(CAMERA, range_min_mm=1.0, range_max_mm=4000.0))
    curve = found.sensor.noise
    assert curve is not None
    assert curve.sigma(np.array([30.0, 2860.0])) == pytest.approx([0.8, 22.0], rel=0.15)
    assert (layers.n_modes[4:22] == 1).all()
    assert np.abs(layers.range[4:22, 0] - place).max() < 3.0 * 22.0 / np.sqrt(45)


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
def test_step_in_mid_window_stays_two_layers_among_drifting_pixels(rng: np.random.Generator) -> None:
    frames, pixels = 100, 300
    time = np.linspace(-1.0, 1.0, frames)[:, np.newaxis]
    drift = 1.5 * SIGMA_MM * rng.choice([-1.0, 1.0], pixels) * time
    drift[:, :15] = np.where(time < 0.1, 0.0, 6.0 * SIGMA_MM)
    found, layers = _learnt(surfaces(rng, (frames, pixels), (2000.0,), drift_mm=drift))
    assert "pixels drift by" in found.line()
    np.testing.assert_array_equal(layers.n_modes[:15], 2)
    assert (layers.n_modes[15:] == 1).mean() >= 0.99


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


SIGMA_MM_ON_STEPS = 6.0
FRAMES, ROWS, COLS_ON_STEPS = 60, 12, 20


def place() -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform(1500.0, 4500.0, (ROWS, COLS_ON_STEPS))


def samples() -> NDArray[np.float64]:
    """Samples (frame, row, col), mm, of one surface in each pixel."""
    return np.asarray(
        place() + SIGMA_MM_ON_STEPS * np.random.default_rng(2).standard_normal((FRAMES, ROWS, COLS_ON_STEPS))
    )


def estimated(values: NDArray[np.float64], *, noise: tm.NoiseCurve | None = None, max_iter: int = 50) -> tm.Estimate:
    camera = tm.Sensor(name="camera", range_min_mm=500.0, range_max_mm=8000.0)
    recording = tm.from_array(values.astype(np.float32), units="mm", sensor=camera)
    return tm.estimate(recording, workers=1, noise=noise, max_iter=max_iter)


@pytest.mark.parametrize(
    "step", [pytest.param(0.3, marks=pytest.mark.slow), 2.0, pytest.param(5.0, marks=pytest.mark.slow)]
)
def test_sigma_false_alarms_and_errors_are_those_of_the_noise_before_rounding(step: float) -> None:
    step_mm = step * SIGMA_MM_ON_STEPS
    found = estimated(step_mm * np.rint(samples() / step_mm))
    assert found.sensor.range_step_mm is not None
    assert found.sensor.range_step_mm == pytest.approx(step_mm, rel=1e-6)
    assert np.nanmedian(found.sigma[0, ..., 0]) == pytest.approx(SIGMA_MM_ON_STEPS, rel=0.05)
    one = found.n_modes[0] == 1
    assert one.mean() > 0.99
    error = (found.range[0, ..., 0] - place())[one] / found.range_stderr[0, ..., 0][one]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.12)


@pytest.mark.slow
def test_a_step_by_range_stands_at_the_ranges_of_the_curve() -> None:
    part = 2.0 * SIGMA_MM_ON_STEPS / 3000.0
    found = estimated(np.exp(part * np.rint(np.log(samples()) / part)))
    noise, step = found.sensor.noise, found.sensor.range_step_mm
    assert noise is not None
    assert step is not None
    assert step.shape == noise.range_mm.shape
    inside = (noise.range_mm > 1600.0) & (noise.range_mm < 4400.0)
    np.testing.assert_allclose(step[inside], part * noise.range_mm[inside], rtol=0.03)
    assert np.nanmedian(found.sigma[0, ..., 0]) == pytest.approx(SIGMA_MM_ON_STEPS, rel=0.05)


@pytest.mark.slow
def test_steps_of_pixels_are_a_map_and_serve_their_pixels() -> None:
    own = 2.0 * SIGMA_MM_ON_STEPS * (1.0 + 0.3 * np.random.default_rng(3).random((ROWS, COLS_ON_STEPS)))
    found = estimated(own * np.rint(samples() / own))
    assert found.sensor.range_step_mm is not None
    np.testing.assert_allclose(found.sensor.range_step_mm, own, rtol=1e-3)
    assert np.nanmedian(found.sigma[0, ..., 0]) == pytest.approx(SIGMA_MM_ON_STEPS, rel=0.05)
    assert (found.n_modes == 1).mean() > 0.99


@pytest.mark.slow
def test_samples_of_one_value_have_the_standard_error_of_their_step() -> None:
    step_mm = 10.0 * SIGMA_MM_ON_STEPS
    values = step_mm * np.rint(samples() / step_mm)
    found = estimated(values, max_iter=1000)
    constant = (values == values[0]).all(axis=0)
    assert 0.4 < constant.mean() < 0.8
    stderr = found.range_stderr[0, ..., 0][constant]
    assert stderr.min() > 0.1 * step_mm
    assert stderr.max() < 0.5 * step_mm
    error = (found.range[0, ..., 0] - place())[constant]
    assert np.abs(error).max() < 0.6 * step_mm


@pytest.mark.slow
def test_two_alternating_values_are_one_surface_between_them() -> None:
    values = np.where(np.arange(FRAMES)[:, None, None] % 2 == 0, 3000.0, 3004.0) * np.ones((1, ROWS, COLS_ON_STEPS))
    found = estimated(values)
    assert found.sensor.range_step_mm == pytest.approx(4.0)
    assert (found.n_modes == 1).all()
    np.testing.assert_allclose(found.range[0, ..., 0], 3002.0, atol=0.05)
    assert (found.range_stderr[0, ..., 0] > 0.01).all()
    assert (found.sigma[0, ..., 0] >= 0.4).all()


def test_a_given_curve_is_integrated_over_the_step_too() -> None:
    step_mm = 2.0 * SIGMA_MM_ON_STEPS
    curve = tm.NoiseCurve(np.array([3000.0]), np.array([SIGMA_MM_ON_STEPS]))
    found = estimated(step_mm * np.rint(samples() / step_mm), noise=curve)
    assert found.sensor.noise is not None
    np.testing.assert_array_equal(found.sensor.noise.sigma_mm, SIGMA_MM_ON_STEPS)
    assert (found.n_modes == 1).mean() > 0.99


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*have two layers within 5 sigma:tofmix.errors.DoubtWarning")
def test_pairs_two_sigma_apart_are_found_and_not_taken_for_widths() -> None:
    rng, step_mm = np.random.default_rng([1, 100]), 0.9 * SIGMA_MM_ON_STEPS
    values = rng.uniform(1500.0, 4500.0, (15, 40)) + SIGMA_MM_ON_STEPS * rng.standard_normal((100, 15, 40))
    values[:, :, ::4] += 2.0 * SIGMA_MM_ON_STEPS * (rng.random((100, 15, 10)) < 0.5)
    found = estimated(step_mm * np.rint(values / step_mm))
    assert found.sensor.noise is not None
    assert found.sensor.noise.width_spread == 0.0
    assert (found.n_modes[0, :, ::4] == 2).mean() > 0.9  # of 150 pixels; taken for widths, it is 0.03
    assert (np.delete(found.n_modes[0], np.s_[::4], axis=1) > 1).mean() < 0.01


FULL = pixel_noise("skewed", background=(1.0, 9.0), width_spread=0.3, drift_mm=(5.0, 0.0, 2.0), memory=0.4)


def test_noise_and_gains_come_back_from_the_sensor() -> None:
    back = PixelNoise.of(camera_with(FULL))
    assert back.curve is FULL.curve
    assert (back.background, back.memory, back.p_outlier) == (FULL.background, FULL.memory, FULL.p_outlier)
    np.testing.assert_array_equal(back.drift_mm, FULL.drift_mm)
    for one, other in zip(back.laws(), FULL.laws(), strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    gains = flat(6.5, 4.5)._replace(log_n=np.log([30.0]))
    thresholds = thresholds_of(FULL.learnt_with(gains))
    for name in ("background", "more", "first"):
        np.testing.assert_array_equal(getattr(thresholds, name), getattr(gains, name))
    np.testing.assert_allclose(thresholds.log_n, gains.log_n, rtol=1e-14)


@pytest.mark.parametrize(
    ("noise", "gaussian"),
    [
        (pixel_noise(), True),
        (pixel_noise("skewed"), False),
        (pixel_noise(width_spread=0.1), False),
        (pixel_noise(background=(1.0, 2.0)), False),
        (pixel_noise(memory=0.1), False),
        (pixel_noise(drift_mm=(0.0, 0.0, 1.0)), False),
    ],
)
def test_any_part_beside_the_curve_makes_the_noise_more_than_a_gaussian(noise: PixelNoise, gaussian: bool) -> None:
    assert noise.is_gaussian is gaussian


def test_second_law_differs_by_its_drift_alone_and_known_background_is_sure() -> None:
    law, plain = FULL.laws()
    np.testing.assert_array_equal(law.drift_mm, [5.0, 0.0, 2.0])
    np.testing.assert_array_equal(plain.drift_mm, np.zeros(3))
    np.testing.assert_array_equal(law.density, plain.density)
    assert law.width_spread == plain.width_spread == SCALE_OF_SPREAD * 0.3
    law, _ = pixel_noise(p_outlier=0.02).laws()
    assert law.background_near / (law.background_near + law.background_far) == pytest.approx(0.02)
    assert law.background_near + law.background_far == pytest.approx(SURE_SAMPLES)


def test_a_sensor_has_the_noise_and_the_drift_that_it_learnt() -> None:
    assert camera_with(FULL).follows_drift
    assert not camera_with(pixel_noise("skewed")).follows_drift
    assert not CAMERA.follows_drift
    noise = PixelNoise.of(replace(CAMERA, noise=FULL.curve, outlier_probability=0.01))
    assert noise.background is None
    assert noise.p_outlier == 0.01
    assert noise.curve.shape is FULL.curve.shape
    with pytest.raises(ValueError, match="no noise curve"):
        PixelNoise.of(CAMERA)


FRAMES_LEARNING, PIXELS = 60, 300
TIME = np.linspace(-1.0, 1.0, FRAMES_LEARNING)[:, np.newaxis]


def _learnt_learning(samples: FloatArray, **choices: Any) -> LearntModel:  # noqa: ANN401  those of learn_pixel_noise
    """Learn from samples (frame, pixel)."""
    pixels = Pixels(samples=np.ascontiguousarray(samples.T, dtype=np.float32))
    return learn_pixel_noise(pixels, CAMERA, None, **choices)


def _parts(model: LearntModel) -> set[str]:
    noise = model.noise
    there = {
        "shape": noise.curve.shape is not None,
        "widths": noise.curve.width_spread > 0,
        "background": noise.background is not None,
        "drift": bool(noise.drift_mm.any()),
        "memory": noise.memory > 0,
    }
    return {name for name, found in there.items() if found}


@pytest.mark.slow
def test_gaussian_noise_teaches_sigma_alone(rng: np.random.Generator) -> None:
    model = _learnt_learning(surfaces(rng, (FRAMES_LEARNING, PIXELS), (2000.0,)))
    assert model.noise.is_gaussian
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.03)
    assert model.pixels == PIXELS
    assert np.median(model.ranges_mm) == pytest.approx(2000.0, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["skewed", "student", "laplace"])
def test_shape_is_learnt_and_nothing_else(name: str, rng: np.random.Generator) -> None:
    model = _learnt_learning(surfaces(rng, (FRAMES_LEARNING, PIXELS), (2000.0,), errors=KNOWN[name].draw))
    assert _parts(model) == {"shape"}
    shape = model.noise.curve.shape
    assert shape is not None
    # The mean of a pixel takes a part of its errors: what is learnt is a little nearer to the Gaussian.
    at = np.linspace(-4.0, 4.0, 81)
    assert np.abs(shape.cdf(at) - KNOWN[name].cdf(at)).max() < 0.03
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_shape_is_not_made_steeper_by_surfaces_located_under_it() -> None:
    """With these samples a shape whose surfaces are located again under it has a peak that is 10 % too high."""
    samples = surfaces(np.random.default_rng(3), (FRAMES_LEARNING, 500), (2000.0,), errors=KNOWN["skewed"].draw)
    pixels = Pixels(samples=np.ascontiguousarray(samples.T, dtype=np.float32))
    gaussian = NoiseCurve(np.array([500.0, 5000.0]), np.full(2, SIGMA_MM))
    found = with_part(whole_fold(pixels, CAMERA), PixelNoise.of(replace(CAMERA, noise=gaussian)), "shape")
    assert found is not None
    assert found.curve.shape is not None
    at = np.linspace(-4.0, 4.0, 1601)
    peak = np.gradient(KNOWN["skewed"].cdf(at), at).max()
    assert found.curve.shape.density.max() == pytest.approx(peak, rel=0.06)


@pytest.mark.slow
def test_widths_are_learnt_and_nothing_else(rng: np.random.Generator) -> None:
    width = np.exp(0.3 * rng.standard_normal(PIXELS))
    model = _learnt_learning(surfaces(rng, (FRAMES_LEARNING, PIXELS), (2000.0,), width=width))
    assert _parts(model) == {"widths"}
    assert model.noise.curve.width_spread == pytest.approx(0.3, abs=0.08)
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM * np.median(width), rel=0.05)


@pytest.mark.slow
def test_background_of_each_pixel_is_learnt_and_nothing_else(rng: np.random.Generator) -> None:
    share = rng.uniform(0.0, 0.9, PIXELS)
    model = _learnt_learning(surfaces(rng, (FRAMES_LEARNING, PIXELS), (2000.0,), background=share))
    assert _parts(model) == {"background"}
    assert model.noise.background is not None
    near, far = model.noise.background
    assert near / (near + far) == pytest.approx(share.mean(), abs=0.05)
    variance = near * far / ((near + far) ** 2 * (near + far + 1.0))
    assert np.sqrt(variance) == pytest.approx(share.std(), rel=0.2)
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_drift_is_learnt_and_sigma_is_that_without_it(rng: np.random.Generator) -> None:
    drift = 1.5 * SIGMA_MM * rng.choice([-1.0, 1.0], PIXELS) * TIME
    model = _learnt_learning(surfaces(rng, (FRAMES_LEARNING, PIXELS), (2000.0,), drift_mm=drift))
    assert _parts(model) == {"drift"}
    assert model.noise.drift_mm[0] == pytest.approx(1.5 * SIGMA_MM, rel=0.15)
    assert (model.noise.drift_mm[1:] < 0.2 * SIGMA_MM).all()
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_memory_is_the_correlation_of_neighbouring_frames(rng: np.random.Generator) -> None:
    z = signal.lfilter([np.sqrt(0.75)], [1.0, -0.5], rng.standard_normal((FRAMES_LEARNING + 40, PIXELS)), axis=0)[40:]
    model = _learnt_learning(2000.0 + SIGMA_MM * z, drift=False)
    assert model.noise.memory == pytest.approx(0.5, abs=0.06)
    assert "shape" not in _parts(model)


def test_independent_photons_of_a_skewed_shape_have_no_memory(rng: np.random.Generator) -> None:
    """The mean of their errors about the place of the shape is not 0, in each pixel and frame alike."""

    def errors(shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
        return np.where(rng.random(shape) < 0.4, rng.exponential(2.5, shape), 0.0) + 0.6 * rng.standard_normal(shape)

    z = errors((30, PIXELS), rng)
    model = _learnt_learning(rng.uniform(1000.0, 3000.0, PIXELS) + SIGMA_MM * z / z.std(), drift=False)
    assert "shape" in _parts(model)
    assert "memory" not in _parts(model)


@pytest.mark.slow
def test_sigma_is_that_of_all_errors_where_drifts_follow_errors_that_remember(rng: np.random.Generator) -> None:
    z = signal.lfilter([np.sqrt(0.75)], [1.0, -0.5], rng.standard_normal((FRAMES_LEARNING + 40, 900)), axis=0)[40:]
    model = _learnt_learning(2000.0 + SIGMA_MM * z)
    assert model.noise.drift_mm.any()
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.04)


@pytest.mark.slow
def test_what_pixels_have_of_their_own_is_drawn_with_the_spread_and_the_tails_that_it_has(
    rng: np.random.Generator,
) -> None:
    drift = np.where(rng.random(PIXELS) < 0.5, 1.5, -1.5) * SIGMA_MM
    own = _learnt_learning(surfaces(rng, (FRAMES_LEARNING, PIXELS), (2000.0,), drift_mm=drift * TIME)).pixel_effects
    assert len(own) > 0.9 * PIXELS
    assert not own[:, 0].any()  # widths are alike
    np.testing.assert_allclose(np.std(own[:, 1]), 1.5 * SIGMA_MM, rtol=0.08)
    assert np.abs(own[:, 1]).max() < 2.5 * SIGMA_MM  # a Student t of this spread has some at 6


@pytest.mark.slow
@pytest.mark.long
def test_all_parts_together_are_all_learnt(rng: np.random.Generator) -> None:
    frames, pixels = 80, PIXELS
    drift = 1.5 * SIGMA_MM * rng.choice([-1.0, 1.0], pixels) * np.linspace(-1.0, 1.0, frames)[:, np.newaxis]
    samples = surfaces(
        rng,
        (frames, pixels),
        (2000.0,),
        errors=KNOWN["skewed"].draw,
        width=np.exp(0.3 * rng.standard_normal(pixels)),
        background=rng.uniform(0.0, 0.9, pixels),
        drift_mm=drift,
    )
    model = _learnt_learning(samples)
    assert _parts(model) == {"shape", "widths", "background", "drift"}
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.1)


@pytest.mark.slow
def test_sigma_is_right_where_every_pixel_sees_two_surfaces(rng: np.random.Generator) -> None:
    near = rng.uniform(800.0, 3000.0, PIXELS)
    second = rng.random((FRAMES_LEARNING, PIXELS)) < rng.uniform(0.2, 0.8, PIXELS)
    samples = near + np.where(second, 600.0, 0.0) + SIGMA_MM * rng.standard_normal((FRAMES_LEARNING, PIXELS))
    model = _learnt_learning(samples)
    assert _parts(model) <= {"drift"}
    sigmas = model.noise.curve.sigma_mm
    assert np.median(sigmas) == pytest.approx(SIGMA_MM, rel=0.05)
    np.testing.assert_allclose(sigmas, SIGMA_MM, rtol=0.12)  # each of twenty or so pixels


@pytest.mark.slow
@pytest.mark.parametrize("places", [(0.0, 5.0), (0.0, 4.0, 8.0)], ids=["two", "three"])
def test_sigma_is_right_where_no_cluster_stands_clear_in_any_pixel(
    places: tuple[float, ...], rng: np.random.Generator
) -> None:
    pixels, frames = 150, 100
    shares = np.cumsum(0.2 + (1.0 - 0.2 * len(places)) * rng.dirichlet(np.ones(len(places)), pixels), axis=1)
    which = (rng.random((frames, pixels, 1)) > shares[:, :-1]).sum(axis=2)
    near = rng.uniform(800.0, 3000.0, pixels)
    samples = near + SIGMA_MM * (np.array(places)[which] + rng.standard_normal((frames, pixels)))
    sigmas = _learnt_learning(samples).noise.curve.sigma_mm
    assert np.median(sigmas) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.parametrize("name", ["gaussian", "skewed"])
def test_few_pixels_give_one_sigma_and_a_gaussian(name: str, rng: np.random.Generator) -> None:
    model = _learnt_learning(surfaces(rng, (30, 12), (2000.0,), errors=KNOWN[name].draw))
    assert model.noise.is_gaussian
    assert len(model.noise.curve.sigma_mm) == 1
    # 360 samples tell a sigma to 4 %; by differences, and with a skewed shape, less exactly.
    assert model.noise.curve.sigma_mm[0] == pytest.approx(SIGMA_MM, rel=0.15)


def test_forbidden_parts_are_skipped_and_required_parts_are_learnt(rng: np.random.Generator) -> None:
    width = np.exp(0.3 * rng.standard_normal(90))
    samples = surfaces(rng, (40, 90), (2000.0,), errors=KNOWN["skewed"].draw, width=width)
    assert _parts(_learnt_learning(samples, shape=False, widths=False, drift=False)) <= {"background"}
    plain = surfaces(rng, (40, 90), (2000.0,))
    insisted = _learnt_learning(plain, shape=False, widths=True, drift=False)
    assert _parts(insisted) <= {"widths", "background"}


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "holds"), [(SIGMA_MM, True), (2.0 * SIGMA_MM, False), (0.5 * SIGMA_MM, False)])
def test_a_given_curve_holds_where_nothing_predicts_better(sigma: float, holds: bool, rng: np.random.Generator) -> None:
    given = NoiseCurve(np.array([2000.0]), np.array([sigma]))
    model = _learnt_learning(surfaces(rng, (40, 90), (2000.0,)), instead_of=given)
    assert model.given_holds is holds


@pytest.mark.parametrize("samples", [np.full((40, 30), 2000.0), np.full((40, 30), np.nan)], ids=["constant", "none"])
def test_samples_without_a_spread_give_no_noise(samples: FloatArray) -> None:
    with pytest.raises(ValueError, match="no two samples of a pixel differ, or none is valid"):
        _learnt_learning(samples)


def test_clusters_of_few_samples_are_none_because_only_narrow_pixels_have_some() -> None:
    samples = np.random.default_rng(1).normal(2000.0, 6.0, (300, 8)).astype(np.float32)
    curve = NoiseCurve(np.array([2000.0]), np.array([6.0]))
    noise = PixelNoise.gaussian(curve, 0.0)
    sensor = Sensor(name="camera", range_min_mm=500.0, range_max_mm=8000.0)
    few = whole_fold(Pixels(samples=samples), sensor)
    assert len(few.clusters(noise).pixel) == 0
    assert with_sigma(few, noise).curve.sigma_mm == pytest.approx(6.0, rel=0.1)  # from clusters, it is 0.7 times that
    many = whole_fold(Pixels(samples=np.hstack([samples, samples[::-1]])), sensor)
    assert len(many.clusters(noise).pixel) > 0.95 * len(samples)


def test_single_deviating_pixel_changes_no_mean_difference(rng: np.random.Generator) -> None:
    one = rng.normal(0.0, 1.0, 400)
    other = one - 0.2 + rng.normal(0.0, 0.1, 400)
    gain, error = mean_difference(one, other)
    assert gain == pytest.approx(0.2, abs=4 * error)
    assert error == pytest.approx(0.1 / np.sqrt(400), rel=0.15)
    other[0] = 1e6
    assert mean_difference(one, other)[0] == pytest.approx(0.2, abs=0.02)
    other[1] = np.nan
    assert mean_difference(one, other)[0] == pytest.approx(0.2, abs=0.02)
    assert mean_difference(one[:2], other[2:4]) == (0.0, np.inf)


def test_gain_of_most_pixels_counts_and_noise_does_not(rng: np.random.Generator) -> None:
    one, noise = rng.normal(0.0, 1.0, 400), rng.normal(0.0, 0.5, 400)
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), one - 0.3 + noise)) == pytest.approx(0.3, abs=0.1)
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), one + noise)) == 0.0
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), one - 0.05)) == 0.0  # less changes no count


def test_large_gain_of_a_few_pixels_counts_and_that_of_one_does_not() -> None:
    other = np.zeros(100)
    few = other.copy()
    few[:6] = 30.0
    assert held_out_gain(NoiseCandidate((), few), NoiseCandidate((), other)) == pytest.approx(150.0 / 99.0)
    one = other.copy()
    one[0] = 1000.0
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), other)) == 0.0
