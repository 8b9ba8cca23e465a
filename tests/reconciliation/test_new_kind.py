"""A kind that nothing but the registry knows is searched for, named, and told from others."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects import EFFECTS, Effect, Level
from tofmix.simulation.effects.base import Context, Target
from tofmix.simulation.effects.parameter import number
from tofmix.simulation.effects.search import has_form
from tofmix.simulation.model import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class Slant(Effect):
    """Columns that are read later have longer ranges."""

    kind: ClassVar[str] = "slant"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias against column"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")

    slope_mm: float = number("Over the image.", unit="mm", low=-500, high=500, zero=0, typical=(2, 50))

    def act(self, echoes: Echoes, context: Context) -> None:
        column = np.arange(echoes.shape[-1]) % context.sensor.cols / context.sensor.cols - 0.5
        echoes.add_bias(self.slope_mm * column)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hiss(Effect):
    """Noise whose growth with the range bends, by two numbers."""

    kind: ClassVar[str] = "hiss"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "spread against range"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("spread",)

    factor: float = number("At 1 m.", unit="1", low=0.1, high=10, zero=1, typical=(1.1, 3))
    exponent: float = number("Of the range in m.", unit="1", low=-4, high=4, typical=(0.2, 2))

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        echoes.scale_sigma(self.factor * np.maximum(echoes.range_mm / 1000, 0.1) ** self.exponent)


@dataclass(frozen=True, slots=True, kw_only=True)
class Dusk(Effect):
    """Noise that changes steadily while it is recorded."""

    kind: ClassVar[str] = "dusk"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "spread against time"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("spread",)
    changes_in_time: ClassVar[bool] = True

    growth_per_s: float = number("Of the noise.", unit="1/s", low=-0.1, high=10, zero=0, typical=(0.02, 0.5))

    def act(self, echoes: Echoes, context: Context) -> None:
        echoes.scale_sigma(1.0 + self.growth_per_s * context.time_s)


@pytest.fixture
def kinds(monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """Some kinds, with three that have nothing but their line in the registry."""
    monkeypatch.setitem(EFFECTS, "slant", Slant)
    monkeypatch.setitem(EFFECTS, "hiss", Hiss)
    monkeypatch.setitem(EFFECTS, "dusk", Dusk)
    return ("slant", "hiss", "dusk", "range_offset", "excess_noise", "surface_pose")


@pytest.mark.parametrize(
    ("hidden", "values"),
    [
        (Slant(slope_mm=-30.0), {"slope_mm": -30.0}),
        (Hiss(factor=1.2, exponent=0.4), {"factor": 1.2, "exponent": 0.4}),
        pytest.param(Dusk(growth_per_s=0.2), {"growth_per_s": 0.2}, marks=pytest.mark.slow),
    ],
    ids=["slant", "hiss", "dusk"],
)
def test_registered_kind_is_found_with_its_numbers(
    small: Model, kinds: tuple[str, ...], hidden: Effect, values: dict[str, float]
) -> None:
    result = reconcile(small, recorded(small, hidden), Settings(kinds=kinds))
    assert (result.verified.verdict, sorted(n.effect.kind for n in result.named)) == ("explained", [hidden.kind])
    for name, value in values.items():
        assert getattr(result.named[0].effect, name) == pytest.approx(value, abs=4 * result.named[0].stderr[name])


@pytest.mark.slow
def test_registered_kind_that_moves_samples_is_among_the_sets(small: Model, kinds: tuple[str, ...]) -> None:
    assert has_form(Slant)
    hidden = Slant(slope_mm=-30.0), MAKE["range_offset"](offset_mm=12.0)
    result = reconcile(small, recorded(small, *hidden), Settings(kinds=kinds))
    assert sorted(n.effect.kind for n in result.named) == ["range_offset", "slant"]


def test_all_registered_kinds_are_tried() -> None:
    assert set(KINDS) == set(EFFECTS)
