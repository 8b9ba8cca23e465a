"""From samples to layers: invariants, statuses, the paper's algorithm, and noise that is not Gaussian."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import stats
from support.cameras import camera_of
from support.drawing import draw
from support.sizes import sized

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.counters import Cpdf, Kde
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.flags import Status
from tofmix.invariants import layer_rules
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.sensor import NoiseCurve, Sensor

CAMERA = camera_of([400.0, 1500.0, 3000.0, 6000.0], [12.0, 25.0, 60.0, 200.0], reach_mm=(300.0, 6000.0))
# Near and far, tied and spread, invalid and absurd.
VALUES = st.one_of(
    st.floats(300, 6500, width=32),
    st.sampled_from([1000.0, 1001.0, 3000.0, 6000.0, 0.0, -50.0, 1e6]),
    st.sampled_from([np.nan, np.inf, -np.inf, float(np.float32(3e38))]),
)
BLOCKS = arrays(np.float32, st.tuples(st.integers(1, 30), st.integers(1, 4)), elements=VALUES)


def equal(a: Layers, b: Layers) -> None:
    for spec in LAYER_FIELDS:
        np.testing.assert_array_equal(getattr(a, spec.name), getattr(b, spec.name), err_msg=spec.name)


def check_invariants(layers: Layers, camera: Sensor) -> None:
    n = layers.n_modes
    for name in ("range", "sigma", "weight", "range_stderr", "weight_stderr", "probability"):
        np.testing.assert_array_equal(np.isfinite(getattr(layers, name)).sum(-1), n)
    fitted = layers.status != Status.TOO_FEW_SAMPLES
    total = np.nansum(layers.weight, -1) + layers.weight_no_return + layers.weight_outlier
    np.testing.assert_allclose(total[fitted], 1, atol=1e-5)
    with np.errstate(invalid="ignore"):
        assert not np.any(np.diff(layers.range, axis=-1) < 0)
        assert not np.any(layers.range_stderr <= 0)
        assert camera.range_max_mm is None or not np.any(layers.range > camera.range_max_mm)
    assert np.all(np.isfinite(layers.log_likelihood[fitted]))
    assert np.all((layers.status == Status.NO_SURFACE) == ((n == 0) & fitted))


@given(block=BLOCKS, mode=st.sampled_from(list(SigmaMode)), refine=st.sampled_from(list(Refine)))
def test_invariants_hold_for_any_samples(block: NDArray[np.float32], mode: SigmaMode, refine: Refine) -> None:
    check_invariants(layer_pixels(block, CAMERA, EstimateOptions(sigma=mode, refine=refine)), CAMERA)


@given(block=BLOCKS, seed=st.integers(0, 99))
def test_the_order_of_frames_does_not_matter(block: NDArray[np.float32], seed: int) -> None:
    equal(layer_pixels(np.random.default_rng(seed).permutation(block), CAMERA), layer_pixels(block, CAMERA))


@given(block=BLOCKS)
def test_pixels_do_not_depend_on_each_other(block: NDArray[np.float32]) -> None:
    together = layer_pixels(block, CAMERA)
    for pixel in range(block.shape[1]):
        alone = layer_pixels(block[:, pixel : pixel + 1], CAMERA)
        for spec in LAYER_FIELDS:
            np.testing.assert_array_equal(getattr(alone, spec.name)[0], getattr(together, spec.name)[pixel])


def test_invalid_samples_are_skipped(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[1000, 2000], shares=[0.5, 0.5], n=60, pixels=5)
    gaps = np.concatenate([samples, np.full((20, 5), np.nan, np.float32)])
    equal(layer_pixels(gaps, CAMERA), layer_pixels(samples, CAMERA))


def test_pixel_with_too_few_samples_has_that_status() -> None:
    block = np.full((10, 2), np.nan, np.float32)
    block[:4, 1] = 1000
    layers = layer_pixels(block, CAMERA, EstimateOptions(min_samples=4))
    assert layers.status.tolist() == [Status.TOO_FEW_SAMPLES, Status.OK]
    assert layers.n_samples.tolist() == [0, 4]
    assert np.isnan(layers.weight_outlier[0])


def test_no_surface_is_no_return_or_outliers(rng: np.random.Generator) -> None:
    empty = draw(rng, CAMERA, ranges_mm=[], shares=[], n=80, pixels=sized(200, 40))
    layers = layer_pixels(empty, CAMERA)
    assert np.mean(layers.status == Status.NO_SURFACE) > 0.99
    assert np.median(layers.weight_no_return) == pytest.approx(1 - CAMERA.outlier_probability)
    scattered = layer_pixels(np.array([[500.0], [2000.0], [4000.0]]), CAMERA)
    assert scattered.status[0] == Status.NO_SURFACE
    assert scattered.weight_outlier[0] == 1


def test_unconverged_pixel_has_that_status(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[1500, 1590], shares=[0.5, 0.5], n=100, pixels=sized(30, 10))
    layers = layer_pixels(samples, CAMERA, EstimateOptions(max_iter=2, tol=1e-9))
    two = layers.n_modes == 2
    assert two.any()
    assert np.all(layers.status[two] == Status.NOT_CONVERGED)
    assert layers.n_iter.max() <= 2


def test_wall_ten_standard_errors_before_range_max_is_one_surface(rng: np.random.Generator) -> None:
    """At 5800 mm, one sigma before r_max, 100 samples tell: ten standard errors."""
    samples = draw(rng, CAMERA, ranges_mm=[5800], shares=[1.0], n=100, pixels=sized(200, 20))
    layers = layer_pixels(samples, CAMERA)
    assert np.mean(layers.n_modes == 1) > sized(0.98, 0.94)
    found = layers.range[layers.n_modes == 1, 0]
    assert abs(found.mean() - 5800) < 10
    assert np.median(layers.weight_no_return) == 0.0
    assert not layers.n_peaks.any()  # a peak there belongs to c_0


def test_wall_and_no_return_four_sigma_apart_are_both_found_with_their_shares(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[5200], shares=[0.7], n=100, pixels=sized(200, 20))
    layers = layer_pixels(samples, CAMERA)
    both = (layers.n_modes == 1) & (layers.weight_no_return > 0)
    assert both.mean() > 0.95
    assert layers.weight_no_return[both].mean() == pytest.approx(0.3, abs=0.03)


def test_walls_next_to_a_constant_of_no_return_are_found(rng: np.random.Generator) -> None:
    """c_0 is a needle at 6000 mm: a wall at 5900 mm and 40 % of no return are told apart."""
    samples = draw(rng, CAMERA, ranges_mm=[5900], shares=[1.0], n=80, pixels=sized(100, 20))
    samples[rng.random(samples.shape) < 0.4] = 6000.0
    layers = layer_pixels(samples, replace(CAMERA, no_return_mm=6000.0))
    assert np.mean(layers.n_modes == 1) > 0.95
    assert layers.weight_no_return.mean() == pytest.approx(0.4, abs=0.04)


@pytest.mark.parametrize("mode", list(SigmaMode))
def test_true_ranges_and_weights_are_recovered(mode: SigmaMode, rng: np.random.Generator) -> None:
    truth, shares = [900, 2000, 3800], [0.2, 0.3, 0.35]
    samples = draw(rng, CAMERA, ranges_mm=truth, shares=shares, n=200, pixels=sized(500, 16))
    layers = layer_pixels(samples, CAMERA, EstimateOptions(sigma=mode))
    right = layers.n_modes == 3
    assert right.mean() > sized(0.98, 0.9)
    np.testing.assert_allclose(layers.range[right, :3].mean(0), truth, rtol=sized(2e-3, 8e-3))
    np.testing.assert_allclose(layers.weight[right, :3].mean(0), shares, atol=sized(0.01, 0.04))
    assert layers.weight_no_return[right].mean() == pytest.approx(0.15, abs=sized(0.01, 0.03))


@pytest.mark.parametrize("shape", [(3,), (2, 2, 2, 2), (0, 5)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        layer_pixels(np.zeros(shape), CAMERA)


def test_images_keep_their_shape_and_may_be_empty(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[1000], shares=[1.0], n=20, pixels=6)
    image = layer_pixels(samples.reshape(20, 2, 3), CAMERA)
    assert image.shape == (2, 3)
    equal(image.reshaped((6,)), layer_pixels(samples, CAMERA))
    assert layer_pixels(np.zeros((4, 0)), CAMERA).shape == (0,)


CURVE = NoiseCurve(np.array([500.0, 3000.0, 7500.0]), np.array([30.0, 90.0, 300.0]))
CAMERA_PAPER = Sensor(name="a camera", range_min_mm=500.0, range_max_mm=7500.0, noise=CURVE)


def twin(samples: FloatArray, gamma: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Means, sigmas and shares of the surfaces, and sigma_0, by equations (1), (4) and (5) and section V."""
    step = CURVE.sigma_mm.min() / 8.0
    cells = np.arange(-np.ceil(1500.0 / step), np.ceil((np.ptp(samples) + 1500.0) / step))
    grid = samples.min() + step * cells
    h = CURVE.sigma(grid)[:, None] / 2.0
    p = stats.norm.pdf(grid[:, None], samples, h).mean(axis=1)  # (4)
    lone = stats.norm.pdf(0.0, 0.0, np.hypot(h[:, 0], 2.0 * h[:, 0]))
    higher = np.r_[False, (p[1:-1] > p[:-2]) & (p[1:-1] >= p[2:]), False]
    places = grid[higher & (p > gamma * lone)]  # (5)
    places = places[places <= 7500.0 - 2.0 * 300.0]
    mean, sigma = np.r_[places, 7500.0], CURVE.sigma(np.r_[places, 7500.0])
    share = np.full(len(mean), (1.0 - 1e-4) / len(mean))
    for _ in range(50):
        density = share * stats.norm.pdf(samples[:, None], mean, sigma)
        posterior = density / (1e-4 / 7500.0 + density.sum(axis=1, keepdims=True))
        support = posterior.sum(axis=0)
        mean = np.r_[(posterior * samples[:, None]).sum(axis=0)[:-1] / support[:-1], 7500.0]
        with np.errstate(invalid="ignore", divide="ignore"):
            free = np.sqrt((posterior * (samples[:, None] - mean) ** 2).sum(axis=0) / support)
        sigma = np.where(free > 1e-6 * CURVE.sigma(mean), free, sigma)  # on one sample alone it would be 0
        share = (1.0 - 1e-4) * support / support.sum()
    order = np.argsort(mean[:-1])
    return mean[:-1][order], sigma[:-1][order], share[:-1][order], float(sigma[-1])


