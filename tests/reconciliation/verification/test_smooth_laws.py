"""Smooth laws that no effect is beat the names that come near them.

That they never beat a true one is held by test_workflow.py, for each kind of effect.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import recorded

from tofmix.arrays import FloatArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

KINDS = ("range_offset", "wiggling", "amplitude_walk", "fixed_pattern", "surface_pose")


def _moved(evidence: Evidence, bias_mm: FloatArray) -> Evidence:
    samples = np.where(evidence.samples > 0, np.rint(evidence.samples + bias_mm), 0)
    return replace(evidence, samples=samples.astype(np.uint16))


@pytest.mark.parametrize(
    "kinds",
    [("range_offset", "fixed_pattern"), pytest.param(KINDS, marks=pytest.mark.slow)],
    ids=["few rivals", "all rivals"],
)
@pytest.mark.slow
def test_bias_that_grows_to_the_corners_is_a_law_of_place(small: Model, kinds: tuple[str, ...]) -> None:
    """A lens that bends range outwards."""
    evidence = recorded(small)
    rows, cols = evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    radius = ((row - rows / 2) ** 2 + (col - cols / 2) ** 2) / (rows**2 / 4 + cols**2 / 4)
    result = reconcile(small, _moved(evidence, 12.0 * radius), Settings(kinds=kinds))
    assert (result.verified.verdict, result.named) == ("unexplained", ())
    assert result.verified.law == "place in the image"
    assert "a smooth function of place in the image" in headline(result)


@pytest.mark.slow
def test_scale_that_is_off_by_1_percent_is_a_law_of_range(model: Model) -> None:
    evidence = recorded(model)
    result = reconcile(model, _moved(evidence, 0.01 * evidence.samples.astype(np.float64)), Settings(kinds=KINDS))
    assert (result.verified.verdict, result.named) == ("unexplained", ())
    assert result.verified.law == "range"
    assert "a smooth function of range" in headline(result)


@pytest.mark.slow
def test_bias_that_rises_from_column_to_column_is_no_pattern(model: Model) -> None:
    """The bias is faint: a law of six numbers is less likely than a pattern, a plane is more likely."""
    evidence = recorded(model)
    cols = evidence.image[1]
    slope = 4.0 * (np.arange(evidence.shape[1]) % cols / cols - 0.5)
    result = reconcile(model, _moved(evidence, slope), Settings(kinds=KINDS))
    assert (result.verified.verdict, result.named) == ("unexplained", ())
    assert result.verified.law == "place in the image"
