"""What a scene predicts depends on the effects alone, wherever they put its surfaces."""

from dataclasses import fields, replace

import numpy as np
import pytest
from support.reconcile_errors import scene
from support.recordings import MAKE

from tofmix.reconciliation.likelihood.mixture import Mixture, Scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

TIME_S = np.arange(40) / 10.0
POSE = MAKE["surface_pose"](surface="near", shift_mm=35.0, yaw_deg=3.0, pitch_deg=-2.0)
MOTION = MAKE["motion"](surface="middle", velocity_mm_s=20.0)
OTHERS = (
    MAKE["surface_pose"](surface="near", shift_mm=-200.0),
    MAKE["range_offset"](offset_mm=5.0),
    MAKE["surface_pose"](surface="wall", shift_mm=90.0, yaw_deg=4.0),
    MAKE["motion"](surface="near", velocity_mm_s=-60.0),
)


@pytest.fixture
def small() -> Model:
    """Three surfaces before 12 x 14 pixels."""
    return scene(rows=12, cols=14, frames=40)


def same(one: Mixture, other: Mixture) -> None:
    for field in fields(Mixture):
        if field.name not in ("shape", "table"):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


@pytest.mark.parametrize(
    "effects", [(), (POSE, MOTION), *(pytest.param(e, marks=pytest.mark.slow) for e in ((POSE,), (MOTION,)))]
)
@pytest.mark.slow
def test_mixture_does_not_depend_on_earlier_predictions(small: Model, effects: tuple[Effect, ...]) -> None:
    expected = Scene(small, TIME_S).mixture(effects)
    used = Scene(small, TIME_S)
    for other in OTHERS:
        used.mixture((other,))
        used.mixture((*effects, other))
    same(used.mixture(effects), expected)


def test_mixture_of_a_pose_is_that_of_the_edited_model(small: Model) -> None:
    edited = replace(small, surfaces=tuple(POSE.place(surface, 0.0) for surface in small.surfaces))
    same(Scene(small, TIME_S).mixture((POSE,)), Scene(edited, TIME_S).mixture())


def test_moving_surface_is_cast_where_it_is_at_each_time(small: Model) -> None:
    moving = Scene(small, TIME_S).mixture((MOTION,))
    for key in range(len(moving.weight)):
        time_s = float((TIME_S - moving.since)[moving.key == key][0])
        moved = replace(small, surfaces=tuple(MOTION.place(surface, time_s) for surface in small.surfaces))
        still = Scene(moved, TIME_S).mixture()
        count = still.weight.shape[1]
        np.testing.assert_allclose(moving.weight[key][:count], still.weight[0], atol=1e-6)
        np.testing.assert_allclose(moving.mean[key][:count], still.mean[0], rtol=1e-6)


def test_rate_of_a_moving_surface_is_the_change_of_its_ranges(small: Model) -> None:
    """A turned surface moves along the normal that it has; the wall fills its pixels at all times."""
    effects = (
        MAKE["surface_pose"](surface="wall", shift_mm=0.0, yaw_deg=5.0),
        MAKE["motion"](surface="wall", velocity_mm_s=-30.0),
    )
    moving = Scene(small, TIME_S).mixture(effects)
    alone = (moving.surface == 2) & (moving.weight > 0.999)
    alone = alone[:-1] & alone[1:]
    apart = TIME_S[-1] / len(moving.weight)
    change = (moving.mean[1:] - moving.mean[:-1]) / apart
    assert alone.sum() > 300
    np.testing.assert_allclose(change[alone], moving.rate[:-1][alone], rtol=5e-3)
