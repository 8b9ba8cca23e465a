"""Verdicts: what is called explained, and what is not."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, Record

from tofmix.reconciliation.comparison.compare import Compared, compare
from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.found import TriedEffect
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.settings import Settings, held_out
from tofmix.reconciliation.verdict import VerdictData, inexact, judge
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.model import Model

BINS = 12
NOTHING: dict[str, float] = {"bias": 0.0, "spread": 0.0, "tails": 0.0}


def curve(statistic: str, size: float) -> Curve:
    """A curve of twelve bins, each of 10,000 samples, that all lie at `size` sigma."""
    ones = np.ones(BINS)
    return Curve(
        statistic=statistic,
        axis="range",
        lower=ones,
        upper=ones,
        value=size * ones,
        variance=1e-4 * ones,
        unit="mm",
        scale_mm=ones,
    )


def panel(**sizes: float) -> Compared:
    nothing = np.zeros(0, dtype=np.int64)
    curves = tuple(curve(name, size) for name, size in (NOTHING | sizes).items())
    return Compared(curves=curves, pattern=np.zeros((1, 1)), part=(nothing, nothing))


def chosen(kind: str = "range_offset", gain: float = 60_000.0, **values: float) -> TriedEffect:
    return TriedEffect(effect=MAKE[kind](**(values or {"offset_mm": 9.0})), gain=gain, parameters=1)


def findings(before: Compared, near: Compared, *effects: TriedEffect, samples: int = 100_000) -> VerdictData:
    return VerdictData(chosen=effects, before=before, after=near, floor=panel(), near=near, alpha=0.01, samples=samples)


def test_no_deviation_is_agree_and_a_bias_is_not() -> None:
    assert judge(findings(panel(), panel())) == "agree"
    assert judge(findings(panel(bias=0.5), panel(bias=0.5))) == "unexplained"


def test_too_few_samples_to_see_half_a_sigma_never_agree() -> None:
    """Half a sigma is 3 standard errors of 40 samples; this panel needs 2.7, and 1.6 more for the power."""
    few = findings(panel(), panel(), samples=40)
    assert few.few
    assert judge(few) == "unexplained"
    assert not findings(panel(), panel(), samples=120).few


def test_too_few_samples_to_see_half_a_sigma_leave_a_name_in_doubt() -> None:
    """A few zones show what moves by 100 sigma, and not whether half a sigma is left."""
    assert judge(findings(panel(bias=9.0), panel(), chosen(), samples=40)) == "partly_explained"
    assert judge(replace(findings(panel(bias=9.0), panel(), chosen()), independent=0.03)) == "unexplained"


def test_explained_needs_no_statistic_that_stands_out_whatever_the_gap() -> None:
    before = panel(bias=2.0, spread=0.3)
    assert judge(findings(before, panel(), chosen())) == "explained"
    left = findings(before, panel(spread=0.3), chosen())
    assert [c.statistic for c in left.open] == ["spread"]
    assert judge(left) == "partly_explained"  # it was there before, and the offset does not touch it


@pytest.mark.parametrize(("left", "verdict"), [(0.15, "explained"), (0.3, "partly_explained")])
def test_tenth_of_an_effects_change_is_accepted_as_error_of_its_law(left: float, verdict: str) -> None:
    assert judge(findings(panel(bias=2.0), panel(bias=left), chosen(gain=240_000.0))) == verdict


def test_limit_of_skew_follows_the_larger_of_skew_and_tails_and_limit_of_bias_follows_bias() -> None:
    before = panel(tails=1.0, skew=0.1, bias=0.1)
    assert inexact(curve("skew", 0.05), before) == pytest.approx(0.1, rel=0.01)
    assert inexact(curve("bias", 0.05), before) == pytest.approx(0.02)


@pytest.mark.parametrize(("own", "limit"), [(0.0, 0.02), (0.3, 0.032)])
def test_inexact_law_may_leave_a_hundredth_of_a_spread_that_comes_from_a_bias(own: float, limit: float) -> None:
    """A law that is wrong by a tenth of a bias of 0.84 sigma leaves 0.084, whose square is next to no spread."""
    told = 0.5 * own**2 * BINS / 1e-4  # nats: the information of spreads beyond means
    spread = replace(curve("spread", 0.5), information=told)
    before = replace(panel(bias=0.84), curves=(curve("bias", 0.84), spread))
    assert inexact(curve("spread", 0.05), before) == pytest.approx(limit, rel=0.01)


def test_unsigned_has_the_numbers_of_effects_whose_statistics_still_stand_out() -> None:
    noise = chosen("excess_noise", gain=30.0, factor=1.02)
    left = findings(panel(bias=2.0, spread=0.1), panel(spread=0.1), chosen(), noise)
    assert left.unsigned == (1,)
    assert not left.signed
    closed = findings(panel(bias=2.0, spread=0.1), panel(), chosen(), noise)
    assert closed.unsigned == ()
    assert closed.signed


AGAINST: tuple[dict[str, object], ...] = (
    {"law": "range"},
    {"own": MAKE["range_offset"](offset_mm=3.0)},
    {"bound": True},
    {"echo": True},
    {"shaped": True},
)


@pytest.mark.parametrize("against", AGAINST, ids=str)
def test_evidence_against_an_effect_gives_unexplained(against: dict[str, object]) -> None:
    found = findings(panel(bias=2.0), panel(), chosen())
    assert judge(found) == "explained"
    assert judge(replace(found, **against)) == "unexplained"  # type: ignore[arg-type]


def test_a_faint_law_and_a_part_of_the_scene_that_has_changed_leave_a_name_and_no_agreement() -> None:
    found = findings(panel(bias=2.0), panel(), chosen())
    assert judge(replace(found, law="range", faint_law=True)) == "partly_explained"
    assert judge(replace(found, changed=True)) == "partly_explained"
    assert judge(replace(findings(panel(), panel()), changed=True)) == "unexplained"


def test_refused_has_the_memory_of_an_echo_and_the_pattern_of_a_shape() -> None:
    memory, pattern = chosen("temporal_correlation", coefficient=0.3), chosen("fixed_pattern", pixel_sigma_mm=3.0)
    found = findings(panel(bias=2.0), panel(), chosen(), memory, pattern)
    assert found.refused == ()
    assert replace(found, echo=True).refused == (1,)
    assert replace(found, echo=True, shaped=True).refused == (1, 2)


def test_remaining_change_in_time_gives_partly_explained() -> None:
    found = findings(panel(bias=2.0), panel(), chosen())
    assert judge(replace(found, in_time=True)) == "partly_explained"


def test_large_gap_of_the_models_own_simulation_gives_unexplained() -> None:
    found = findings(panel(bias=0.2), panel(), chosen())
    assert judge(replace(found, floor=panel(bias=0.9))) == "unexplained"


def test_noise_that_a_line_shares_is_no_sign_that_an_offset_is_wrong_and_that_a_frame_shares_is() -> None:
    left = panel(common_mode=0.5)
    of_line, of_frame = (
        replace(left, curves=tuple(replace(c, axis=axis) for c in left.curves)) for axis in ("col", "frame")
    )
    assert findings(panel(bias=2.0), of_line, chosen(gain=1000.0)).signed
    assert not findings(panel(bias=2.0), of_frame, chosen(gain=1000.0)).signed


def test_every_kind_shows_in_statistics_of_the_panel_or_has_an_exact_law(model: Model, record: Record) -> None:
    evidence = record(MAKE["dropout"](probability=0.02))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    state = replace(likelihood.start(), effects=(MAKE["pixel_crosstalk"](share=0.01),))
    panel_ = compare(likelihood, state, held_out(likelihood, Settings(kinds=())), seed=1)
    known = {curve.statistic for curve in panel_.curves}
    assert [kind for kind, effect in EFFECTS.items() if not (effect.shows_in or effect.exact_law)] == []
    assert {s for effect in EFFECTS.values() for s in effect.shows_in} - known == set()