def draw_paper(rng: np.random.Generator, pixels: int) -> NDArray[np.float32]:
    """Two boards and samples without a return, (frame, pixel)."""
    truth = rng.choice([1500.0, 2400.0, 7500.0], p=[0.4, 0.4, 0.2], size=(80, pixels))
    return (truth + CURVE.sigma(truth) * rng.standard_normal(truth.shape)).astype(np.float32)


@pytest.mark.parametrize("gamma", [0.02, 0.1])
def test_paper_algorithm_equals_its_numpy_twin(rng: np.random.Generator, gamma: float) -> None:
    samples = draw_paper(rng, 8)
    found = layer_pixels(samples, CAMERA_PAPER, EstimateOptions(paper=True, counter=Kde(gamma=gamma), max_layers=32))
    for pixel in range(samples.shape[1]):
        mean, sigma, share, _ = twin(samples[:, pixel].astype(np.float64), gamma)
        k = int(found.n_modes[pixel])
        assert k == len(mean)
        np.testing.assert_allclose(found.range[pixel, :k], mean, rtol=1e-4)
        if found.status[pixel] == Status.OK:
            np.testing.assert_allclose(found.sigma[pixel, :k], sigma, rtol=2e-3)
        np.testing.assert_allclose(found.weight[pixel, :k], share, atol=1e-4)


