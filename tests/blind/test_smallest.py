"""The search for the smallest magnitude that is named finds where naming ends, and does nothing twice."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from blind.cases import OPEN_SEED
from blind.smallest import STEPS, Cell, Trials, reconciled, search

CELL = Cell(kind="range_offset", frames=40, rows=16, cols=20)


@pytest.mark.parametrize("last", [None, 0, 5, 11, STEPS])
def test_the_last_step_that_is_named_is_found(last: int | None) -> None:
    asked: list[int] = []

    def often(_: Cell, step: int) -> bool:
        asked.append(step)
        return last is not None and step <= last

    assert search(CELL, often) == last
    assert len(asked) <= 2 + np.log2(STEPS)


@pytest.mark.usefixtures("quick_calibration")
def test_the_device_and_scene_are_those_of_every_step_but_for_the_magnitude() -> None:
    strong, weak = CELL.built(0, 3, OPEN_SEED), CELL.built(4, 3, OPEN_SEED)
    assert strong.device == weak.device
    assert (strong.device.frames, strong.device.rows, strong.device.cols) == (40, 16, 20)
    assert strong.scenes == weak.scenes
    big, small = (b.mechanisms[0].equivalent(b.place())["offset_mm"] for b in (strong, weak))  # type: ignore[attr-defined]
    assert big == pytest.approx(4 * small)


def test_it_gives_up_at_one_miss_too_many_and_asks_nothing_twice(tmp_path: Path) -> None:
    asked: list[int] = []

    def name(cell: Cell, step: int, seed: int, master: int, work: Path) -> list[str]:  # noqa: ARG001
        asked.append(seed)
        return ["range_offset"] if len(asked) > 2 else []

    trials = Trials(path=tmp_path / "smallest.jsonl", master=OPEN_SEED, recordings=20, name=name)
    assert not trials.often(CELL, 2)  # one of 20 may be missed, not two
    assert asked == [0, 1]
    assert not trials.often(CELL, 2)
    assert asked == [0, 1]
    assert trials.often(CELL, 1)
    assert len(asked) == 22
    assert len((tmp_path / "smallest.jsonl").read_text().splitlines()) == 22


@pytest.mark.usefixtures("quick_calibration")
def test_what_the_command_says_is_read_and_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    effects = tmp_path / "effects.json"
    effects.write_text(json.dumps([{"kind": "range_offset", "offset_mm": 5.0}]))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    fake = (sys.executable, "-m", "blind.fake_reconcile", str(effects))
    assert reconciled(CELL, 2, 0, OPEN_SEED, tmp_path / "work", command=fake) == ["range_offset"]
    assert not list((tmp_path / "work").iterdir())
