"""Errors of parameters against closed forms: a bent likelihood has the profile that geometry says."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from support.recordings import MAKE

from tofmix.arrays import FloatArray
from tofmix.reconciliation.parameters.fits import Fitted
from tofmix.reconciliation.parameters.standard_errors import ProfiledParameter, parabola_error, stretch
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.search import Problem


def parameter(
    name: str, make: Callable[[FloatArray], Effect], vector: FloatArray, steps: FloatArray
) -> ProfiledParameter:
    problem = Problem(make=make, starts=(tuple(vector),), steps=tuple(steps))
    fitted = Fitted(effect=make(vector), vector=vector, problem=problem)
    return ProfiledParameter(name=name, fitted=fitted, own=slice(0, vector.size), steps=steps)


def polar(x: FloatArray) -> Effect:
    return MAKE["wiggling"](amplitude_mm=math.hypot(x[0], x[1]), phase_rad=math.atan2(x[1], x[0]))


def exponential(x: FloatArray) -> Effect:
    return MAKE["excess_noise"](factor=math.exp(x[0]))


def offset(x: FloatArray) -> Effect:
    return MAKE["range_offset"](offset_mm=float(x[0]))


@pytest.mark.parametrize("step", [0.05, 2.0])
def test_error_of_a_gaussian_mean_is_its_standard_deviation(step: float) -> None:
    """Whatever the step in which the covariance is given."""
    of = parameter("offset_mm", offset, np.array([3.0]), np.array([step]))
    covariance = np.array([[(0.7 / step) ** 2]])
    assert parabola_error(of, covariance) == pytest.approx(0.7, rel=1e-9)
    assert stretch(of, covariance, lambda move: -0.5 * (move[0] * step / 0.7) ** 2) == 1.0


@pytest.mark.parametrize("turn", [0.0, 1.2, math.pi, -2.9])
@pytest.mark.parametrize("sigma", [0.2, 0.4])
def test_error_in_polar_numbers_is_that_of_the_profile(turn: float, sigma: float) -> None:
    """A round Gaussian about a point at distance 2, in polar numbers: radii to +-2 sigma, angles to asin(sigma)."""
    vector = 2.0 * np.array([math.cos(turn), math.sin(turn)])
    steps = np.array([0.1, 0.3])
    covariance = np.diag((sigma / steps) ** 2)
    radius, angle = (parameter(name, polar, vector, steps) for name in ("amplitude_mm", "phase_rad"))
    assert parabola_error(radius, covariance) == pytest.approx(sigma, rel=1e-3)
    assert parabola_error(angle, covariance) == pytest.approx(math.asin(sigma) / 2, rel=0.03)
    assert math.asin(sigma) / 2 > sigma / 2  # the error by the slope alone


def test_error_of_an_exponential_is_the_mean_of_both_sides() -> None:
    of = parameter("factor", exponential, np.array([0.2]), np.array([0.1]))
    wanted = math.exp(0.2) * math.sinh(2 * 0.3) / 2
    assert parabola_error(of, np.array([[9.0]])) == pytest.approx(wanted, rel=1e-9)


def test_error_beside_a_bound_is_that_of_the_other_side() -> None:
    def bounded(x: FloatArray) -> Effect:
        if x[0] < 3.0:
            raise ValueError("out of bounds")
        return offset(x)

    of = parameter("offset_mm", bounded, np.array([3.1]), np.array([0.05]))
    assert parabola_error(of, np.array([[100.0]])) == pytest.approx(0.5, rel=1e-9)


def test_error_along_a_bent_ridge_is_that_of_the_profile() -> None:
    """One wide by 3 (quartic, so narrower than its curvature says), one narrow about x * x / 10: the profile of x."""

    def value(move: FloatArray) -> float:
        x, y = move
        return float(-0.5 * (x / 3.0) ** 2 - 0.02 * x**4 - 0.5 * ((y - x * x / 10) / 0.2) ** 2)

    def profile(x: float) -> float:
        best = minimize_scalar(lambda y: -value(np.array([x, y])), bounds=(-9.0, 9.0), method="bounded")
        return float(best.fun) - 2.0

    of = parameter("offset_mm", offset, np.zeros(2), np.ones(2))
    covariance = np.diag([9.0, 0.04])
    found = parabola_error(of, covariance) * stretch(of, covariance, value)
    assert parabola_error(of, covariance) == pytest.approx(3.0, rel=1e-9)
    assert found == pytest.approx(brentq(profile, 0.0, 20.0) / 2, rel=0.06)
