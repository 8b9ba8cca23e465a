"""The hidden effects are named together, and no effect that imitates them."""

from dataclasses import replace

import numpy as np
import pytest
from support.reconcile_errors import in_errors, scene
from support.recordings import MAKE, reconciled, recorded

from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model

WITHOUT_POSES = ("range_offset", "amplitude_walk", "wiggling", "scattering", "fixed_pattern")


def named_kinds(result: Reconciliation) -> list[str]:
    """Kinds of the named effects, sorted, of a result that is explained."""
    assert result.verified.verdict == "explained"
    return sorted(n.effect.kind for n in result.named)


@pytest.mark.parametrize(
    ("shift_mm", "rows", "cols", "frames"),
    [(14.0, 20, 24, 120), (-14.0, 14, 18, 80)],
    ids=["behind", "before"],
)
@pytest.mark.slow
def test_pose_and_excess_noise_replace_a_second_path_that_gains_more_alone(
    shift_mm: float, rows: int, cols: int, frames: int
) -> None:
    """Alone, a second path that also widens the noise gains more than either; it would be longer than a room."""
    model = scene(rows=rows, cols=cols, frames=frames)
    hidden = MAKE["surface_pose"](surface="middle", shift_mm=shift_mm), MAKE["excess_noise"](factor=1.25)
    kinds = ("surface_pose", "multipath", "excess_noise", "temperature_drift")
    result = reconciled(model, *hidden, kinds=kinds)
    assert named_kinds(result) == ["excess_noise", "surface_pose"]
    pose = next(n for n in result.named if n.effect.kind == "surface_pose")
    assert abs(numeric(pose.effect)["shift_mm"] - shift_mm) < 4 * pose.stderr["shift_mm"]


def stuck(model: Model, every: int, value_mm: float | None = None) -> Effect:
    """Every so many-th pixel at one value; or at a value of its own, some of which a surface could have."""
    values = np.full((model.sensor.rows, model.sensor.cols), np.nan, dtype=np.float32)
    own = np.rint(np.linspace(700, 4500, values.flat[::every].size))
    values.flat[::every] = own if value_mm is None else value_mm
    return MAKE["stuck_pixels"](map=PixelMap("stuck.npy", values))


@pytest.mark.slow
def test_offset_with_pixels_of_one_value_is_not_named_a_pattern(small: Model) -> None:
    """A pattern takes such pixels as large biases; with such large spreads it also absorbs the offset."""
    hidden = stuck(small, 33, 3000.0), MAKE["range_offset"](offset_mm=-6.0)
    kinds = ("range_offset", "fixed_pattern", "stuck_pixels", "amplitude_walk", "surface_pose")
    assert named_kinds(reconciled(small, *hidden, kinds=kinds)) == ["range_offset", "stuck_pixels"]


FAR = (
    MAKE["surface_pose"](surface="middle", shift_mm=150.0),
    MAKE["surface_pose"](surface="middle", shift_mm=-300.0),
    MAKE["multipath"](surface="middle", share=0.3, extra_path_mm=1500.0),
)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", FAR, ids=str)
def test_surface_many_sigma_from_its_model_is_found_with_the_right_effect(small: Model, hidden: Effect) -> None:
    """The likelihood has no slope there; a pattern or random values could explain all samples of the surface."""
    kinds = ("surface_pose", "multipath", "fixed_pattern", "outliers", *(("motion",) if hidden is FAR[0] else ()))
    result = reconciled(small, hidden, kinds=kinds)
    assert named_kinds(result) == [hidden.kind]
    off = in_errors(hidden, result.named[0].effect, result.named[0].stderr)
    assert off.keys() == {name for name, value in numeric(hidden).items() if value}
    assert all(abs(distance) < 4 for distance in off.values()), off


def _shifted(model: Model, shifts_mm: tuple[float, ...]) -> Model:
    """The model with its surfaces farther away."""
    moved = (
        replace(s, center_mm=(*s.center_mm[:2], s.center_mm[2] + d))
        for s, d in zip(model.surfaces, shifts_mm, strict=True)
    )
    return replace(model, surfaces=tuple(moved))


@pytest.mark.slow
def test_offset_is_named_and_no_other_effect_if_poses_are_nearly_right(model: Model) -> None:
    """A walk follows the errors of the poses too: by a tenth of sigma, which is taken as right."""
    evidence = recorded(model, MAKE["range_offset"](offset_mm=7.0), seed=14)
    result = reconcile(_shifted(model, (0.4, -0.7, 1.6)), evidence, Settings(kinds=WITHOUT_POSES))
    assert named_kinds(result) == ["range_offset"]
    assert headline(result).endswith("within --tolerance, which the errors exclude.")


@pytest.mark.parametrize("shifts_mm", [(-0.5, 1.2, -2.0), (0.5, -1.2, 2.2)], ids=str)
def test_poses_within_the_tolerance_agree_in_pixels_that_surfaces_share_too(
    model: Model, shifts_mm: tuple[float, float, float]
) -> None:
    """There the samples of each surface are off by its own error: one bias for the pixel would not do."""
    result = reconcile(_shifted(model, shifts_mm), recorded(model, seed=14), Settings(kinds=KINDS))
    assert result.verified.verdict == "agree"


@pytest.mark.slow
def test_walk_that_follows_wrong_poses_is_no_more_than_an_alias_of_what_is_true(model: Model) -> None:
    """Surfaces are up to 2.9 mm from each other's places, and the tolerance is 1.6 mm.

    A walk of two numbers follows the three places better than an offset does. An offset with a pose is as likely.
    """
    evidence = recorded(model, MAKE["range_offset"](offset_mm=7.0), seed=14)
    result = reconcile(
        _shifted(model, (0.63, -1.75, -2.23)), evidence, Settings(kinds=(*WITHOUT_POSES, "surface_pose"))
    )
    sets = [{kind for kind, _ in s.names} for s in result.added.considered if s.is_alias]
    sets.append(set(named_kinds(result)))
    assert any("range_offset" in s and s <= {"range_offset", "surface_pose"} for s in sets)


@pytest.mark.slow
@pytest.mark.parametrize("every", [9, 33, 5])
def test_small_offset_is_found_with_pixels_of_one_value(model: Model, every: int) -> None:
    """The large gain of the stuck pixels must not count against the small gain of the offset.

    The offset is a third of sigma on the near board, three times the tolerance: half of it gains less than a name costs
    with or without the stuck pixels.
    """
    hidden = stuck(model, every), MAKE["range_offset"](offset_mm=1.5)
    result = reconciled(model, *hidden, kinds=("range_offset", "fixed_pattern", "stuck_pixels"))
    assert named_kinds(result) == ["range_offset", "stuck_pixels"]
