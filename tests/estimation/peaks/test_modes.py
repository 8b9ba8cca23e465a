"""The kernel density of equation (4), grown frame by frame, and its maxima by test (5)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import trapezoid
from support import naive
from support.drawing import draw
from support.sizes import sized

from tofmix.circle import circular_noise, fold
from tofmix.estimation.beam import beam_of, sigma_at
from tofmix.estimation.peaks.counters import Kde
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.peaks.modes import density, find_modes
from tofmix.estimation.samples import sort_samples
from tofmix.estimation.unrolling import unroll
from tofmix.sensor import NoiseCurve, Sensor

CURVE = NoiseCurve(np.array([400.0, 1500.0, 3000.0, 6000.0]), np.array([12.0, 25.0, 60.0, 200.0]))


@given(
    samples=arrays(np.float64, st.integers(1, 40), elements=st.floats(300, 7000)),
    at=arrays(np.float64, st.integers(1, 30), elements=st.floats(-500, 9000)),
)
def test_density_equals_its_naive_twin(samples: naive.Array, at: naive.Array) -> None:
    expected = naive.density(samples, at, CURVE)
    # The reach cuts each kernel at 4e-6 of its height.
    tallest = 1 / (CURVE.sigma(at) / 2 * np.sqrt(2 * np.pi))
    assert np.all(np.abs(density(samples, at, CURVE) - expected) <= 4e-6 * tallest)


def test_density_integrates_to_one_where_sigma_is_flat(rng: np.random.Generator) -> None:
    flat = NoiseCurve(np.array([0.0]), np.array([30.0]))
    grid = np.arange(500.0, 3500.0, 2.0)
    p = density(rng.uniform(1000, 3000, 200), grid, flat)
    assert trapezoid(p, grid) == pytest.approx(1, abs=1e-5)


def test_density_ignores_order_and_invalid_samples(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = rng.uniform(500, 5000, 50)
    at = np.linspace(500, 5000, 40)
    shuffled = np.append(rng.permutation(samples), [np.nan, np.inf])
    np.testing.assert_array_equal(density(samples, at, sensor.noise), density(shuffled, at, sensor.noise))


def test_densities_refuse_no_samples_and_invalid_options() -> None:
    with pytest.raises(ValueError, match="none is finite"):
        density([np.nan], [1.0], CURVE)
    with pytest.raises(ValueError, match="pixels"):
        IncrementalDensity(CAMERA, 0)
    with pytest.raises(ValueError, match="gamma"):
        IncrementalDensity(CAMERA, 1).modes(gamma=2.0)


@given(range_mm=st.floats(-1e4, 2e4))
def test_sigma_at_equals_interp(range_mm: float) -> None:
    expected = np.interp(range_mm, CURVE.range_mm, CURVE.sigma_mm)
    assert sigma_at(range_mm, CURVE.range_mm, CURVE.sigma_mm) == pytest.approx(expected, rel=1e-12)


NOISE = NoiseCurve(np.array([400.0, 1500.0, 3000.0, 6000.0]), np.array([12.0, 25.0, 60.0, 200.0]))
CAMERA = Sensor(name="test camera", range_min_mm=300.0, range_max_mm=6000.0, noise=NOISE)


def _block(rng: np.random.Generator, n: int, pixels: int) -> np.ndarray:
    return draw(rng, CAMERA, ranges_mm=[1000, 2200, 4000], shares=[0.2, 0.3, 0.4], n=n, pixels=pixels, outliers=0.01)


def test_density_is_equation_4(rng: np.random.Generator) -> None:
    block = _block(rng, 60, 3)
    block[::4, 1] = np.nan
    density = IncrementalDensity(CAMERA, 3)
    density.add(block)
    assert density.n_samples.tolist() == [60, 45, 60]
    for pixel, p in enumerate(density.density()):
        samples = block[:, pixel][np.isfinite(block[:, pixel])].astype(np.float64)
        np.testing.assert_allclose(p, naive.density(samples, density.range_mm, NOISE), atol=1e-5 * p.max())
        assert trapezoid(p, density.range_mm) == pytest.approx(1, abs=0.05)


def test_grid_of_the_density_is_a_quarter_of_the_bandwidth_and_read_only() -> None:
    grid = IncrementalDensity(CAMERA, 1).range_mm
    np.testing.assert_allclose(np.diff(grid) / NOISE.sigma(grid[:-1]), 0.125)
    assert grid[0] == 300 - 4 * 12
    assert grid[-1] >= 6000 + 4 * 200
    density = IncrementalDensity(CAMERA, 1)
    density.add([[1000.0]])
    before = density.n_samples
    density.add([[1000.0]])
    assert before.tolist() == [1]
    with pytest.raises(ValueError, match="read-only"):
        density.range_mm[0] = 0.0


@given(seed=st.integers(0, 2**32 - 1), cuts=st.lists(st.integers(0, 40), max_size=6), backwards=st.booleans())
def test_any_split_and_any_order_give_the_batch_result(*, seed: int, cuts: list[int], backwards: bool) -> None:
    rng = np.random.default_rng(seed)
    block = _block(rng, 40, 4)
    block[rng.random(block.shape) < 0.1] = np.nan
    batch, live = IncrementalDensity(CAMERA, 4), IncrementalDensity(CAMERA, 4)
    batch.add(block)
    shuffled = block[rng.permutation(40)]
    pieces = np.split(shuffled, sorted(cuts))
    for piece in reversed(pieces) if backwards else pieces:
        live.add(piece)
    np.testing.assert_array_equal(live.n_samples, batch.n_samples)
    np.testing.assert_allclose(live.density(), batch.density(), rtol=1e-12, atol=1e-18)
    one, other = live.modes(), batch.modes()
    np.testing.assert_array_equal(one.found, other.found)
    np.testing.assert_allclose(one.place, other.place, atol=1e-6)


@pytest.mark.parametrize(("n", "gamma", "epsilon"), [(5, 0.02, 0.01), (30, 0.1, 1e-9), (100, 0.02, 0.01)])
def test_modes_agree_with_the_batch_search(n: int, gamma: float, epsilon: float, rng: np.random.Generator) -> None:
    pixels = sized(300, 30)
    block = _block(rng, n, pixels)
    density = IncrementalDensity(CAMERA, pixels)
    density.add(block)
    modes = density.modes(gamma=gamma, epsilon=epsilon)
    batch = Kde(gamma=gamma, epsilon=epsilon).peaks(sort_samples(block), beam_of(CAMERA))
    differing = 0
    for pixel, column in enumerate(block.T):
        found = modes.place[pixel, : modes.found[pixel]]
        expected = find_modes(column, NOISE, gamma=gamma, epsilon=epsilon)
        if len(found) == len(expected):
            assert np.all(np.abs(found - expected) < 0.1 * NOISE.sigma(expected))
            np.testing.assert_allclose(modes.height[pixel, : len(found)], batch.height[pixel, : len(found)], rtol=0.05)
        else:
            differing += 1
    # Of 300, or 30: two maxima, or a shoulder and a maximum, within a step; a height next to gamma.
    assert differing <= sized(12, 3)


def test_pixels_without_a_peak_have_none() -> None:
    density = IncrementalDensity(CAMERA, 3)
    density.add([[2000.0, np.nan, 1e8]])
    modes = density.modes()
    assert modes.found.tolist() == [0, 0, 0]
    assert modes.place[0, 0] == pytest.approx(2000, abs=5)
    assert density.n_samples.tolist() == [1, 0, 1]
    assert np.all(density.density()[1:] == 0)
    range_mm = np.arange(500.0, 1500.0, 4.0)
    jagged = NoiseCurve(range_mm, np.tile([5.0, 40.0], len(range_mm) // 2))
    sensor = Sensor(name="jagged", range_min_mm=500.0, range_max_mm=1500.0, noise=jagged)
    density = IncrementalDensity(sensor, 1)
    samples = np.array([700.0, 1000.0, 1003.0])
    density.add(samples[:, np.newaxis])
    expected = naive.density(samples, density.range_mm, jagged)
    np.testing.assert_allclose(density.density()[0], expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("shape", [(3,), (3, 2), (1, 3, 1)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="block"):
        IncrementalDensity(CAMERA, 3).add(np.zeros(shape))


def _folded_block(rng: np.random.Generator, n: int, pixels: int) -> np.ndarray:
    mean = np.array([5800.0, 6010.0, 2200.0])[rng.choice(3, p=[0.2, 0.4, 0.4], size=(n, pixels))]
    return np.asarray(fold(mean + rng.standard_normal((n, pixels)) * 0.03 * mean, 6000.0), dtype=np.float32)


def test_on_a_circle_the_density_goes_round_it(rng: np.random.Generator) -> None:
    block = _folded_block(rng, 60, 3)
    block[0] = 0.0
    block[1, 2] = np.nan
    density = IncrementalDensity(CAMERA, 3, unambiguous_range_mm=6000.0)
    density.add(block[:20])
    density.add(block[20:])
    assert density.n_samples.tolist() == [60, 60, 59]
    grid, noise = density.range_mm, circular_noise(CAMERA, 6000.0)
    assert grid[0] == 0
    assert grid[-1] < 6000
    steps = np.diff(np.append(grid, 6000.0)) / noise.sigma(grid)
    assert (steps < 0.13).all()
    for pixel, p in enumerate(density.density()):
        samples = block[:, pixel][np.isfinite(block[:, pixel])].astype(np.float64)
        # Every sample on this turn, the one before and the one after.
        images = np.concatenate([samples - 6000.0, samples, samples + 6000.0])
        np.testing.assert_allclose(p, 3 * naive.density(images, grid, noise), atol=1e-5 * p.max())


def test_on_a_circle_the_modes_agree_with_the_batch_search(rng: np.random.Generator) -> None:
    pixels = sized(200, 20)
    block = _folded_block(rng, 80, pixels)
    density = IncrementalDensity(CAMERA, pixels, unambiguous_range_mm=6000.0)
    density.add(block)
    modes = density.modes()
    samples, beam = sort_samples(block), beam_of(CAMERA, 6000.0)
    _, at_fold = unroll(samples, beam, 400.0, 6000.0)
    assert at_fold.all()
    batch = Kde().peaks(samples, beam)
    same = modes.found == batch.found
    # Two maxima, or a shoulder and a maximum, within a step; a height next to gamma.
    assert same.mean() > sized(0.96, 0.84)
    for pixel in np.flatnonzero(same):
        k = modes.found[pixel]
        place = fold(batch.place[pixel, :k], 6000.0)
        order = np.argsort(place)
        away = fold(modes.place[pixel, :k] - place[order] + 3000.0, 6000.0) - 3000.0
        assert (np.abs(away) < 0.1 * circular_noise(CAMERA, 6000.0).sigma(place[order])).all()
        np.testing.assert_allclose(modes.height[pixel, :k], batch.height[pixel, :k][order], rtol=0.05)


STRICT = 1e-9


@pytest.mark.parametrize("n", [5, 15, pytest.param(100, marks=pytest.mark.slow)])
def test_modes_equal_the_fine_grid_twin(n: int, rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    differing = 0
    for column in draw(rng, sensor, ranges_mm=[1200, 2000, 4000], shares=[0.2, 0.3, 0.5], n=n, pixels=sized(30, 15)).T:
        samples = column.astype(np.float64)
        expected = naive.peaks(samples, sensor.noise, gamma=0.02, step=0.02)
        found = find_modes(samples, sensor.noise, epsilon=STRICT)
        if len(found) == len(expected):
            assert np.all(np.abs(found - expected) < 0.1 * sensor.noise.sigma(expected))
        else:
            differing += 1
    # Two maxima closer than a step of the walk, or a height within rounding of gamma.
    assert differing <= 1


def test_one_lone_sample_is_no_peak(sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = [1000.0] * 10 + [4000.0]
    assert find_modes(samples, sensor.noise, epsilon=STRICT) == pytest.approx([1000.0], abs=0.1)


def test_gamma_is_the_least_share_of_a_surface(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = draw(rng, sensor, ranges_mm=[1000, 3000], shares=[0.9, 0.1], n=sized(5000, 1000), pixels=1)
    for gamma, peaks in ((0.05, 2), (0.2, 1)):
        places = find_modes(samples, sensor.noise, gamma=gamma, epsilon=STRICT)
        clusters = {round(place / 1000) for place in places}
        assert len(clusters) == peaks


def test_shoulders_are_peaks_for_a_large_epsilon_and_corners_of_a_curve_never() -> None:
    flat = NoiseCurve(np.array([0.0]), np.array([10.0]))
    # A tall and a low pile 1.3 sigma apart: one maximum with a shoulder.
    samples = np.concatenate([np.full(60, 1000.0), np.full(22, 1014.0)])
    assert len(find_modes(samples, flat, epsilon=1e-6)) == 1
    assert len(find_modes(samples, flat, epsilon=0.6)) == 2
    range_mm = np.linspace(900, 1100, 41)
    jagged = NoiseCurve(range_mm, np.tile([20.0, 23.0], 21)[:41])
    samples = 1000 + 20 * np.linspace(-2, 2, 401)
    assert len(find_modes(samples, jagged, epsilon=STRICT)) == 1


def test_modes_survive_any_place_and_more_peaks_than_kept(sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = np.repeat(np.linspace(-1e6, 1e6, 100), 3)
    places = find_modes(samples, sensor.noise, epsilon=STRICT, most=20)
    assert len(places) == 20
    assert np.all(np.diff(places) > 0)
