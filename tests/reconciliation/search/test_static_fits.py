"""Static effects fitted to pixels' biases: least squares that anyone can write down."""

import numpy as np
import pytest
from support.recordings import MAKE, Record

from tofmix.reconciliation.likelihood.joint import joint_likelihood, views
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases
from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.reconciliation.search.name import Trial, begin_trial, candidates
from tofmix.reconciliation.search.static_fits import StaticFits
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.hidden import PatternSpreads
from tofmix.simulation.model import Model


def _trial(model: Model, record: Record, *hidden: Effect) -> Trial:
    likelihood = joint_likelihood([(model, record(*hidden))])
    return begin_trial(likelihood, likelihood.start(), "frames,pixels", 1)


@pytest.mark.parametrize("pattern", [None, PatternSpreads(pixel_sigma_mm=1.0, column_sigma_mm=9.0, row_sigma_mm=2.0)])
def test_static_offset_is_the_weighted_mean_of_biases(
    model: Model, record: Record, pattern: PatternSpreads | None
) -> None:
    trial = _trial(model, record, MAKE["range_offset"](offset_mm=9.0))
    (offset,) = candidates(trial, ("range_offset",))
    assert offset.fitted is not None
    fits = StaticFits(trial.likelihood, trial.state, trial.mixture, trial.fit_part, pattern)
    gain, fitted, _ = fits.fitted(offset.fitted)
    found = pixel_biases(trial.likelihood, trial.mixture, trial.state, trial.fit_part)
    use = np.flatnonzero(found.information > 0)
    row, col = np.divmod(use, trial.likelihood.evidence.image[1])
    spread = (0.0, 0.0, 0.0) if pattern is None else (1.0, 9.0, 2.0)
    covariance = np.diag(1 / found.information[use] + max(spread[0], 1e-6) ** 2)
    covariance += spread[1] ** 2 * (col[:, None] == col) + spread[2] ** 2 * (row[:, None] == row)
    lit = trial.mixture.of_main(trial.mixture.lit)[use].astype(float)
    weighed = np.linalg.solve(covariance, np.stack([lit, found.bias[use]], axis=1))
    mean = (lit @ weighed[:, 1]) / (lit @ weighed[:, 0])
    assert numeric(fitted.effect)["offset_mm"] == pytest.approx(mean, abs=1e-3)
    assert gain == pytest.approx(0.5 * mean**2 * (lit @ weighed[:, 0]), rel=1e-3)


def test_fit_to_two_recordings_equals_least_squares_with_one_common_pattern(model: Model, record: Record) -> None:
    """Against the covariance of all biases, written out."""
    pattern, (pixel, column, row_) = (
        PatternSpreads(pixel_sigma_mm=3.0, column_sigma_mm=5.0, row_sigma_mm=2.0),
        (3, 5, 2),
    )
    hidden = MAKE["range_offset"](offset_mm=9.0)
    pairs = [(model, record(hidden, seed=seed)) for seed in (5, 6)]
    likelihood = joint_likelihood(pairs)
    trial = begin_trial(likelihood, likelihood.start(), "frames,pixels", 1)
    (offset,) = candidates(trial, ("range_offset",))
    assert offset.fitted is not None
    gain, fitted, _ = StaticFits(likelihood, trial.state, trial.mixture, trial.fit_part, pattern).fitted(offset.fitted)
    found = [
        pixel_biases(likelihood, trial.mixture, trial.state, view.part_of_all)
        for view in views(likelihood, trial.mixture, trial.fit_part)
    ]
    use = [np.flatnonzero(f.information > 0) for f in found]
    at = np.concatenate(use)
    row, col = np.divmod(at, likelihood.evidence.image[1])
    covariance = np.diag(np.concatenate([1 / f.information[u] for f, u in zip(found, use, strict=True)]))
    covariance += pixel**2 * (at[:, None] == at) + column**2 * (col[:, None] == col) + row_**2 * (row[:, None] == row)
    lit = trial.mixture.of_main(trial.mixture.lit)[at].astype(float)
    bias = np.concatenate([f.bias[u] for f, u in zip(found, use, strict=True)])
    weighed = np.linalg.solve(covariance, np.stack([lit, bias], axis=1))
    mean = (lit @ weighed[:, 1]) / (lit @ weighed[:, 0])
    assert numeric(fitted.effect)["offset_mm"] == pytest.approx(mean, abs=1e-3)
    assert gain == pytest.approx(0.5 * mean**2 * (lit @ weighed[:, 0]), rel=1e-3)


@pytest.mark.slow
def test_pose_and_offset_fitted_together_have_their_true_numbers(model: Model, record: Record) -> None:
    """A pose that was fitted alone has absorbed a part of the offset."""
    hidden = MAKE["surface_pose"](surface="middle", shift_mm=20.0), MAKE["range_offset"](offset_mm=8.0)
    first = _trial(model, record, *hidden)
    pose = next(c for c in candidates(first, ("surface_pose",)) if getattr(c.effect, "surface", "") == "middle")
    assert pose.fitted is not None
    assert numeric(pose.effect)["shift_mm"] > 25
    second = begin_trial(first.likelihood, pose.state, "frames,pixels", 1)
    (offset,) = candidates(second, ("range_offset",))
    assert offset.fitted is not None
    fits = StaticFits(second.likelihood, second.state, second.mixture, second.fit_part)
    _, fitted, others = fits.fitted(offset.fitted, {0: pose.fitted})
    assert abs(numeric(fitted.effect)["offset_mm"] - 8) < 1
    assert abs(numeric(others[0].effect)["shift_mm"] - 20) < 2
