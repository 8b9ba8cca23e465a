"""Bounds of settings, options, tables, errors and words."""

import ast
import math
from collections.abc import Callable
from dataclasses import is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pytest

import tofmix
from tofmix import options
from tofmix.bounds import (
    Bounds,
    Count,
    Declared,
    Factor,
    Finite,
    Share,
    declared,
)
from tofmix.cli.estimate import estimate
from tofmix.cli.reconcile import reconcile
from tofmix.errors import (
    EXIT_CODE_MEANINGS,
    BadInputError,
    ExitCode,
    StorageError,
    TofmixError,
    UsageError,
    os_error_text,
)
from tofmix.estimation.filters import FilterSettings
from tofmix.estimation.noise.curve import AmplitudeSettings, CurveSettings, NoiseSettings, OutlierSettings
from tofmix.estimation.noise.curve_check import CurveTolerances
from tofmix.estimation.peaks.counters import COUNTERS
from tofmix.estimation.settings import EstimateOptions
from tofmix.io.guard.structure_rules import Limits
from tofmix.options import ESTIMATE, NOISE, RECONCILE, Option
from tofmix.reconciliation.settings import Settings
from tofmix.report.explorer import PageLimits
from tofmix.report.summary.findings import Thresholds
from tofmix.surfaces.settings import BrightnessSettings, EdgeSettings, LinkSettings, ShareSettings, SurfaceSettings
from tofmix.toml_table import nearest, parse_toml
from tofmix.unmixing.settings import (
    CurvedSettings,
    HypothesisSettings,
    ImageSettings,
    LabelSettings,
    LawSettings,
    NeighbourSettings,
    PlaneSettings,
    SeedSettings,
    UnfoldingSettings,
    UnmixSettings,
)
from tofmix.wording import counted, finite_or_none, number, rounded

CLASSES: tuple[type, ...] = (
    AmplitudeSettings,
    CurveSettings,
    CurveTolerances,
    NoiseSettings,
    OutlierSettings,
    Limits,
    PageLimits,
    CurvedSettings,
    Thresholds,
    BrightnessSettings,
    EdgeSettings,
    FilterSettings,
    LinkSettings,
    ShareSettings,
    SurfaceSettings,
    HypothesisSettings,
    ImageSettings,
    LabelSettings,
    LawSettings,
    NeighbourSettings,
    PlaneSettings,
    SeedSettings,
    UnfoldingSettings,
    UnmixSettings,
)
WITH_A_CHECK_OF_THEIR_OWN = {"RecordingSettings", "Settings"}
"""Settings of a model file, whose refusals name its keys, and of a reconciliation, whose bounds are in `options`."""


def _made(settings: type, **values: Any) -> Any:  # noqa: ANN401  of any class
    return settings(**values)


def _changed(made: Any, **values: Any) -> Any:  # noqa: ANN401  of any class
    change = replace if is_dataclass(made) else type(made)._replace
    return change(made, **values)


def _outside(kind: type, bounds: Bounds) -> list[Any]:
    """Values that a field must refuse."""
    step = 1 if kind is int else 1e-9
    wrong: list[Any] = [math.nan, -math.inf, "1", None, True] + [math.inf] * (not bounds.infinite)
    if kind is int:
        wrong.append(bounds.low + 0.5)
    for end, outward in ((bounds.low, -step), (bounds.high, step)):
        if math.isfinite(end):
            wrong.append(kind(end) if bounds.inside else kind(end) + outward)
    return wrong


each_class = pytest.mark.parametrize(
    "settings", CLASSES, ids=lambda settings: f"{settings.__module__}.{settings.__name__}"
)


def _numbers(settings: type) -> list[tuple[str, Declared, Bounds]]:
    """Each number, or tuple of numbers, by name."""
    return [(name, field, field.bounds) for name, field in declared(settings).items() if field.bounds is not None]


@each_class
def test_values_out_of_bounds_are_refused_with_field_value_and_remedy(settings: type) -> None:
    made = _made(settings)
    for name, field, bounds in _numbers(settings):
        for value in _outside(field.kind, bounds):
            wrong = (value, *getattr(made, name)[1:]) if field.is_tuple else value
            with pytest.raises(UsageError) as refusal:
                _made(settings, **{name: wrong})
            assert str(refusal.value).startswith(f"{settings.__name__}: {name} is {wrong!r}; give a") or field.is_tuple
            assert str(bounds) in str(refusal.value)
            with pytest.raises(UsageError):
                _changed(made, **{name: wrong})


@each_class
def test_ends_of_the_bounds_are_taken(settings: type) -> None:
    for name, field, bounds in _numbers(settings):
        if field.is_tuple:
            continue
        for end in (bounds.low, bounds.high):
            if (math.isfinite(end) and not bounds.inside) or (end == math.inf and bounds.infinite):
                assert getattr(_made(settings, **{name: field.kind(end)}), name) == end
        near = field.kind(getattr(_made(settings), name))
        assert getattr(_made(settings, **{name: np.dtype(field.kind).type(near)}), name) == near


@each_class
def test_every_number_has_bounds(settings: type) -> None:
    without = [
        name for name, field in declared(settings).items() if field.bounds is None and field.kind in (int, float)
    ]
    assert not without


@each_class
def test_a_value_of_another_type_is_refused(settings: type) -> None:
    for name in declared(settings):
        with pytest.raises(UsageError, match=f"{name} is 3.5j; give"):
            _made(settings, **{name: 3.5j})


