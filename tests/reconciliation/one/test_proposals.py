"""Proposals: every set of a size once, with the evidence of a dense Gaussian model."""

from itertools import combinations

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from support.recordings import MAKE
from support.search_tasks import MakeTask

from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.proposals import About, Columns, by_trial

STATIC = ("range_offset", "amplitude_walk", "wiggling", "scattering")


def test_all_pairs_are_proposed(make_task: MakeTask) -> None:
    task = make_task((*STATIC, "temperature_drift"), MAKE["range_offset"](offset_mm=5.0))
    about = About(Columns.of(task), FittedSet.without_effects(task).fit())
    names = {law.name for law in task.laws if law.named and law.forms}
    assert {kind for kind, _ in names} == {*STATIC, "temperature_drift"}
    assert {p.names for p in about.sets(2)} == {frozenset(pair) for pair in combinations(names, 2)}


def test_neighbours_of_a_set_are_its_parts_exchanges_and_additions(make_task: MakeTask) -> None:
    task = make_task(STATIC, MAKE["range_offset"](offset_mm=5.0))
    columns = Columns.of(task)
    null = About(columns, FittedSet.without_effects(task).fit())
    base = next(p for p in null.sets(2) if {k for k, _ in p.names} == {"range_offset", "wiggling"}).build().fit()
    about = About(columns, base)
    one, three = ({frozenset(k for k, _ in p.names) for p in about.sets(size)} for size in (1, 3))
    assert one == {frozenset([kind]) for kind in STATIC}
    assert three == {frozenset(some) for some in combinations(STATIC, 3)}


def test_evidence_is_that_of_the_dense_gaussian_model(make_task: MakeTask) -> None:
    task = make_task(STATIC, MAKE["range_offset"](offset_mm=5.0))
    null = FittedSet.without_effects(task).fit()
    about = About(Columns.of(task), null)
    summary = null.summary()
    total = summary.bias_information.sum(axis=0).ravel()
    errors = task.low.toarray()
    rest = errors.T @ errors + np.diag(1 / total)
    for pair in combinations([o for o in about.new if o.law.kind.kind in ("range_offset", "amplitude_walk")], 2):
        covariance = rest.copy()
        for option in pair:
            columns = about._static[option.at].reshape(option.at.size, -1) * option.prior[:, None]
            covariance += columns.T @ columns
        bias = summary.mean_mm.ravel()
        wanted = multivariate_normal.logpdf(bias, cov=covariance) - multivariate_normal.logpdf(bias, cov=rest)
        found = about.evidence([pair, []], set(), patterned=False)
        assert found[0] - found[1] == pytest.approx(wanted - sum(o.price_nats for o in pair), rel=1e-6, abs=1e-6)


def test_predicted_score_of_a_small_effect_is_the_fitted_one(make_task: MakeTask) -> None:
    task = make_task(("range_offset", "wiggling"), MAKE["range_offset"](offset_mm=5.0))
    about = About(Columns.of(task), FittedSet.without_effects(task).fit())
    for p in about.sets(1):
        assert p.build().fit().score == pytest.approx(p.predicted, abs=2.0 + p.slack), p.names


def test_kinds_that_summaries_do_not_show_are_tried_on_samples(make_task: MakeTask) -> None:
    hidden = MAKE["outliers"](probability=0.05)
    task = make_task(("outliers", "quantisation", "interference", "temporal_correlation", "stuck_pixels"), hidden)
    null = FittedSet.without_effects(task).fit()
    found = {p.names: p for p in by_trial(null)}
    best = max(found.values(), key=lambda p: p.predicted)
    assert best.names == {("outliers", "")}
    assert best.build().fit().score == pytest.approx(best.predicted, abs=5.0 + 0.05 * (best.predicted - null.score))
