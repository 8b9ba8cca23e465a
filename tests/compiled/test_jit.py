"""The decorator compiles, whatever the arguments."""

import numpy as np

from tofmix.compiled import jit


def test_a_constant_argument_compiles_nothing_more() -> None:
    @jit.jit
    def shifted(value: int, by: int) -> int:
        return value + by

    @jit.jit
    def both(value: int) -> int:
        return shifted(value, 1) + shifted(1, value) + shifted(value, by=value)

    assert both(2) == 3 + 3 + 4
    callee = getattr(shifted, "get_overload", None)
    assert callee is None or len(callee.__self__._compiled) == 1


def test_compiled_function_returns_its_value() -> None:
    def twice(values: np.ndarray) -> float:
        return float(2 * values.sum())

    assert jit.jit(twice)(np.arange(4.0)) == 12
