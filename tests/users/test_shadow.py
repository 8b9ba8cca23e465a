"""The score by held-out blocks: the truth leads, chance earns no names, and blocks add up to the evidence."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from support.recordings import MAKE, recorded

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.search.columns import terms
from tofmix.reconciliation.search.summaries import summaries
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from users.shadow import Shadow, _evidence, beats

KINDS = ("range_offset", "surface_pose", "wiggling", "amplitude_walk", "excess_noise")


def shadow_of(model: Model, hidden: Sequence[Effect]) -> Shadow:
    evidence = recorded(model, *hidden)
    likelihood = joint_likelihood(((model, evidence),))
    state = likelihood.start()
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    seen = summaries(likelihood, state, whole)
    return Shadow(seen[0], terms(likelihood, state, seen, KINDS), 0.1)


@pytest.fixture(scope="module")
def model() -> Model:
    from support.reconcile_errors import scene

    return scene(rows=20, cols=24)


@pytest.mark.parametrize(
    "hidden",
    [
        (MAKE["range_offset"](offset_mm=9.0),),
        (MAKE["wiggling"](amplitude_mm=9.0, phase_rad=0.5), MAKE["excess_noise"](factor=1.3)),
    ],
    ids=["offset", "wave and noise"],
)
def test_truth_is_beaten_by_no_set_and_beats_no_effect(model: Model, hidden: tuple[Effect, ...]) -> None:
    names = frozenset((e.kind, "") for e in hidden)
    found, count = shadow_of(model, hidden).finalists([names])
    truth = next(s for s in found if s.names == names and not s.laws)
    nothing = next(s for s in found if not s.names and not s.laws)
    assert [s for s in found if beats(s, truth, count)] == []
    assert beats(truth, nothing, count)


def test_right_model_earns_no_name(model: Model) -> None:
    found, count = shadow_of(model, ()).finalists()
    nothing = next(s for s in found if not s.names and not s.laws)
    assert [s for s in found if beats(s, nothing, count)] == []


def test_predictive_density_is_that_of_the_joint_normal() -> None:
    """A block given others: the ratio of two marginal densities, each a normal of all its data."""
    rng = np.random.default_rng(3)
    law, noise = rng.normal(size=(30, 3)), rng.uniform(0.5, 2.0, 30)
    seen = law @ rng.normal(size=3) + noise * rng.normal(size=30)
    fit, every = slice(0, 20), slice(0, 30)

    def products(part: slice) -> tuple[np.ndarray, np.ndarray]:
        weighed = law[part] / noise[part, None] ** 2
        return np.eye(3) + law[part].T @ weighed, weighed.T @ seen[part]

    def log_density(part: slice) -> float:
        covariance = law[part] @ law[part].T + np.diag(noise[part] ** 2)
        bare = multivariate_normal(np.zeros(covariance.shape[0]), np.diag(noise[part] ** 2)).logpdf(seen[part])
        return float(multivariate_normal(np.zeros(covariance.shape[0]), covariance).logpdf(seen[part]) - bare)

    expected = log_density(every) - log_density(fit)
    assert float(_evidence(*products(every)) - _evidence(*products(fit))) == pytest.approx(expected)
