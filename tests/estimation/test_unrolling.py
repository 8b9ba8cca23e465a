"""Ranges on a circle: a surface at the fold is one, and the circle has no beginning."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.cameras import camera_of
from support.sizes import sized

from tofmix.circle import circular_noise, fold
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.mixture.em import fit_mixture
from tofmix.estimation.noise.measurement import measure_noise
from tofmix.estimation.peaks.counters import COUNTERS, Cpdf
from tofmix.estimation.samples import sort_samples
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.estimation.unrolling import UnrolledSource, unroll
from tofmix.flags import Status
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

LENGTH = 7495.0
FLAT = NoiseCurve(np.array([1000.0, LENGTH]), np.array([40.0, 40.0]))
CAMERA = Sensor(name="flat noise", noise=FLAT)
RISING = camera_of([500.0, 2000.0, 7500.0], [6.0, 20.0, 110.0], reach_mm=(600.0, 7200.0))
ON_CIRCLE = EstimateOptions(unambiguous_range_mm=LENGTH)


def _surfaces(
    rng: np.random.Generator, places: list[float], shares: list[float], n: int, pixels: int, outliers: float = 0.0
) -> NDArray[np.float64]:
    mean = np.array(places)[rng.choice(len(places), p=shares, size=(n, pixels))]
    readings = mean + rng.normal(0, 40.0, mean.shape)
    wild = rng.random(mean.shape) < outliers
    readings[wild] = rng.uniform(0, LENGTH, int(wild.sum()))
    return readings


def _turned(layers: Layers, offset: float) -> Layers:
    """The same layers with every range turned by `offset`, near to far again."""
    turned = layers.reshaped(layers.shape)
    arrays = {spec.name: getattr(turned, spec.name).copy() for spec in LAYER_FIELDS}
    arrays["range"] = fold(arrays["range"] + offset, LENGTH)
    order = np.argsort(arrays["range"], axis=-1)
    for spec in LAYER_FIELDS:
        if spec.per_layer:
            arrays[spec.name] = np.take_along_axis(arrays[spec.name], order, -1)
    return Layers(**arrays)


def _same(one: Layers, other: Layers, tolerance: float) -> None:
    for spec in LAYER_FIELDS:
        a, b = getattr(one, spec.name), getattr(other, spec.name)
        if spec.dtype.startswith("f"):
            np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=spec.name)
        else:
            np.testing.assert_array_equal(a, b, err_msg=spec.name)


@settings(max_examples=sized(25, 5))
@given(seed=st.integers(0, 2**32 - 1), offset=st.floats(0, LENGTH), n=st.sampled_from([2, 3, 10, 60, 200]))
def test_turning_all_readings_only_turns_the_layers(*, seed: int, offset: float, n: int) -> None:
    rng = np.random.default_rng(seed)
    readings = _surfaces(rng, [0.0, 900.0, 1100.0, 4000.0], [0.3, 0.2, 0.2, 0.3], n, 4)
    first = layer_pixels(fold(readings, LENGTH), CAMERA, ON_CIRCLE)
    turned = layer_pixels(fold(readings + offset, LENGTH), CAMERA, ON_CIRCLE)
    _same(_turned(first, offset), turned, 5e-3)  # readings are float32: half a micrometre at the fold


@pytest.mark.parametrize(("n", "outliers"), [(2, 0.0), (5, 0.0), (30, 0.0), (1000, 0.0), (5, 0.3), (200, 0.3)])
def test_a_surface_at_the_fold_is_that_of_the_same_samples_unrolled_by_hand(
    n: int, outliers: float, rng: np.random.Generator
) -> None:
    camera = replace(CAMERA, outlier_probability=max(outliers, 1e-4))
    readings = _surfaces(rng, [LENGTH + 10.0, 3000.0], [0.7, 0.3], n, sized(8, 2), outliers)
    by_hand = np.where(fold(readings, LENGTH) < 1500, fold(readings, LENGTH) + LENGTH, fold(readings, LENGTH))
    line = layer_pixels(by_hand, camera, EstimateOptions(min_samples=2))
    circle = layer_pixels(fold(readings, LENGTH), camera, replace(ON_CIRCLE, min_samples=2))
    _same(_turned(line, 0.0), circle, 5e-3)
    assert (circle.n_modes == 2).all() or n * (1 - outliers) < 20


def test_flips_at_the_fold_and_readings_of_zero_are_one_surface() -> None:
    flips = np.where(np.arange(60) % 2, 60.0, 7470.0)[:, np.newaxis]
    line, circle = (layer_pixels(flips, CAMERA, options) for options in (EstimateOptions(), ON_CIRCLE))
    assert (line.n_modes[0], circle.n_modes[0]) == (2, 1)
    assert circle.range[0, 0] == pytest.approx((60 + LENGTH + 7470) / 2 - LENGTH, abs=1e-2)
    assert circle.weight[0, 0] == pytest.approx(1, abs=1e-3)
    zeros = np.where(np.arange(40) % 3 == 0, 0.0, 7490.0)[:, np.newaxis]
    layers = layer_pixels(zeros, CAMERA, ON_CIRCLE)
    assert (layers.n_samples[0], layers.n_modes[0], layers.status[0]) == (40, 1, Status.OK)
    share = (zeros == 0).mean()
    assert layers.range[0, 0] == pytest.approx(7490 + 5 * share, abs=1e-2)


@pytest.mark.parametrize("counter", COUNTERS)
@pytest.mark.parametrize("sigma", SigmaMode)
def test_every_counter_and_sigma_finds_the_surface_at_the_fold(
    counter: str, sigma: SigmaMode, rng: np.random.Generator
) -> None:
    readings = fold(_surfaces(rng, [LENGTH - 5.0, 3000.0], [0.5, 0.5], 120, sized(30, 5)), LENGTH)
    layers = layer_pixels(readings, CAMERA, replace(ON_CIRCLE, counter=COUNTERS[counter](), sigma=sigma))
    assert (layers.n_modes == 2).mean() > 0.96
    two = layers.n_modes == 2
    at_fold = np.abs(fold(layers.range[two, :2] + LENGTH / 2, LENGTH) - LENGTH / 2).min(axis=1)
    assert np.sqrt((at_fold**2).mean()) < 12  # the surface lies at -5; its standard error is 5
    assert (np.abs(layers.range[two, :2] - 3000).min(axis=1) < 25).all()


@pytest.mark.compiled("a frequency over 800 pixels")
def test_standard_errors_at_the_fold_are_right(rng: np.random.Generator) -> None:
    layers = layer_pixels(fold(_surfaces(rng, [0.0], [1.0], 50, 800), LENGTH), CAMERA, ON_CIRCLE)
    error = fold(layers.range[:, 0] + LENGTH / 2, LENGTH) - LENGTH / 2
    covered = (np.abs(error) < 1.96 * layers.range_stderr[:, 0]).mean()
    assert 0.92 < covered < 0.98  # 95 %, standard error 0.8 %


def test_layers_away_from_the_fold_do_not_change(rng: np.random.Generator) -> None:
    readings = _surfaces(rng, [1500.0, 3000.0], [0.6, 0.4], 80, 20)
    camera = replace(CAMERA, range_max_mm=LENGTH)
    line, circle = layer_pixels(readings, camera), layer_pixels(readings, camera, ON_CIRCLE)
    for spec in LAYER_FIELDS:
        np.testing.assert_array_equal(getattr(line, spec.name), getattr(circle, spec.name), err_msg=spec.name)


@settings(max_examples=sized(30, 5))
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 80), outliers=st.floats(0, 0.9))
def test_any_readings_give_layers_that_keep_all_rules(*, seed: int, n: int, outliers: float) -> None:
    rng = np.random.default_rng(seed)
    readings = _surfaces(rng, [20.0, 2000.0, 7000.0], [0.4, 0.3, 0.3], n, 3, outliers)
    layers = layer_pixels(readings, RISING, ON_CIRCLE)
    again = layer_pixels(readings[rng.permutation(n)], RISING, ON_CIRCLE)
    for spec in LAYER_FIELDS:
        np.testing.assert_array_equal(getattr(layers, spec.name), getattr(again, spec.name), err_msg=spec.name)
    found = np.isfinite(layers.range)
    np.testing.assert_array_equal(found.sum(axis=1), layers.n_modes)
    assert (layers.range[found] >= 0).all()
    assert (layers.range[found] < LENGTH).all()
    assert not (np.diff(layers.range, axis=1) < 0).any()
    fitted = (layers.status == Status.OK) | (layers.status == Status.NO_SURFACE)
    total = np.nansum(layers.weight, axis=1) + layers.weight_no_return + layers.weight_outlier
    np.testing.assert_allclose(total[fitted], 1, atol=1e-5)
    ok = layers.status == Status.OK
    assert np.isfinite(layers.range_stderr[found & ok[:, np.newaxis]]).all()


@settings(max_examples=sized(50, 15))
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 40))
def test_unrolled_samples_ascend_over_one_turn_and_fold_back(*, seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    readings = rng.choice([0.0, 60.0, 7490.0, 3000.0, 12.5], size=(n, 3)) + rng.normal(0, 300, (n, 3))
    block = sort_samples(readings)
    before = np.sort(fold(block.values, LENGTH), axis=1)
    beam = beam_of(RISING, LENGTH)
    cuts, _ = unroll(block, beam, 600.0, LENGTH)
    assert (np.diff(block.values, axis=1) >= 0).all()
    assert (block.values >= cuts[:, np.newaxis]).all()
    assert (block.values < cuts[:, np.newaxis] + LENGTH).all()
    np.testing.assert_allclose(np.sort(fold(block.values, LENGTH), axis=1), before, atol=1e-6)
    # c_0 stays where it is, wherever the cut is.
    assert ((cuts <= beam.range_max) & (beam.range_max < cuts + LENGTH)).all()


def test_no_return_stays_a_reading_and_ranges_beyond_it_are_a_surface(rng: np.random.Generator) -> None:
    camera, pixels = replace(CAMERA, range_max_mm=6500.0), sized(20, 5)
    mean = np.array([6500.0, LENGTH + 20.0, 2000.0])[rng.choice(3, p=[0.4, 0.4, 0.2], size=(150, pixels))]
    layers = layer_pixels(fold(mean + rng.normal(0, 40, mean.shape), LENGTH), camera, ON_CIRCLE)
    assert (layers.n_modes == 2).all()
    np.testing.assert_allclose(layers.range[:, :2], np.tile([20.0, 2000.0], (pixels, 1)), atol=40)
    assert np.abs(layers.weight_no_return - 0.4).max() < 0.15
    # Up to 2 sigma beyond range_max there is only c_0; before it a surface competes with c_0 by likelihood.
    for place, modes in ((6497.0, 0), (6570.0, 0), (6430.0, 1), (6700.0, 1)):
        alone = layer_pixels((place + rng.normal(0, 8, (100, 5))), camera, ON_CIRCLE)
        assert (alone.n_modes == modes).all(), place


def test_near_surfaces_keep_their_sigma_without_a_surface_at_the_fold(rng: np.random.Generator) -> None:
    noisy = replace(RISING, range_max_mm=None, noise=NoiseCurve(np.array([500.0, 7500.0]), np.array([6.0, 400.0])))
    assert noisy.noise is not None
    assert circular_noise(noisy, LENGTH).sigma(900.0) > 5 * noisy.noise.sigma(900.0)  # 4 sigma(d_u) are 1600 mm
    mean = rng.choice([900.0, 1200.0], size=(100, sized(40, 8)))
    readings = mean + rng.standard_normal(mean.shape) * noisy.noise.sigma(mean)
    readings[3] = 7300.0  # one reading alone at the fold is an outlier
    line, circle = layer_pixels(readings, noisy), layer_pixels(readings, noisy, ON_CIRCLE)
    assert (line.n_modes == 2).mean() > 0.95
    np.testing.assert_array_equal(circle.n_modes, line.n_modes)
    np.testing.assert_allclose(circle.range, line.range, atol=0.1)
    # The noise of a surface at the fold reaches as far, and is no surface of its own.
    at_fold = fold(7450.0 + 400.0 * rng.standard_normal((100, sized(40, 8))), LENGTH)
    assert (layer_pixels(at_fold, noisy, ON_CIRCLE).n_modes == 1).mean() > 0.95


def test_one_pixel_is_fitted_from_given_means(rng: np.random.Generator) -> None:
    readings = fold(_surfaces(rng, [LENGTH + 15.0, 3000.0], [0.6, 0.4], 300, 1)[:, 0], LENGTH)
    fit = fit_mixture(readings, [7480.0, 3050.0], CAMERA, ON_CIRCLE)
    assert fit.converged
    assert fit.mean_mm[0] == pytest.approx(15, abs=12)
    assert fit.mean_mm[1] == pytest.approx(3000, abs=15)
    assert fit.weight[0] == pytest.approx(0.6, abs=0.1)


def test_noise_is_measured_across_the_fold(rng: np.random.Generator) -> None:
    mean = np.repeat([1500.0, 5000.0, LENGTH - 10.0, LENGTH + 15.0], 60).reshape(12, 20)
    noise = NoiseCurve(np.array([1000.0, 8000.0]), np.array([15.0, 120.0]))
    sensor = Sensor(name="x", range_min_mm=600.0, outlier_probability=1e-3)
    readings = mean + rng.standard_normal((100, *mean.shape)) * noise.sigma(mean)
    folded = ArrayRecording(fold(readings, LENGTH), sensor)
    measured = measure_noise(UnrolledSource(folded, LENGTH))
    at = np.array([1500.0, 5000.0, LENGTH])
    np.testing.assert_allclose(measured.curve.sigma(at), noise.sigma(at), rtol=0.05)
    # Where nothing reaches over the fold, every reading stays where it is.
    block = folded.read_range(slice(0, 100), slice(0, 6))
    np.testing.assert_array_equal(UnrolledSource(folded, LENGTH).read_range(slice(0, 100), slice(0, 6)), block)


def test_working_range_of_a_circle_is_one_turn_and_invalid_lengths_are_refused() -> None:
    beam = beam_of(RISING, LENGTH)
    assert (beam.range_min, beam.range_top) == (600.0, 600.0 + LENGTH)
    assert beam.outlier_density == pytest.approx(1e-4 / 6600.0)
    assert Cpdf().edges(beam)[0] == 600.0
    assert beam_of(CAMERA, LENGTH).outlier_density == pytest.approx(1e-4 / LENGTH)
    np.testing.assert_array_equal(beam.curve_range, circular_noise(RISING, LENGTH).range_mm)
    with pytest.raises(ValueError, match="unambiguous_range_mm"):
        EstimateOptions(unambiguous_range_mm=0.0)
    with pytest.raises(ValueError, match="not below the unambiguous range"):
        beam_of(replace(CAMERA, range_min_mm=8000.0), LENGTH)
