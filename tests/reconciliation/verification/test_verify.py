"""The verdict is of the models as they are: no trace of poses that were tried, none of pixels that see nothing."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from support.recordings import MAKE, Record, recorded

from tofmix.reconciliation.comparison.compare import compare
from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.one import outcome
from tofmix.reconciliation.settings import Settings, held_out
from tofmix.reconciliation.verdict import VerdictData
from tofmix.reconciliation.verification.verify import changes_in_time, verify
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.model import Model

SETTINGS = Settings(kinds=("range_offset",))


def test_panel_of_held_out_frames_does_not_depend_on_the_fitted_ones(model: Model, record: Record) -> None:
    evidence, other = record(seed=5), record(seed=6)
    samples = np.where(evidence.fit_frames[:, None], other.samples, evidence.samples)
    panels = []
    for one in (evidence, replace(evidence, samples=samples)):
        added, _ = outcome.named(Likelihood(one, Scene(model, one.time_s)), replace(SETTINGS, max_effects=0))
        panels.append({c.name: c.chi2 for c in added.panel.curves})
    assert panels[0] == panels[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Inconsistent(RangeOffset):
    """An offset whose samples lie 80 mm from its own prediction."""

    def sample(self, samples: FrameSamples, context: Context) -> None:  # noqa: ARG002
        """Add what the prediction does not know."""
        samples.add_bias(80.0)


@pytest.mark.slow
def test_model_whose_simulation_contradicts_its_prediction_is_unexplained(small: Model) -> None:
    evidence = recorded(small, MAKE["range_offset"](offset_mm=8.0))
    likelihood = Likelihood(evidence, Scene(small, evidence.time_s))
    added, _ = outcome.named(likelihood, SETTINGS)
    assert verify(likelihood, added, SETTINGS).verdict == "explained"
    (found,) = added.state.effects
    assert isinstance(found, RangeOffset)
    inconsistent = replace(added.state, effects=(Inconsistent(offset_mm=found.offset_mm),))
    judged = verify(likelihood, replace(added, state=inconsistent), SETTINGS)
    assert judged.verdict == "unexplained"


@pytest.mark.parametrize(
    ("left", "goes_on"),
    [
        ({"memory": 80.0}, True),
        ({"memory": 80.0, "bias": 60.0}, True),
        ({"memory": 60.0, "pattern": 80.0}, False),  # neighbouring frames are alike because of a constant bias
        ({"memory": 4.0}, False),  # too small a part of the gain
        ({"pattern": 80.0}, False),
    ],
)
def test_remaining_memory_is_a_change_in_time_unless_a_bias_remains(
    left: dict[str, float], goes_on: bool, model: Model, record: Record
) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    floor = compare(likelihood, likelihood.start(), held_out(likelihood, SETTINGS), seed=1)
    near = replace(floor, curves=tuple(_curve(statistic, z) for statistic, z in left.items()))
    quiet = replace(floor, curves=())
    found = VerdictData(chosen=(), before=near, after=near, floor=quiet, near=near, alpha=0.01, samples=10_000)
    assert changes_in_time(likelihood.start(), found, 2000.0) == goes_on
    remembers = replace(likelihood.start(), effects=(MAKE["temporal_correlation"](coefficient=0.5),))
    assert not changes_in_time(remembers, found, 2000.0)


def _curve(statistic: str, nats: float) -> Curve:
    """A curve of one bin that is left with so many nats."""
    axis = {"memory": "frame"}.get(statistic, "all")
    one = np.ones(1)
    return Curve(
        statistic=statistic,
        axis=axis,
        lower=one,
        upper=one,
        value=np.sqrt(2 * nats + one),
        variance=one,
        unit="",
        scale_mm=0 * one,
    )
