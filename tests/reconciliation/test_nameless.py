"""Smooth laws that no effect is beat the names that come near them, and never a true one."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.arrays import FloatArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

KINDS = ("range_offset", "wiggling", "amplitude_walk", "fixed_pattern", "surface_pose")


def _moved(evidence: Evidence, bias_mm: FloatArray) -> Evidence:
    samples = np.where(evidence.samples > 0, np.rint(evidence.samples + bias_mm), 0)
    return replace(evidence, samples=samples.astype(np.uint16))


@pytest.mark.parametrize("law", ["place in the image", "range"])
def test_a_law_that_no_effect_is_gets_no_name(model: Model, record: Record, law: str) -> None:
    """A lens that bends range outwards, and a scale that is off by 1 %."""
    evidence = record()
    rows, cols = evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    radius = ((row - rows / 2) ** 2 + (col - cols / 2) ** 2) / (rows**2 / 4 + cols**2 / 4)
    bias = 12.0 * radius if law == "place in the image" else 0.01 * evidence.samples.astype(np.float64)
    result = reconcile(model, _moved(evidence, bias), Settings(kinds=KINDS))
    assert result.verified.verdict == "unexplained"
    assert result.named == ()
    assert result.verified.law == law
    assert f"a smooth law of {law}" in headline(result)


def test_a_bias_that_rises_from_column_to_column_is_no_pattern(model: Model, record: Record) -> None:
    """A faint one: a law of six numbers would pay too much for it."""
    evidence = record()
    cols = evidence.image[1]
    result = reconcile(
        model, _moved(evidence, 4.0 * (np.arange(evidence.shape[1]) % cols / cols - 0.5)), Settings(kinds=KINDS)
    )
    assert (result.verified.verdict, result.named) == ("unexplained", ())
    assert result.verified.law == "place in the image"


TRUE = (
    MAKE["range_offset"](offset_mm=8.0),
    MAKE["amplitude_walk"](scale_mm=8.0, reference_amplitude=100.0, exponent=0.8),
    MAKE["fixed_pattern"](pixel_sigma_mm=3.0, column_sigma_mm=4.0, row_sigma_mm=2.0),
)


@pytest.mark.parametrize("effect", TRUE, ids=[e.kind for e in TRUE])
def test_a_true_effect_keeps_its_name(model: Model, record: Record, effect: Effect) -> None:
    result = reconcile(model, record(effect), Settings(kinds=KINDS))
    assert result.verified.law is None
    assert [n.effect.kind for n in result.named] == [effect.kind]
