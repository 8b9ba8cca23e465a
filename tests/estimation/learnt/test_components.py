"""Surfaces added to a mixture and removed from it: the shares of all add up to 1."""

import math

import numpy as np
import pytest
from support.learnt_pixels import SIGMA_MM, TOP_MM, camera_with, pixel_noise

from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    OWN,
    SIGMA,
    WEIGHT,
    add_surface,
    new_fit,
    remove_surface,
    start_without_surface,
)
from tofmix.learnt_noise import DRIFTS

BEAM = beam_of(camera_with(pixel_noise()))


@pytest.mark.parametrize("near", [0, 1, 3, 10])
def test_start_has_no_return_for_the_samples_at_the_end_of_range(near: int) -> None:
    value = np.array([2000.0] * (10 - near) + [TOP_MM + 1.0] * near)
    fit = new_fit(2)
    fit[:] = 7.0
    start_without_surface(value, fit, BEAM)
    assert fit[WEIGHT, -1] == pytest.approx(min(0.1 * near, 0.9))  # background keeps one sample
    assert fit[OWN, BACKGROUND] + fit[WEIGHT, -1] == 1.0
    assert fit[OWN, LOG_WIDTH] == 0.0
    assert not fit[WEIGHT, :-1].any()


def test_start_without_an_end_of_range_is_background_alone() -> None:
    fit = new_fit(1)
    start_without_surface(np.array([TOP_MM]), fit, BEAM._replace(range_max=math.inf))
    assert (fit[WEIGHT, -1], fit[OWN, BACKGROUND]) == (0.0, 1.0)


def test_share_of_an_added_surface_comes_from_all_others() -> None:
    fit = new_fit(2)
    fit[DRIFT : DRIFT + DRIFTS] = 9.0
    fit[MEAN, 0], fit[WEIGHT, 0], fit[WEIGHT, -1], fit[OWN, BACKGROUND] = 1000.0, 0.5, 0.3, 0.2
    assert add_surface(1, 2000.0, 0.25, fit, BEAM) == 2
    np.testing.assert_allclose(fit[WEIGHT], [0.375, 0.25, 0.225])
    assert fit[OWN, BACKGROUND] == pytest.approx(0.15)
    assert (fit[MEAN, 1], fit[SIGMA, 1]) == (2000.0, SIGMA_MM)
    assert not fit[DRIFT : DRIFT + DRIFTS, 1].any()


def test_share_of_a_removed_surface_goes_to_all_others_and_the_last_one_s_to_background() -> None:
    fit = new_fit(3)
    fit[MEAN, :3], fit[WEIGHT, :3] = (1.0, 2.0, 3.0), (0.2, 0.3, 0.4)
    fit[OWN, BACKGROUND], fit[OWN, LOG_WIDTH] = 0.1, 0.4
    assert remove_surface(3, 1, fit) == 2
    np.testing.assert_array_equal(fit[MEAN, :2], [1.0, 3.0])
    np.testing.assert_allclose(fit[WEIGHT, :2], np.array([0.2, 0.4]) / 0.7)
    assert fit[OWN, BACKGROUND] == pytest.approx(0.1 / 0.7)
    assert remove_surface(2, 0, fit) == 1
    assert remove_surface(1, 0, fit) == 0
    assert fit[OWN, BACKGROUND] == 1.0
    assert fit[OWN, LOG_WIDTH] == 0.0  # a width without a surface is that of all
