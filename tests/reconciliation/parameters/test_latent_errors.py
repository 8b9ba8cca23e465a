"""Errors in closed form, against draws."""

import numpy as np
import pytest
from scipy.stats import binom

from tofmix.reconciliation.parameters.pattern_errors import share_error


@pytest.mark.parametrize(("frames", "share"), [(12, 0.25), (20, 0.1), (60, 0.4)])
def test_error_of_a_share_covers_the_truth_where_frames_are_few(frames: int, share: float) -> None:
    """By the binomial law, of which the mean square distance in errors is summed exactly."""
    count = np.arange(frames + 1)
    errors = np.array([share_error(k / frames, frames) for k in count])
    square = ((count / frames - share) / errors) ** 2
    assert 0.7 < float(binom.pmf(count, frames, share) @ square) < 1.1
