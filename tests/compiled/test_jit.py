"""The decorator compiles, whatever the arguments."""

from pathlib import Path

import numpy as np
import pytest

from tofmix.compiled import jit


def test_a_constant_argument_compiles_nothing_more_and_a_value_is_returned(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tofmix.compiled.kept._folders", lambda: (tmp_path,))  # an earlier run kept its code

    @jit.jit
    def shifted(value: int, by: int) -> int:
        return value + by

    @jit.jit
    def both(value: int) -> int:
        return shifted(value, 1) + shifted(1, value) + shifted(value, by=value)

    assert both(2) == 3 + 3 + 4
    callee = getattr(shifted, "get_overload", None)
    assert callee is None or len(callee.__self__._compiled) == 1

    def twice(values: np.ndarray) -> float:
        return float(2 * values.sum())

    assert jit.jit(twice)(np.arange(4.0)) == 12
