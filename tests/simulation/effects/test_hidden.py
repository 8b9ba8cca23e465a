"""What effects declare of their hidden states, and of the errors of every model."""

import pytest

from tofmix.simulation.effects import EFFECTS, Effect, basic_kind
from tofmix.simulation.effects.base import Basic, Latent
from tofmix.simulation.effects.hidden import (
    AffectedPixels,
    DisturbedFrames,
    PixelBias,
    PixelValue,
    RangeStep,
    RememberedNoise,
)

LATENT = {
    DisturbedFrames: Latent.FRAME,
    PixelBias: Latent.PIXEL,
    PixelValue: Latent.PIXEL,
    AffectedPixels: Latent.PIXEL,
    RememberedNoise: Latent.MEMORY,
    RangeStep: Latent.STEP,
}


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=EFFECTS)
def test_hidden_state_is_declared_with_numbers_of_the_effect(kind: type[Effect]) -> None:
    if kind.hidden is None:
        assert kind.latent is Latent.NONE
        return
    assert kind.latent is LATENT[type(kind.hidden)]
    assert set(kind.hidden.numbers) <= set(kind.parameters())


@pytest.mark.parametrize("kind", [k for k in EFFECTS.values() if k.hidden and k.hidden.numbers], ids=lambda k: k.kind)
def test_effect_of_a_hidden_state_has_its_numbers(kind: type[Effect]) -> None:
    assert kind.hidden is not None
    values = [0.5 + 0.1 * k for k in range(len(kind.hidden.numbers))]
    if isinstance(kind.hidden, DisturbedFrames):
        values[2] = 3.0  # a burst lasts a frame at least
    made = kind.hidden.made(kind, values)
    assert kind.hidden.values(made) == pytest.approx(values)
    others = [0.9 * value for value in values]
    assert kind.hidden.values(kind.hidden.changed(made, others)) == pytest.approx(others)


@pytest.mark.parametrize("error", Basic)
def test_one_kind_describes_each_error_of_every_model(error: Basic) -> None:
    assert [kind for kind in EFFECTS.values() if kind.basic is error] == [basic_kind(error)]


@pytest.mark.parametrize(
    ("error", "name", "value"),
    [(Basic.OFFSET, "offset_mm", 7.0), (Basic.NOISE, "factor", 1.2), (Basic.POSE, "shift_mm", -3.0)],
)
def test_effect_of_a_magnitude_has_it_in_its_first_number_that_can_be_nothing(
    error: Basic, name: str, value: float
) -> None:
    made = basic_kind(error).of_magnitude(value, surface="wall" if error is Basic.POSE else "")
    assert getattr(made, name) == value
    assert getattr(made, "surface", "") == ("wall" if error is Basic.POSE else "")
