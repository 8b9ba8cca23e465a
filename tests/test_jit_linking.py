"""A kernel that others call is compiled inside them, once, and computes the same."""

import math
from typing import Any

import numpy as np
import pytest

from tofmix.arrays import FloatArray
from tofmix.jit import config, jit

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="there is no compiler to look at")


def _kernels() -> tuple[Any, Any]:
    """A kernel, and one that calls it in several ways."""

    @jit
    def power(value: float, times: int = 2) -> float:
        if times < 0:
            raise ValueError("times")
        out = 1.0
        for _ in range(times):
            out *= value
        return out

    @jit
    def total(values: FloatArray, times: int) -> float:
        out = 0.0
        for value in values:
            out += math.sqrt(power(value)) + power(value, times) + power(value, times=3)
        return out

    return power, total


def test_callees_are_linked_and_not_compiled_by_themselves() -> None:
    power, total = _kernels()
    values = np.array([0.1, 0.7, 3.3])
    expected = 0.0
    for value in values:
        expected += math.sqrt(value * value) + 1.0 * value * value * value * value + 1.0 * value * value * value
    assert total(values, 4) == expected  # to the last bit
    assert len(total.signatures) == 1
    assert power.signatures == []


def test_python_can_call_a_callee_too() -> None:
    power, total = _kernels()
    assert total(np.array([2.0]), 1) == 2.0 + 2.0 + 8.0
    assert power(2.0, 5) == 32.0
    assert len(power.signatures) == 1


def test_an_error_in_a_callee_reaches_python() -> None:
    _, total = _kernels()
    with pytest.raises(ValueError, match="times"):
        total(np.array([2.0]), -1)


def test_a_callee_takes_several_types() -> None:
    @jit
    def double(value: float) -> float:
        return value + value

    @jit
    def both(whole: int, real: float) -> float:
        return double(whole) + double(real)

    assert both(1, 0.25) == 2.5
    assert both(2**60, 0.5) == float(2**61 + 1)
