"""Changes of all pixels from a frame to the next: a jump, jitter, and courses that are neither."""

from collections.abc import Callable

import numpy as np
import pytest
from support.recordings import recorded

from tofmix.arrays import FloatArray
from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verification.frame_levels import FrameMedians, find_jump, jitter_mm
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

FRAMES, ERROR_MM = 100, 1.0
TIME_S = np.arange(FRAMES) / 25.0


def medians(course_mm: FloatArray, seed: int, *, jitter: float = 0.0) -> FrameMedians:
    """Levels of frames with this course, each with the error that it states, and jitter, both normal."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, np.hypot(ERROR_MM, jitter), FRAMES)
    return FrameMedians(
        level_mm=course_mm + noise, error_mm=np.full(FRAMES, ERROR_MM), frames=np.arange(FRAMES), sigma_mm=10.0
    )


def test_a_jump_is_found_with_its_frame_and_its_size() -> None:
    for seed in range(20):
        found = find_jump(medians(np.where(np.arange(FRAMES) < 37, 0.0, 15.0), seed), TIME_S)
        assert found is not None
        assert abs(found.frame - 37) <= 1
        assert found.change_mm == pytest.approx(15.0, abs=1.0)


@pytest.mark.parametrize(
    "course",
    [
        lambda t: 0.0 * t,
        lambda t: 5.0 * t,
        lambda t: 4.0 * (t - 2.0) ** 2,
        lambda t: 20.0 * (1.0 - np.exp(-t / 0.7)),
        lambda t: np.clip(20.0 * (t - 1.5), 0.0, 20.0),
        lambda t: np.where((t > 1.2) & (t < 2.6), 15.0, 0.0),
    ],
    ids=["still", "line", "square", "warm-up", "ramp of a second", "there and back"],
)
def test_other_courses_are_no_jump(course: Callable[[FloatArray], FloatArray]) -> None:
    jumps = [find_jump(medians(course(TIME_S), seed), TIME_S) for seed in range(40)]
    assert sum(jump is not None for jump in jumps) <= 1


def test_jitter_is_found_with_its_size_beside_a_jump_and_a_way() -> None:
    course = np.where(np.arange(FRAMES) < 37, 0.0, 60.0) + 200.0 * TIME_S
    found = [jitter_mm(medians(course, seed, jitter=4.0), 0.01) for seed in range(40)]
    assert min(found) > 0.0
    assert np.mean(found) == pytest.approx(4.0, rel=0.05)


def test_noise_of_single_samples_is_no_jitter() -> None:
    found = [jitter_mm(medians(200.0 * TIME_S, seed), 0.01) for seed in range(200)]
    assert sum(size > 0.0 for size in found) <= 8  # 2 at the level of the test, were the median normal


def shaken(model: Model, by_mm: FloatArray) -> Evidence:
    """A recording of the model whose frames are off by so many mm as a whole."""
    seen = recorded(model)
    samples = np.where(seen.samples > 0, np.rint(seen.samples + by_mm[:, None]), np.nan)
    return make_evidence(model, samples.reshape(-1, *model.sensor.shape).astype(np.float32), time_s=seen.time_s)


@pytest.mark.slow
def test_after_a_jump_the_step_names_the_command_that_compares_its_sides_and_no_offset(small: Model) -> None:
    result = reconcile(small, shaken(small, np.where(np.arange(80) < 40, 0.0, 20.0)), Settings(kinds=("range_offset",)))
    assert result.verified.verdict == "unexplained"
    (step,) = result.next_steps
    assert step.startswith("The ranges jump by +20")
    assert "at 4 s: `tofmix reconcile --self=40 MEASURED.h5 -o FOLDER`" in step
    assert not result.suggested


@pytest.mark.slow
def test_frames_that_move_together_are_said_with_their_size_and_no_curve_of_noise_is_advised(small: Model) -> None:
    jitter = np.random.default_rng(3).normal(0.0, 12.0, 80)
    result = reconcile(small, shaken(small, jitter), Settings(kinds=("range_offset",)))
    assert result.verified.verdict == "unexplained"
    (step,) = [s for s in result.next_steps if s.startswith("Whole frames move together, by ")]
    size = float(step.split("by ")[1].split(" mm")[0])
    assert size == pytest.approx(float(np.std(jitter)), rel=0.2)
    assert not any("--noise" in s for s in result.next_steps)
