"""Effects that came first give way where a rival does better beside what came later."""

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconcile.add import Settings
from tofmix.reconcile.profiles import numeric
from tofmix.reconcile.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.effects.stuck_pixels import StuckPixels
from tofmix.simulation.model import Model

IMAGE = (20, 24)
KINDS = ("surface_pose", "multipath", "excess_noise", "temperature_drift")


@pytest.mark.parametrize("shift_mm", [-14.0, 14.0])
def test_a_second_bounce_gives_way_to_a_pose_beside_more_noise(model: Model, record: Record, shift_mm: float) -> None:
    """Alone, the bounce, which widens the noise too, gains more than either."""
    hidden = MAKE["surface_pose"](surface="middle", shift_mm=shift_mm), MAKE["excess_noise"](factor=1.25)
    result = reconcile(model, record(*hidden), Settings(kinds=KINDS))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == ["excess_noise", "surface_pose"]
    pose = next(n for n in result.named if n.effect.kind == "surface_pose")
    assert abs(numeric(pose.effect)["shift_mm"] - shift_mm) < 4 * pose.stderr["shift_mm"]


def test_pixels_that_hold_one_value_do_not_hide_an_offset_in_a_pattern(model: Model, record: Record) -> None:
    """To a pattern they are large biases, and with spreads that large it takes the offset too."""
    stuck = np.full(IMAGE, np.nan, dtype=np.float32)
    stuck.flat[::33] = 3000
    hidden = MAKE["stuck_pixels"](map=PixelMap("stuck.npy", stuck)), MAKE["range_offset"](offset_mm=-6.0)
    kinds = ("range_offset", "fixed_pattern", "stuck_pixels", "amplitude_walk", "surface_pose")
    result = reconcile(model, record(*hidden), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == ["range_offset", "stuck_pixels"]


def _stuck(every: int) -> Effect:
    """Every so many-th pixel at a value of its own, some of which a surface could have."""
    values = np.full(IMAGE, np.nan, dtype=np.float32)
    values.flat[::every] = np.rint(np.linspace(700, 4500, values.flat[::every].size))
    return MAKE["stuck_pixels"](map=PixelMap("stuck.npy", values))


@pytest.mark.parametrize("every", [33, 9, 5])
def test_a_small_offset_is_found_beside_pixels_that_hold_one_value(model: Model, record: Record, every: int) -> None:
    """What each sample of these gains says nothing of how small a gain is a crumb."""
    hidden = _stuck(every), MAKE["range_offset"](offset_mm=1.0)
    result = reconcile(model, record(*hidden), Settings(kinds=("range_offset", "fixed_pattern", "stuck_pixels")))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == ["range_offset", "stuck_pixels"]


@pytest.mark.parametrize("step_mm", [30.0, 80.0])
def test_pixels_that_a_lattice_holds_are_not_stuck(model: Model, record: Record, step_mm: float) -> None:
    kinds = ("quantisation", "stuck_pixels", "fixed_pattern", "range_offset")
    result = reconcile(model, record(MAKE["quantisation"](step_mm=step_mm)), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert [n.effect.kind for n in result.named] == ["quantisation"]


@pytest.mark.parametrize("step_mm", [12.0, 40.0])
def test_stuck_pixels_are_found_on_a_lattice(model: Model, record: Record, step_mm: float) -> None:
    hidden = MAKE["quantisation"](step_mm=step_mm), _stuck(33)
    kinds = ("quantisation", "stuck_pixels", "fixed_pattern", "range_offset")
    result = reconcile(model, record(*hidden), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    found = next(n.effect for n in result.named if isinstance(n.effect, StuckPixels))
    assert found.map is not None
    assert np.isfinite(found.map.values).ravel().nonzero()[0].tolist() == list(range(0, IMAGE[0] * IMAGE[1], 33))