def test_every_class_of_settings_is_checked() -> None:
    found = {
        node.name
        for module in Path(tofmix.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(module.read_text()))
        if isinstance(node, ast.ClassDef) and node.name.endswith(("Settings", "Limits", "Tolerances"))
    }
    assert len(found) > 15
    assert found - {settings.__name__ for settings in CLASSES} == WITH_A_CHECK_OF_THEIR_OWN


@pytest.mark.parametrize(
    ("settings", "values", "reason"),
    [
        (CurveSettings, {"slopes": (4.0, -1.0)}, r"slopes is \(4.0, -1.0\); give ascending values"),
        (AmplitudeSettings, {"exponents": (2.0, 2.0)}, "exponents is .* give ascending values"),
        (AmplitudeSettings, {"pieces": (1, 3, 2)}, "pieces is .* give ascending values"),
        (AmplitudeSettings, {"ends": (0.9, 0.1)}, "ends is .* give ascending values"),
        (AmplitudeSettings, {"pieces": [1, 2]}, r"pieces is \[1, 2\]; give a tuple"),
        (CurveSettings, {"slopes": (1.0,)}, r"slopes is \(1.0,\); give 2 values"),
        (LinkSettings, {"sweeps": 4.0}, r"sweeps is 4.0; give a whole number of at least 0"),
        (
            Thresholds,
            {"scatter_factor": -math.inf},
            "scatter_factor is -inf; give a number of at least 1, or inf",
        ),
        (UnmixSettings, {"law": LabelSettings()}, "law is .* give values of LawSettings"),
        (SurfaceSettings, {"edge": LinkSettings()}, "edge is .* give values of EdgeSettings"),
    ],
)
def test_values_that_do_not_go_together_are_refused(settings: type, values: dict[str, Any], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        _made(settings, **values)


class Small(NamedTuple):
    """A tuple with each kind of bounds."""

    share: Share = 0.5
    number: Count = 1
    factor: Factor = 1.0
    slope: Finite = -3.0


@pytest.mark.parametrize(
    ("settings", "name", "off"),
    [
        (Thresholds, "scatter_factor", math.inf),
        (SeedSettings, "unlike_sigmas", math.inf),
        (LawSettings, "most_error", np.float32(math.inf)),
        (EdgeSettings, "corner_gain", math.inf),
        (EdgeSettings, "most_edges", 0),
        (LinkSettings, "sweeps", 0),
        (LabelSettings, "rounds", 0),
        (PlaneSettings, "tries", 0),
    ],
)
def test_a_threshold_or_a_loop_can_be_off(settings: type, name: str, off: float) -> None:
    assert getattr(_made(settings, **{name: off}), name) == off


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


TABLE = parse_toml("a = true\nb = ['x', 'y']\nc = 1\nd = 'long " + "x" * 90 + "'", source="f")


def test_tables_are_read_by_type_and_refuse_wrong_ones_in_short() -> None:
    assert TABLE.boolean("a") is True
    assert TABLE.texts("b") == ("x", "y")
    with pytest.raises(BadInputError, match=r"^f: c: expected true or false, got a whole number, 1$"):
        TABLE.boolean("c")
    with pytest.raises(BadInputError, match=r"^f: a: expected a list of strings, got a boolean, true$"):
        TABLE.texts("a")
    with pytest.raises(BadInputError, match=r"^f: z: missing$"):
        TABLE.text("z")
    with pytest.raises(BadInputError) as caught:
        TABLE.number("d")
    assert len(str(caught.value)) < 110
    assert nearest("zzz", ["b", "a"]) == "; known: a, b"
    assert nearest("bb", ["b", "a"]) == '; did you mean "b"? known: a, b'


@pytest.mark.parametrize("text", ["a." * 20_000 + "a = 1", "a = 1 # " + "x" * 5000, "a = 1\n" * 200_000])
def test_texts_that_no_person_writes_are_refused_before_they_are_parsed(text: str) -> None:
    with pytest.raises(BadInputError, match=r"m\.toml: .* are read"):
        parse_toml(text, source="m.toml")


@pytest.mark.parametrize(("kind", "code"), [(UsageError, 2), (BadInputError, 3), (StorageError, 4)])
def test_exit_codes_have_the_values_of_the_contract(kind: type[TofmixError], code: int) -> None:
    assert kind("x").exit_code == code


def test_exit_codes_have_meanings_and_os_errors_words() -> None:
    assert set(EXIT_CODE_MEANINGS) == set(ExitCode)
    assert os_error_text(FileNotFoundError(2, "No such file or directory"), "a.h5") == "a.h5: No such file or directory"
    assert os_error_text(OSError("odd"), "a.h5") == "a.h5: odd"


PACKAGE = Path(__file__).parents[1] / "tofmix"


def test_numbers_are_written_with_their_nouns_and_rounded() -> None:
    assert [counted(n, "pixel") for n in (0, 1, 2)] == ["0 pixels", "1 pixel", "2 pixels"]
    assert counted(25344, "pixel", ",") == "25,344 pixels"
    assert number(None, ".2f") == "-"
    assert number(None, missing="none") == "none"
    assert number(0, ",") == "0"
    assert [finite_or_none(value) for value in (math.nan, math.inf, 1.5, "nan", 2)] == [None, None, 1.5, "nan", 2]
    assert rounded(1.23456789) == 1.23457
    assert rounded(1234.5, 2) == 1200.0
    assert math.copysign(1.0, rounded(-0.0)) == 1.0
