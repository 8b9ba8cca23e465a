"""Phase and range."""

import pytest
from scipy.constants import c

from tofmix.optics.geometry import unambiguous_range_mm


def test_unambiguous_range_is_half_a_wavelength() -> None:
    assert unambiguous_range_mm(20e6) == pytest.approx(1000 * c / 40e6)


@pytest.mark.parametrize("frequency", [0.0, -1.0, float("nan")])
def test_a_frequency_must_be_above_zero(frequency: float) -> None:
    with pytest.raises(ValueError, match="not above 0"):
        unambiguous_range_mm(frequency)
