"""Numbers and latent states end where they are best together, whichever came first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, Record

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.parameters.standard_errors import numeric, standard_errors
from tofmix.reconciliation.search.name import TriedEffect, begin_trial, candidates
from tofmix.reconciliation.search.refit import numbers, refit
from tofmix.simulation.model import Model

HIDDEN = (
    MAKE["wiggling"](amplitude_mm=20.0, phase_rad=0.7),
    MAKE["fixed_pattern"](pixel_sigma_mm=2.0, column_sigma_mm=4.0, row_sigma_mm=1.0),
)

Found = tuple[dict[str, float], dict[str, float]]


def added(model: Model, evidence: Evidence, kinds: Sequence[str]) -> Found:
    """Numbers and errors of the wiggling, effects of these kinds added in this order."""
    likelihood = joint_likelihood([(model, evidence)])
    part = np.flatnonzero(likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])
    state, chosen = likelihood.start(), list[TriedEffect]()
    for kind in kinds:
        tried = candidates(begin_trial(likelihood, state, "frames,pixels", 1), (kind,))
        best = next(one for one in tried if not one.form)  # without harmonics
        state, chosen = refit(likelihood, best.state, [*chosen, best], part)
    errors = standard_errors(numbers(likelihood, state, chosen, part))
    place = kinds.index("wiggling")
    return numeric(chosen[place].effect), errors[place]


@pytest.mark.slow
@pytest.mark.parametrize(
    "flat",
    [
        pytest.param(False, id="a slanted wall"),
        pytest.param(True, id="three boards that face the camera"),
    ],
)
def test_wave_is_the_same_if_added_before_or_after_a_pattern(model: Model, record: Record, *, flat: bool) -> None:
    """Columns of 4 mm can absorb most of a wave over three boards; the refit corrects this."""
    surfaces = tuple(replace(s, yaw_deg=0.0 if flat else s.yaw_deg) for s in model.surfaces)
    scene = replace(model, surfaces=surfaces)
    evidence = record(*HIDDEN, of=scene)
    pattern_first, errors = added(scene, evidence, ("fixed_pattern", "wiggling"))
    wave_first, _ = added(scene, evidence, ("wiggling", "fixed_pattern"))
    for name, error in errors.items():
        assert abs(pattern_first[name] - wave_first[name]) < 0.2 * error
    assert abs(pattern_first["amplitude_mm"] - 20) < 3.5 * errors["amplitude_mm"]
    assert errors["amplitude_mm"] < 1.5
