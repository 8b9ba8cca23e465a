"""Effects that no longer gain in the presence of later ones are removed; the others stay."""

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.search.drop import drop
from tofmix.reconciliation.search.name import begin_trial, candidates
from tofmix.reconciliation.search.refit import begin, refit
from tofmix.reconciliation.search.search_state import SearchState, Settings, fit_part
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

WAVE = MAKE["wiggling"](amplitude_mm=12.0, phase_rad=0.7)
COLUMNS = MAKE["fixed_pattern"](pixel_sigma_mm=2.0, column_sigma_mm=10.0, row_sigma_mm=2.0)
OFFSET = MAKE["range_offset"](offset_mm=6.0)
NOISE = MAKE["excess_noise"](factor=1.3)
LARGE, LITTLE = MAKE["wiggling"](amplitude_mm=60.0, phase_rad=0.7), MAKE["excess_noise"](factor=1.05)


def added(model: Model, hidden: tuple[Effect, ...], kinds: tuple[str, ...]) -> SearchState:
    """Effects of some kinds, of all surfaces, added in that order, whatever they gain, to the model of a recording."""
    likelihood, settings = joint_likelihood([(model, recorded(model, *hidden))]), Settings(kinds=kinds)
    part = fit_part(likelihood, settings)
    search = SearchState(likelihood, settings, lambda _: None, begin(likelihood, part[0], settings.tolerance))
    for kind in kinds:
        found = candidates(begin_trial(likelihood, search.state, settings.split, settings.seed), (kind,))
        candidate = next(c for c in found if not getattr(c.effect, "surface", ""))
        search.state = candidate.state
        search.chosen.append(candidate)
        search.rivals.append(())
        search.state, search.chosen = refit(likelihood, search.state, search.chosen, part)
    return search


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
)
def test_effect_that_is_not_hidden_is_dropped_and_others_are_kept(
    model: Model, small: Model, hidden: tuple[Effect, ...], kinds: tuple[str, ...], kept: list[str]
) -> None:
    search = added(model if LITTLE in hidden else small, hidden, kinds)
    drop(search)
    assert [c.kind for c in search.chosen] == kept
    assert [e.kind for e in search.state.effects] == kept
    assert len(search.rivals) == len(kept)
    assert bool(np.any(search.state.pixel_bias)) == ("fixed_pattern" in kept)
