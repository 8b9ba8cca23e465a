"""The table of thresholds: interpolated within, held beyond its ends."""

import numpy as np
import pytest
from scipy import interpolate

from tofmix.estimation.learnt.thresholds import GainThresholds, read_gains
from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS


@pytest.fixture
def gains() -> GainThresholds:
    rng = np.random.default_rng(8)
    chances = len(FALSE_ALARMS)
    return GainThresholds(
        log_n=np.log([5.0, 20.0, 300.0]),
        background=np.array([0.0, 0.1, 0.5, 0.8]),
        more=rng.uniform(1.0, 9.0, (3, 4, chances)),
        first=rng.uniform(1.0, 9.0, (3, chances)),
    )


@pytest.mark.parametrize("n", [5.0, 12.0, 20.0, 299.0])
@pytest.mark.parametrize("background", [0.0, 0.05, 0.1, 0.33, 0.8])
def test_gains_are_interpolated_as_scipy_does(gains: GainThresholds, n: float, background: float) -> None:
    out = np.zeros(len(FALSE_ALARMS))
    read_gains(n, background, False, gains, out)  # noqa: FBT003  a kernel's flag
    wanted = interpolate.RegularGridInterpolator((gains.log_n, gains.background), gains.more)((np.log(n), background))
    np.testing.assert_allclose(out, wanted, rtol=1e-12)
    read_gains(n, background, True, gains, out)  # noqa: FBT003  likewise
    for c in range(len(out)):
        assert out[c] == pytest.approx(np.interp(np.log(n), gains.log_n, gains.first[:, c]), rel=1e-12)


def test_gains_past_the_ends_of_the_table_are_those_of_its_ends(gains: GainThresholds) -> None:
    out = np.zeros(len(FALSE_ALARMS))
    read_gains(2.0, 0.95, False, gains, out)  # noqa: FBT003  a kernel's flag
    np.testing.assert_array_equal(out, gains.more[0, -1])
    read_gains(1e5, 0.0, False, gains, out)  # noqa: FBT003  likewise
    np.testing.assert_array_equal(out, gains.more[-1, 0])
