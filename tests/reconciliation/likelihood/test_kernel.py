"""The compiled loops over samples against whole-array twins: every kind of component, cell, fold and gap."""

import math
from typing import Any, TypeAlias

import numpy as np
import pytest
from numpy.polynomial import hermite_e
from numpy.typing import NDArray
from scipy import stats
from support import reconcile_twins as twins
from support.noise_parts import long_tailed, skewed

from tofmix.noise_shape import NoiseShape
from tofmix.reconciliation.likelihood import kernel
from tofmix.reconciliation.likelihood.error_shape import GAUSSIAN, moves, shape_table
from tofmix.reconciliation.likelihood.kernel import empty_sums
from tofmix.reconciliation.likelihood.smooth_kernel import LatentEvents

FRAMES, PIXELS, COMPONENTS, TIMES = 9, 12, 4, 2
NONE_NEAREST = np.zeros(PIXELS, dtype=bool)
"""Pixels with samples of 1 mm: none."""

RANDOM = np.linspace(1e-6, 3e-6, PIXELS)
"""Density of random values of each pixel, 1/mm."""

Scene: TypeAlias = tuple[Any, Any, Any, LatentEvents]


def _scene(rng: np.random.Generator, *, step: float, period: float, spread: float) -> tuple[Scene, NDArray[np.float64]]:
    """Samples and a mixture that have all that a kernel may meet."""
    shape = (TIMES, COMPONENTS, PIXELS)
    mean = rng.uniform(50.0, 7400.0, shape)
    samples = np.rint(mean[0, rng.integers(0, COMPONENTS, (FRAMES, PIXELS)), np.arange(PIXELS)])
    samples = np.clip(samples + np.rint(spread * rng.standard_normal(samples.shape)), 1, 60_000)
    if step > 0:
        on_lattice = rng.random(samples.shape) < 0.8
        samples = np.where(on_lattice, np.rint(np.rint(samples / step) * step), samples)
    samples[rng.random(samples.shape) < 0.1] = 0
    samples[0, 0] = 60_000  # what no component explains
    weight = rng.dirichlet(np.ones(COMPONENTS), (TIMES, PIXELS)).transpose(0, 2, 1).copy()
    weight[:, 1, ::3] = 0.0
    lit = np.ones(shape, dtype=np.bool_)
    lit[:, -1] = False
    if period > 0:
        mean[:, 0] += period  # lights that are a turn ahead
    scene = (
        samples.astype(np.uint16),
        np.arange(0, PIXELS, dtype=np.int64),
        np.array([0, 1, 2, 4, 5, 8]),
        LatentEvents(
            np.array([0] * 5 + [1] * 4),
            np.linspace(0.0, 1.0, FRAMES),
            rng.normal(0, 3, FRAMES),
            np.where(np.arange(FRAMES) % 2, 0.0, 100.0),
            rng.normal(0, 3, PIXELS),
            weight,
            mean,
            rng.uniform(0.3, 3.0, shape) * spread,
            rng.normal(0, 2, shape),
            lit,
        ),
    )
    return scene, rng.uniform(0.0, 0.2, (TIMES, PIXELS))


@pytest.mark.parametrize("step", [0.0, 0.3, 7.3])
@pytest.mark.parametrize("period", [0.0, 7495.0])
@pytest.mark.parametrize("spread", [0.2, 3.0, 40.0])
def test_likelihood_slope_and_information_equal_the_twins(
    rng: np.random.Generator, step: float, period: float, spread: float
) -> None:
    scene, invalid = _scene(rng, step=step, period=period, spread=spread)
    found, wanted = empty_sums(FRAMES, PIXELS), empty_sums(FRAMES, PIXELS)
    chosen = kernel.sort_pixels(scene[1], scene[3].weight, scene[3].sigma, invalid, step, period, NONE_NEAREST)
    kernel.log_likelihood(scene[0], chosen, *scene[2:], invalid, RANDOM, step, period, GAUSSIAN, *found)
    twins.log_likelihood(*scene, invalid, RANDOM, step, period, GAUSSIAN, *wanted)
    for got, should in zip(found, wanted, strict=True):
        # In narrow cells the kernel takes density times width, with Sheppard's correction.
        np.testing.assert_allclose(got[:, 0], should[:, 0], rtol=2e-3, atol=2e-2)
        np.testing.assert_allclose(got[:, 1:], should[:, 1:], rtol=2e-2, atol=2e-3 / min(spread, 1.0))
        np.testing.assert_array_equal(got[:, 3], should[:, 3])
    assert sorted(chosen.all) == list(range(PIXELS))
    assert (chosen.narrow.size > 0) == (step == period == 0 and spread > 1)
    left_out = np.setdiff1d(np.arange(FRAMES), scene[2])
    assert not found[1][left_out].any()


