"""Effects as vectors: the vector of an effect, and the prior that does not depend on the vector."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t
from support.recordings import MAKE, Record

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.one.coordinates import Law, laws
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.reconciliation.parameters.searches import search_facts
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.parameter import StudentPrior
from tofmix.simulation.effects.search import OwnProblems, Problem
from tofmix.simulation.model import Model


@pytest.fixture(scope="module")
def task(model: Model, record: Record) -> SearchTask:
    evidence = record(MAKE["range_offset"](offset_mm=9.0), MAKE["dropout"](probability=0.02))
    return SearchTask(joint_likelihood([(model, evidence)]), Settings(kinds=KINDS))


def test_every_kind_that_may_hide_nothing_has_a_law(task: SearchTask) -> None:
    found = {law.kind.kind for law in task.laws if law.named}
    always_hides = {kind.kind for kind in task.hidden if not isinstance(kind, OwnProblems)}
    possible = set(KINDS) - always_hides - {"phase_wrapping", "near_return"}  # nothing is a turn away, or near
    assert found == possible
    assert {law.surface for law in task.laws if law.kind.kind == "surface_pose"} == set(task.likelihood.scene.names)


def test_a_form_begins_no_search_of_another_form(task: SearchTask) -> None:
    """Of a drift of two terms that has no start within bounds, the linear form must not begin that of one term."""
    steep = np.arange(100.0), 1e6 * np.arange(100.0)
    facts = replace(search_facts(task.likelihood, task.mixture), course=lambda: steep)
    found = list(laws(KINDS, facts, task.columns.facts, set(), task.likelihood.scene.model.sensor))
    assert "temperature_drift" in {law.kind.kind for law in found}
    assert all(form.form == law.problem.form for law in found for form in law.forms)


def test_vector_of_an_effect_makes_this_effect(task: SearchTask) -> None:
    rng = np.random.default_rng(3)
    for law in task.laws:
        start = np.array(law.problem.starts[0])
        if not law.size:
            continue
        x = start + 0.5 * rng.normal(size=start.size) * np.array(law.problem.steps)
        try:
            wanted = law.make(x)
        except ValueError:
            continue
        found = law.make(law.vector_of(wanted)).numbers()
        for name in wanted.priors():
            value, size = wanted.numbers()[name], abs(wanted.numbers()[name])
            away = found[name] - value
            if name.endswith("_rad"):
                away = math.remainder(away, 2 * math.pi)
            assert abs(away) <= 0.02 * size + 1e-3, (law.key, name, value, found[name])


def _law(kind: str, problem: Problem) -> Law:
    return Law(kind=EFFECTS[kind], surface="", variant=0, problem=problem, forms=(), price_nats=0.0)


def test_prior_at_a_vector_is_the_density_of_the_numbers_times_the_jacobian() -> None:
    def make(x: np.ndarray) -> object:
        return MAKE["wiggling"](amplitude_mm=math.hypot(*x) * 5.0, phase_rad=math.atan2(x[1], x[0]))

    law = _law("wiggling", Problem(make=make, starts=((1.0, 1.0),), steps=(0.3, 0.3)))  # type: ignore[arg-type]
    x = np.array([1.5, 0.7])
    relative, precision = law.prior_at(x)
    gaussian = relative + 0.5 * np.linalg.slogdet(precision)[1] - math.log(2 * math.pi)
    radius = math.hypot(*x)  # d(amplitude, phase) / dx is 5 / radius
    assert gaussian == pytest.approx(law.log_density(x) + math.log(5.0 / radius), abs=1e-3)


@pytest.mark.parametrize("unit", [0.2, 1.0, 30.0])
def test_prior_does_not_depend_on_the_unit_of_the_vector(unit: float) -> None:
    law = _law(
        "range_offset",
        Problem(make=lambda x: MAKE["range_offset"](offset_mm=float(x[0]) * unit), starts=((1.0,),), steps=(0.3,)),
    )
    x = np.array([12.0 / unit])
    relative, precision = law.prior_at(x)
    prior = EFFECTS["range_offset"].parameters()["offset_mm"].prior
    assert isinstance(prior, StudentPrior)
    in_mm = relative + 0.5 * math.log(precision[0, 0] / unit**2 / (2 * math.pi))
    assert in_mm == pytest.approx(prior.log_density(12.0), abs=1e-6)


@pytest.mark.parametrize(("speed", "error"), [(0.0, 0.1), (30.0, 3.0), (600.0, 3.0), (600.0, 30.0), (600.0, 100.0)])
def test_evidence_of_a_speed_is_the_integral_over_its_prior_however_far_it_is(speed: float, error: float) -> None:
    """The prior of speeds has a tail that falls by a power; samples tell the speed to `error`."""
    law = _law(
        "motion",
        Problem(make=lambda x: MAKE["motion"](surface="a", velocity_mm_s=float(x[0])), starts=((1.0,),), steps=(0.3,)),
    )
    prior = EFFECTS["motion"].parameters()["velocity_mm_s"].prior
    assert isinstance(prior, StudentPrior)
    each = np.geomspace(1e-4, 1e5, 100_000)
    at = np.concatenate([-each[::-1], each])
    density = t.pdf(at, prior.dof, scale=prior.scale) * np.exp(-0.5 * ((at - speed) / error) ** 2)
    relative, precision = law.prior_at(np.array([speed]))
    found = relative - 0.5 * math.log((precision[0, 0] + error**-2) / precision[0, 0])
    assert found == pytest.approx(math.log(np.trapezoid(density, at)), abs=0.15)


def test_numbers_beyond_real_cameras_are_named_in_the_reason() -> None:
    law = _law(
        "pixel_crosstalk",
        Problem(make=lambda x: MAKE["pixel_crosstalk"](share=float(x[0])), starts=((0.01,),), steps=(0.01,)),
    )
    assert "share 0.2" in law.at_a_bound(np.array([0.2]))
    assert law.at_a_bound(np.array([2.0])) == "is out of its bounds"
    assert law.at_a_bound(np.array([0.01])) == ""
