"""Effects that bring the statistics down to chance, and are nevertheless not named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.likelihood.side_information import AmplitudeInformation
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verification.contradictions import absent, deviate, smooth, tilted
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

TURN = 7494.8


@pytest.mark.parametrize(
    ("errors", "probability"),
    [({"offset_mm": 565.0}, 0.484), ({"offset_mm": 23.0}, 0.159), ({"offset_mm": 1.0}, 0.0), ({}, 0.0)],
)
def test_offset_with_a_large_error_is_likely_absent(errors: dict[str, float], probability: float) -> None:
    assert absent(MAKE["range_offset"](offset_mm=23.0), errors) == pytest.approx(probability, abs=1e-3)


def test_pose_that_only_turns_a_surface_is_not_absent() -> None:
    pose = MAKE["surface_pose"](surface="wall", shift_mm=0.3, yaw_deg=1.0)
    assert absent(pose, {"shift_mm": 0.4, "yaw_deg": 0.02, "pitch_deg": 0.02}) < 1e-6


def test_factor_is_absent_at_one_and_not_at_zero() -> None:
    assert absent(MAKE["excess_noise"](factor=1.01), {"factor": 0.02}) == pytest.approx(0.309, abs=1e-3)


def test_deviate_is_that_of_the_best_known_magnitude() -> None:
    pose = MAKE["surface_pose"](surface="wall", shift_mm=0.3, yaw_deg=1.0)
    assert deviate(pose, {"shift_mm": 0.4, "yaw_deg": 0.02}) == pytest.approx(50.0)
    assert deviate(MAKE["phase_wrapping"](unambiguous_range_mm=7500.0), {}) == math.inf


@pytest.mark.parametrize(("recorded_ratio", "refuted"), [(0.0, True), (math.log(0.5), False)])
def test_amplitudes_that_did_not_fall_refute_a_second_path_in_antiphase(
    recorded_ratio: float, *, refuted: bool
) -> None:
    side = AmplitudeInformation(surface="board", log_ratio=recorded_ratio, scale=0.004, dof=3.0, turn_mm=TURN)
    odds = side.log_odds(MAKE["multipath"](surface="board", share=0.5, extra_path_mm=TURN))
    assert (odds < math.log(0.01)) is refuted
    assert side.log_odds(MAKE["multipath"](surface="wall", share=0.5, extra_path_mm=TURN)) == 0.0
    assert side.log_odds(MAKE["range_offset"](offset_mm=5.0)) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.5, 2.0])
def test_sunlit_board_is_not_explained_by_a_second_path(small: Model, factor: float) -> None:
    """A second path of a whole turn adds noise alone, as the sun does: it has no such size."""
    name = small.surfaces[0].name
    sunny = MAKE["excess_noise"](factor=factor, surface=name)
    kinds = ("multipath", "excess_noise", "surface_pose", "range_offset", "vignetting")
    result = reconcile(small, recorded(small, sunny), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert [(n.effect.kind, n.parameters["surface"]) for n in result.named] == [("excess_noise", name)]
    assert abs(result.named[0].parameters["factor"] - factor) < 4 * result.named[0].stderr["factor"]
    assert not result.aliases


@pytest.mark.slow
def test_effects_that_fit_and_are_refused_are_next_steps(small: Model) -> None:
    """Frames jump by 3 sigma at random: much noise fits, and stands for their means."""
    wall = replace(small, surfaces=small.surfaces[-1:])
    evidence = recorded(wall)
    jumps = np.rint(np.random.default_rng(1).normal(0, 60.0, len(evidence.samples)))
    samples = np.where(evidence.samples > 0, evidence.samples + jumps[:, None], 0).astype(np.uint16)
    result = reconcile(wall, replace(evidence, samples=samples), Settings(kinds=("excess_noise", "range_offset")))
    assert result.verified.verdict == "unexplained"
    assert not result.named


@pytest.mark.parametrize("everywhere", [True, False], ids=["lit", "two boards"])
@pytest.mark.parametrize(
    ("kind", "runs"),
    [("pixels", False), ("columns", False), ("rows", False), ("lens", True), ("kink", True), ("rising rows", True)],
)
def test_map_of_similar_neighbours_is_smooth_and_random_ones_are_not(
    kind: str, runs: bool, everywhere: bool, rng: np.random.Generator
) -> None:
    row, col = np.mgrid[-1:1:36j, -1:1:44j]
    values = rng.normal(0, 0.5, row.shape)
    values += {
        "pixels": 0.0,
        "columns": rng.normal(0, 3, 44),
        "rows": rng.normal(0, 3, (36, 1)),
        "lens": 4 * np.hypot(row, col) ** 4,
        "kink": 2 * np.maximum(col, 0),
        "rising rows": 2 * row,
    }[kind]
    boards = np.where(col < 0, row < 0.3, row > -0.3)
    known = boards | everywhere
    assert smooth(np.where(known, values, 0.0), known) == runs


@pytest.mark.parametrize("seed", range(20))
def test_tilted_board_and_columns_are_separated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:30, :40]
    board = (np.abs(row - 12) < 6) & (np.abs(col - 20) < 6)
    values = rng.normal(0, 1, row.shape) + rng.normal(0, 3, 40)
    known = np.ones(row.shape, dtype=bool)
    assert not tilted(values, known, board.astype(np.int64))
    tilt = np.where(board, 1.2 * (col - 20), 0.0) + rng.normal(0, 1, row.shape)
    assert tilted(tilt, known, board.astype(np.int64))
    assert not tilted(tilt, known & ~board, board.astype(np.int64))