@pytest.mark.parametrize("mean_mm", [150.0, 980.0, 1040.0])
def test_probabilities_of_all_values_of_a_folded_axis_add_up_to_one(mean_mm: float) -> None:
    """Also beside the fold, where noise goes over it: no phase is stored as more than a turn."""
    turn_mm, pixels = 1000.5, 1300
    samples = np.arange(1, pixels + 1, dtype=np.uint16)[None]  # each value in a pixel of its own
    one = np.ones((1, 1, pixels))
    frame, still, nothing = np.array([0]), np.zeros(1), np.zeros(pixels)
    events = LatentEvents(frame, still, still, still, nothing, one, mean_mm * one, 20.0 * one, 0 * one, one > 0)
    found = empty_sums(1, pixels)
    every = np.arange(pixels)
    kernel.any_log_likelihood(samples, every, frame, events, nothing[None], nothing, 0.0, turn_mm, GAUSSIAN, *found)
    # the value 0, at most 0.02, is stored as 1; if values beyond the fold counted, the sum would be 1.15 to 2.00
    assert np.exp(found[0][:, 0]).sum() == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("step", "sigma_mm"), [(0.0, 8.0), (0.0, 1.0), (0.3, 8.0), (21.05, 8.0), (60.0, 8.0)])
def test_samples_nearer_than_1_mm_are_those_stored_as_1(step: float, sigma_mm: float) -> None:
    """As those of a cover glass: the least valid value stands for all of them."""
    pixels = 400
    samples = np.arange(1, pixels + 1, dtype=np.uint16)[None]
    one = np.ones((1, 1, pixels))
    frame, still, nothing = np.array([0]), np.zeros(1), np.zeros(pixels)
    events = LatentEvents(frame, still, still, still, nothing, one, 5.0 * one, sigma_mm * one, 0 * one, one > 0)
    found = empty_sums(1, pixels)
    first = samples[0] == 1
    chosen = kernel.sort_pixels(np.arange(pixels), one, events.sigma, nothing[None], step, 0.0, first)
    kernel.log_likelihood(samples, chosen, frame, events, nothing[None], nothing, step, 0.0, GAUSSIAN, *found)
    nearest = 0.5 * step if step > 3 else 1.35 if step else 1.5  # mm, up to which a range is stored as 1
    assert np.exp(found[0][0, 0]) == pytest.approx(stats.norm.cdf(nearest, 5.0, sigma_mm), rel=1e-9)
    assert np.exp(found[0][:, 0]).sum() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("step", [0.0, 0.3, 7.3])
@pytest.mark.parametrize("period", [0.0, 7495.0])
@pytest.mark.parametrize("spread", [0.2, 3.0, 40.0])
def test_transform_equals_the_twins_and_lies_between_0_and_1(
    rng: np.random.Generator, step: float, period: float, spread: float
) -> None:
    scene, _ = _scene(rng, step=step, period=period, spread=spread)
    found, wanted = (np.full((FRAMES, PIXELS), 7.0, np.float32) for _ in range(2))
    kernel.transform(*scene, 1e4 * RANDOM, 300.0, 7500.0, step, period, GAUSSIAN, 3, found)
    twins.transform(*scene, 1e4 * RANDOM, 300.0, 7500.0, step, period, GAUSSIAN, 3, wanted)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    frames = scene[2]
    np.testing.assert_array_equal(np.isnan(found[frames]) | (scene[0][frames] > 0), np.ones_like(found[frames], bool))
    assert np.nanmin(found[frames]) >= 0
    assert np.nanmax(found[frames]) <= 1 + 1e-6
    assert np.isfinite(found[frames]).mean() > 0.5