def test_paper_algorithm_frees_sigma_0_and_holds_mu_0(rng: np.random.Generator) -> None:
    """No return with a quarter of the curve's spread: all of its samples are c_0's, though (1) has sigma(r_max)."""
    truth = np.where(rng.random((200, 20)) < 0.5, 1500.0, 7500.0)
    spread = np.where(truth < 7000.0, CURVE.sigma(truth), 75.0)
    samples = truth + spread * rng.standard_normal(truth.shape)
    found = layer_pixels(samples, CAMERA_PAPER, EstimateOptions(paper=True, counter=Kde(gamma=0.1)))
    share = (truth > 7000.0).mean(axis=0)
    assert (found.n_modes == 1).all()
    np.testing.assert_allclose(found.weight_no_return, share, atol=2e-3)
    as_held = layer_pixels(samples, CAMERA_PAPER)
    assert (found.log_likelihood > as_held.log_likelihood + 50.0).all()


def test_paper_algorithm_keeps_every_rule_of_a_layers_file(rng: np.random.Generator) -> None:
    samples = np.concatenate([draw_paper(rng, 200), np.full((80, 1), 7500.0), np.full((80, 1), np.nan)], axis=1)
    samples[:, 3] = 1500.0  # equal samples: sigma goes to 0
    found = layer_pixels(samples.reshape(80, 2, 101), CAMERA_PAPER, EstimateOptions(paper=True))
    layers = found.reshaped((1, 2, 101))
    assert [rule.text for rule in layer_rules(layers, np.array([80])) if rule.broken.any()] == []
    assert found.status.ravel()[3] == Status.DEGENERATE
    assert found.status.ravel()[-2:].tolist() == [Status.NO_SURFACE, Status.TOO_FEW_SAMPLES]


