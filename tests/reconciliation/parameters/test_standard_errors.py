"""Standard errors cover the truth, also where noise is shared; the last step finds the top."""

import warnings
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from support.reconcile_errors import EFFECTS_OF, FRAMES, MEMORY, deviations, scene
from support.recordings import MAKE, Record

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.hidden_states import latent_states
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.likelihood.pixel_pattern import PixelBiases, marginal_pattern
from tofmix.reconciliation.parameters.fits import Fitted, Numbers, Value, inverse, parabola
from tofmix.reconciliation.parameters.polish import polish
from tofmix.reconciliation.parameters.searches import problems
from tofmix.reconciliation.parameters.standard_errors import standard_errors
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.model import Model

if TYPE_CHECKING:
    from tofmix.simulation.effects.range_offset import RangeOffset

FULL = 150.0
"""An amplitude between those of the near board and of the middle one."""

EXACTLY_KNOWN = {"phase_wrapping", "stuck_pixels"}
"""Kinds without a number that has a standard error."""


def test_every_kind_with_errors_is_tried() -> None:
    tried = {effect.kind for effects in EFFECTS_OF.values() for effect in effects}
    assert tried | EXACTLY_KNOWN == set(EFFECTS), "add the kind to EFFECTS_OF in tests/support/reconcile_errors.py"


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), (MEMORY,)], ids=["independent noise", "noise with a memory"])
def test_offset_and_wave_lie_within_their_errors(beside: tuple[Effect, ...]) -> None:
    """32 numbers in 16 recordings: of a normal deviate's squares the mean is 1 +- 0.25, which is 0.35 to 2.0 at 4 such.

    The largest of three estimates is a little too large, so that the lower margin is wider.
    """
    both = EFFECTS_OF["range_offset and wiggling"]
    off = np.array([d for seed in range(16) for d in deviations(scene(), both, beside, seed=seed).values()])
    assert off.size == 3 * 16
    assert 0.35 < (off**2).mean() < 2.0
    assert (np.abs(off) < 3).mean() > 0.9


def fitted_offset(model: Model, likelihood: Likelihood, start_sigma: float) -> Numbers:
    """An offset that was not searched for, so many typical sigmas long."""
    (problem,) = problems("range_offset", likelihood, likelihood.scene.mixture())
    vector = np.array([start_sigma])
    fitted = Fitted(effect=problem.make(vector), vector=vector, problem=problem)
    part = np.arange(FRAMES), np.arange(model.sensor.rows * model.sensor.cols)
    state = replace(likelihood.start(), effects=(fitted.effect,))
    return Numbers(likelihood=likelihood, state=state, fits={0: fitted}, part=part)


