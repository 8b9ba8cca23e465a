"""A short recording under a memory holds few independent frames: no name, and the advice says how many more."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.memory import independent
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

KINDS = ("range_offset", "fixed_pattern", "excess_noise", "temporal_correlation")


def recorded(model: Model, *, frames: int, memory: float, offset_mm: float, seed: int) -> tuple[Model, Evidence]:
    """8 x 8 zones before the model's last surface, and its samples with AR(1) noise, drawn here."""
    wall = replace(model.surfaces[-1], size_mm=(9e4, 9e4))
    zones = replace(model, surfaces=(wall,), sensor=replace(model.sensor, rows=8, cols=8))
    blank = make_evidence(zones, np.full((frames, 8, 8), 1000.0))
    mixture = joint_likelihood([(zones, blank)]).scene.mixture()
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((frames, 64))
    for k in range(1, frames):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    samples = mixture.of_main(mixture.mean) + mixture.of_main(mixture.sigma) * noise + offset_mm
    return zones, make_evidence(zones, np.rint(samples).reshape(frames, 8, 8))


@pytest.mark.parametrize("offset_mm", [0.0, 60.0])
def test_ten_frames_of_two_independent_ones_get_no_name_and_the_number_to_record(
    model: Model, offset_mm: float
) -> None:
    zones, evidence = recorded(model, frames=10, memory=0.65, offset_mm=offset_mm, seed=4)
    found = reconcile(zones, evidence, Settings(kinds=KINDS)).as_dict()
    assert found["verdict"] == "unexplained"
    assert found["effects"] == []
    (few,) = (step for step in found["next_steps"] if step.startswith("Too few samples"))
    more = int(few.partition("Record ")[2].split()[0])
    assert 2 <= more <= 20


def test_eight_independent_frames_are_enough_for_an_offset(model: Model) -> None:
    zones, evidence = recorded(model, frames=8, memory=0.0, offset_mm=60.0, seed=4)
    found = reconcile(zones, evidence, Settings(kinds=KINDS)).as_dict()
    assert (found["verdict"], [e["kind"] for e in found["effects"]]) == ("explained", ["range_offset"])


@pytest.mark.parametrize(("memory", "worth"), [(0.0, 1.0), (0.65, 0.3)])
def test_share_of_independent_samples_follows_the_memory_of_the_scores(
    model: Model, memory: float, worth: float
) -> None:
    """Of 12 frames under 0.65: 1 / (1 + 2 sum of (1 - k / 12) 0.65^k) = 0.28."""
    likelihood = joint_likelihood([recorded(model, frames=12, memory=memory, offset_mm=0.0, seed=4)])
    assert independent(likelihood, likelihood.start(), 0.01, 1) == pytest.approx(worth, abs=0.08)


def test_pixels_without_a_surface_do_not_count_as_independent(model: Model) -> None:
    """Most of the image sees nothing: the memory of the others decides. Those at edges share less of the noise."""
    zones, evidence = recorded(model, frames=12, memory=0.65, offset_mm=0.0, seed=4)
    few = replace(zones, surfaces=(replace(zones.surfaces[0], size_mm=(500.0, 500.0)),))
    likelihood = joint_likelihood([(few, evidence)])
    remembered = replace(likelihood.start(), effects=(MAKE["temporal_correlation"](coefficient=0.65),))
    lit = likelihood.mixture(remembered).lit.any(axis=(0, 1))
    assert 4 <= lit.sum() < 0.4 * lit.size
    assert 0.25 < independent(likelihood, remembered, 0.01, 1) < 0.45
