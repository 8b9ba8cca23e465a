"""What was added is dropped where it earns nothing beside what came since; what is there stays."""

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.drop import drop
from tofmix.reconciliation.joint import joint_likelihood
from tofmix.reconciliation.name import begin_trial, candidates
from tofmix.reconciliation.refit import begin, refit
from tofmix.reconciliation.way import Settings, Way, fit_part
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

WAVE = MAKE["wiggling"](amplitude_mm=12.0, phase_rad=0.7)
COLUMNS = MAKE["fixed_pattern"](pixel_sigma_mm=2.0, column_sigma_mm=10.0, row_sigma_mm=2.0)
OFFSET = MAKE["range_offset"](offset_mm=6.0)
NOISE = MAKE["excess_noise"](factor=1.3)
LARGE, LITTLE = MAKE["wiggling"](amplitude_mm=60.0, phase_rad=0.7), MAKE["excess_noise"](factor=1.05)


def added(model: Model, hidden: tuple[Effect, ...], kinds: tuple[str, ...]) -> Way:
    """Effects of some kinds, added in that order, whatever they gain, to the model of a recording."""
    likelihood, settings = joint_likelihood([(model, recorded(model, *hidden))]), Settings(kinds=kinds)
    part = fit_part(likelihood, settings)
    way = Way(likelihood, settings, lambda _: None, begin(likelihood, part[0], settings.tolerance))
    for kind in kinds:
        (candidate,) = candidates(begin_trial(likelihood, way.state, settings.split, settings.seed), (kind,))
        way.state = candidate.state
        way.chosen.append(candidate)
        way.rivals.append(())
        way.state, way.chosen = refit(likelihood, way.state, way.chosen, part)
    return way


@pytest.mark.parametrize(
    ("hidden", "kinds", "kept"),
    [
        ((WAVE,), ("fixed_pattern", "wiggling"), ["wiggling"]),
        ((WAVE, COLUMNS), ("fixed_pattern", "wiggling"), ["fixed_pattern", "wiggling"]),
        ((COLUMNS,), ("fixed_pattern", "range_offset"), ["fixed_pattern"]),
        ((COLUMNS,), ("range_offset", "fixed_pattern"), ["fixed_pattern"]),
        ((OFFSET,), ("range_offset", "excess_noise"), ["range_offset"]),
        ((OFFSET, NOISE), ("excess_noise", "range_offset"), ["excess_noise", "range_offset"]),
        ((OFFSET, LITTLE), ("excess_noise", "range_offset"), ["excess_noise", "range_offset"]),
        ((LARGE, LITTLE), ("excess_noise", "wiggling"), ["wiggling"]),  # faint beside the wave
    ],
)  # fmt: skip
def test_effect_that_is_not_hidden_is_dropped_and_others_are_kept(
    model: Model, small: Model, hidden: tuple[Effect, ...], kinds: tuple[str, ...], kept: list[str]
) -> None:
    way = added(model if LITTLE in hidden else small, hidden, kinds)
    drop(way)
    assert [c.kind for c in way.chosen] == kept
    assert [e.kind for e in way.state.effects] == kept
    assert len(way.rivals) == len(kept)
    assert bool(np.any(way.state.pixel_bias)) == ("fixed_pattern" in kept)
