"""Bounds of the options, and the fixed part of equation (1)."""

from typing import Any

import pytest

from tofmix.estimation.peaks.counters import Kde
from tofmix.estimation.settings import EstimateOptions, SigmaMode


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_layers", 0), ("max_layers", 33),
        ("max_iter", 0), ("max_iter", 65536), ("tol", 0.0), ("tol", 1.0),
        ("min_samples", 1),
    ],
)  # fmt: skip
def test_options_out_of_bounds_are_named(name: str, value: float) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=name):
        EstimateOptions(**options)


def test_unknown_sigma_mode_is_refused() -> None:
    assert EstimateOptions(sigma="tied").sigma is SigmaMode.TIED  # type: ignore[arg-type]  # the CLI passes text
    with pytest.raises(ValueError, match="loose"):
        EstimateOptions(sigma="loose")  # type: ignore[arg-type]


def test_as_dict_names_every_option() -> None:
    options = EstimateOptions(counter=Kde(gamma=0.1)).as_dict()
    assert (options["counter"], options["gamma"], options["sigma"]) == ("kde", 0.1, "prior")