@pytest.mark.parametrize("shape", [skewed(), long_tailed()], ids=["skewed", "long-tailed"])
@pytest.mark.parametrize("step", [0.0, 7.3])
@pytest.mark.parametrize("period", [0.0, 7495.0])
@pytest.mark.parametrize("spread", [0.5, 40.0])
def test_kernels_with_a_shape_equal_the_twins(
    rng: np.random.Generator, shape: NoiseShape, step: float, period: float, spread: float
) -> None:
    scene, invalid = _scene(rng, step=step, period=period, spread=spread)
    table = shape_table(shape)
    found, wanted = empty_sums(FRAMES, PIXELS), empty_sums(FRAMES, PIXELS)
    chosen = kernel.sort_pixels(
        scene[1], scene[3].weight, scene[3].sigma, invalid, step, period, NONE_NEAREST, gaussian=False
    )
    kernel.log_likelihood(scene[0], chosen, *scene[2:], invalid, RANDOM, step, period, table, *found)
    twins.log_likelihood(*scene, invalid, RANDOM, step, period, table, *wanted)
    for got, should in zip(found, wanted, strict=True):
        np.testing.assert_allclose(got, should, rtol=1e-6, atol=1e-7)
    scores, theirs = (np.full((FRAMES, PIXELS), 7.0, np.float32) for _ in range(2))
    kernel.transform(*scene, 1e4 * RANDOM, 300.0, 7500.0, step, period, table, 3, scores)
    twins.transform(*scene, 1e4 * RANDOM, 300.0, 7500.0, step, period, table, 3, theirs)
    np.testing.assert_allclose(scores, theirs, atol=1e-6)


def test_slope_with_a_shape_is_that_of_the_log_likelihood(rng: np.random.Generator) -> None:
    scene, invalid = _scene(rng, step=0.0, period=0.0, spread=40.0)
    table, moved = shape_table(skewed()), []
    for bias in (-0.01, 0.0, 0.01):
        found = empty_sums(FRAMES, PIXELS)
        shifted = scene[3]._replace(pixel_bias=scene[3].pixel_bias + bias)
        chosen = kernel.sort_pixels(
            scene[1], scene[3].weight, scene[3].sigma, invalid, 0.0, 0.0, NONE_NEAREST, gaussian=False
        )
        kernel.log_likelihood(scene[0], chosen, scene[2], shifted, invalid, RANDOM, 0.0, 0.0, table, *found)
        moved.append(found[0])
    np.testing.assert_allclose(moved[1][:, 1], (moved[2][:, 0] - moved[0][:, 0]) / 0.02, rtol=2e-3, atol=2e-5)


def test_moves_equal_the_changes_of_simulated_scores_with_a_bias_or_another_width(rng: np.random.Generator) -> None:
    shape, more = skewed(), 0.01
    z = rng.standard_normal(400_000)
    near, at = np.abs(z) < 3.9, shape.quantile(stats.norm.cdf(z))
    for moved, expected in zip((at + more, at * np.exp(more)), moves(shape), strict=True):
        scores = stats.norm.ppf(np.clip(shape.cdf(moved), 1e-12, 1 - 1e-12))
        change = [float((b - a)[near].mean()) / more for a, b in zip(_orders(z), _orders(scores), strict=True)]
        np.testing.assert_allclose(change, expected, atol=0.12)  # second orders are some 0.05


def _orders(z: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Normalised Hermite polynomials of the orders 1 to 4."""
    orders = (hermite_e.hermeval(z, [0] * k + [1]) / math.sqrt(math.factorial(k)) for k in (1, 2, 3, 4))
    return [np.asarray(order, dtype=np.float64) for order in orders]
