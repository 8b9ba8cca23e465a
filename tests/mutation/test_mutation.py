"""The mutation study draws sound changes, and chooses every test that may notice one."""

import ast
from pathlib import Path

import pytest

from mutation.__main__ import importers, noticing
from mutation.draw import Mutant, draw, mutants_of

SOURCE = '''"""A docstring with 1 + 1."""

from typing import Literal, TypeAlias

Choice: TypeAlias = Literal[1, 2]
LIMIT = 3


def act(value: Literal[4] = 4) -> int:
    """Return 5 + 5."""
    total = value * LIMIT
    if value > 6 and not total:
        raise ValueError(f"{value + 7} is more than 8")
    total += 9  # 10
    return total
'''


def test_mutants_change_code_and_leave_text_annotations_and_errors_alone() -> None:
    made = {mutant.new.strip() for mutant in mutants_of(SOURCE, "tofmix/a.py")}
    assert {"LIMIT = 4", "LIMIT = 2", "total = value / LIMIT", "total -= 9", "pass", "return None"} <= made
    headers = {text.split("\n")[0] for text in made}
    assert {
        f"if {test}:" for test in ("value >= 6 and (not total)", "value > 6 or not total", "value > 7 and (not total)")
    } <= headers
    assert {text for text in headers if text.startswith("def")} == {
        f"def act(value: Literal[4]={n}) -> int:" for n in (3, 5)
    }
    assert not any(f"{n} + {n}" in text for text in made for n in (1, 5) if text.startswith('"'))
    assert all("ValueError(f'{value + 7} is more than 8')" in text or "ValueError" not in text for text in made)


def test_each_mutant_parses_and_one_of_another_source_is_refused() -> None:
    for mutant in mutants_of(SOURCE, "tofmix/a.py"):
        assert ast.dump(ast.parse(mutant.applied(SOURCE))) != ast.dump(ast.parse(SOURCE))
    with pytest.raises(ValueError, match="draw again"):
        mutant.applied("#\n" + SOURCE)


def test_draw_repeats_and_a_longer_one_begins_with_it(tmp_path: Path) -> None:
    (tmp_path / "tofmix").mkdir()
    (tmp_path / "tofmix/a.py").write_text(SOURCE)
    drawn = draw(tmp_path, seed=7, count=4)
    assert drawn[:3] == draw(tmp_path, seed=7, count=3)
    assert len({mutant.at for mutant in drawn}) == 4


def test_unseen_line_has_the_tests_of_all_modules_above(tmp_path: Path) -> None:
    folder = tmp_path / "tofmix"
    (folder / "io").mkdir(parents=True)
    for name, text in (("io/a", "LIMIT = 1"), ("b", "from tofmix.io.a import LIMIT"), ("c", "from tofmix import b")):
        (folder / f"{name}.py").write_text(text)
    lines = {
        "tofmix/io/a.py": {5: ["tests/io/test_a.py::test"], 9: ["tests/test_z.py::test"]},
        "tofmix/c.py": {3: ["tests/test_c.py::test"]},
        "tofmix/d.py": {3: ["tests/test_d.py::test"]},
    }
    found = [
        noticing(
            lines, Mutant(number=0, kind="", file="tofmix/io/a.py", at=k, line=k, end_line=k, old="", new=""), above
        )
        for above in [importers(tmp_path)]
        for k in (1, 5)
    ]
    assert found[0] == ["tests/io/test_a.py::test", "tests/test_c.py::test", "tests/test_z.py::test"]
    assert found[1] == ["tests/io/test_a.py::test"]
