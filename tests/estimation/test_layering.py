"""From samples to layers: invariants that hold for any samples, and what each status means."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.layering import layer_pixels, warm_up
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.flags import Status
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.sensor import NoiseCurve, Sensor

CAMERA = Sensor(
    name="test camera",
    range_min_mm=300.0,
    range_max_mm=6000.0,
    noise=NoiseCurve(np.array([400.0, 1500.0, 3000.0, 6000.0]), np.array([12.0, 25.0, 60.0, 200.0])),
)
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


def test_wall_near_the_end_of_the_range_is_no_return_by_the_papers_procedure(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[5800], shares=[1.0], n=100, pixels=20)
    assert not layer_pixels(samples, CAMERA, EstimateOptions(refine=Refine.NONE)).n_modes.any()


def test_wall_within_two_standard_errors_of_the_end_of_the_range_is_no_return(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[5970], shares=[1.0], n=100, pixels=sized(200, 20))
    assert np.mean(layer_pixels(samples, CAMERA).n_modes == 0) > 0.9


def test_wall_and_no_return_four_sigma_apart_are_both_found_with_their_shares(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[5200], shares=[0.7], n=100, pixels=sized(200, 20))
    layers = layer_pixels(samples, CAMERA)
    both = (layers.n_modes == 1) & (layers.weight_no_return > 0)
    assert both.mean() > 0.95
    assert layers.weight_no_return[both].mean() == pytest.approx(0.3, abs=0.03)


def test_probability_of_a_surface_near_the_end_of_the_range_is_low_where_c_0_explains_it_nearly_as_well(
    rng: np.random.Generator,
) -> None:
    far = layer_pixels(draw(rng, CAMERA, ranges_mm=[5600], shares=[1.0], n=60, pixels=sized(100, 10)), CAMERA)
    near = layer_pixels(draw(rng, CAMERA, ranges_mm=[5905], shares=[1.0], n=60, pixels=sized(400, 100)), CAMERA)
    found = near.n_modes == 1
    assert found.any()
    assert np.median(far.probability[:, 0]) > 0.99999
    assert np.median(near.probability[found, 0]) < 0.99999


def test_walls_next_to_a_constant_of_no_return_are_found(rng: np.random.Generator) -> None:
    """c_0 is a needle at 6000 mm: a wall at 5900 mm and 40 % of no return are told apart."""
    samples = draw(rng, CAMERA, ranges_mm=[5900], shares=[1.0], n=80, pixels=sized(100, 20))
    samples[rng.random(samples.shape) < 0.4] = 6000.0
    layers = layer_pixels(samples, replace(CAMERA, no_return_mm=6000.0))
    assert np.mean(layers.n_modes == 1) > 0.95
    assert layers.weight_no_return.mean() == pytest.approx(0.4, abs=0.04)


def test_without_range_max_a_far_surface_is_a_surface(rng: np.random.Generator) -> None:
    endless = Sensor(name="endless", noise=CAMERA.noise)
    samples = draw(rng, CAMERA, ranges_mm=[5800], shares=[1.0], n=100, pixels=sized(200, 50))
    layers = layer_pixels(samples, endless)
    assert np.mean(layers.n_modes == 1) > sized(0.98, 0.9)
    assert not layers.weight_no_return.any()


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


def test_input_is_not_altered(rng: np.random.Generator) -> None:
    samples = draw(rng, CAMERA, ranges_mm=[1000], shares=[0.7], n=20, pixels=6)
    samples.setflags(write=False)
    before = samples.copy()
    layer_pixels(samples, CAMERA)
    np.testing.assert_array_equal(samples, before)


def test_warm_up_runs_without_error() -> None:
    warm_up(EstimateOptions())
