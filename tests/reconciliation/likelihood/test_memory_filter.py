"""What is expected of a sample, given all before it: held against the joint normal distribution of all of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.reconciliation.likelihood.memory import RandomValues, noise_of, predicted_noise

FRAMES = 12


def none(pixels: int = 1) -> RandomValues:
    return RandomValues(share=np.zeros(pixels), below=np.full(pixels, 0.5), density=np.full(pixels, 1e-3))


@given(rho=st.floats(-0.9, 0.95), camera=st.floats(0.3, 1.0), seed=st.integers(0, 99), lost=st.integers(0, 5))
def test_prediction_is_the_conditional_mean_and_variance_of_all_samples_before(
    rho: float, camera: float, seed: int, lost: int
) -> None:
    """AR(1) noise with a part that has no memory, some samples unknown; by the covariance matrix of all."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(FRAMES, 1))
    u[rng.choice(FRAMES, lost, replace=False)] = np.nan
    mean, variance = predicted_noise(u, rho, np.array([camera]), none())
    at = np.arange(FRAMES)
    covariance = camera * rho ** np.abs(at[:, None] - at) + (1 - camera) * np.eye(FRAMES)
    for t in at:
        known = at[:t][np.isfinite(u[:t, 0])]
        pull = np.linalg.solve(covariance[np.ix_(known, known)], covariance[known, t])
        assert mean[t, 0] == pytest.approx(pull @ u[known, 0], abs=1e-9)
        assert variance[t, 0] == pytest.approx(covariance[t, t] - pull @ covariance[known, t], abs=1e-9)


def test_a_random_value_is_not_remembered() -> None:
    random = RandomValues(share=np.array([0.02]), below=np.array([0.5]), density=np.array([1e-3]))
    u = np.array([[0.5], [6.5], [0.0]])  # 6.5 sigma is no noise
    mean, variance = predicted_noise(u, 0.8, np.ones(1), random)
    without, wider = predicted_noise(np.where(u > 6, np.nan, u), 0.8, np.ones(1), random)
    assert mean[2, 0] == pytest.approx(without[2, 0], abs=1e-4)
    assert variance[2, 0] == pytest.approx(wider[2, 0], abs=1e-3)


@given(share=st.floats(0.0, 0.1), below=st.floats(0.05, 0.95), u=st.floats(-3.2, 3.2))
def test_noise_of_undoes_the_score_of_noise_with_random_values(share: float, below: float, u: float) -> None:
    from scipy.special import ndtr, ndtri

    random = RandomValues(share=np.array([share]), below=np.array([below]), density=np.array([2e-3]))
    chance = random.chance(np.array([[u]]), ndtr(np.array([[u]])))
    assert noise_of(ndtri(chance), random)[0, 0] == pytest.approx(u, abs=2e-2)
