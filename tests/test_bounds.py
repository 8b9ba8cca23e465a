"""Bounds of settings: every class of settings refuses each field's values out of bounds, and takes those within."""

import ast
import inspect
import math
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import tofmix
from tofmix.bounds import (
    Bounds,
    Count,
    Declared,
    Factor,
    Finite,
    Share,
    check_ascending,
    check_bounds,
    checked,
    declared,
)
from tofmix.errors import UsageError
from tofmix.estimation.filters import FilterSettings
from tofmix.estimation.noise.curve_check import CurveTolerances
from tofmix.estimation.noise.settings import AmplitudeSettings, CurveSettings, NoiseSettings, OutlierSettings
from tofmix.io.guard.structure_rules import Limits
from tofmix.report.explorer.packing import PageLimits
from tofmix.report.summary.thresholds import Thresholds
from tofmix.surfaces.settings import BrightnessSettings, EdgeSettings, LinkSettings, ShareSettings, SurfaceSettings
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


def _ascending(low: float, high: float, count: int) -> list[float]:
    """Values from one end to the other; a step of 1 takes the place of an end that is infinite."""
    first = low if math.isfinite(low) else min(high, 0.0) - count if math.isfinite(high) else -1.0
    last = high if math.isfinite(high) else first + count - 1
    return [float(value) for value in np.linspace(first, last, count)]


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
def test_tuples_take_the_ends_of_their_bounds_also_as_numpy_scalars(settings: type) -> None:
    for name, field, bounds in _numbers(settings):
        if not field.is_tuple:
            continue
        for kind in (field.kind, np.dtype(field.kind).type):
            values = tuple(map(kind, _ascending(bounds.low, bounds.high, field.length or 3)))
            assert getattr(_made(settings, **{name: values}), name) == values


@each_class
def test_tuples_of_another_length_are_refused(settings: type) -> None:
    made = _made(settings)
    for name, field in declared(settings).items():
        values = getattr(made, name)
        for wrong in () if field.length is None else (values[:-1], (*values, values[-1] + 1), ()):
            with pytest.raises(UsageError) as refusal:
                _made(settings, **{name: wrong})
            assert str(refusal.value) == f"{settings.__name__}: {name} is {wrong!r}; give {field.length} values"


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


@pytest.mark.parametrize("settings", [LinkSettings, ShareSettings, EdgeSettings, SurfaceSettings, NeighbourSettings])
def test_the_signature_of_a_checked_tuple_shows_its_fields(settings: Any) -> None:  # noqa: ANN401  a named tuple
    parameters = inspect.signature(settings).parameters
    assert tuple(parameters) == settings._fields
    assert [parameter.default for parameter in parameters.values()] == list(settings())


def test_a_checked_tuple_stays_one() -> None:
    small = checked(Small)
    made = small(0.25, number=2)
    assert made == (0.25, 2, 1.0, -3.0)
    assert made._replace(slope=-1e300).slope == -1e300
    with pytest.raises(UsageError, match=r"Small: share is 1\.5; give a number from 0 to 1"):
        made._replace(share=1.5)
    with pytest.raises(UsageError, match=r"Small: number is 0; give a whole number of at least 1"):
        small(0.5, 0)
    with pytest.raises(UsageError, match=r"Small: slope is -inf; give a number that is finite"):
        small(slope=-math.inf)


@dataclass(frozen=True)
class Ordered:
    """Ascending values."""

    values: tuple[float, ...] = (1.0, 2.0)


def test_order_is_checked() -> None:
    check_bounds(Ordered())
    check_ascending(Ordered(), "values")
    check_ascending(Ordered(values=()), "values")
    with pytest.raises(UsageError, match="values is"):
        check_ascending(Ordered(values=(1.0, 1.0)), "values")
