"""The mutation study draws sound changes, chooses every test that may notice one, and judges how runs end."""

import ast
from collections.abc import Iterable
from pathlib import Path

import pytest

from mutation.coverage_map import CoverageMap, KnownTest
from mutation.draw import draw, mutants_of
from mutation.names import Names, statement_lines
from mutation.slot import judged

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

PACKAGE = {
    "__init__.py": "",
    "kernels.py": """
from tofmix.compiled.jit import jit

LIMIT = 3.0
UNUSED = 4.0


@jit
def inner(x):
    return x + LIMIT


@jit
def outer(x):
    return inner(x)


def alone(x):
    return x
""",
    "users.py": """
from tofmix import kernels
from tofmix.kernels import alone as one, outer

TABLE = {"outer": outer}
MADE = one(2)


def through_table(x):
    return TABLE["outer"](x)


def through_module(x):
    return kernels.inner(x)


def through_value():
    return MADE


def calls_alone(x):
    return one(x)
""",
}


@pytest.fixture
def top(tmp_path: Path) -> Path:
    """A checkout with a small package."""
    (tmp_path / "tofmix").mkdir()
    for name, text in PACKAGE.items():
        (tmp_path / "tofmix" / name).write_text(text)
    return tmp_path


def _line(file: str, text: str) -> int:
    return next(number for number, line in enumerate(PACKAGE[file].splitlines(), 1) if text in line)


def _map(tests: dict[str, tuple[str, Iterable[int]]], **more: object) -> CoverageMap:
    """A map of tests that each run some lines of a file."""
    lines: dict[str, dict[int, int]] = {}
    for place, (file, run) in enumerate(tests.values()):
        for line in run:
            found = lines.setdefault(f"tofmix/{file}", {})
            found[line] = found.get(line, 0) | 1 << place
    values: dict[str, object] = {"sources": {}, "imports": {}, "readers": set(), "failed": []}
    made = [KnownTest(id=name, seconds=0.1, marks=()) for name in tests]
    return CoverageMap(tests=made, lines=lines, **(values | more))  # type: ignore[arg-type]


def _noticing(found: CoverageMap, top: Path, file: str, text: str) -> set[str]:
    source = (top / "tofmix" / file).read_bytes()
    mutant = next(m for m in mutants_of(source, f"tofmix/{file}") if m.line == _line(file, text))
    return {test.id for test in found.noticing(mutant, Names(top), source)}


def test_mutants_change_code_and_leave_text_annotations_and_errors_alone() -> None:
    changes = {(mutant.old, mutant.new) for mutant in mutants_of(SOURCE.encode(), "tofmix/a.py")}
    assert {("*", "/"), (">", ">="), ("and", "or"), ("not", ""), ("3", "4"), ("6", "7"), ("+=", "-=")} <= changes
    assert {("total += 9", "pass"), ("return total", "return None")} <= changes
    texts = {old for old, _ in changes}
    assert not texts & {"1", "2", "5", "7", "8", "10", "total = value * LIMIT"}
    assert ("4", "5") in changes  # the default value, not the annotation


def test_each_mutant_differs_in_its_own_line_and_keeps_the_number_of_lines() -> None:
    for mutant in mutants_of(SOURCE.encode(), "tofmix/a.py"):
        changed = mutant.applied(SOURCE.encode()).decode()
        pairs = zip(SOURCE.splitlines(), changed.splitlines(), strict=True)
        assert [number for number, (old, new) in enumerate(pairs, 1) if old != new] == [mutant.line]


def test_a_removed_statement_of_several_lines_leaves_the_lines_below_in_place() -> None:
    source = b"def act(values):\n    values.append(\n        1,\n    )\n    return values\n"
    removed = next(mutant for mutant in mutants_of(source, "tofmix/a.py") if mutant.kind == "statement")
    assert removed.applied(source).decode().splitlines() == [
        "def act(values):",
        "    pass",
        "",
        "",
        "    return values",
    ]


def test_a_draw_repeats_and_a_longer_one_begins_with_it(top: Path) -> None:
    drawn = draw(top, seed=7, count=6)
    assert len(drawn) == 6
    assert drawn[:4] == draw(top, seed=7, count=4)
    assert len({(mutant.file, mutant.line) for mutant in drawn}) == len(drawn)
    for mutant in drawn:
        source = (top / mutant.file).read_bytes()
        assert ast.dump(ast.parse(mutant.applied(source))) != ast.dump(ast.parse(source))


