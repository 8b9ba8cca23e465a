"""Bounds of the options, and the fixed part of equation (1)."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tofmix.estimation.settings import EstimateOptions, SigmaMode, beam_of
from tofmix.sensor import NoiseCurve, Sensor


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_layers", 0), ("max_layers", 33), ("gamma", -0.1), ("gamma", 1.0), ("gamma", float("nan")),
        ("epsilon", 0.0), ("epsilon", float("inf")), ("max_iter", 0), ("max_iter", 65536), ("tol", 0.0), ("tol", 1.0),
        ("min_samples", 1),
    ],
)  # fmt: skip
def test_options_out_of_bounds_are_named(name: str, value: float) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=name):
        EstimateOptions(**options)


def test_sigma_is_one_of_three() -> None:
    assert EstimateOptions(sigma="tied").sigma is SigmaMode.TIED  # type: ignore[arg-type]  # the CLI passes text
    with pytest.raises(ValueError, match="loose"):
        EstimateOptions(sigma="loose")  # type: ignore[arg-type]


def test_as_dict_names_every_option() -> None:
    assert EstimateOptions(**EstimateOptions(gamma=0.1).as_dict()).gamma == 0.1  # type: ignore[arg-type]


def test_beam_spreads_outliers_over_the_working_range(sensor: Sensor) -> None:
    assert beam_of(sensor).outlier_density == pytest.approx(1e-4 / 5700)
    assert beam_of(sensor).no_return_from == 6000 - 2 * 200


def test_beam_without_an_end_spreads_them_over_the_curve(sensor: Sensor) -> None:
    beam = beam_of(replace(sensor, range_max_mm=None))
    assert beam.range_max == np.inf
    assert beam.outlier_density == pytest.approx(1e-4 / 5700)


def test_beam_refuses_what_it_cannot_use(sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="noise curve"):
        beam_of(replace(sensor, noise=None))
    short = NoiseCurve(np.array([100.0]), np.array([5.0]))
    with pytest.raises(ValueError, match="not below"):
        beam_of(replace(sensor, range_max_mm=None, noise=short))


def test_outliers_of_probability_zero_still_have_a_likelihood(sensor: Sensor) -> None:
    beam = beam_of(replace(sensor, outlier_probability=0.0))
    assert beam.p_outlier == 0
    assert beam.outlier_density > 0
