"""The sorting of further layers by what other pixels see, on clusters that are made up."""

import numpy as np
import pytest
from benchmarks.clusters import Cluster, Judged, Kind
from benchmarks.further_layers import FurtherLayers, further_layers

pytestmark = pytest.mark.slow  # of the benchmarks alone

ROWS, COLS = 10, 20
WALL, BOARD = Cluster(3990.0, 4010.0, 5.0), Cluster(1990.0, 2010.0, 5.0)
BESIDE_THE_BOARD, FAR_FROM_IT = 5 * COLS + 3, 5 * COLS + 15


def sorted_with(*further_mm: float, pixel: int = BESIDE_THE_BOARD) -> FurtherLayers:
    """A wall at 4000 mm, a board at 2000 mm in columns 5 to 9; one pixel of the wall has further layers."""
    clusters = [[BOARD] if 5 <= p % COLS < 10 else [WALL] for p in range(ROWS * COLS)]
    judged = Judged(
        kind=np.full(ROWS * COLS, list(Kind).index(Kind.SINGLE)),
        clusters=clusters,
        half_width_mm=5.0,
        step_mm=0.0,
        background=np.zeros(ROWS * COLS),
        faint=np.zeros(ROWS * COLS, dtype=bool),
    )
    range_mm = np.full((ROWS * COLS, 1 + len(further_mm)), np.nan)
    range_mm[:, 0] = [own[0].low_mm + 10.0 for own in clusters]
    range_mm[pixel, 1:] = further_mm
    weight = np.where(np.isfinite(range_mm), 0.1, np.nan)
    weight[:, 0] = 0.9
    return further_layers(judged, (ROWS, COLS), range_mm, weight, low_mm=0.0, high_mm=5000.0)


def test_layer_near_the_pixels_own_cluster_is_beside_it() -> None:
    found = sorted_with(4035.0)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (1, 0, 0, 0)


def test_layer_at_a_cluster_two_columns_away_is_at_a_surface_around() -> None:
    found = sorted_with(2005.0)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 1, 0, 0)
    # Around it the clusters cover 20 mm of the wall and 20 mm of the board.
    assert found.around_by_chance == pytest.approx(40.0 / 5000.0, rel=0.1)


def test_layer_at_a_surface_of_pixels_far_away_is_at_one_of_the_scene() -> None:
    found = sorted_with(2005.0, pixel=FAR_FROM_IT)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 0, 1, 0)
    assert found.around_by_chance == pytest.approx(20.0 / 5000.0, rel=0.1)
    assert found.scene_by_chance == pytest.approx(40.0 / 5000.0, rel=0.1)


def test_layer_at_no_cluster_is_elsewhere_and_its_pixel_counts_once() -> None:
    found = sorted_with(1000.0, 3000.0)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 0, 0, 2)
    assert found.pixels_elsewhere == pytest.approx(1.0 / (ROWS * COLS))


def test_no_further_layer_gives_no_chance() -> None:
    found = sorted_with()
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 0, 0, 0)
    assert np.isnan(found.around_by_chance)
