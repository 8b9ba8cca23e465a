"""Cameras of one row, or of one column: line scanners. What needs two lines of an image has nothing to say there."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.reconcile_errors import scene
from support.recordings import MAKE

from tofmix.reconciliation.comparison.compare import Compared
from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks

SHAPES = [(1, 24), (24, 1)]
FRAMES = 80


def _record(model: Model, *effects: Effect, frames: int = FRAMES) -> Evidence:
    real = replace(model, effects=effects)
    (block,) = render_blocks(real, cast_scene(real), n_frames=frames, seed=5, block_frames=frames)
    range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
    return make_evidence(model, range_mm, time_s=block.time_s)


def _axes(panel: Compared, statistic: str) -> set[str]:
    return {curve.axis for curve in panel.curves if curve.statistic == statistic and curve.dof}


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols"), SHAPES)
def test_offset_is_found_and_a_right_model_agrees(rows: int, cols: int) -> None:
    model = scene(rows=rows, cols=cols)
    right = reconcile(model, _record(model), Settings(kinds=KINDS))
    assert right.verified.verdict == "agree"
    found = reconcile(model, _record(model, MAKE["range_offset"](offset_mm=30.0)), Settings(kinds=KINDS))
    assert found.verified.verdict == "explained"
    sets = [{named.effect.kind for named in found.named}, *({k for k, _ in s} for a in found.aliases for s in a.sets)]
    assert {"range_offset"} in sets
    for result in (right, found):
        assert np.isfinite([c.distance for c in result.verified.before.curves]).all()
        json.dumps(result.as_dict(), allow_nan=False)


def test_panel_of_rows_and_columns_has_the_statistics_of_both() -> None:
    model = scene(rows=12, cols=16)
    panel = reconcile(model, _record(model), Settings(kinds=("range_offset",))).verified.before
    for statistic in ("common_mode", "neighbour_correlation", "bias"):
        assert {"row", "col"} <= _axes(panel, statistic)
