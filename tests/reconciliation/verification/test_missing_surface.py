"""A surface that a recording shows and the model lacks is described by its samples; a surface elsewhere is not one."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood, views
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verification.missing_surface import MissingSurface, missing_surface
from tofmix.reconciliation.words import suggested_tables
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

BOX = Surface(name="box", center_mm=(350.0, 150.0, 1900.0), size_mm=(420.0, 380.0))


def shown(model: Model, evidence: Evidence) -> MissingSurface | None:
    likelihood = joint_likelihood([(model, evidence)])
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    (view,) = views(likelihood, likelihood.mixture(likelihood.start()), whole)
    return missing_surface(view, view.scene.model, Settings(kinds=()))


def with_box(model: Model, box: Surface = BOX) -> Evidence:
    return recorded(replace(model, surfaces=(*model.surfaces, box)))


@pytest.mark.parametrize("yaw_deg", [0.0, 25.0])
def test_a_box_before_a_wall_is_found_with_its_place_and_size(small: Model, yaw_deg: float) -> None:
    fine = replace(small, sensor=replace(small.sensor, rows=28, cols=36))
    found = shown(fine, with_box(fine, replace(BOX, yaw_deg=yaw_deg)))
    assert found is not None
    assert found.surface.center_mm == pytest.approx(BOX.center_mm, abs=10.0)
    assert found.surface.size_mm == pytest.approx(BOX.size_mm, abs=15.0)
    assert found.surface.yaw_deg == pytest.approx(yaw_deg, abs=2.0)
    assert found.share > 0.8


@pytest.mark.parametrize("shift_mm", [0.0, -30.0, -300.0, 300.0])
def test_a_surface_at_another_place_is_no_missing_one(small: Model, shift_mm: float) -> None:
    first, *others = small.surfaces
    moved = replace(small, surfaces=(first.shifted(shift_mm), *others))
    assert shown(small, recorded(moved)) is None


@pytest.mark.parametrize(
    "effect",
    [
        MAKE["range_offset"](offset_mm=150.0),
        MAKE["outliers"](probability=0.2),
        MAKE["excess_noise"](factor=3.0),
        MAKE["fixed_pattern"](pixel_sigma_mm=150.0),
    ],
    ids=lambda effect: effect.kind,
)
def test_no_effect_is_a_missing_surface(small: Model, effect: object) -> None:
    assert shown(small, recorded(small, effect)) is None  # type: ignore[arg-type]


def test_a_bias_that_is_smooth_over_the_image_is_no_missing_surface(small: Model) -> None:
    """It leaves five standard deviations in the columns at the sides alone."""
    evidence, (rows, cols) = recorded(small), small.sensor.shape
    law = np.rint(40.0 * (np.linspace(-1.0, 1.0, cols) ** 2 - 1.0 / 3.0))
    samples = (evidence.samples.reshape(-1, rows, cols) + law).reshape(len(evidence.samples), -1).astype(np.uint16)
    assert shown(small, replace(evidence, samples=samples)) is None


@pytest.mark.slow
def test_the_advice_for_a_box_leads_to_agreement(small: Model) -> None:
    evidence, settings = with_box(small), Settings(kinds=("range_offset", "fixed_pattern", "outliers"))
    first = reconcile(small, evidence, settings)
    assert first.verified.verdict == "unexplained"
    (step,) = [s for s in first.next_steps if "where the model has nothing" in s]
    line = step[step.index("[[surface]]") :].replace("[[surface]] ", "").replace("; ", "\n")
    ((recording, surface),) = first.suggested_surfaces
    assert recording == 0
    assert tomllib.loads(line) == tomllib.loads(suggested_tables(first))["surface"][0]
    assert "suggested_model.toml has this: reconcile it with the same recording." in first.next_steps
    assert not any("along its normal" in s or "--noise" in s for s in first.next_steps)
    advised = replace(small, surfaces=(*small.surfaces, surface))
    assert reconcile(advised, evidence, settings).verified.verdict == "agree"
