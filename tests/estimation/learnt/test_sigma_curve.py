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


@pytest.mark.parametrize("samples", [30, 1000, 10_000])
@pytest.mark.parametrize("off_grid", [0.0, 0.3, 0.5, 0.8])
def test_sigma_between_those_that_are_tried_is_not_biased_by_many_samples(samples: int, off_grid: float) -> None:
    rng = np.random.default_rng([7, samples])
    spacing = np.log(SIGMAS[1] / SIGMAS[0])
    sigma = SIGMAS[20] * np.exp(off_grid * spacing)
    clusters = 400
    variance = sigma**2 * rng.chisquare(samples - 1, (clusters, 1)) / (samples - 1)
    likelihood = -(samples - 1) * (np.log(SIGMAS) + 0.5 * variance / SIGMAS**2)
    deviation = 1.0 / np.sqrt(2.0 * (samples - 1) * clusters)
    assert abs(np.log(_sigma_in_steps(likelihood) / sigma)) < 4.0 * deviation


@pytest.mark.parametrize("place", [0, -1])
def test_sigma_at_an_end_of_those_that_are_tried_is_that_end(place: int) -> None:
    likelihood = np.tile(-1.0e4 * np.abs(np.log(SIGMAS / SIGMAS[place])), (5, 1))
    assert _sigma_in_steps(likelihood) == pytest.approx(SIGMAS[place], rel=1e-6)
