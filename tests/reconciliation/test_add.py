"""Effects that came first give way where a rival does better beside what came later."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconciliation.profiles import numeric
from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.workflow import reconcile
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


@pytest.mark.parametrize(
    "hidden",
    [
        MAKE["surface_pose"](surface="middle", shift_mm=150.0),
        MAKE["surface_pose"](surface="middle", shift_mm=-300.0),
        MAKE["multipath"](surface="middle", share=0.7, extra_path_mm=2500.0),
    ],
    ids=str,
)
def test_a_surface_that_is_measured_far_away_is_found_there(model: Model, record: Record, hidden: Effect) -> None:
    """Where the likelihood has no slope: a pattern of pixels, or random values, would take it all."""
    kinds = ("surface_pose", "multipath", "fixed_pattern", "outliers", "motion")
    result = reconcile(model, record(hidden), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    (named,) = result.named
    assert named.effect.kind == hidden.kind
    truth = numeric(hidden)
    assert all(abs(named.parameters[name] - truth[name]) < 4 * named.stderr[name] for name in truth)


def test_lost_samples_do_not_hide_a_bias(model: Model, record: Record) -> None:
    """What lost samples gain is a thousand times what a wave does, of which it says nothing."""
    hidden = MAKE["dropout"](probability=0.7), MAKE["wiggling"](amplitude_mm=2.5, phase_rad=0.8)
    kinds = ("dropout", "wiggling", "range_offset", "saturation", "fixed_pattern")
    result = reconcile(model, record(*hidden), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == ["dropout", "wiggling"]


@pytest.mark.parametrize("shifts_mm", [(0.4, -0.7, 1.6), (0.63, -1.75, -2.23)])
def test_an_offset_keeps_its_name_where_poses_are_nearly_right(
    model: Model, record: Record, shifts_mm: tuple[float, ...]
) -> None:
    """A walk follows the errors of the poses too: by a tenth of sigma, which is taken as right, or up to two."""
    nearly = replace(
        model,
        surfaces=tuple(
            replace(s, center_mm=(*s.center_mm[:2], s.center_mm[2] + d))
            for s, d in zip(model.surfaces, shifts_mm, strict=True)
        ),
    )
    offset = MAKE["range_offset"](offset_mm=7.0)
    kinds = ("range_offset", "amplitude_walk", "wiggling", "scattering", "fixed_pattern")
    result = reconcile(nearly, record(offset, seed=14), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert [n.effect.kind for n in result.named] == ["range_offset"]


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


@pytest.mark.parametrize("spread", [{"pixel_sigma_mm": 1.0}, {"column_sigma_mm": 0.5}], ids=str)
def test_a_pattern_is_found_that_the_held_out_pixels_are_too_few_for(
    model: Model, record: Record, spread: dict[str, float]
) -> None:
    """A tenth of sigma: the panel sees it, since it looks at all pixels."""
    kinds = ("fixed_pattern", "range_offset", "excess_noise", "stuck_pixels")
    result = reconcile(model, record(MAKE["fixed_pattern"](**spread)), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    (named,) = result.named
    assert named.effect.kind == "fixed_pattern"
    found = numeric(named.effect)
    assert all(found[name] == pytest.approx(value, rel=0.3) for name, value in spread.items())
