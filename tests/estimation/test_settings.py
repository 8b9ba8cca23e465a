"""Bounds of the options, and the fixed part of equation (1)."""

from typing import Any

import pytest

from tofmix.estimation.peaks.counters import Kde
from tofmix.estimation.settings import EstimateOptions, SigmaMode


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_layers", 0),
        ("max_layers", 33),
        ("max_iter", 0),
        ("max_iter", 65536),
        ("tol", 0.0),
        ("tol", 1.0),
        ("min_samples", 1),
    ],
)
def test_options_out_of_bounds_are_named(name: str, value: float) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=name):
        EstimateOptions(**options)


def test_unknown_choice_is_refused_with_its_name_and_all_choices() -> None:
    assert EstimateOptions(sigma="tied").sigma is SigmaMode.TIED  # type: ignore[arg-type]  # the CLI passes text
    with pytest.raises(ValueError, match=r"^sigma: 'loose' is not one of tied, prior, free$"):
        EstimateOptions(sigma="loose")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^mixing: 'phaser' is not one of auto, events, phasor$"):
        EstimateOptions(mixing="phaser")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "refusal"),
    [
        ("max_layers", 2.5, "max_layers: 2.5 is not a whole number"),
        ("max_iter", 10.5, "max_iter: 10.5 is not a whole number"),
        ("min_samples", True, "min_samples: True is not a whole number"),
        ("tol", "x", "tol: 'x' is not a number"),
        ("false_alarm", "0.1", "false_alarm: '0.1' is not a number"),
        ("paper", "no", "paper: 'no' is neither True nor False"),
        ("counter", "cpdf", r"counter: 'cpdf' is not one of .*Cpdf\(\).*, of tofmix.estimation.peaks.counters"),
    ],
)
def test_option_of_another_type_is_refused_by_name(name: str, value: object, refusal: str) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=f"^{refusal}$"):
        EstimateOptions(**options)


def test_as_dict_names_every_option() -> None:
    options = EstimateOptions(counter=Kde(gamma=0.1)).as_dict()
    assert (options["counter"], options["gamma"], options["sigma"]) == ("kde", 0.1, "prior")
