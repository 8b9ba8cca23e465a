"""Priors are densities, and every number of every effect has one, or is known to have any magnitude."""

import math

import pytest
from scipy.integrate import quad
from scipy.stats import norm, t

from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.multipath import Multipath
from tofmix.simulation.effects.parameter import FARTHEST, Holds, Prior, StudentPrior, UniformPrior, about

ANY_MAGNITUDE = {
    ("amplitude_walk", "reference_amplitude"),
    ("amplitude_walk", "saturation_amplitude"),
    ("dropout", "threshold"),
    ("dropout", "threshold_noise"),
    ("phase_wrapping", "unambiguous_range_mm"),
    ("saturation", "full_well_amplitude"),
    ("stuck_pixels", "value_mm"),
}
"""Numbers in a unit of the camera's own, or fixed by its frequency."""

PRIORS: tuple[tuple[Prior, float, float], ...] = (
    (StudentPrior(scale=25.0), -math.inf, math.inf),
    (StudentPrior(scale=25.0, dof=2), -math.inf, math.inf),
    (StudentPrior(scale=0.2, dof=3, half=True), 0.0, math.inf),
    (about(120.0, 10.0), 0.0, math.inf),
    (StudentPrior(scale=0.7, log=True, half=True), 1.0, math.inf),
    (UniformPrior(low=0.0, high=0.5), 0.0, 0.5),
    (UniformPrior(low=1.0, high=1000.0, log=True), 1.0, 1000.0),
)


@pytest.mark.parametrize(("prior", "low", "high"), PRIORS, ids=[p.words("mm") for p, _, _ in PRIORS])
def test_density_integrates_to_one(prior: Prior, low: float, high: float) -> None:
    def density(x: float) -> float:
        return math.exp(prior.log_density(x))

    middle = max(low, 0.0) + min(prior.farthest[1] - max(low, 0.0), 100.0) / 7
    area = quad(density, low, middle, limit=400)[0] + quad(density, middle, high, limit=400)[0]
    assert area == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("dof", [2.0, 3.0, math.inf])
def test_log_density_and_deviate_are_those_of_scipy(dof: float) -> None:
    prior, law = StudentPrior(scale=4.0, center=1.0, dof=dof), norm if math.isinf(dof) else t(dof)
    for value in (-30.0, 0.0, 1.0, 2.5, 60.0):
        assert prior.log_density(value) == pytest.approx(law.logpdf((value - 1) / 4) - math.log(4), abs=1e-9)
        assert norm.sf(prior.deviate(value)) == pytest.approx(law.sf(abs(value - 1) / 4), rel=1e-6)


@pytest.mark.parametrize("prior", [p for p, _, _ in PRIORS if isinstance(p, StudentPrior)], ids=repr)
def test_farthest_value_is_three_deviations_away(prior: StudentPrior) -> None:
    assert prior.deviate(prior.farthest[1]) == pytest.approx(FARTHEST, abs=1e-6)


def test_half_and_log_priors_have_no_density_outside_their_numbers() -> None:
    assert StudentPrior(scale=1.0, half=True).log_density(-0.1) == -math.inf
    assert about(5.0, 2.0).log_density(0.0) == -math.inf
    assert UniformPrior(low=0.0, high=1.0).log_density(1.1) == -math.inf


def test_number_on_the_other_side_of_half_a_density_is_possible_in_no_camera() -> None:
    half = StudentPrior(scale=25, dof=3, half=True)
    assert half.deviate(10.0) == StudentPrior(scale=25, dof=3).deviate(10.0)
    assert half.deviate(-10.0) == math.inf


def test_every_number_declares_a_prior_or_has_any_magnitude() -> None:
    bare = {
        (kind, p.name)
        for kind, effect in EFFECTS.items()
        for p in effect.parameters().values()
        if p.holds is Holds.NUMBER and p.prior is None
    }
    assert bare == ANY_MAGNITUDE


def test_typical_magnitudes_are_plausible() -> None:
    """The prior is made from them."""
    for kind, effect in EFFECTS.items():
        for p in effect.parameters().values():
            if p.prior is not None and not math.isnan(p.typical[0]):
                assert all(p.prior.deviate(size) <= FARTHEST for size in p.typical), (kind, p.name)


def test_log_prior_of_an_effect_is_the_sum_of_those_of_its_numbers() -> None:
    assert ExcessNoise(factor=2.0).log_prior() == pytest.approx(about(1.0, 2.0).log_density(2.0))
    path = Multipath(surface="wall", share=0.1, extra_path_mm=800.0)
    wanted = sum(prior.log_density(getattr(path, name)) for name, prior in path.priors().items())
    assert path.log_prior() == pytest.approx(wanted)
    assert path.priors().keys() == {"share", "extra_path_mm", "lamp_falloff"}
