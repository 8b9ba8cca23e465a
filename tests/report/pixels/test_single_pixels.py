"""Pixels of one layer beside the learnt noise: the width of their samples, and the errors of all of them."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_noises import ALL, SIGMA_MM, Made, Parts, made
from support.noise_parts import skewed

from tofmix.arrays import FloatArray
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.report.pixels.single_pixels import SinglePixels, single_pixels


def true_layers(case: Made, *, background: float = 0.0) -> Layers:
    """Layers of one surface in each pixel, as a perfect estimator would have them."""
    layers = Layers.empty(case.range_mm.shape, 2)
    layers.n_modes[...] = 1
    layers.range[..., 0], layers.sigma[..., 0] = case.range_mm, SIGMA_MM * case.width
    layers.weight[..., 0], layers.weight_outlier[...] = 1.0 - background, background
    return layers


def looked_at(case: Made, layers: Layers, samples: FloatArray | None = None) -> SinglePixels:
    samples = case.samples_mm if samples is None else samples
    source = ArrayRecording(samples.astype(np.float32), case.sensor)
    return single_pixels(layers, case.provenance(), recording=source, start=0, stop=len(samples))


@pytest.mark.parametrize(
    "parts",
    [
        Parts(),
        Parts(shape=skewed(1.0)),
        Parts(background=0.3),
        Parts(drift_mm=(60.0, 20.0, 10.0)),
        Parts(width_spread=0.2),
        ALL,
    ],
)
def test_half_the_central_width_is_sigma_for_any_other_parts(parts: Parts) -> None:
    case = made(parts, frames=60, image=(20, 30), seed=2)
    spread = looked_at(case, true_layers(case, background=parts.background)).spread()
    assert spread is not None
    assert spread.count == 600
    assert spread.q50 == pytest.approx(float(np.median(case.width)), rel=0.03)


def test_each_pixel_has_its_own_width() -> None:
    case = made(Parts(width_spread=0.4), frames=900, image=(3, 4))
    found = looked_at(case, true_layers(case))
    np.testing.assert_allclose(found.over_curve, case.width.ravel(), rtol=0.15)
    np.testing.assert_allclose(found.range_mm, case.range_mm.ravel(), rtol=1e-6)


def test_errors_have_the_shape_less_the_background() -> None:
    case = made(ALL, frames=60, image=(20, 30))
    found = looked_at(case, true_layers(case, background=0.15))
    edges = np.array([-1.0, 0.0, 1.0, 3.0])
    share = np.histogram(found.errors, edges)[0] / found.errors.size
    surface = (share - found.background * np.diff(edges)) / found.held
    assert ALL.shape is not None
    np.testing.assert_allclose(surface, np.diff(ALL.shape.cdf(edges)), atol=0.02)


def test_only_pixels_of_one_layer_are_used() -> None:
    case = made(Parts(), frames=30, image=(4, 5))
    layers = true_layers(case)
    layers.n_modes[0, :] = [0, 2, 2, 0, 1]
    found = looked_at(case, layers)
    assert found.pixels_of_one_layer == found.range_mm.size == 16
    layers.n_modes[...] = 2
    nothing = looked_at(case, layers)
    assert nothing.spread() is None
    assert nothing.errors.size == 0


def test_pixels_of_few_samples_have_no_width() -> None:
    case = made(Parts(), frames=30, image=(2, 3))
    samples = case.samples_mm.copy()
    samples[11:, 0, 0] = np.nan
    found = looked_at(case, true_layers(case), samples)
    assert found.range_mm.size == 5
    assert found.pixels_of_one_layer == 6


def test_without_a_recording_sigma_is_that_of_the_file() -> None:
    case = made(Parts(width_spread=0.3), frames=2, image=(4, 5))
    found = single_pixels(true_layers(case), case.provenance(), recording=None, start=0, stop=2)
    assert not found.from_samples
    np.testing.assert_allclose(found.over_curve, case.width.ravel(), rtol=1e-6)
    assert found.errors.size == 0


def test_large_images_and_long_windows_are_thinned_out_evenly() -> None:
    case = made(Parts(), frames=20, image=(60, 50))
    found = looked_at(case, true_layers(case))
    assert found.pixels_of_one_layer == 3000
    assert found.range_mm.size == 1000
    assert found.range_mm[[0, -1]].tolist() == pytest.approx([1500.0, 3000.0])
    long = made(Parts(drift_mm=(60.0, 20.0, 10.0)), frames=3500, image=(1, 2))
    few = looked_at(long, true_layers(long))
    assert few.errors.size == 2 * 875
    np.testing.assert_allclose(few.over_curve, 1.0, atol=0.12)


def test_ranges_on_a_circle_are_held_to_their_layer_across_the_fold() -> None:
    case = made(Parts(), frames=200, image=(2, 3))
    length = 5300.0
    on_circle = replace(case.provenance(), options={"unambiguous_range_mm": length})
    shift = length - case.range_mm  # all surfaces at the fold
    layers = true_layers(case)
    layers.range[..., 0] = 1.0
    source = ArrayRecording(np.mod(case.samples_mm + shift + 1.0, length).astype(np.float32), case.sensor)
    found = single_pixels(layers, on_circle, recording=source, start=0, stop=200)
    np.testing.assert_allclose(found.over_curve, 1.0, atol=0.25)


def test_pixels_with_impossible_numbers_are_skipped() -> None:
    case = made(Parts(drift_mm=(60.0, 20.0, 10.0)), frames=30, image=(2, 3))
    layers = true_layers(case)
    layers.sigma[0, 0, 0], layers.sigma[0, 1, 0], layers.range[0, 2, 0] = np.nan, 0.0, np.inf
    layers.weight[1, 0, 0], layers.weight_outlier[1, 1] = np.nan, np.nan
    found = looked_at(case, layers)
    assert found.pixels_of_one_layer == found.range_mm.size == 2
    assert np.isfinite(found.errors).all()
