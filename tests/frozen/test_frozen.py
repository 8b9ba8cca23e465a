"""Results of small inputs are those that the repository holds, to 1e-6 of each value."""

from pathlib import Path

import numpy as np
import pytest

from frozen import stored
from frozen.cases import CASES
from frozen.difference import differences
from frozen.inputs import INPUTS
from frozen.outcome import Outcome, load, save


@pytest.mark.compiled("it learns noise")
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.is_stored])
def test_results_of_small_inputs_are_the_stored_ones(name: str, tmp_path: Path) -> None:
    assert list(differences(stored.read()[name], stored.run(name, tmp_path), relative=1e-6)) == []


def test_every_input_has_a_case_and_every_case_its_inputs() -> None:
    assert {name for case in CASES.values() for name in case.inputs.split()} == set(INPUTS)


OUTCOME: Outcome = {"a": np.array([1.0, np.nan, 0.0]), "t": ["range 12.5 mm", "no number"]}


def test_an_outcome_is_read_as_it_was_saved(tmp_path: Path) -> None:
    save(OUTCOME, tmp_path / "o.zip")
    assert list(differences(OUTCOME, load(tmp_path / "o.zip"))) == []


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"a": np.array([1.0, np.nan, 1e-12])}, "a: 1 of 3 differ"),
        ({"a": np.array([1.0, 2.0, 0.0])}, "a: 1 of 3 differ"),
        ({"a": np.array([1.0 + 1e-5, np.nan, 0.0])}, "a: 1 of 3 differ"),
        ({"a": np.array([1.0, np.nan])}, "a: float64 (3,) has become float64 (2,)"),
        ({"a": np.array([1, 0, 0])}, "a: float64 (3,) has become int64 (3,)"),
        ({"t": ["range 12.6 mm", "no number"]}, "t: -range 12.5 mm"),
        ({"t": ["range 12.5 m", "no number"]}, "t: -range 12.5 mm"),
        ({"t": ["range 12.5 mm"]}, "t: -no number"),
        ({"b": np.zeros(1)}, "b: new"),
    ],
)
def test_a_change_is_a_difference(changed: Outcome, said: str) -> None:
    for relative in (0.0, 1e-6):
        assert next(differences(OUTCOME, {**OUTCOME, **changed}, relative=relative)).startswith(said)


def test_last_bits_differ_only_bit_by_bit() -> None:
    nearly: Outcome = {"a": np.array([1.0 + 1e-9, np.nan, 0.0]), "t": ["range 12.50000001 mm", "no number"]}
    assert list(differences(OUTCOME, nearly, relative=1e-6)) == []
    assert len(list(differences(OUTCOME, nearly))) == 3
