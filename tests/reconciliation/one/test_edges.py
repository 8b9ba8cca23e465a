"""Shares of surfaces that the model has a little off."""

from dataclasses import replace

import numpy as np
import pytest
from support.reconcile_errors import scene
from users.cases import FRAMES, RATE_HZ, draw, recorded

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.one.scene_errors import Edges
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@pytest.fixture
def step() -> Model:
    """The front and the side of a box, which touch at x = 20 mm, and nothing behind them."""
    front = Surface(name="front", center_mm=(-980.0, 0.0, 1000.0), size_mm=(2000.0, 4000.0), reflectivity=0.7)
    side = Surface(
        name="side", center_mm=(20.0, 0.0, 1500.0), size_mm=(1000.0, 4000.0), reflectivity=0.5, yaw_deg=-90.0
    )
    return replace(scene(rows=6, cols=31, frames=20), surfaces=(front, side), effects=())


def test_shares_of_moved_surfaces_are_those_of_a_cast(step: Model) -> None:
    ranges_mm = np.array([8.0, 0.0])
    given = cast_scene(step)
    shared = np.flatnonzero((given.n_modes.ravel() > 1) | (given.weight_no_return.ravel() > 0.01))
    alone = [(given.n_modes.ravel() == 1) & (given.surface[..., 0].ravel() == k) for k in (0, 1)]
    edges = Edges.of(step, shared, alone)
    before, after = edges.change(np.zeros(2)), edges.change(ranges_mm)
    assert not before.any()
    front = step.surfaces[0]
    median = float(np.median(given.range_true[..., 0].ravel()[alone[0]]))
    moved = replace(step, surfaces=(front.shifted(8.0 * front.plane_distance_mm / median), step.surfaces[1]))
    now = cast_scene(moved)
    for component, surface in enumerate((0, 1)):
        own = edges.surface[component] == surface
        of = [
            np.nan_to_num(np.where(seen.surface == surface, seen.weight_true, 0.0)).sum(axis=2).ravel()[shared]
            for seen in (given, now)
        ]
        assert after[component][own] == pytest.approx((of[1] - of[0])[own], abs=0.002)
    assert np.abs(after).max() > 0.003  # a shift that changes shares


@pytest.mark.slow
def test_alcove_with_walls_a_tenth_of_sigma_off_agrees_although_gaps_open_at_its_edges() -> None:
    case = draw(20261202, 10, "rooms")
    evidence = make_evidence(case.given, recorded(case), time_s=np.arange(FRAMES) / RATE_HZ)
    assert reconcile(case.given, evidence, Settings(kinds=KINDS)).verified.verdict == "agree"
