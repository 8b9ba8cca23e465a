"""Effects on where surfaces stand: the cast of the moved scene, and many frames of a moving one."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.effect_bench import Bench, effect

from tofmix.errors import BadInputError
from tofmix.simulation.casting.cast import MovingCaster, cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks


def at(model: Model, *centres: tuple[float, float, float]) -> Model:
    """The model without effects, with its surfaces at these centres."""
    surfaces = tuple(replace(s, center_mm=c) for s, c in zip(model.surfaces, centres, strict=True))
    return replace(model, surfaces=surfaces, effects=())


def same(one: Truth, other: Truth) -> None:
    for field in fields(Truth):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize("shift", [0.0, 35.0, -800.0])
def test_a_pose_is_a_shift_along_the_normal(bench: Bench, shift: float) -> None:
    """The near board is pitched by 10 degrees: its normal is (0, -sin, cos)."""
    model = bench.boards(effect("surface_pose", surface="near", shift_mm=shift), frames=1).model
    pitch = np.radians(10)
    x, y, z = model.surfaces[0].center_mm
    moved = (x, y - shift * np.sin(pitch), z + shift * np.cos(pitch))
    expected = cast_scene(at(model, moved, *(s.center_mm for s in model.surfaces[1:])))
    found = cast_scene(model)
    np.testing.assert_array_equal(found.n_modes, expected.n_modes)
    np.testing.assert_allclose(found.range_true, expected.range_true, rtol=1e-6)
    np.testing.assert_allclose(found.weight_true, expected.weight_true, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(shift=st.floats(-500, 500), yaw=st.floats(-60, 60), pitch=st.floats(-60, 60), own=st.floats(-30, 30))
def test_a_turned_pose_gives_the_cast_of_the_model_with_the_edited_surface(
    bench: Bench, shift: float, yaw: float, pitch: float, own: float
) -> None:
    """The shift is along the normal that the surface has before it is turned."""
    still = bench.boards(frames=1).model
    still = replace(still, surfaces=(replace(still.surfaces[0], yaw_deg=own), *still.surfaces[1:]))
    pose = effect("surface_pose", surface="near", shift_mm=shift, yaw_deg=yaw, pitch_deg=pitch)
    near = still.surfaces[0]
    x, y, z = np.array(near.center_mm) + shift * near.rotation()[:, 2]
    edited = replace(near, center_mm=(x, y, z), yaw_deg=own + yaw, pitch_deg=near.pitch_deg + pitch)
    same(
        cast_scene(replace(still, effects=(pose,))), cast_scene(replace(still, surfaces=(edited, *still.surfaces[1:])))
    )


def test_samples_are_those_of_the_moved_scene(bench: Bench) -> None:
    one = effect("surface_pose", surface="middle", shift_mm=300.0)
    moved = bench.boards(one)
    model = at(moved.model, *(s.center_mm for s in moved.model.placed(0.0)))
    block = next(render_blocks(model, cast_scene(model), n_frames=20, seed=3))
    np.testing.assert_array_equal(block.range_mm.reshape(20, -1), moved.stored)


@pytest.mark.parametrize("velocity", [0.0, 150.0, -1500.0])
def test_a_moving_surface_is_elsewhere_in_every_frame(bench: Bench, velocity: float) -> None:
    one = effect("motion", surface="wall", velocity_mm_s=velocity)
    plain, other = bench.wall(frames=10), bench.wall(one, frames=10)
    same(cast_scene(replace(other.model, effects=())), plain.truth)
    slant = np.radians(50)
    for frame in range(10):
        distance = 2500 * np.cos(slant) + velocity * frame / 10
        factor = distance / (2500 * np.cos(slant))  # every range of a plane goes with its distance
        mean = plain.true_mm * factor
        noise = (plain.range_mm[frame] - plain.true_mm) / plain.sigma(plain.true_mm)
        ratio = plain.sigma(mean) / plain.sigma(plain.true_mm)
        error = abs(other.range_mm[frame] - mean - noise * plain.sigma(mean))
        assert (error <= 0.5 * (1 + ratio) + 0.01).all()


@pytest.mark.parametrize("time_s", [0.0, 0.4, 1.7])
def test_a_moving_scene_casts_as_a_still_one(bench: Bench, time_s: float) -> None:
    effects = (
        effect("motion", surface="middle", velocity_mm_s=-900.0),
        effect("surface_pose", surface="far", shift_mm=50.0),
        effect("motion", surface="near", velocity_mm_s=100.0),
    )
    model = bench.boards(*effects, frames=1).model
    caster = MovingCaster(model)
    still = replace(model, surfaces=model.placed(time_s), effects=())
    same(caster.cast(time_s), cast_scene(still).padded(caster.layers))


def test_true_ranges_follow_frame_by_frame(bench: Bench) -> None:
    model = bench.boards(effect("motion", surface="near", velocity_mm_s=700.0), frames=1).model
    truth = cast_scene(model)
    blocks = list(render_blocks(model, truth, n_frames=12, seed=1, block_frames=5))
    ranges = np.concatenate([block.range_true for block in blocks if block.range_true is not None])
    assert ranges.shape == (12, *truth.range_true.shape)
    np.testing.assert_array_equal(ranges[0], truth.range_true)
    np.testing.assert_array_equal(ranges[11], cast_scene(model, time_s=1.1).range_true)


def test_a_surface_that_leaves_the_world_is_refused(bench: Bench) -> None:
    one = effect("motion", surface="wall", velocity_mm_s=99_999.0)
    model = replace(bench.wall(frames=1).model, effects=(one,))
    with pytest.raises(BadInputError, match=r"motion: at 19.9 s: center_mm: .* are not all within \+-1e\+06"):
        render_blocks(model, cast_scene(model), n_frames=200, seed=1)
