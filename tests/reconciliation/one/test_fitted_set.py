"""The value and the evidence of a set, against dense covariances and numerical integration."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from support.recordings import MAKE
from support.search_tasks import MakeTask

from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.simulation.effects.hidden import PatternSpreads, PixelBias
from tofmix.simulation.model import Model

OFFSET = MAKE["range_offset"](offset_mm=4.0)


def _with_offset(task: SearchTask) -> FittedSet:
    (law,) = (law for law in task.laws if law.kind.kind == "range_offset")
    start = law.vector_of(MAKE["range_offset"](offset_mm=2.0))
    return FittedSet(task=task, laws=(law,), x=np.array(start))


@pytest.mark.parametrize("patterned", [False, True])
def test_log_likelihood_integrates_the_static_errors_out(make_task: MakeTask, patterned: bool) -> None:
    task = make_task(("range_offset", "fixed_pattern"), OFFSET)
    s = _with_offset(task)
    spreads = PatternSpreads(4.0, 2.0, 3.0) if patterned else PatternSpreads(0.0, 0.0, 0.0)
    (kind,) = (k for k in task.hidden if isinstance(k.hidden, PixelBias))
    s.pattern = (kind, spreads) if patterned else None
    s.settle_errors(s.x)
    other = s.x + 0.4
    found = s.log_likelihood(other) - s.log_likelihood(s.x)

    samples = task.likelihood.evidence.samples.astype(float)
    rows, cols = task.likelihood.evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    errors = task.low.toarray()
    covariance = errors.T @ errors + spreads.pixel_sigma_mm**2 * np.eye(rows * cols)
    covariance += spreads.column_sigma_mm**2 * (col[:, None] == col) + spreads.row_sigma_mm**2 * (row[:, None] == row)
    values = []
    for x in (other, s.x):
        mixture = task.likelihood.mixture(s.state(x))
        noise = (mixture.of_main(mixture.sigma) ** 2 + 1 / 12) / len(samples)
        away = samples.mean(axis=0) - mixture.of_main(mixture.mean)
        values.append(multivariate_normal.logpdf(away, cov=covariance + np.diag(noise)))
    assert found == pytest.approx(values[0] - values[1], rel=0.01, abs=0.05)


def test_evidence_is_the_integral_of_the_likelihood_over_the_prior(make_task: MakeTask) -> None:
    task = make_task(("range_offset",), OFFSET)
    s = _with_offset(task).fit()
    assert s.members()[0].numbers()["offset_mm"] == pytest.approx(4.0, abs=1.0)
    width = 1.0 / np.sqrt(np.diag(s.hessian))  # type: ignore[arg-type]
    (law,) = s.laws
    offsets = s.x[0] + width[0] * np.linspace(-6, 6, 41)
    values = np.array([s.log_likelihood(np.array([x])) for x in offsets])
    unit_mm = law.make(np.array([1.0])).numbers()["offset_mm"]
    prior = [law.log_density(np.array([x])) + math.log(unit_mm) for x in offsets]
    whole = logsumexp(values + np.array(prior)) + math.log(offsets[1] - offsets[0])
    assert s.evidence == pytest.approx(whole, abs=0.1)
    assert s.score == pytest.approx(s.evidence - task.price_nats(s.keys) - s.laws[0].price_nats)


def test_an_effect_that_is_there_scores_and_one_that_is_not_costs_its_price(make_task: MakeTask) -> None:
    there, absent = make_task(("range_offset",), OFFSET), make_task(("range_offset",))
    gains = [_with_offset(t).fit().score - FittedSet.without_effects(t).fit().score for t in (there, absent)]
    assert gains[0] > 10
    assert -15 < gains[1] < 0


def test_errors_of_the_noise_are_integrated_out(make_task: MakeTask) -> None:
    noise = MAKE["excess_noise"](factor=1.05)
    task = make_task(("excess_noise",), noise)
    law = next(law for law in task.laws if law.kind.kind == "excess_noise")
    s = FittedSet(task=task, laws=(law,), x=law.vector_of(noise)).fit()
    one, other = s.x, law.vector_of(MAKE["excess_noise"](factor=1.02))
    found = s.log_likelihood(other) - s.log_likelihood(one)

    samples = task.likelihood.evidence.samples.astype(float)
    errors = task.low.toarray()
    sd = float(np.sqrt((task.low_width.toarray() ** 2).sum(axis=0)).max())
    widths = np.linspace(-5, 5, 41) * sd
    values = []
    for x in (other, one):
        state = replace(s.state(x), log_width=np.zeros_like(task.null.log_width))
        mixture = task.likelihood.mixture(state)
        middle, scatter = samples.mean(axis=0), ((samples - samples.mean(axis=0)) ** 2).sum(axis=0)
        of_width = []
        for width in widths:
            variance = mixture.of_main(mixture.sigma) ** 2 * np.exp(2 * width) + 1 / 12
            own = multivariate_normal(cov=errors.T @ errors + np.diag(variance / len(samples)))
            inside = -0.5 * (scatter / variance + (len(samples) - 1) * np.log(variance)).sum()
            of_width.append(own.logpdf(middle - mixture.of_main(mixture.mean)) + inside - 0.5 * (width / sd) ** 2)
        values.append(logsumexp(of_width))
    assert found == pytest.approx(values[0] - values[1], rel=0.01)


def test_a_memory_close_to_none_adds_little_more_than_its_gain(make_task: MakeTask) -> None:
    """At 0.01 the noise of a mean grows by two hundredths: no evidence comes of that."""
    task = make_task(("temporal_correlation",), OFFSET)
    null = FittedSet.without_effects(task).fit()
    small = FittedSet(task=task, linked=(MAKE["temporal_correlation"](coefficient=0.01),))
    small.settle_errors(final=True)
    gain = small.log_likelihood(small.x, final=True) - null.log_likelihood(null.x, final=True)
    assert small.memory_nats is not None
    assert gain == pytest.approx(small.memory_nats, abs=1.0)


def test_density_with_a_memory_is_the_same_wherever_it_is_expanded(make_task: MakeTask) -> None:
    memory = MAKE["temporal_correlation"](coefficient=0.8)
    task = make_task(("excess_noise", "temporal_correlation"), memory)
    law = next(law for law in task.laws if law.kind.kind == "excess_noise")
    one, other = (law.vector_of(MAKE["excess_noise"](factor=f)) for f in (1.03, 0.98))
    values = []
    for about in (one, other):
        s = FittedSet(task=task, laws=(law,), x=about, linked=(memory,))
        s.settle_errors(final=True)
        values.append(s.log_likelihood(one, final=True))
    # a nat a pixel of each unit of log sigma would be 0.05 nats a pixel
    assert values[0] == pytest.approx(values[1], abs=0.004 * task.lit.size)


@pytest.mark.parametrize("width_spread", [0.0, 0.2])
def test_density_is_the_same_about_the_errors_of_any_noise(
    make_task: MakeTask, wall: Model, width_spread: float
) -> None:
    """Errors that a model without the noise has stand a tenth off: the first expansion about them is as good."""
    noise = MAKE["excess_noise"](factor=1.25)
    model = replace(wall, sensor=replace(wall.sensor, noise=replace(wall.sensor.noise, width_spread=width_spread)))
    task = make_task(("excess_noise",), noise, of=model)
    law = next(law for law in task.laws if law.kind.kind == "excess_noise")
    x = law.vector_of(noise)
    s = replace(FittedSet.without_effects(task).fit(), laws=(law,), x=x)
    values = []
    for about in (x, x - 0.1, x + 0.1, x):
        s.settle_errors(about)
        values.append(s.log_likelihood(x))
    # the factor that the information about each bias takes changes by a fifth, half a nat a unit of its logarithm
    assert np.ptp(values) < 0.04 * task.lit.size


def test_a_set_with_numbers_of_no_camera_is_refused(make_task: MakeTask) -> None:
    task = make_task(("range_offset",), MAKE["range_offset"](offset_mm=900.0))
    s = _with_offset(task)
    s.x[0] = s.laws[0].vector_of(MAKE["range_offset"](offset_mm=900.0))[0]
    s.fit()
    assert s.score == -math.inf
    assert "beyond that of real cameras" in s.refused


def test_biases_are_told_beside_a_near_return_of_a_tenth(make_task: MakeTask) -> None:
    """Samples of the camera's own cover are of no surface: those of the wall tell its bias as well as without them."""
    near = MAKE["near_return"](share=0.1, range_mm=60.0, sigma_mm=8.0)
    told = []
    for hidden in ((OFFSET,), (OFFSET, near)):
        task = make_task(("range_offset", "near_return"), *hidden)
        laws = [law for law in task.laws if law.kind.kind == "near_return"][: len(hidden) - 1]
        s = FittedSet(task=task, laws=tuple(laws), x=np.concatenate([np.zeros(0), *(w.vector_of(near) for w in laws)]))
        s.settle_errors()
        summary = s.summary()
        assert float(np.median(summary.mean_mm)) == pytest.approx(4.0, abs=0.3)
        told.append(float(summary.bias_information.sum()))
    assert told[1] == pytest.approx(0.9 * told[0], rel=0.03)
