import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import beta
from support.alike import MakeLayers

from tofmix.mapping.beams import beams_from_layers
from tofmix.mapping.grid import Pose, VoxelGrid, plan_grid
from tofmix.mapping.occupancy import MAX_LOG_ODDS, State, VoxelMap, log_odds, map_beams, project
from tofmix.sensor import Sensor


@given(st.floats(0, 40), st.floats(0, 40), st.floats(0.01, 0.3))
def test_log_odds_are_the_ratio_of_the_two_marginal_likelihoods(stopped: float, passed: float, share: float) -> None:
    def likelihood(low: float, high: float) -> float:
        area, _ = quad(lambda s: s**stopped * (1 - s) ** passed, low, high, epsabs=0, epsrel=1e-10)
        return float(area) / (high - low)

    expected = math.log(likelihood(share, 1.0) / likelihood(0.0, share))
    expected = min(max(expected, -MAX_LOG_ODDS), MAX_LOG_ODDS)
    assert log_odds(stopped, passed, 1.0, min_share=share) == pytest.approx(expected, abs=1e-5)


def test_log_odds_of_hits_and_passes_have_closed_forms() -> None:
    assert log_odds(0.0, 0.0, 0.0) == pytest.approx(0.0, abs=1e-12)
    # All of f samples pass: I = 1 - (1 - m)^(f + 1).
    m, f = 0.05, 20.0
    rest = (1 - m) ** (f + 1)
    assert log_odds(0.0, f, 0.0) == pytest.approx(math.log(rest / (1 - m)) - math.log((1 - rest) / m))
    # As a posterior of the share with even odds.
    odds = float(log_odds(3.0, 30.0, 1.0))
    tail = beta(4.0, 31.0).sf(m)
    assert odds == pytest.approx(math.log(tail / (1 - tail)) - math.log((1 - m) / m))


def test_log_odds_are_bounded_by_the_layer_and_the_limit() -> None:
    assert log_odds(1e5, 0.0, 0.9) == pytest.approx(math.log(9))
    assert log_odds(1e5, 0.0, 1.0) == pytest.approx(MAX_LOG_ODDS)
    assert log_odds(0.0, 1e7, 0.0) == pytest.approx(-MAX_LOG_ODDS)
    assert log_odds(1e5, 0.0, 0.3) == 0  # what is probably not there does not make space free
    with pytest.raises(ValueError, match="min_share: 0"):
        log_odds(0.0, 0.0, 0.0, min_share=0.0)


def test_wall_behind_a_partial_one_is_occupied_with_free_space_between(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([2000.0, 4000.0], [0.3, 0.5], no_return=0.2, size=40)
    beams = beams_from_layers(layers, camera)
    grid = plan_grid(beams, Pose(), cell_mm=50.0, height_mm=(0.0, 50.0))
    row = project(map_beams(beams, Pose(), grid), (0.0, 50.0)).cells[:, -grid.first[1]]
    states = dict(zip((grid.centres_mm(0) - 25).astype(int), row, strict=True))
    for place, state in (
        (1000, State.FREE),
        (2000, State.OCCUPIED),
        (3000, State.FREE),
        (4000, State.OCCUPIED),
        (5000, State.FREE),
        (6000, State.UNKNOWN),
    ):
        assert states[place] == state, place


def test_column_has_the_worst_state_of_its_voxels() -> None:
    odds = np.array([[[0, 0, 0], [-5, 0, 0], [-5, 5, -5], [0, 0.1, 0]]], dtype=np.float32)
    voxels = VoxelMap(grid=VoxelGrid(cell_mm=100.0, first=(3, -2, 0), shape=(1, 4, 3)), log_odds=odds)
    flat = project(voxels, (0.0, 300.0))
    assert flat.cells.tolist() == [[State.UNKNOWN, State.FREE, State.OCCUPIED, State.UNKNOWN]]
    assert project(voxels, (0.0, 50.0)).cells.tolist() == [[State.UNKNOWN, State.FREE, State.FREE, State.UNKNOWN]]
    assert flat.origin_mm == (300.0, -200.0)
    assert flat.centres_mm(1).tolist() == [-150, -50, 50, 150]
    assert voxels.probability()[0, 0, 0] == 0.5


def test_lost_light_makes_cells_less_free_and_no_less_occupied() -> None:
    free, occupied = float(log_odds(0.0, 100.0, 0.0)), float(log_odds(100.0, 0.0, 1.0))
    assert float(log_odds(0.0, 100.0, 0.0, 0.0)) == free
    p = 1.0 / (1.0 + math.exp(-free))
    half = 0.5 * p + 0.25
    assert float(log_odds(0.0, 100.0, 0.0, 100.0)) == pytest.approx(math.log(half / (1 - half)))
    assert float(log_odds(0.0, 5.0, 0.0, 95.0)) > math.log(0.196 / 0.804)  # unknown
    assert float(log_odds(100.0, 0.0, 1.0, 100.0)) == occupied


@pytest.mark.parametrize(("lost", "state"), [(0.0, State.FREE), (0.95, State.UNKNOWN), (1.0, State.UNKNOWN)])
def test_space_before_a_wall_is_free_only_if_its_light_came_back(
    make_layers: MakeLayers, camera: Sensor, lost: float, state: State
) -> None:
    size, dark = 40, (slice(10, 30), slice(10, 30))
    layers = make_layers([4000.0], [1.0], size=size)
    shares = np.zeros((size, size), np.float32)
    shares[dark] = lost
    layers.n_samples[dark] = round(100 * (1 - lost))
    layers = replace(layers, invalid_share=shares)
    beams = beams_from_layers(layers, camera)
    assert beams.samples_lost[20, 20] == pytest.approx(100 * lost)
    assert beams.samples_lost[0, 0] == 0
    grid = plan_grid(beams, Pose(), cell_mm=50.0, height_mm=(0.0, 50.0))
    row = project(map_beams(beams, Pose(), grid), (0.0, 50.0)).cells[:, -grid.first[1]]
    states = dict(zip((grid.centres_mm(0) - 25).astype(int), row, strict=True))
    assert states[2000] == states[3000] == state
