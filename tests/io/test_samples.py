"""Values that are no samples, held against the rules written out one by one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.io.samples import no_sample


@given(
    dtype=st.sampled_from(["u1", "u2", "u4", "u8", "i2", "i4", "i8"]),
    raw=st.lists(st.one_of(st.integers(-70000, 70000), st.sampled_from([2**31 - 1, -(2**31), 2**63 - 1])), min_size=1),
)
def test_integers_are_samples_unless_zero_negative_at_an_end_of_their_type_or_a_16_bit_fill(
    dtype: str, raw: list[int]
) -> None:
    ends = np.iinfo(dtype)
    fitting = [value for value in raw if ends.min <= value <= ends.max]
    fills = {ends.max, 32768, 65535} if ends.bits > 8 else {ends.max}
    expected = [value <= 0 or value in fills or value > 10**9 for value in fitting]
    found = no_sample(np.array(fitting, dtype=dtype), unit_mm=1.0)
    assert found.bad.tolist() == expected
    assert sum(found.dropped.values()) == sum(expected)
    assert found.dropped.get("zero", 0) == fitting.count(0)


@pytest.mark.parametrize(("dtype", "unit_mm"), [("f4", 1000.0), ("f8", 1000.0), ("f4", 1.0), ("f8", 10.0)])
def test_floats_that_were_16_bit_fills_are_dropped_in_any_unit(dtype: str, unit_mm: float) -> None:
    values = np.array([65535.0, 65534.0, 32768.0, 0.0, 2e9, -1.0, np.nan, np.inf]) / unit_mm
    found = no_sample(values.astype(dtype), unit_mm=unit_mm)
    assert found.bad.tolist() == [True, False, True, True, True, True, True, True]
    assert list(found.dropped.values()) == [1] * 7


def test_kept_offset_and_given_values_are_counted_apart() -> None:
    values = np.array([0.0, 65535.0, 2e9, -1.0, np.nan, -math.inf])
    found = no_sample(values, unit_mm=1.0, keep_values=True)
    assert found.bad.tolist() == [False, False, False, True, True, True]
    assert found.dropped == {"NaN": 1, "infinite": 1, "negative": 1}
    packed = np.array([-3000, -2001, -2000, -1999, 0, 100], dtype="i2")  # range = 0.5 * packed + 1000 mm
    found = no_sample(packed, unit_mm=0.5, offset_mm=1000.0)
    assert found.bad.tolist() == [True, True, True, False, False, False]
    assert found.dropped == {"zero": 1, "negative": 2}
    values = np.array([100, 200, 300, 9999, 5000], dtype="u2")
    found = no_sample(values, unit_mm=1.0, invalid=(9999.0,), valid_span=(150.0, 4500.0))
    assert found.bad.tolist() == [True, False, False, True, True]
    assert found.dropped == {"value 9999": 1, "outside of the stated valid range": 2}


@pytest.mark.parametrize("dtype", ["u2", "i4", "u8", "f4", "f8"])
@pytest.mark.parametrize("unit_mm", [0.25, 0.5, 1.0])
def test_16_bit_counts_have_the_same_fills_in_any_type_and_unit(dtype: str, unit_mm: float) -> None:
    counts = np.array([4321, 65535, 65534, 32768, 32767, 0]).astype(dtype)
    found = no_sample(counts, unit_mm=unit_mm)
    assert found.bad.tolist() == [False, True, False, True, False, True]
    assert sum(found.dropped.values()) == 3


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_fill_value_in_metres_is_known_in_the_precision_of_its_type(dtype: str) -> None:
    metres = (np.array([1234, 65535, 32768]) / 1000).astype(dtype)
    assert no_sample(metres, unit_mm=1000.0).bad.tolist() == [False, True, True]