def test_paper_option_is_recorded_and_refuses_what_it_does_not_have() -> None:
    recorded = EstimateOptions(paper=True, counter=Kde(gamma=0.1)).as_dict()
    assert recorded["paper"] is True
    assert (recorded["gamma"], recorded["sigma"], recorded["refine"], recorded["max_iter"]) == (0.1, "free", "none", 50)
    assert not {"epsilon", "tol", "false_alarm"} & set(recorded)
    assert "paper" not in EstimateOptions().as_dict()
    with pytest.raises(ValueError, match="kernel density"):
        EstimateOptions(paper=True, counter=Cpdf())
    with pytest.raises(ValueError, match="wrapped range axis"):
        EstimateOptions(paper=True, unambiguous_range_mm=7500.0)


SIGMA = 20.0
CAMERA_NOT_GAUSSIAN = camera_of([1000.0], [SIGMA], reach_mm=(300.0, 7500.0))
Draw = Callable[[np.random.Generator, tuple[int, int]], NDArray[np.float64]]

NOISES: dict[str, Draw] = {
    "skewed": lambda rng, shape: (rng.gamma(4.0, size=shape) - 4.0) / 2.0,
    "heavy-tailed": lambda rng, shape: rng.standard_t(5, size=shape) * np.sqrt(3 / 5),
    "steps of sigma": lambda rng, shape: np.rint(rng.standard_normal(shape)),
    "steps of two sigma": lambda rng, shape: 2 * np.rint(0.5 * np.sqrt(2 / 3) * rng.standard_normal(shape)),
    "tied": lambda rng, shape: rng.choice([-0.5, 0.0, 0.0, 0.5], size=shape),
    "near-constant": lambda rng, shape: 1e-3 * rng.standard_normal(shape),
    "constant": lambda rng, shape: 0.0 * rng.standard_normal(shape),
    "drifting": lambda rng, shape: np.linspace(-1, 1, shape[0])[:, None] + 0.8 * rng.standard_normal(shape),
}
TAILED = ("skewed", "heavy-tailed")
"""A few of their samples lie where no Gaussian sample would: docs/results/limits.md has the rates of false layers."""


