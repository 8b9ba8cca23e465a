"""Biases of pixels; columns and rows are eliminated block by block, the same as one dense matrix."""

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.pixel_pattern import LinesFactor, PatternLines, pixel_biases
from tofmix.simulation.model import Model


@pytest.mark.parametrize("offset_mm", [60.0, 150.0])
def test_bias_of_a_pixel_of_two_surfaces_is_that_of_both_and_no_way_from_one_to_the_other(
    small: Model, offset_mm: float
) -> None:
    """The surfaces are 1.1 to 3 m apart; the noise of a sample is 9 mm."""
    evidence, frames = recorded(small, MAKE["range_offset"](offset_mm=offset_mm)), 13
    likelihood = joint_likelihood([(small, evidence)])
    mixture, part = likelihood.mixture(likelihood.start()), (np.arange(frames), np.arange(evidence.shape[1]))
    found = pixel_biases(likelihood, mixture, likelihood.start(), part)
    several = ((mixture.weight[0] > 0).sum(axis=0) > 1) & (found.information > 0)
    assert several.sum() > 30
    assert np.abs(found.bias[several] - offset_mm).max() < 20.0


@pytest.mark.parametrize("shape", [(5, 9), (9, 5), (6, 6)])
@pytest.mark.parametrize("right", [1, 3])
def test_factor_solves_as_the_dense_matrix_does(shape: tuple[int, int], right: int) -> None:
    rng = np.random.default_rng(4)
    cross = rng.uniform(0.1, 1.0, shape)
    diagonal = np.concatenate([cross.sum(axis=1), cross.sum(axis=0)]) + rng.uniform(0.2, 1.0, sum(shape))
    dense = np.diag(diagonal)
    dense[: shape[0], shape[0] :] = cross
    dense[shape[0] :, : shape[0]] = cross.T
    factor = LinesFactor(diagonal, cross)
    values = rng.normal(size=(sum(shape), right)).squeeze()
    np.testing.assert_allclose(factor.solve(values), np.linalg.solve(dense, values), rtol=1e-9)
    assert factor.logdet == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-12)


@pytest.mark.parametrize("image", [(4, 7), (7, 4)])
def test_covariance_is_that_of_pixels_columns_and_rows(image: tuple[int, int]) -> None:
    """Against the whole matrix, pixels without information left out."""
    rng = np.random.default_rng(5)
    information = rng.uniform(0.5, 2.0, image[0] * image[1])
    information[3] = 0.0
    lines = PatternLines(information, image, 1.5)
    root, logdet = lines.factor(2.0, 0.7)
    row, col = np.divmod(lines.use, image[1])
    noise = np.diag(1 / information[lines.use])
    dense = noise + 1.5**2 * np.eye(row.size) + 4.0 * (col[:, None] == col) + 0.49 * (row[:, None] == row)
    b = rng.normal(size=row.size)
    pulled = lines.sums(b / lines.variance)
    quadratic = (b * b / lines.variance).sum() - pulled @ root.solve(pulled)
    assert quadratic == pytest.approx(b @ np.linalg.solve(dense, b), rel=1e-9)
    assert logdet == pytest.approx(np.linalg.slogdet(dense)[1] - np.linalg.slogdet(noise)[1], rel=1e-9)
