"""The verdict is of the models as they are: no trace of poses that were tried, none of pixels that see nothing."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconcile.add import Added, Settings, held_out, ways
from tofmix.reconcile.compare import compare
from tofmix.reconcile.likelihood import Likelihood
from tofmix.reconcile.mixture import Scene
from tofmix.reconcile.name import KINDS
from tofmix.reconcile.verify import _smooth, verify
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model

SETTINGS = Settings(kinds=KINDS)


def test_a_pose_that_was_tried_leaves_no_trace_in_the_gaps(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    start = likelihood.start()
    panel = compare(likelihood, start, held_out(likelihood, SETTINGS), seed=SETTINGS.seed)
    added = Added(state=start, chosen=(), first=(), aliases=(), panel=panel)
    straight = verify(likelihood, added, SETTINGS)
    likelihood.scene.anchor((MAKE["surface_pose"](surface="near", shift_mm=200.0),))
    after_a_trial = verify(likelihood, added, SETTINGS)
    assert after_a_trial.before.gap == straight.before.gap
    assert after_a_trial.floor.gap == straight.floor.gap


def test_the_tolerance_brings_no_chance_of_other_frames_along(model: Model, record: Record) -> None:
    evidence, other = record(seed=5), record(seed=6)
    samples = np.where(evidence.fit_frames[:, None], other.samples, evidence.samples)
    panels = []
    for one in (evidence, replace(evidence, samples=samples)):
        (added,) = ways(Likelihood(one, Scene(model, one.time_s)), replace(SETTINGS, max_effects=0))
        panels.append({c.name: c.chi2 for c in added.panel.curves})
    assert panels[0] == panels[1]


@pytest.mark.parametrize("everywhere", [True, False], ids=["lit", "two boards"])
@pytest.mark.parametrize(("kind", "smooth"), [("pixels", False), ("columns", False), ("lens", True)])
def test_a_pattern_is_smooth_where_a_lens_bends_it(
    kind: str, smooth: bool, everywhere: bool, rng: np.random.Generator
) -> None:
    row, col = np.mgrid[-1:1:36j, -1:1:44j]
    values = rng.normal(0, 0.5, row.shape)
    values += {"pixels": 0.0, "columns": rng.normal(0, 3, 44), "lens": 4 * np.hypot(row, col) ** 4}[kind]
    boards = np.where(col < 0, row < 0.3, row > -0.3)
    known = boards | everywhere
    effect = FixedPattern(map=PixelMap("fixed_pattern.npy", np.where(known, values, 0.0)))
    assert _smooth(effect, known) == smooth
