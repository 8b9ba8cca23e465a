"""The count under learnt noise: as many surfaces as there are, whatever the shape, and none out of background."""

import numpy as np
import pytest
from support.learnt_pixels import (
    CAMERA,
    KNOWN,
    LOW_MM,
    SIGMA_MM,
    TOP_MM,
    camera_with,
    flat,
    pixel_noise,
    surfaces,
)

from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions
from tofmix.flags import Status

PLACES = 1500.0, 1500.0 + 6 * SIGMA_MM, 3000.0
SHARES = {1: (1.0,), 2: (0.4, 0.6), 3: (0.3, 0.3, 0.4)}
ON_BACKGROUND = (2.0, 6.0)


@pytest.mark.compiled("hundreds of pixels")
@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("name", KNOWN)
def test_surfaces_six_sigma_apart_are_counted_for_any_shape(name: str, count: int, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (120, 200), PLACES[:count], SHARES[count], errors=KNOWN[name].draw)
    layers = layer_pixels(samples, camera_with(pixel_noise(name), flat(8.0)))
    assert (layers.n_modes == count).mean() >= 0.985
    right = layers.n_modes == count
    np.testing.assert_allclose(np.median(layers.range[right, :count], axis=0), PLACES[:count], atol=0.1 * SIGMA_MM)
    np.testing.assert_allclose(layers.weight[right, :count].mean(axis=0), SHARES[count], atol=0.01)
    assert np.isin(layers.status[right], [Status.OK, Status.NOT_CONVERGED]).mean() >= 0.99  # corners are slow


@pytest.mark.compiled("hundreds of pixels")
def test_a_gaussian_splits_pixels_of_a_skewed_shape_that_the_learnt_shape_does_not(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (200, 300), PLACES[:1], errors=KNOWN["skewed"].draw)
    split = {n: (layer_pixels(samples, camera_with(pixel_noise(n))).n_modes > 1).mean() for n in ("gaussian", "skewed")}
    assert split["gaussian"] > 0.05
    assert split["skewed"] <= 0.01


@pytest.mark.compiled("hundreds of pixels")
@pytest.mark.parametrize("background", [0.0, 0.3, 0.6, 0.85])
def test_background_of_each_pixel_is_found_and_its_surface_too(background: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (200, 200), (2000.0,), background=background)
    layers = layer_pixels(samples, camera_with(pixel_noise(background=ON_BACKGROUND), flat(9.0, 9.0)))
    assert (layers.n_modes == 1).mean() >= 0.98
    near, far = ON_BACKGROUND
    with_prior = (200 * background + near) / (200 + near + far)
    assert layers.weight_outlier.mean() == pytest.approx(with_prior, abs=0.01)
    one = layers.n_modes == 1
    total = layers.weight[one, 0] + layers.weight_outlier[one] + layers.weight_no_return[one]
    np.testing.assert_allclose(total, 1.0, atol=1e-5)


@pytest.mark.parametrize("name", ["gaussian", "skewed"])
def test_background_alone_has_no_surface(name: str, rng: np.random.Generator) -> None:
    samples = rng.uniform(LOW_MM, TOP_MM, (100, 150))
    layers = layer_pixels(samples, camera_with(pixel_noise(name, background=ON_BACKGROUND), flat(9.0, 16.0)))
    assert (layers.n_modes == 0).mean() >= 0.97
    none = layers.n_modes == 0
    assert (layers.status[none] == Status.NO_SURFACE).all()
    # Where a sample lies near r_max, it may be c_0's.
    np.testing.assert_allclose(layers.weight_outlier[none] + layers.weight_no_return[none], 1.0, atol=1e-5)
    assert (layers.weight_outlier[none] > 0.9).all()
    assert np.isnan(layers.range[none]).all()


@pytest.mark.compiled("hundreds of pixels")
@pytest.mark.parametrize("distance", [4.0, 6.0, 12.0])
def test_two_surfaces_are_not_one_wide_one_where_widths_are_free(distance: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (120, 200), (2000.0, 2000.0 + distance * SIGMA_MM), (0.5, 0.5))
    layers = layer_pixels(samples, camera_with(pixel_noise(width_spread=0.2)))
    assert (layers.n_modes == 2).mean() >= 0.97


