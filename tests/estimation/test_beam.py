"""The fixed part of equation (1)."""

from dataclasses import replace

import numpy as np
import pytest

from tofmix.estimation.beam import beam_of
from tofmix.sensor import NoiseCurve, Sensor


def test_beam_spreads_outliers_over_the_working_range(sensor: Sensor) -> None:
    assert beam_of(sensor).outlier_density == pytest.approx(1e-4 / 5700)
    assert beam_of(sensor).no_return_from == 6000 - 2 * 200


def test_beam_without_an_end_spreads_them_over_the_curve(sensor: Sensor) -> None:
    beam = beam_of(replace(sensor, range_max_mm=None))
    assert beam.range_max == np.inf
    assert beam.outlier_density == pytest.approx(1e-4 / 5700)


def test_beam_refuses_a_sensor_without_a_curve_or_with_an_empty_interval(sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="noise curve"):
        beam_of(replace(sensor, noise=None))
    short = NoiseCurve(np.array([100.0]), np.array([5.0]))
    with pytest.raises(ValueError, match="not below"):
        beam_of(replace(sensor, range_max_mm=None, noise=short))


def test_outliers_of_probability_zero_still_have_a_likelihood(sensor: Sensor) -> None:
    beam = beam_of(replace(sensor, outlier_probability=0.0))
    assert beam.p_outlier == 0
    assert beam.outlier_density > 0
