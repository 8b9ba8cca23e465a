"""Errors of a measured scene: the log-likelihood with them integrated out is that of a Gaussian of their covariance."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tofmix.reconciliation.likelihood.likelihood import Sums
from tofmix.reconciliation.likelihood.reference_errors import ReferenceErrors

SIGMA = np.array([2.0, 3.0, 5.0])
VARIANCE = np.array([0.4, 0.2, 1.5])
FRAMES = 12


def _errors(*, common: float = 0.0, frame_noise: float = 0.0) -> ReferenceErrors:
    nothing = np.zeros(3)
    return ReferenceErrors(
        sigma_mm=SIGMA,
        variance_mm2=VARIANCE,
        log_width=nothing,
        lent_log_width=nothing,
        shares=nothing,
        lost=nothing,
        lost_share=nothing,
        lost_worth=0.0,
        common_lost=0.0,
        common=common,
        common_log_width=0.0,
        frame_noise=frame_noise,
    )


def _sums(off_mm: np.ndarray) -> tuple[Sums, float]:
    """Log-likelihood, slope and information of Gaussian samples (frame, pixel); and the log-likelihood itself."""
    each = -0.5 * (off_mm / SIGMA) ** 2 - np.log(SIGMA) - 0.5 * np.log(2 * np.pi)
    count = np.full(3, float(len(off_mm)))
    by_pixel = np.stack([each.sum(axis=0), (off_mm / SIGMA**2).sum(axis=0), count / SIGMA**2, count], axis=1)
    return Sums(by_pixel, np.zeros((len(off_mm), 4))), float(each.sum())


@pytest.mark.parametrize("common", [0.0, 0.3])
def test_marginal_is_the_density_of_correlated_samples(common: float) -> None:
    off = np.random.default_rng(1).normal(0.7, 1.0, (FRAMES, 3)) * SIGMA
    sums, plain = _sums(off)
    by_pixel, shared = _errors(common=common).marginal(sums.by_pixel, VARIANCE, 1.0, FRAMES)
    between = np.diag(VARIANCE) + common * np.outer(SIGMA, SIGMA)
    covariance = np.kron(np.ones((FRAMES, FRAMES)), between) + np.kron(np.eye(FRAMES), np.diag(SIGMA**2))
    exact = multivariate_normal(np.zeros(3 * FRAMES), covariance).logpdf(off.ravel())
    assert plain + float(by_pixel.sum()) + shared == pytest.approx(float(exact), abs=1e-6)


def test_memory_divides_the_gain_of_a_bias() -> None:
    off = np.random.default_rng(2).normal(0.0, 1.0, (FRAMES, 3)) * SIGMA
    gains = []
    for repeats in (1.0, 4.0):
        values = []
        for bias in (0.0, 1.0):
            sums, plain = _sums(off + bias * SIGMA - off.mean(axis=0))
            by_pixel, shared = _errors().marginal(sums.by_pixel, np.zeros(3), repeats, FRAMES)
            values.append(plain + float(by_pixel.sum()) + shared)
        gains.append(values[0] - values[1])
    assert gains[1] == pytest.approx(gains[0] / 4.0, rel=1e-6)


def test_noise_of_whole_frames_adds_to_what_means_share() -> None:
    errors = _errors(common=0.1, frame_noise=0.5)
    assert errors.common_to(10, 0.0) == pytest.approx(0.1 + 0.025)
    assert errors.common_to(10, 0.5) == pytest.approx(0.1 + 0.075)
