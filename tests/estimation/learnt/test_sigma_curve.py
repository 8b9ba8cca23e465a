"""Sigma from the likelihoods of clusters on a step."""

import numpy as np
import pytest

from tofmix.estimation.learnt.clusters import SIGMAS
from tofmix.estimation.learnt.sigma_curve import _sigma_in_steps


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("samples", [10.0, 1000.0, 1.0e6])
def test_the_likeliest_sigma_is_found_however_many_samples_tell_it(samples: float) -> None:
    sigma = 1.03 * SIGMAS[len(SIGMAS) // 2]
    x = np.log(SIGMAS / sigma)
    narrow = np.where(x < 0.0, 30.0, 1.0)  # less than sigma is less likely by far
    likelihood = np.tile(-samples * narrow * x**2 - 5.0, (4, 1))
    spacing = np.log(SIGMAS[1] / SIGMAS[0])
    assert abs(np.log(_sigma_in_steps(likelihood) / sigma)) < spacing


def test_a_cluster_of_two_surfaces_leaves_sigma_as_it_is() -> None:
    sigma = SIGMAS[len(SIGMAS) // 2]
    single = np.tile(-200.0 * np.log(SIGMAS / sigma) ** 2, (9, 1))
    wide = -200.0 * np.log(SIGMAS / (3.0 * sigma)) ** 2
    assert _sigma_in_steps(np.vstack([single, wide])) == pytest.approx(_sigma_in_steps(single), rel=0.02)
