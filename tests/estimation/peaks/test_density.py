"""Equation (4) against SciPy's normal density, and as a density."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import trapezoid
from support import naive

from tofmix.estimation.beam import sigma_at
from tofmix.estimation.peaks.density import density
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


def test_density_refuses_no_samples() -> None:
    with pytest.raises(ValueError, match="none is finite"):
        density([np.nan], [1.0], CURVE)


@given(range_mm=st.floats(-1e4, 2e4))
def test_sigma_at_equals_interp(range_mm: float) -> None:
    expected = np.interp(range_mm, CURVE.range_mm, CURVE.sigma_mm)
    assert sigma_at(range_mm, CURVE.range_mm, CURVE.sigma_mm) == pytest.approx(expected, rel=1e-12)
