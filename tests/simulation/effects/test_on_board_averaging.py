"""Effects in a camera that averages on board: what acts on each exposure, what on the mean, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from support.effect_bench import Bench, Recorded, effect, light_alone, neutral_values

from tofmix.errors import BadInputError
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.parameter import Holds
from tofmix.simulation.render import recording_sensor, render_blocks

NEUTRAL = {"near_return": {"range_mm": 25.0, "sigma_mm": 5.0}}
REFUSED = {"near_return", "outliers", "temporal_correlation", "saturation", "phase_wrapping"}


def averaged(bench: Bench, *effects: Effect, frames: int = 10) -> Recorded:
    """Eight exposures of 1.2 ms and one of 0.4 ms a frame, of three boards."""
    base = bench.boards(*effects, frames=1)
    model = replace(base.model, sensor=replace(base.model.sensor, default_integration_time_ms=10.0))
    with light_alone():
        block = next(render_blocks(model, cast_scene(model), n_frames=frames, seed=3, averaged=True))
    stored = block.range_mm.reshape(frames, -1)
    amplitude = block.amplitude.reshape(frames, -1).astype(np.float64)
    return replace(base, stored=stored, range_mm=stored.astype(np.float64), amplitude=amplitude)


@pytest.mark.parametrize("kind", sorted(set(EFFECTS) - REFUSED))
def test_zero_magnitude_changes_no_byte(bench: Bench, kind: str) -> None:
    needed = {
        p.name: "near" if p.holds is Holds.SURFACE else 1.0
        for p in EFFECTS[kind].parameters().values()
        if p.required and p.zero is None
    }
    if kind == "multipath":  # its second path is either of this length or by another surface
        needed["extra_path_mm"] = 1.0
    plain, other = averaged(bench), averaged(bench, effect(kind, **needed, **neutral_values(EFFECTS[kind])))
    np.testing.assert_array_equal(other.stored, plain.stored)
    np.testing.assert_array_equal(other.amplitude, plain.amplitude)


def test_bias_of_each_exposure_is_the_bias_of_the_mean(bench: Bench) -> None:
    plain, other = averaged(bench), averaged(bench, effect("range_offset", offset_mm=80.0))
    lit = plain.amplitude > 0
    full = np.broadcast_to((plain.truth.weight_no_return == 0).ravel(), lit.shape)
    moved = (other.range_mm - plain.range_mm)[lit & full]
    # a random value within a frame has no amplitude and takes no part
    assert abs(moved - 80).max() <= 1


def test_read_out_acts_on_the_mean(bench: Bench) -> None:
    other = averaged(bench, effect("quantisation", step_mm=50.0), effect("dropout", threshold=300.0))
    valid = other.stored > 0
    assert not (other.stored[valid] % 50).any()
    np.testing.assert_array_equal(valid, averaged(bench).amplitude >= 300)
    assert 0 < valid.mean() < 1


@pytest.mark.parametrize("kind", sorted(REFUSED))
def test_effects_without_meaning_in_averaged_frames_are_refused(bench: Bench, kind: str) -> None:
    model = bench.boards(effect(kind, **NEUTRAL.get(kind, {}), **neutral_values(EFFECTS[kind])), frames=1).model
    message = rf"\[\[effect\]\] 1: kind: {kind} is not simulated in a camera that averages on board; .* --averaged"
    with pytest.raises(BadInputError, match=message):
        recording_sensor(model, averaged=True)
    with pytest.raises(BadInputError, match=message):
        render_blocks(model, cast_scene(model), n_frames=1, seed=1, averaged=True)
