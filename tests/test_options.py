"""Options that commands and Python functions share: one declaration each, whose bounds both keep."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import click
import pytest

from tofmix import options
from tofmix.cli.estimate import estimate
from tofmix.cli.reconcile import reconcile
from tofmix.errors import UsageError
from tofmix.estimation.peaks.counters import COUNTERS
from tofmix.estimation.settings import EstimateOptions
from tofmix.options import ESTIMATE, NOISE, RECONCILE, Option
from tofmix.reconciliation.search.search_state import Settings

CASES = [
    *((EstimateOptions, estimate, name, option) for name, option in ESTIMATE.items()),
    *((partial(Settings, kinds=()), reconcile, name, option) for name, option in RECONCILE.items()),
    *((COUNTERS[k], estimate, name, option) for k, rows in options.COUNTERS.items() for name, option in rows.items()),
]
each = pytest.mark.parametrize(("made", "command", "name", "option"), CASES, ids=[case[2] for case in CASES])


def _wrong(option: Option) -> list[Any]:
    """Values of another type, and values past each bound."""
    if option.is_flag:
        return ["yes", 1]
    if option.choices:
        return ["neither", 1]
    past: list[Any] = ["1", True, math.nan, math.inf] if not option.whole else ["1", True, 1.5]
    step = 1 if option.whole else 1e-9
    past += [option.low if option.low_open else option.low - step]
    return past + ([option.high if option.high_open else option.high + step] if math.isfinite(option.high) else [])


def _right(option: Option) -> list[Any]:
    """The default, and the bounds that are values."""
    if option.is_flag:
        return [False]
    if option.choices:
        return list(option.choices)
    kind = int if option.whole else float
    ends = [(option.low, option.low_open), (option.high, option.high_open)]
    return [option.default, *(kind(end) for end, is_open in ends if math.isfinite(end) and not is_open)]


@each
def test_settings_take_what_the_option_allows_and_refuse_the_rest(
    made: Callable[..., object], command: click.Command, name: str, option: Option
) -> None:
    assert getattr(made(), name) == option.default
    for value in _right(option):
        made(**{name: value})
    for value in _wrong(option):
        with pytest.raises((ValueError, UsageError), match=f"^{name}: "):
            made(**{name: value})
    assert name.removesuffix("_mm") in {parameter.name for parameter in command.params}


@each
def test_the_command_s_option_has_the_same_default_bounds_and_choices(
    made: Callable[..., object], command: click.Command, name: str, option: Option
) -> None:
    assert getattr(made(), name) == option.default
    own = next(p for p in command.params if isinstance(p, click.Option) and p.name == name.removesuffix("_mm"))
    if option.default is not None and not option.is_flag:
        assert own.default == option.default
    if option.choices:
        assert isinstance(own.type, click.Choice)
        assert tuple(own.type.choices) == option.choices
    elif not option.is_flag:
        assert isinstance(own.type, click.IntRange if option.whole else click.FloatRange)
        assert (own.type.min, own.type.min_open) == (option.low, option.low_open)
        assert own.type.max == (None if math.isinf(option.high) else option.high)
        assert own.type.max_open == option.high_open


def test_options_of_measured_noise_are_words_that_the_command_takes() -> None:
    of_command = {p.name: p for p in estimate.params}
    for name, option in NOISE.items():
        assert of_command[name].default == option.default
        assert option.refusal(name, "neither") == f"{name}: 'neither' is not one of {', '.join(option.choices)}"


@pytest.mark.parametrize(
    ("option", "bounds"),
    [
        (Option(help="", default=1, low=1, high=32), "1 to 32"),
        (Option(help="", default=1, low=0, low_open=True), "above 0"),
        (Option(help="", default=2, low=2), "at least 2"),
        (Option(help="", default=0.5, low=0, high=1, high_open=True), "in [0, 1)"),
        (Option(help="", default=0.5, low=0, high=1, low_open=True, high_open=True), "in (0, 1)"),
    ],
)
def test_bounds_are_told_in_words(option: Option, bounds: str) -> None:
    assert option.bounds == bounds
