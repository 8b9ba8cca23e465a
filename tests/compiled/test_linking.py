"""A kernel that others call is compiled inside them, once, and computes the same."""

import math
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.errors import NumbaError

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.kept import config

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


def test_with_another_numba_callees_are_compiled_by_themselves(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tofmix.compiled.kept._folders", lambda: (tmp_path,))  # an earlier run kept its code
    monkeypatch.setattr("tofmix.compiled.jit.LINKS_WITH", ((0, 1), (0, 2)))
    power, total = _kernels()
    plain = total(np.array([0.1, 0.7, 3.3]), 4)
    assert power.signatures != []
    monkeypatch.undo()
    assert plain == _kernels()[1](np.array([0.1, 0.7, 3.3]), 4)


def test_callees_serve_python_several_types_and_errors() -> None:
    power, total = _kernels()
    assert total(np.array([2.0]), 1) == 2.0 + 2.0 + 8.0
    assert power(2.0, 5) == 32.0
    assert len(power.signatures) == 1
    _, total = _kernels()
    with pytest.raises(ValueError, match="times"):
        total(np.array([2.0]), -1)

    @jit
    def double(value: float) -> float:
        return value + value

    @jit
    def both(whole: int, real: float) -> float:
        return double(whole) + double(real)

    assert both(1, 0.25) == 2.5
    assert both(2**60, 0.5) == float(2**61 + 1)


def test_borrowing_kernel_neither_leaks_nor_frees_arrays() -> None:
    @borrowing
    def first_half(values: FloatArray) -> float:
        half, out = values[: len(values) // 2], 0.0
        for value in half:
            out += value
        return out

    @jit
    def sums(rows: int) -> float:
        table = np.arange(4.0 * rows).reshape(rows, 4)
        out = 0.0
        for row in table:
            out += first_half(row)
        return out + first_half(table[0])

    assert sums(3) == (0 + 1) + (4 + 5) + (8 + 9) + (0 + 1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(50):
        sums(250_000)  # 8 MB each
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB
    values = np.ones(4)
    held = sys.getrefcount(values)
    assert first_half(values) == 2.0
    assert sys.getrefcount(values) == held


def test_borrowing_kernel_may_not_return_or_make_arrays() -> None:
    @borrowing
    def half(values: FloatArray) -> FloatArray:
        return values[: len(values) // 2]

    @borrowing
    def same(values: FloatArray) -> FloatArray:
        return values

    @borrowing
    def doubled(values: FloatArray) -> float:
        return float((2.0 * values)[0])

    @jit
    def returned(values: FloatArray) -> float:
        return float(half(values)[0])

    @jit
    def passed_on(values: FloatArray) -> float:
        return float(same(values)[0])

    @jit
    def made(values: FloatArray) -> float:
        return doubled(values)

    with pytest.raises(NumbaError, match="returning of array"):
        returned(np.ones(4))
    with pytest.raises(TypeError, match="same borrows its arrays: it cannot return"):
        passed_on(np.ones(4))
    with pytest.raises(NumbaError, match="NRT required"):
        made(np.ones(4))
    assert half(np.ones(4)).tolist() == [1.0, 1.0]  # from Python it counts
