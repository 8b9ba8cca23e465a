"""Light between the surfaces of a corner is named with where it comes from, in the place of poses and second paths."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.recordings import MAKE, reconciled, recorded

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.joint import joint_likelihood, renamed
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.parameters.searches import problems
from tofmix.simulation.effects.search import EFFECT_NATS
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

BACK = Surface(name="back", center_mm=(0, 0, 3300), size_mm=(5000, 4000), reflectivity=0.7)
TABLE = Surface(name="table", center_mm=(0, 600, 2300), size_mm=(3400, 2000), pitch_deg=-90, reflectivity=0.6)
KINDS = ("multipath", "surface_pose", "range_offset", "excess_noise", "surface_offset", "smooth_pattern")


@pytest.fixture(name="corner", scope="module")
def a_table_before_a_wall(small: Model) -> Model:
    return replace(small, surfaces=(BACK, TABLE))


def times_of(model: Model) -> FloatArray:
    return np.asarray(np.arange(model.recording.frames) / model.recording.frame_rate_hz)


@pytest.mark.slow
def test_bounce_is_named_with_its_source_and_share(corner: Model) -> None:
    hidden = MAKE["multipath"](surface="back", share=0.6, from_="table")
    found = reconciled(corner, hidden, kinds=KINDS)
    assert found.verified.verdict == "explained"
    (named,) = found.named
    effect: Any = named.effect
    assert (effect.kind, effect.surface, effect.from_) == ("multipath", "back", "table")
    assert abs(effect.share - 0.6) < 3 * named.stderr["share"] < 0.2
    assert named.parameters.keys() == {"surface", "share", "from"}


def test_bounce_of_another_scene_does_not_act_in_a_recording(corner: Model) -> None:
    bounce = MAKE["multipath"](surface="back", share=0.1, from_="table")
    alone = replace(corner, surfaces=(BACK,))
    assert Scene(alone, times_of(corner)).own((bounce,)) == ()
    assert Scene(corner, times_of(corner)).own((bounce,)) == (bounce,)
    other = renamed(bounce, {"back": "back", "table": "table (2)"})
    assert other.surfaces == {"surface": "back", "from_": "table (2)"}


def test_bounce_costs_as_much_as_one_more_effect(corner: Model) -> None:
    likelihood = joint_likelihood([(corner, recorded(corner))])
    searches = problems("multipath", likelihood, likelihood.scene.mixture())
    prices = {(p.form, p.price_nats, p.parameters) for p in searches}
    lights = {(f"one bounce, light to the power of {falloff}", EFFECT_NATS, 1) for falloff in (0, 1)}
    assert prices == {("", 0.0, 2), *lights}
