"""Standard errors against numeric derivatives, and by how often they cover the truth."""

import numpy as np
import pytest
from numpy.typing import NDArray
from support import naive
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.sensor import Sensor

TIED = EstimateOptions(sigma=SigmaMode.TIED, tol=1e-9, max_iter=2000)


def _numeric_hessian(samples: naive.Array, point: naive.Array, *args: object) -> NDArray[np.float64]:
    size = len(point)
    step = np.where(np.arange(size) < args[0], 1e-2, 1e-5)  # type: ignore[operator]  # args[0] is k
    hessian = np.zeros((size, size))
    for a in range(size):
        for b in range(size):
            for sign_a in (-1, 1):
                for sign_b in (-1, 1):
                    shift = np.zeros(size)
                    shift[a] += sign_a * step[a]
                    shift[b] += sign_b * step[b]
                    value = naive.log_likelihood(samples, point + shift, *args)  # type: ignore[arg-type]
                    hessian[a, b] += sign_a * sign_b * value / (4 * step[a] * step[b])
    return hessian


@pytest.mark.parametrize(
    ("ranges", "shares"), [([1500, 1580], [0.4, 0.6]), ([1500, 1600, 3000], [0.3, 0.3, 0.4]), ([2000], [0.6])]
)
def test_errors_equal_the_inverse_numeric_hessian(
    ranges: list[float], shares: list[float], rng: np.random.Generator, sensor: Sensor
) -> None:
    samples = draw(rng, sensor, ranges_mm=ranges, shares=shares, n=400, pixels=1)
    layers = layer_pixels(samples, sensor, TIED)
    k = int(layers.n_modes[0])
    assert k == len(ranges)
    with_no_return = layers.weight_no_return[0] * 400 > 0.5
    weights = [*layers.weight[0, :k], layers.weight_no_return[0]][: k + with_no_return]
    point = np.array([*layers.range[0, :k], *weights[:-1]], dtype=np.float64)
    sigma = layers.sigma[0, :k].astype(np.float64)
    hessian = _numeric_hessian(samples[:, 0].astype(np.float64), point, k, sigma, with_no_return, sensor)
    expected = np.sqrt(np.diag(np.linalg.inv(-hessian)))[:k]
    np.testing.assert_allclose(layers.range_stderr[0, :k], expected, rtol=5e-3)


def test_one_surface_has_sigma_over_root_n(rng: np.random.Generator, sensor: Sensor) -> None:
    layers = layer_pixels(draw(rng, sensor, ranges_mm=[1500], shares=[1], n=64, pixels=20), sensor, TIED)
    np.testing.assert_allclose(layers.range_stderr[:, 0], layers.sigma[:, 0] / 8, rtol=0.02)


@pytest.mark.compiled("a frequency over 4000 pixels")
def test_errors_cover_the_truth(rng: np.random.Generator, sensor: Sensor) -> None:
    truth = [1500.0, 1640.0, 3500.0]
    layers = layer_pixels(draw(rng, sensor, ranges_mm=truth, shares=[0.3, 0.3, 0.4], n=100, pixels=4000), sensor)
    right = layers.n_modes == 3
    assert right.mean() > 0.98
    z = (layers.range[right, :3] - truth) / layers.range_stderr[right, :3]
    cover = (np.abs(z) < 1.96).mean(axis=0)
    assert np.all((cover > 0.925) & (cover < 0.975))


@pytest.mark.compiled("a frequency over 4000 pixels")
def test_shares_have_errors_that_cover_the_truth(rng: np.random.Generator, sensor: Sensor) -> None:
    shares = [0.25, 0.35, 0.4]
    samples = draw(rng, sensor, ranges_mm=[1500, 1640, 3500], shares=shares, n=100, pixels=4000)
    layers = layer_pixels(samples, sensor)
    right = layers.n_modes == 3
    z = (layers.weight[right, :3] - shares) / layers.weight_stderr[right, :3]
    cover = (np.abs(z) < 1.96).mean(axis=0)
    assert np.all((cover > 0.925) & (cover < 0.975))


def test_share_without_a_competitor_has_no_error(rng: np.random.Generator, sensor: Sensor) -> None:
    layers = layer_pixels(draw(rng, sensor, ranges_mm=[1500], shares=[1], n=64, pixels=20), sensor)
    assert not layers.weight_stderr[layers.n_modes == 1, 0].any()


def test_overlap_makes_errors_larger(rng: np.random.Generator, sensor: Sensor) -> None:
    errors = []
    for apart in (100, 900):
        samples = draw(rng, sensor, ranges_mm=[1500, 1500 + apart], shares=[0.5, 0.5], n=100, pixels=sized(300, 30))
        layers = layer_pixels(samples, sensor)
        errors.append(np.nanmedian(layers.range_stderr[layers.n_modes == 2, 0]))
    assert errors[0] > 1.05 * errors[1]
