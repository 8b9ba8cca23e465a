"""CSV with a sample a line: read in pieces where its frames ascend, and whole where they do not."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.errors import BadInputError
from tofmix.io.importers import csv_long
from tofmix.io.importers.base import Frame, SourceRequest
from tofmix.io.importers.csv_long import open_long
from tofmix.io.importers.csv_text import layout_of

NAMES = ["frame", "row", "col", "target", "range", "amplitude", "time"]


def _lines(frames: int, rows: int, cols: int) -> list[str]:
    """A line for each sample; of two targets, the second is missing in every third line."""
    lines = []
    for number, (frame, row, col, target) in enumerate(np.ndindex(frames, rows, cols, 2)):
        if target == 0 or number % 3:
            lines.append(f"{2 * frame + 7},{row},{col},{target},{1000 + number},{number % 50},{frame / 25}")
    return lines


def _read(path: Path, lines: list[str]) -> tuple[tuple[int, ...], int, list[Frame]]:
    path.write_text("\n".join([",".join(NAMES), *lines]))
    source = open_long(path, NAMES, layout_of(path), SourceRequest())
    return source.shape, source.targets, list(source.frames)


@given(
    size=st.tuples(st.integers(1, 6), st.integers(1, 4), st.integers(1, 4)),
    piece=st.integers(1, 40),
    seed=st.integers(0, 9),
)
def test_pieces_of_any_length_and_lines_in_any_order_give_the_same_frames(
    tmp_path_factory: pytest.TempPathFactory, size: tuple[int, int, int], piece: int, seed: int
) -> None:
    path, lines = tmp_path_factory.getbasetemp() / "a.csv", _lines(*size)
    shuffled = [lines[k] for k in np.random.default_rng(seed).permutation(len(lines))]
    whole = _read(path, lines)
    assert whole[:2] == (size, 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_long, "PIECE_LINES", piece)
        for found in (_read(path, lines), _read(path, shuffled)):
            assert found[:2] == whole[:2]
            for one, other in zip(found[2], whole[2], strict=True):
                np.testing.assert_array_equal(one.depth, other.depth)
                np.testing.assert_array_equal(np.asarray(one.amplitude), np.asarray(other.amplitude))
                assert one.time_s == other.time_s
    first = whole[2][0].depth.ravel()
    given_ = [float(line.split(",")[4]) for line in lines if line.startswith("7,")]
    assert sorted(first[np.isfinite(first)]) == sorted(given_)


def test_ascending_frames_are_never_held_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_long, "PIECE_LINES", 10)
    monkeypatch.setattr(csv_long, "MOST_WHOLE_BYTES", 0)
    lines = _lines(30, 2, 2)
    assert len(_read(tmp_path / "a.csv", lines)[2]) == 30
    with pytest.raises(
        BadInputError, match=r"longer than 0 GB, and its frames are not in order.*sort its lines by frame"
    ):
        _read(tmp_path / "a.csv", lines[::-1])


def test_duplicate_samples_in_two_pieces_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_long, "PIECE_LINES", 3)
    lines = ["0,0,0,0,10,1,0", "1,0,0,0,10,1,0", "1,0,1,0,10,1,0", "1,1,0,0,10,1,0", "1,0,1,0,11,1,0"]
    with pytest.raises(BadInputError, match="frame 1 has two samples of row 0, column 1, target 0"):
        _read(tmp_path / "a.csv", lines)


def test_invalid_cell_is_refused_with_the_number_of_samples_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_long, "PIECE_LINES", 4)
    lines = _lines(3, 2, 2)
    lines[6] = "zero," + lines[6].split(",", 1)[1]
    with pytest.raises(BadInputError, match=r"a\.csv: after 4 samples: cannot be read: .*zero"):
        _read(tmp_path / "a.csv", lines)


@pytest.mark.parametrize("text", ["", "# nothing but a remark\n\n"])
def test_a_header_alone_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(BadInputError, match="no sample below its header"):
        _read(tmp_path / "a.csv", text.splitlines())