def test_polished_offset_is_at_the_top_and_its_error_that_of_a_mean(model: Model, record: Record) -> None:
    evidence = record(MAKE["range_offset"](offset_mm=4.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    found = polish(fitted_offset(model, likelihood, 0.39))
    mixture = likelihood.scene.mixture(found.state.effects)
    slope = likelihood.sums(mixture, found.state, found.part).by_pixel[:, 1:3].sum(axis=0)
    assert abs(slope[0]) < 0.2 * np.sqrt(slope[1])  # a fifth of a standard error from the top
    assert standard_errors(found)[0]["offset_mm"] == pytest.approx(1 / np.sqrt(slope[1]), rel=0.35)


def test_number_whose_neighbour_has_no_density_is_held_without_a_warning(
    model: Model, record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Samples may have no density at all a step away, as where a surface leaves the image: no slope is told there."""
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    numbers = fitted_offset(model, likelihood, 0.1)
    at_start, least_mm = numbers.vector[0], cast("RangeOffset", numbers.state.effects[0]).offset_mm

    def none_below(_: Likelihood, state: ModelState) -> float:
        return 0.0 if cast("RangeOffset", state.effects[0]).offset_mm >= least_mm else -np.inf

    monkeypatch.setattr(Likelihood, "outside", none_below)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert parabola(numbers) is None
        assert polish(numbers).vector[0] == at_start


def test_error_of_an_offset_under_an_unknown_pattern_is_the_patterns_spread_over_root_pixels(
    model: Model, record: Record
) -> None:
    """The error of a constant under a pattern of pixels is the pattern's spread over root pixels, and some more.

    More, because columns and rows may differ too, by what the pixels' pattern would hide.
    """
    evidence = record(
        MAKE["range_offset"](offset_mm=4.0),
        MAKE["fixed_pattern"](pixel_sigma_mm=8.0, column_sigma_mm=0.0, row_sigma_mm=0.0),
    )
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    alone = fitted_offset(model, likelihood, 0.4)
    pattern = MAKE["fixed_pattern"](pixel_sigma_mm=8.0)
    state = replace(alone.state, effects=(*alone.state.effects, pattern))
    both = replace(alone, state=latent_states(likelihood, state, alone.part[0]))
    known = 8.0 / np.sqrt(evidence.shape[1])
    assert 0.95 * known < standard_errors(both)[0]["offset_mm"] < 1.4 * known


def test_errors_of_a_patterns_spreads_are_those_of_normal_theory(model: Model, record: Record) -> None:
    """Pixels' spread: normal theory. Columns' spread: that of their means, which hold the pixels' too."""
    evidence = record(MAKE["fixed_pattern"](pixel_sigma_mm=6.0, column_sigma_mm=5.0, row_sigma_mm=5.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    part = np.arange(FRAMES), np.arange(evidence.shape[1])
    pattern = MAKE["fixed_pattern"](pixel_sigma_mm=6.0, column_sigma_mm=5.0, row_sigma_mm=5.0)
    state = latent_states(likelihood, replace(likelihood.start(), effects=(pattern,)), part[0])
    errors = standard_errors(Numbers(likelihood=likelihood, state=state, fits={}, part=part))[0]
    rows, cols = evidence.image
    assert errors["pixel_sigma_mm"] == pytest.approx(6.0 / np.sqrt(2 * rows * cols), rel=0.2)
    for name, lines, along in (("column_sigma_mm", cols, rows), ("row_sigma_mm", rows, cols)):
        mean_variance = 5.0**2 + 6.0**2 / along
        assert errors[name] == pytest.approx(mean_variance / 5.0 / np.sqrt(2 * lines), rel=0.35)


def test_fitted_map_is_shrunk_by_the_posterior_covariance(rng: np.random.Generator) -> None:
    """The interface that `standard_errors` uses: the posterior covariance times a vector."""
    rows, cols = 4, 5
    information, vector = rng.uniform(0.5, 2.0, rows * cols), rng.normal(size=rows * cols)
    found = PixelBiases(bias=vector / information, information=information, gain=np.zeros(rows * cols))
    row, col = np.divmod(np.arange(rows * cols), cols)
    prior = 4.0 * np.eye(rows * cols) + 1.0 * (col[:, None] == col) + 0.49 * (row[:, None] == row)
    wanted = np.linalg.solve(np.linalg.inv(prior) + np.diag(information), vector)
    np.testing.assert_allclose(marginal_pattern(found, (rows, cols), (2.0, 1.0, 0.7))[1], wanted, rtol=1e-9)


class _Saddle:
    """Two numbers whose log-likelihood is bent both ways between its tops, at (1, 1) and (-1, -1)."""

    first_steps = (0.3, 0.3)
    state = SimpleNamespace(effects=(), linking=())
    likelihood = None

    def __init__(self, *vector: float) -> None:
        self.vector = np.array(vector)

    def moved(self, x: FloatArray) -> "_Saddle":
        return _Saddle(*x)

    def at(self, x: FloatArray) -> Value:
        along, across = x[0] + x[1], x[0] - x[1]
        nothing = np.zeros((1, 4))
        return Value(total=-50.0 * (along**2 - 4.0) ** 2 / 16.0 - 20.0 * across**2, by_pixel=nothing, by_frame=nothing)


def test_polish_moves_from_a_saddle_to_the_top() -> None:
    """At the saddle the predicted gain is negative, which must not count as convergence."""
    start = _Saddle(0.3, 0.2)
    about = parabola(cast("Numbers", start))
    assert about is not None
    assert 0.5 * float(about.slope @ inverse(about.hessian) @ about.slope) < 0
    end = cast("_Saddle", polish(cast("Numbers", start)))
    assert end.at(end.vector).total > start.at(start.vector).total + 30
    assert (end.vector > 0.7).all()
