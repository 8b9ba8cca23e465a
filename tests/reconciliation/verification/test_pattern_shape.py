"""What a pattern of pixels is told from: maps that run smoothly, and tilted surfaces."""

import numpy as np
import pytest

from tofmix.reconciliation.verification.pattern_shape import smooth, tilted


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


@pytest.mark.parametrize("lines", [12, 24, 60])
def test_independent_columns_are_never_smooth(lines: int) -> None:
    rng = np.random.default_rng(lines)
    known = np.ones((16, lines), dtype=bool)
    found = [smooth(rng.normal(0, 0.2, known.shape) + rng.normal(0, 1, lines), known) for _ in range(100)]
    assert not any(found)


def test_pattern_of_pixels_with_faint_smooth_columns_is_not_smooth(rng: np.random.Generator) -> None:
    """Poses within the tolerance make the columns smooth; in a pattern of pixels the columns are a small part."""
    known = np.ones((40, 60), dtype=bool)
    assert not smooth(rng.normal(0, 3, known.shape) + np.linspace(0, 1, 60) ** 2, known)


def test_empty_map_is_not_smooth() -> None:
    assert not smooth(np.zeros((8, 8)), np.ones((8, 8), dtype=bool))
    assert not smooth(np.zeros((8, 8)), np.zeros((8, 8), dtype=bool))
