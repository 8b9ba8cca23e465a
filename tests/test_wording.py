"""Counts with their nouns, and numbers without a sign that says nothing."""

import math
import re
from pathlib import Path

import pytest

from tofmix.wording import counted, finite_or_none, number, rounded

PACKAGE = Path(__file__).parents[1] / "tofmix"


def test_one_is_singular_and_all_else_plural() -> None:
    assert [counted(n, "pixel") for n in (0, 1, 2)] == ["0 pixels", "1 pixel", "2 pixels"]
    assert counted(25344, "pixel", ",") == "25,344 pixels"


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (-0.0, "", "0.0"),
        (-0.0, ".2f", "0.00"),
        (-0.004, ".2f", "0.00"),
        (0.004, "+.2f", "0.00"),
        (-0.4, ",.0f", "0"),
        (-0.006, ".2f", "-0.01"),
        (-0.0, "+.3g", "0"),
        (-1e-9, ".3g", "-1e-09"),
        (12.5, "", "12.5"),
        (float("nan"), ".1f", "nan"),
        (float("-inf"), ".1f", "-inf"),
        (-1200.0, ",.0f", "-1,200"),
    ],
)
def test_zero_has_no_sign(value: float, form: str, text: str) -> None:
    assert number(value, form) == text


def test_number_that_is_missing_has_the_text_for_it_and_a_whole_zero_no_digits() -> None:
    assert number(None, ".2f") == "-"
    assert number(None, missing="none") == "none"
    assert number(0, ",") == "0"


def test_values_for_json_are_finite_and_rounded_without_a_negative_zero() -> None:
    assert [finite_or_none(value) for value in (math.nan, math.inf, 1.5, "nan", 2)] == [None, None, 1.5, "nan", 2]
    assert rounded(1.23456789) == 1.23457
    assert rounded(1234.5, 2) == 1200.0
    assert math.copysign(1.0, rounded(-0.0)) == 1.0


def test_only_counted_makes_plurals() -> None:
    """`counted` is the one place: a plural by hand is wrong for 1, or for 0."""
    by_hand = re.compile(r"['\"]s['\"] ?\*|['\"]s['\"] if ")
    found = [
        f"{p}:{n}"
        for p in PACKAGE.rglob("*.py")
        for n, line in enumerate(p.read_text().splitlines(), 1)
        if by_hand.search(line) and p.name not in ("import_.py", "wording.py")
    ]
    assert found == []