def _hold_together(layers: Layers, samples: NDArray[np.float64]) -> None:
    found = np.isfinite(layers.range)
    np.testing.assert_array_equal(found.sum(axis=1), layers.n_modes)
    ok = (layers.status == Status.OK)[:, np.newaxis] & found
    assert (layers.n_modes[layers.status == Status.OK] > 0).all()
    for name in ("sigma", "weight", "range_stderr", "weight_stderr", "probability"):
        values = getattr(layers, name)[ok]
        assert np.isfinite(values).all(), name
        assert (values >= 0).all(), name
    fitted = layers.status != Status.TOO_FEW_SAMPLES
    total = np.nansum(layers.weight, axis=1) + layers.weight_no_return + layers.weight_outlier
    np.testing.assert_allclose(total[fitted], 1, atol=1e-5)
    assert np.isfinite(layers.log_likelihood[fitted]).all()
    low, high = samples.min(axis=0) - SIGMA, samples.max(axis=0) + SIGMA
    assert ((layers.range >= low[:, np.newaxis]) & (layers.range <= high[:, np.newaxis]))[found].all()


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("n", [2, 3, 5, 15, 100, 600])
def test_layers_keep_all_rules_under_any_noise(noise: str, n: int, rng: np.random.Generator) -> None:
    pixels = sized(60, 5) if n < 600 else sized(8, 1)
    near = rng.random((n, pixels)) < 0.4
    samples = np.where(near, 1200.0, 3000.0) + SIGMA * NOISES[noise](rng, (n, pixels))
    for options in (
        EstimateOptions(min_samples=2),
        EstimateOptions(min_samples=2, sigma=SigmaMode.FREE, refine=Refine.NONE),
    ):
        _hold_together(layer_pixels(samples, CAMERA_NOT_GAUSSIAN, options), samples)


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("n", [10, 100])
def test_no_layer_lies_between_two_surfaces(noise: str, n: int, rng: np.random.Generator) -> None:
    pixels = sized(400, 40)
    near = rng.random((n, pixels)) < 0.5
    samples = np.where(near, 2000.0, 2000.0 + 25 * SIGMA) + SIGMA * NOISES[noise](rng, (n, pixels))
    layers = layer_pixels(samples, CAMERA_NOT_GAUSSIAN)
    between = (layers.range > 2000 + 3 * SIGMA) & (layers.range < 2000 + 22 * SIGMA)
    if noise in TAILED:
        assert between.any(axis=1).mean() < 0.08
        # What there is are a few samples next to the surface whose tail they are, never a bridge.
        assert (layers.weight[between] < 0.08).all() or n < 100
        assert not ((layers.range > 2000 + 9 * SIGMA) & (layers.range < 2000 + 16 * SIGMA)).any()
    else:
        assert not between.any()
    both = (layers.n_modes >= 2).mean()
    assert both > (0.97 if n == 10 else 0.999)


