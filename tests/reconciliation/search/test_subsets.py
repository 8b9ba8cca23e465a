"""Sets of effects against the summaries of a recording: their evidence, and which are told apart."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from support.recordings import MAKE, recorded

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.search.alternatives import Explained, Subsets
from tofmix.reconciliation.search.columns import Column, Term, terms
from tofmix.reconciliation.search.refit import begin
from tofmix.reconciliation.search.summaries import PixelSummary, summaries
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

TOLERANCE = 0.1


def board(model: Model, distance_mm: float) -> Model:
    """The camera before one board that faces it and fills the image."""
    return replace(model, surfaces=(Surface(name="board", center_mm=(0, 0, distance_mm), size_mm=(9000.0, 9000.0)),))


def summed(model: Model, evidence: Evidence) -> tuple[list[PixelSummary], list[Term]]:
    likelihood = joint_likelihood([(model, evidence)])
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    state = begin(likelihood, whole[0], TOLERANCE)
    seen = summaries(likelihood, state, whole)
    return seen, terms(likelihood, state, seen, tuple(EFFECTS))


def sets(model: Model, evidence: Evidence, size: int = 2) -> list[Explained]:
    return Subsets(*summed(model, evidence), TOLERANCE).all_up_to(size)


def kinds(found: Explained) -> set[str]:
    return {kind for kind, _ in found.names}


def test_biases_and_widths_are_those_of_the_recording(model: Model) -> None:
    hidden = MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=4.0), MAKE["excess_noise"](factor=1.4)
    (seen,), _ = summed(model, recorded(model, *hidden))
    rise = 12.0 * -np.expm1(-seen.elapsed_s / 4.0)
    known = seen.bias_information[:, seen.used]
    off = ((seen.bias_mm[:, seen.used] - rise[:, None]) * known).sum(axis=1) / np.sqrt(known.sum(axis=1))
    assert np.abs(off).max() < 4.5  # ten means, in standard errors; a tenth's own drift adds a little
    width, sure = seen.width[seen.used], seen.width_information[seen.used]
    assert abs((width * sure).sum() / sure.sum() - np.log(1.4)) < 4 / np.sqrt(sure.sum())


def test_stray_light_of_the_lens_is_no_reflection_of_the_glass_and_the_other_way_round(model: Model) -> None:
    """Both add one phasor to every pixel's: that of the scene, or that of a short way."""
    for hidden in (MAKE["scattering"](share=0.03), MAKE["internal_reflection"](amplitude=6.0, range_mm=20.0)):
        found = sets(model, recorded(model, hidden), size=1)
        assert kinds(found[0]) == {hidden.kind}
        other = next(s for s in found if kinds(s) == {"scattering", "internal_reflection"} - {hidden.kind})
        assert found[0].evidence > other.evidence + 6


def test_evidence_is_the_density_of_the_data_with_the_coefficients_integrated_out(model: Model) -> None:
    """By the covariance of all cells at once, which has each column's prior in it."""
    (seen,), _ = summed(model, recorded(model))
    rng = np.random.default_rng(2)
    some = np.flatnonzero(seen.used)[:30]
    use = np.zeros(seen.used.size, dtype=bool)
    use[some] = True
    bias = rng.normal(0, 2.0, seen.bias_mm.shape)
    few = replace(seen, used=use, bias_mm=np.where(use, bias, 0.0), bias_information=np.where(use, 0.2, 0.0 * bias))
    columns = tuple(
        Column(
            bias_mm=(rng.normal(0, 1, use.size),),
            profile=(rng.normal(1, 0.3, len(bias)),),
            width=(np.zeros(use.size),),
            prior=prior,
        )
        for prior in (0.5, 2.0)
    )
    term = Term(kind="any", surface="", columns=columns, make=lambda _: MAKE["range_offset"](offset_mm=1.0))
    found = Subsets([few], [term], 0.0).explained([0]).evidence
    design = np.stack([np.outer(c.profile[0], c.bias_mm[0][some]).ravel() for c in columns], axis=1)
    noise = np.eye(design.shape[0]) / 0.2
    covariance = noise + design @ np.diag([0.25, 4.0]) @ design.T
    data = few.bias_mm[:, some].ravel()
    wanted = multivariate_normal(cov=covariance).logpdf(data) - multivariate_normal(cov=noise).logpdf(data)
    assert found == pytest.approx(wanted, rel=1e-9)


def test_empty_set_has_most_evidence_for_a_recording_without_effects(model: Model) -> None:
    assert kinds(sets(model, recorded(model))[0]) == set()


def test_offset_and_pose_are_aliases_on_one_board_and_separated_on_two(model: Model) -> None:
    one = board(model, 1500.0)
    best = sets(one, recorded(one, MAKE["range_offset"](offset_mm=2.5)), 1)
    gains = {tuple(kinds(s)): s.evidence for s in best}
    assert abs(gains["range_offset",] - gains["surface_pose",]) < 4
    best = sets(model, recorded(model, MAKE["range_offset"](offset_mm=9.0)), 1)
    assert kinds(best[0]) == {"range_offset"}
    assert best[0].evidence > max(s.evidence for s in best if "surface_pose" in kinds(s)) + 10


@pytest.mark.parametrize(
    "hidden",
    [
        (MAKE["wiggling"](amplitude_mm=9.0, phase_rad=0.5), MAKE["excess_noise"](factor=1.3)),
        pytest.param(
            (MAKE["range_offset"](offset_mm=-8.0), MAKE["motion"](surface="near", velocity_mm_s=3.0)),
            marks=pytest.mark.slow,
        ),
        (MAKE["surface_pose"](surface="middle", shift_mm=20.0, yaw_deg=2.0), MAKE["range_offset"](offset_mm=8.0)),
    ],
    ids=lambda hidden: "+".join(e.kind for e in hidden),
)
def test_two_hidden_effects_have_most_evidence_of_all_pairs(model: Model, hidden: tuple) -> None:  # type: ignore[type-arg]
    assert kinds(sets(model, recorded(model, *hidden))[0]) == {e.kind for e in hidden}
