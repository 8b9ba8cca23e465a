"""The covariance of static errors, against one that is written out and inverted."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.sparse import csr_array

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.one.static_errors import NO_PATTERN, StaticErrors
from tofmix.simulation.effects.hidden import PatternSpreads

IMAGE = (3, 4)
SPREADS = PatternSpreads(pixel_sigma_mm=3.0, column_sigma_mm=2.0, row_sigma_mm=1.5)


class _Dense(NamedTuple):
    """The covariance (n, n) of all known biases: of the errors of a model, of a pattern, and of noise."""

    model: FloatArray
    pattern: FloatArray
    noise: FloatArray
    known: IntArray

    @property
    def whole(self) -> FloatArray:
        return self.model + self.pattern + self.noise


def _case(recordings: int, spreads: PatternSpreads, more: FloatArray, seed: int) -> tuple[StaticErrors, _Dense]:
    rng = np.random.default_rng(seed)
    pixels = IMAGE[0] * IMAGE[1]
    low = rng.normal(0, 2, (3, recordings, pixels))
    information = rng.uniform(0.05, 2.0, (recordings, pixels))
    information[0, 5] = 0.0
    known = np.flatnonzero(information.ravel())
    row, col = np.divmod(np.arange(pixels), IMAGE[1])
    same = np.eye(pixels) * (spreads.pixel_sigma_mm**2 + more)
    same += spreads.column_sigma_mm**2 * (col[:, None] == col) + spreads.row_sigma_mm**2 * (row[:, None] == row)
    some = np.ix_(known, known)
    flat = low.reshape(3, -1)
    dense = _Dense(
        model=(flat.T @ flat)[some],
        pattern=np.tile(same, (recordings, recordings))[some],
        noise=np.diag(1 / information.ravel()[known]),
        known=known,
    )
    return StaticErrors.of(csr_array(flat), information, IMAGE, spreads, more), dense


CASES = pytest.mark.parametrize(
    ("recordings", "spreads", "more"),
    [(1, NO_PATTERN, 0.0), (1, SPREADS, 0.0), (2, NO_PATTERN, 0.0), (2, SPREADS, 0.0), (2, SPREADS, 4.0)],
)


@CASES
def test_products_and_determinant_are_those_of_the_dense_covariance(
    recordings: int, spreads: PatternSpreads, more: float
) -> None:
    errors, dense = _case(recordings, spreads, np.full(12, more), 1)
    vectors = np.random.default_rng(2).normal(0, 5, (4, recordings, 12))
    known = vectors.reshape(4, -1)[:, dense.known]
    assert errors.products(vectors) == pytest.approx(known @ np.linalg.solve(dense.whole, known.T), rel=1e-9)
    assert errors.square(vectors[0]) == pytest.approx(errors.products(vectors)[0, 0])
    of_noise = np.linalg.slogdet(dense.noise)[1]
    assert errors.logdet == pytest.approx(np.linalg.slogdet(dense.whole)[1] - of_noise, rel=1e-9)


@CASES
def test_errors_beside_less_noise_are_those_made_with_its_information(
    recordings: int, spreads: PatternSpreads, more: float
) -> None:
    rng = np.random.default_rng(8)
    low, information = csr_array(rng.normal(0, 2, (3, recordings * 12))), rng.uniform(0.05, 2.0, (recordings, 12))
    factor, bias = rng.uniform(0.5, 3.0, (recordings, 12)), rng.normal(0, 5, (recordings, 12))
    own = np.full(12, more)
    found = StaticErrors.of(low, information, IMAGE, spreads, own).weighed(factor)
    wanted = StaticErrors.of(low, information * factor, IMAGE, spreads, own)
    assert found.logdet == pytest.approx(wanted.logdet, rel=1e-12)
    np.testing.assert_allclose(found.mean(bias), wanted.mean(bias), rtol=1e-12)
    assert found.square(bias) == pytest.approx(wanted.square(bias), rel=1e-12)


@CASES
def test_posterior_means_are_those_of_the_dense_covariance(
    recordings: int, spreads: PatternSpreads, more: float
) -> None:
    errors, dense = _case(recordings, spreads, np.full(12, more), 3)
    bias = np.random.default_rng(4).normal(0, 5, (recordings, 12))
    solved = np.linalg.solve(dense.whole, bias.ravel()[dense.known])
    assert errors.mean(bias).ravel()[dense.known] == pytest.approx((dense.model + dense.pattern) @ solved)
    assert errors.mean_of_model(bias).ravel()[dense.known] == pytest.approx(dense.model @ solved)


def test_biases_of_unknown_pixels_change_nothing() -> None:
    errors, _ = _case(1, SPREADS, np.zeros(12), 5)
    bias = np.random.default_rng(6).normal(0, 5, (1, 12))
    other = bias.copy()
    other[0, 5] = 1e6
    assert errors.square(other) == pytest.approx(errors.square(bias))


def test_errors_without_any_prior_variance_leave_the_noise_alone() -> None:
    information = np.full((1, 12), 0.25)
    errors = StaticErrors.of(csr_array((0, 12)), information, IMAGE)
    bias = np.arange(12.0)[None]
    assert errors.square(bias) == pytest.approx(0.25 * (np.arange(12.0) ** 2).sum())
    assert errors.logdet == pytest.approx(0.0)
    assert not errors.mean(bias).any()