def test_a_mutant_of_another_source_is_refused() -> None:
    mutant = mutants_of(SOURCE.encode(), "tofmix/a.py")[0]
    with pytest.raises(ValueError, match="draw again"):
        mutant.applied(b"#" + SOURCE.encode())


def test_a_statement_reaches_from_its_first_line_to_its_last() -> None:
    source = b"@made(\n  1\n)\ndef act(x=(\n  2\n)):\n  if (\n    x\n  ):\n    call(\n      3\n    )\n"
    assert statement_lines(source, 2) == (range(1, 7), False)  # the decorator and the default: at import
    assert statement_lines(source, 8) == (range(7, 10), True)
    assert statement_lines(source, 11) == (range(10, 13), True)


def test_a_seen_line_has_the_tests_that_run_it_alone(top: Path) -> None:
    body = _line("users.py", "return one(x)")
    found = _map({"runs": ("users.py", [body]), "other": ("users.py", [body - 4])})
    source = PACKAGE["users.py"].replace("return one(x)", "return one(x) + 1")
    (top / "tofmix" / "users.py").write_text(source)
    assert _noticing(found, top, "users.py", "return one(x)") == {"runs"}


def test_a_kernel_has_the_tests_of_the_functions_above_it_and_of_files_that_import_it(top: Path) -> None:
    table, module = _line("users.py", 'TABLE["outer"](x)'), _line("users.py", "kernels.inner(x)")
    tests: dict[str, tuple[str, Iterable[int]]] = {
        "table": ("users.py", [table]),
        "module": ("users.py", [module]),
        "unrelated": ("users.py", [_line("users.py", "return one(x)")]),
        "tests/test_it.py::test": ("kernels.py", []),
    }
    found = _map(tests, imports={"tests/test_it.py": {("tofmix.kernels", "inner")}})
    noticing = _noticing(found, top, "kernels.py", "return x + LIMIT")
    assert noticing == {"table", "module", "tests/test_it.py::test"}


def test_a_constant_of_a_kernel_has_the_kernels_tests_and_an_unused_one_has_none(top: Path) -> None:
    found = _map({"table": ("users.py", [_line("users.py", 'TABLE["outer"](x)')])})
    assert _noticing(found, top, "kernels.py", "LIMIT = 3.0") == {"table"}
    assert _noticing(found, top, "kernels.py", "UNUSED = 4.0") == set()


def test_a_function_that_makes_a_value_at_import_has_the_tests_of_the_values_users(top: Path) -> None:
    source = PACKAGE["kernels.py"].replace("    return x\n", "    return x * 2\n")
    (top / "tofmix" / "kernels.py").write_text(source)
    value, calls = _line("users.py", "return MADE"), _line("users.py", "return one(x)")
    found = _map({"value": ("users.py", [value]), "calls": ("users.py", [calls])})
    mutant = next(m for m in mutants_of(source.encode(), "tofmix/kernels.py") if m.old == "*")
    assert {test.id for test in found.noticing(mutant, Names(top), source.encode())} == {"value"}


def test_kernels_that_use_a_changed_one_are_compiled_again(top: Path) -> None:
    names = Names(top)
    above = names.definitions(names.all_above([("tofmix.kernels", "inner")]))
    assert {found.name for found in above if found.kind == "kernel"} == {"inner", "outer"}


def test_a_map_of_an_older_package_keeps_the_tests_of_equal_lines(top: Path) -> None:
    line = _line("users.py", "return MADE")
    sources = {f"tofmix/{name}": text for name, text in PACKAGE.items()}
    found = _map({"value": ("users.py", [line]), "calls": ("users.py", [line + 4])}, sources=sources)
    path = top / "tofmix" / "users.py"
    path.write_text("NEW = 1\n" + PACKAGE["users.py"])
    lines = found.for_package(top).lines["tofmix/users.py"]
    assert lines[line + 1] == 1
    assert lines[1] == 0b11  # a new line has the tests of the file


def test_a_failure_a_hang_and_a_broken_import_count_as_found_and_a_pass_does_not() -> None:
    passed = [["start", "a"], ["end", "a"]]
    assert judged(0, passed).killed_by is None
    assert judged(1, [*passed, ["start", "b"], ["failed", "b"], ["end", "b"]]).killed_by == "b"
    hung = judged(1, [*passed, ["start", "b"]])
    assert (hung.how, hung.killed_by, hung.passed) == ("hung", "b", ["a"])
    assert judged(None, [["start", "a"]]).how == "hung"
    assert judged(4, []).how == "broken"
