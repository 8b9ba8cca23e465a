"""The samples about static errors, where an error or an effect makes another surface of a pixel the heaviest one."""

from dataclasses import replace

import numpy as np
import pytest
from support.reconcile_errors import scene
from support.recordings import MAKE
from support.search_tasks import MakeTask

from tofmix.arrays import FloatArray
from tofmix.reconciliation.one.expansion import Expansion, log_sigma, main_ranges, main_surfaces
from tofmix.reconciliation.one.recordings import SearchTask


@pytest.fixture
def task(make_task: MakeTask) -> SearchTask:
    """Boards before a wall, with pixels that see two of them."""
    return make_task(("range_offset",), MAKE["range_offset"](offset_mm=4.0), of=scene(rows=12, cols=14, frames=40))


def exchanged(weight: FloatArray) -> FloatArray:
    """Weights (component, pixel) with those of the two heaviest components of each pixel exchanged."""
    out, pixel, order = weight.copy(), np.arange(weight.shape[1]), np.argsort(weight, axis=0)
    out[order[-1], pixel], out[order[-2], pixel] = weight[order[-2], pixel], weight[order[-1], pixel]
    return out


def test_noise_and_range_of_a_surface_are_its_own_where_another_is_the_heaviest(task: SearchTask) -> None:
    before, surface = task.mixture, main_surfaces(task, task.mixture)
    shared = ((before.weight[0] > 0) & before.lit[0]).sum(axis=0) > 1
    after = replace(before, weight=np.where(shared, exchanged(before.weight[0]), before.weight[0])[None])
    other = main_surfaces(task, after) != surface
    assert other.any()
    assert np.abs(log_sigma(task, after) - log_sigma(task, before))[other].max() > 0.1
    assert log_sigma(task, after, surface) == pytest.approx(log_sigma(task, before))
    assert main_ranges(task, after, surface) == pytest.approx(main_ranges(task, before))


def test_noise_is_as_wide_as_where_samples_are_expanded_although_shares_have_changed(task: SearchTask) -> None:
    """Shares that follow errors of the model make another surface the heaviest: no change of its noise."""
    shifts = task.shifts(np.zeros(task.low.shape[0]))
    assert shifts is not None
    weight, surface = (of[0][:, shifts.pixels] for of in (task.mixture.weight, task.mixture.surface))
    shifted = replace(task.null, shifts=shifts._replace(shares=((surface, exchanged(weight) - weight),)))
    assert (main_surfaces(task, task.likelihood.mixture(shifted)) != main_surfaces(task, task.mixture)).any()
    about = Expansion.of(task, shifted, task.given, np.zeros(task.lit.shape))
    assert np.abs(about.followed(task.null).wider).max() < 0.05
