"""Types that no model key needs yet, and the nearest name."""

import pytest

from tofmix.errors import BadInputError
from tofmix.toml_table import nearest, parse_toml

TABLE = parse_toml("a = true\nb = ['x', 'y']\nc = 1\nd = 'long " + "x" * 90 + "'", source="f")


def test_booleans_and_texts_are_read() -> None:
    assert TABLE.boolean("a") is True
    assert TABLE.texts("b") == ("x", "y")


def test_wrong_types_and_missing_keys_are_refused() -> None:
    with pytest.raises(BadInputError, match=r"^f: c: expected true or false, got a whole number, 1$"):
        TABLE.boolean("c")
    with pytest.raises(BadInputError, match=r"^f: a: expected a list of strings, got a boolean, true$"):
        TABLE.texts("a")
    with pytest.raises(BadInputError, match=r"^f: z: missing$"):
        TABLE.text("z")


def test_long_values_are_cut() -> None:
    with pytest.raises(BadInputError) as caught:
        TABLE.number("d")
    assert len(str(caught.value)) < 110


def test_nearest_lists_all_even_without_a_guess() -> None:
    assert nearest("zzz", ["b", "a"]) == "; known: a, b"
    assert nearest("bb", ["b", "a"]) == '; did you mean "b"? known: a, b'


@pytest.mark.parametrize("text", ["a." * 20_000 + "a = 1", "a = 1 # " + "x" * 5000, "a = 1\n" * 200_000])
def test_texts_that_no_person_writes_are_refused_before_they_are_parsed(text: str) -> None:
    with pytest.raises(BadInputError, match=r"m\.toml: .* are read"):
        parse_toml(text, source="m.toml")
