"""What to do after a verdict."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, reconciled, recorded

from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.search.search_state import Settings
from tofmix.reconciliation.verification.aliases import separate_by
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@pytest.mark.slow
def test_every_verdict_ends_with_a_step(small: Model) -> None:
    kinds = ("range_offset", "surface_pose")
    agree = reconciled(small, kinds=kinds)
    explained = reconciled(small, MAKE["range_offset"](offset_mm=9.0), kinds=kinds)
    unexplained = reconciled(small, MAKE["excess_noise"](factor=2.0), kinds=kinds)
    verdicts = [r.verified.verdict for r in (agree, explained, unexplained)]
    assert verdicts == ["agree", "explained", "unexplained"]
    assert all(
        r.next_steps and r.as_dict()["next_steps"] == list(r.next_steps) for r in (agree, explained, unexplained)
    )
    assert "sigma of all samples would have been seen" in agree.next_steps[-1]
    assert any("--noise auto" in step for step in unexplained.next_steps)


@pytest.mark.slow
def test_a_surface_elsewhere_comes_first_with_the_table_that_moves_it_there(small: Model) -> None:
    """No tried effect moves a surface, so only the step names the other position."""
    moved = replace(
        small,
        surfaces=(
            SurfacePose(surface=small.surfaces[0].name, shift_mm=40.0, yaw_deg=2.0).place(small.surfaces[0], 0.0),
            *small.surfaces[1:],
        ),
    )
    result = reconcile(small, recorded(moved), Settings(kinds=("range_offset", "wiggling")))
    first = result.next_steps[0]
    assert result.verified.verdict == "unexplained"
    assert first.startswith(f'"{small.surfaces[0].name}" is ')
    table = "\n".join(part.strip() for part in first[first.index("[[effect]]") + 10 :].split(";"))
    (effect,) = tomllib.loads("[[effect]]\n" + table)["effect"]
    assert effect["kind"] == "surface_pose"
    assert effect["shift_mm"] == pytest.approx(40.0, abs=1.0)
    assert effect["yaw_deg"] == pytest.approx(2.0, abs=0.2)


def test_few_samples_are_reported_with_the_sufficient_number_of_frames(small: Model) -> None:
    one = replace(small, sensor=replace(small.sensor, rows=1, cols=1))
    result = reconcile(one, recorded(one), Settings(kinds=("range_offset",)))
    assert result.verified.verdict == "unexplained"
    assert result.next_steps[0].startswith("Too few samples: 40 were held out")
    assert "Record " in result.next_steps[0]


def test_repeated_frames_are_left_out_and_counted(small: Model) -> None:
    samples = recorded(small).samples.reshape(-1, *small.sensor.shape).astype(np.float32)
    samples[4::5] = samples[3::5]
    evidence = make_evidence(small, np.where(samples > 0, samples, np.nan), time_s=np.arange(80) / 10.0)
    assert evidence.shape[0] == 64
    result = reconcile(small, evidence, Settings(kinds=("temporal_correlation", "range_offset")))
    assert result.verified.verdict == "agree"
    assert result.next_steps[0].startswith("16 frames of 80 repeated the frame before")


def test_aliases_name_the_recording_that_separates_them(small: Model) -> None:
    board = replace(small, surfaces=(Surface(name="board", center_mm=(0, 0, 1500), size_mm=(9000, 9000)),))
    hidden = MAKE["range_offset"](offset_mm=3.0)
    result = reconcile(board, recorded(board, hidden), Settings(kinds=("range_offset", "surface_pose")))
    assert any("cannot separate" in step and "record a second surface" in step for step in result.next_steps)


def test_advice_that_another_advice_contains_is_left_out() -> None:
    both = separate_by(["wiggling"], ["multipath", "surface_pose"])
    assert both == "the same surface at a second distance, without others around it"
    assert separate_by(["range_offset"], ["surface_pose", "wiggling"]).count("; and ") == 1


@pytest.mark.slow
def test_offset_beside_noise_of_one_part_of_the_image_is_named_and_no_pose_is_advised(small: Model) -> None:
    """More noise everywhere gains little beyond the offset and does not remove the spread, so it is taken back."""
    evidence = recorded(small, MAKE["range_offset"](offset_mm=60.0))
    middle = np.nanmedian(evidence.samples, axis=0)
    noisier = np.where(np.arange(middle.size) % small.sensor.cols < small.sensor.cols // 3, 1.3, 1.0)
    samples = np.rint(middle + noisier * (evidence.samples - middle))
    shown = make_evidence(small, samples.reshape(-1, small.sensor.rows, small.sensor.cols), time_s=evidence.time_s)
    result = reconcile(small, shown, Settings(kinds=("range_offset", "excess_noise")))
    assert result.verified.verdict == "partly_explained"
    assert [n.effect.kind for n in result.named] == ["range_offset"]
    assert abs(result.named[0].effect.offset_mm - 60.0) < 0.6  # type: ignore[attr-defined]
    assert not any("surface_pose" in step for step in result.next_steps)
    assert any("--noise auto" in step for step in result.next_steps)
