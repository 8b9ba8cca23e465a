import numpy as np
import pytest
from support.unpacking import unpack

from tofmix.report.explorer.packing import pack_numbers


@pytest.mark.parametrize("unit", [1.0, 0.1, 0.01, 1e-4, 1e-6, 1e-7])
def test_numbers_come_back_to_half_a_unit(unit: float) -> None:
    rng = np.random.default_rng(1)
    values = rng.uniform(-1e8, 1e8, 200) * unit
    values[[3, 5, 7]] = np.nan, np.inf, -np.inf
    specs, text = pack_numbers({"first": (np.arange(7, dtype=np.uint8), 1.0), "a": (values.reshape(4, 50), unit)})
    back = unpack({"arrays": specs, "data": text})
    assert back["first"] == list(range(7))
    known = np.isfinite(values)
    assert [value is not None for value in back["a"]] == known.tolist()
    found = np.array([value for value in back["a"] if value is not None])
    np.testing.assert_allclose(found, values[known], rtol=0, atol=0.5001 * unit)


def test_packed_numbers_round_like_text() -> None:
    rng = np.random.default_rng(2)
    values = np.append(rng.uniform(0, 8000, 3000), [0.125, 0.375, 2.5, 1000.005]).astype(np.float32)
    specs, text = pack_numbers({"mm": (values, 0.01)})
    shown = [f"{value:.2f}" for value in unpack({"arrays": specs, "data": text})["mm"]]
    assert shown == [f"{float(value):.2f}" for value in values]


def test_numbers_beyond_all_bounds_are_cut_off() -> None:
    specs, text = pack_numbers({"a": (np.array([1e30, -1e30]), 0.01)})
    high, low = unpack({"arrays": specs, "data": text})["a"]
    assert high is not None
    assert low is not None
    assert high > 2e7
    assert low < -2e7


def test_empty_arrays_are_packed_as_empty_text() -> None:
    specs, text = pack_numbers({"a": (np.empty(0), 1.0)})
    assert unpack({"arrays": specs, "data": text}) == {"a": []}
