"""A wall a turn of the phase away; the camera has an offset and a bias of each pixel, both far beyond the noise."""

import numpy as np
import pytest
from benchmarks import measured
from benchmarks.measured_parts import walls
from support.search_tasks import MakeTask

from tofmix.reconciliation.one.expansion import Expansion
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.hidden import PatternSpreads
from tofmix.simulation.effects.parameter import PixelMap


def test_pattern_of_many_sigma_is_expanded_about_the_samples(make_task: MakeTask) -> None:
    values = (200.0 * np.random.default_rng(3).standard_normal((8, 10))).astype(np.float32)
    task = make_task((), FixedPattern(map=PixelMap("", values)))
    sigma = task.sigma_mm
    assert np.abs(values).max() > 20 * sigma  # most samples count as outliers of the model as given
    nothing = np.zeros(task.lit.shape)
    found = Expansion.of(task, task.null, PatternSpreads(200.0, 0.0, 0.0), nothing)
    assert found.used.all()
    assert np.abs(found.bias_mm[0] - values.ravel()).max() < sigma  # 60 frames tell each to 0.13 sigma


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "names"),
    [
        pytest.param(13, {"phase_wrapping", "range_offset", "fixed_pattern"}, id="12 pixels"),
        pytest.param(40, {"phase_wrapping", "range_offset", "fixed_pattern"}, id="47 pixels"),
        pytest.param(49, {"phase_wrapping", "fixed_pattern"}, id="a sine that its numbers do not tell gives way"),
    ],
)
def test_folded_wall_is_named_with_offset_and_pattern(number: int, names: set[str]) -> None:
    found = walls.judged(number, measured.SEED)
    assert (found["verdict"], set(found["named"])) == ("explained", names)