@pytest.mark.parametrize("outliers", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("n", [30, 300])
def test_many_outliers_make_no_layer(outliers: float, n: int, rng: np.random.Generator) -> None:
    pixels = sized(100, 10) if n < 300 else sized(12, 2)
    samples = np.where(rng.random((n, pixels)) < 0.5, 2000.0, 5000.0) + SIGMA * rng.standard_normal((n, pixels))
    wild = rng.random(samples.shape) < outliers
    samples[wild] = rng.uniform(300, 7500, int(wild.sum()))
    camera = replace(CAMERA_NOT_GAUSSIAN, outlier_probability=outliers)
    layers = layer_pixels(samples, camera)
    _hold_together(layers, samples)
    away = np.minimum(np.abs(layers.range - 2000), np.abs(layers.range - 5000))
    assert (away > 4 * SIGMA).any(axis=1).mean() <= 0.02  # asked: 0.1 %
    if n * (1 - outliers) > 100:
        assert (layers.n_modes == 2).all()


@pytest.mark.parametrize("noise", ["steps of sigma", "steps of two sigma", "tied", "near-constant", "constant"])
@pytest.mark.parametrize("n", [5, 30, 200])
def test_coarse_or_quiet_readings_of_one_surface_are_one_layer(noise: str, n: int, rng: np.random.Generator) -> None:
    pixels = sized(300, 30)
    place = rng.uniform(1000, 3000, pixels)
    samples = place + SIGMA * NOISES[noise](rng, (n, pixels))
    layers = layer_pixels(samples, CAMERA_NOT_GAUSSIAN)
    assert (layers.n_modes == 1).mean() > sized(0.985, 0.96)  # 0.1 % asked; 4 standard errors of 300 pixels
    spread = 2 * SIGMA / np.sqrt(n)
    assert (np.abs(layers.range[:, 0] - place) < 4 * spread).mean() > sized(0.99, 0.95)


def test_a_drift_of_one_sigma_is_one_layer_and_a_long_one_is_not_nan(rng: np.random.Generator) -> None:
    drift = np.linspace(-0.5, 0.5, 100)[:, None]
    for length, pixels, least in ((1.0, sized(100, 20), sized(0.97, 0.9)), (40.0, sized(5, 1), 0.0)):
        samples = 2000 + SIGMA * (length * drift + rng.standard_normal((100, pixels)))
        layers = layer_pixels(samples, CAMERA_NOT_GAUSSIAN)
        _hold_together(layers, samples)
        assert (layers.n_modes == 1).mean() >= least


def test_beam_spreads_outliers_over_the_working_range_or_the_curve(sensor: Sensor) -> None:
    assert beam_of(sensor).outlier_density == pytest.approx(1e-4 / 5700)
    assert beam_of(sensor).no_return_from == 6000 - 2 * 200
    beam = beam_of(replace(sensor, range_max_mm=None))
    assert beam.range_max == np.inf
    assert beam.outlier_density == pytest.approx(1e-4 / 5700)
    beam = beam_of(replace(sensor, outlier_probability=0.0))
    assert beam.p_outlier == 0
    assert beam.outlier_density > 0
    with pytest.raises(ValueError, match="noise curve"):
        beam_of(replace(sensor, noise=None))
    short = NoiseCurve(np.array([100.0]), np.array([5.0]))
    with pytest.raises(ValueError, match="not below"):
        beam_of(replace(sensor, range_max_mm=None, noise=short))


def test_options_are_all_in_as_dict_and_unknown_choices_refused_with_all() -> None:
    options = EstimateOptions(counter=Kde(gamma=0.1)).as_dict()
    assert (options["counter"], options["gamma"], options["sigma"]) == ("kde", 0.1, "prior")
    assert EstimateOptions(sigma="tied").sigma is SigmaMode.TIED  # type: ignore[arg-type]  # the CLI passes text
    with pytest.raises(ValueError, match=r"^sigma: 'loose' is not one of tied, prior, free$"):
        EstimateOptions(sigma="loose")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^mixing: 'phaser' is not one of auto, events, phasor$"):
        EstimateOptions(mixing="phaser")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "refusal"),
    [
        ("max_layers", 2.5, "max_layers: 2.5 is not a whole number"),
        ("max_iter", 10.5, "max_iter: 10.5 is not a whole number"),
        ("min_samples", True, "min_samples: True is not a whole number"),
        ("tol", "x", "tol: 'x' is not a number"),
        ("false_alarm", "0.1", "false_alarm: '0.1' is not a number"),
        ("paper", "no", "paper: 'no' is neither True nor False"),
        ("counter", "cpdf", r"counter: 'cpdf' is not one of .*Cpdf\(\).*, of tofmix.estimation.peaks.counters"),
    ],
)
def test_option_of_another_type_is_refused_by_name(name: str, value: object, refusal: str) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=f"^{refusal}$"):
        EstimateOptions(**options)