@pytest.mark.compiled("hundreds of pixels")
def test_a_wide_pixel_is_one_surface_and_its_width_is_stated(rng: np.random.Generator) -> None:
    width = np.repeat([0.6, 1.0, 1.6], 100)
    samples = surfaces(rng, (150, 300), (2000.0,), width=width)
    layers = layer_pixels(samples, camera_with(pixel_noise(width_spread=0.3)))
    assert (layers.n_modes == 1).mean() >= 0.98
    assert layers.noise_width is not None
    for wide in (0.6, 1.0, 1.6):
        found = layers.noise_width[width == wide]
        assert float(np.median(found)) == pytest.approx(wide, rel=0.05)
        np.testing.assert_allclose(layers.sigma[width == wide, 0], SIGMA_MM * found, rtol=1e-5)


@pytest.mark.parametrize("most", [1, 2])
def test_no_more_than_the_chosen_number_of_layers_is_kept(most: int, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (120, 20), PLACES, SHARES[3])
    layers = layer_pixels(samples, camera_with(pixel_noise("skewed")), EstimateOptions(max_layers=most))
    np.testing.assert_array_equal(layers.n_modes, most)
    assert layers.range.shape[1] == most
    assert (layers.probability > 0.99).all()


def test_samples_at_the_end_of_range_are_no_return_and_no_surface(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (150, 30), (2000.0, TOP_MM), (0.7, 0.3))
    layers = layer_pixels(samples, camera_with(pixel_noise(background=ON_BACKGROUND)))
    np.testing.assert_array_equal(layers.n_modes, 1)
    np.testing.assert_allclose(layers.weight_no_return.mean(), 0.3, atol=0.03)


def _with_fewest(samples: FloatArray) -> FloatArray:
    out = np.full((10, 3), np.nan)
    out[: samples.size, 0] = samples
    out[:2, 1] = 2000.0, 2010.0
    return out


@pytest.mark.parametrize("background", [None, ON_BACKGROUND])
def test_three_samples_together_are_a_surface_and_fewer_are_too_few(background: tuple[float, float] | None) -> None:
    samples = _with_fewest(np.array([1990.0, 2000.0, 2015.0]))
    layers = layer_pixels(samples, camera_with(pixel_noise("skewed", background=background)))
    assert layers.n_modes.tolist() == [1, 0, 0]
    assert layers.status.tolist() == [Status.OK, Status.TOO_FEW_SAMPLES, Status.TOO_FEW_SAMPLES]
    assert abs(layers.range[0, 0] - 2000.0) < SIGMA_MM


@pytest.mark.parametrize("samples", ["constant", "steps of two sigma", "two constants"])
def test_equal_and_coarse_samples_are_fitted_without_trouble(samples: str, rng: np.random.Generator) -> None:
    block = {
        "constant": np.full((60, 5), 2000.0),
        "steps of two sigma": 2 * SIGMA_MM * np.rint(rng.normal(2010.0, SIGMA_MM, (60, 5)) / (2 * SIGMA_MM)),
        "two constants": np.where(np.arange(60)[:, np.newaxis] % 2 == 0, 2000.0, 3000.0) * np.ones(5),
    }[samples]
    for noise in (pixel_noise("skewed"), pixel_noise(width_spread=0.3, background=ON_BACKGROUND, drift_mm=(9.0,) * 3)):
        layers = layer_pixels(block, camera_with(noise))
        assert (layers.n_modes >= 1).all()
        if samples != "steps of two sigma":  # they are wider than the curve says
            assert (layers.n_modes == (2 if samples == "two constants" else 1)).all()
        found = np.isfinite(layers.range)
        for name in ("range_stderr", "weight_stderr", "probability", "sigma", "weight"):
            assert np.isfinite(getattr(layers, name)[found]).all()
    assert CAMERA.learnt is None
