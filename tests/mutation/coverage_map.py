"""Which tests run which lines, from what `mutation.follow` wrote, and which tests can notice a mutant."""

import ast
import difflib
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from mutation.draw import Mutant
from mutation.names import Name, Names, statement_lines

_OUTLIVES_S = 1.0
"""A process that ends later than this after its test serves other tests too."""
_CHEAP_S = 0.5
"""Tests that read the package's source are run for every mutant if they take less than this.

Of those with a case for each module (`test[io/storage.py]`) the mutant's case is run."""
_TIERS_S = 0.05, 0.5, 2.0, 8.0
"""Tests are run in tiers, the quick ones first, and within a tier file by file, for files share fixtures."""
_NEARER_TIERS = 2
"""Tests of the mutant's own module are run this many tiers earlier."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownTest:
    """A test that passes on the unchanged package."""

    id: str
    seconds: float
    """Processor time of set-up, call and tear-down, without compiling."""
    marks: tuple[str, ...]

    @property
    def file(self) -> str:
        """The file that it stands in."""
        return self.id.split("::")[0]


@dataclass(frozen=True, kw_only=True)
class CoverageMap:
    """Tests, and the lines of the package that each of them runs, as bits of a number by file and line."""

    tests: list[KnownTest]
    lines: dict[str, dict[int, int]]
    sources: dict[str, str]
    """The package's files, as they were."""
    imports: dict[str, set[Name]]
    """What of the package each test file imports, through helpers and its folder's fixtures too."""
    readers: set[str]
    """Test files that read the package's source."""
    failed: list[str]
    """Tests that fail on the unchanged package; left out."""
    gone: frozenset[str] = frozenset()
    """Tests that can no longer be collected; never chosen."""

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        lines = {file: {str(line): f"{bits:x}" for line, bits in found.items()} for file, found in self.lines.items()}
        imports = {file: sorted(names) for file, names in self.imports.items()}
        tests = [asdict(test) for test in self.tests]
        values = {"tests": tests, "lines": lines, "sources": self.sources, "imports": imports}
        path.write_text(json.dumps(values | {"readers": sorted(self.readers), "failed": self.failed}))

    @classmethod
    def read(cls, path: Path) -> "CoverageMap":
        """Read what `write` wrote."""
        values = json.loads(path.read_text())
        return cls(
            tests=[KnownTest(**test | {"marks": tuple(test["marks"])}) for test in values["tests"]],
            lines={
                file: {int(line): int(bits, 16) for line, bits in found.items()}
                for file, found in values["lines"].items()
            },
            sources=values["sources"],
            imports={file: {(module, name) for module, name in found} for file, found in values["imports"].items()},
            readers=set(values["readers"]),
            failed=values["failed"],
        )

    def is_of(self, top: Path) -> bool:
        """Whether the package in `top` is the one that the map was made with."""
        files = {path.relative_to(top).as_posix(): path.read_text() for path in (top / "tofmix").rglob("*.py")}
        return files == self.sources

    def for_package(self, top: Path) -> "CoverageMap":
        """Return the map for a package that has changed a little: equal lines keep their tests.

        A line that is new has all the tests of its file.
        """
        lines = dict(self.lines)
        for path in (top / "tofmix").rglob("*.py"):
            file, now = path.relative_to(top).as_posix(), path.read_text()
            before = self.sources.get(file, "")
            if now == before:
                continue
            known = self.lines.get(file, {})
            bits = 0
            for found in known.values():
                bits |= found
            moved = dict.fromkeys(range(1, now.count("\n") + 2), bits)
            matcher = difflib.SequenceMatcher(None, before.splitlines(), now.splitlines(), autojunk=False)
            for old, new, size in matcher.get_matching_blocks():
                moved |= {new + step + 1: known.get(old + step + 1, 0) for step in range(size)}
            lines[file] = moved
        return replace(self, lines=lines)

    def noticing(self, mutant: Mutant, names: Names, source: bytes) -> list[KnownTest]:
        """Return the tests that may notice a mutant, in the order in which to run them."""
        bits = self._of_lines(mutant, names, source)
        bits |= self._of_files(file for file in self._by_file if _is_of_module(file, mutant.file))
        for place, test in enumerate(self.tests):
            other_module = ".py" in test.id.partition("[")[2] and not _names_file(test.id, mutant.file)
            if test.file in self.readers and test.seconds < _CHEAP_S and not other_module:
                bits |= 1 << place
        chosen = [test for place, test in enumerate(self.tests) if bits >> place & 1 and test.id not in self.gone]
        cost: dict[tuple[int, str], float] = defaultdict(float)
        for test in chosen:
            cost[_tier(test, mutant), test.file] += test.seconds
        return sorted(chosen, key=lambda t: (tier := _tier(t, mutant), cost[tier, t.file], t.file))

    def _of_lines(self, mutant: Mutant, names: Names, source: bytes) -> int:
        """Tests that run the mutant's statement, or where coverage cannot see it, a function above."""
        lines, in_function = statement_lines(source, mutant.line)
        lines = range(min(lines.start, mutant.line), max(lines.stop, mutant.end_line + 1 if in_function else 0))
        changed = names.at(mutant.file, mutant.line)
        bits = 0
        unseen = not in_function or any(definition.kind == "kernel" for definition in changed)
        if not unseen:
            bits = self._of(mutant.file, lines)
        above = names.seen_above(((d.module, d.name) for d in changed), unseen=unseen)
        for definition in names.definitions(above):
            if unseen or definition not in changed:
                bits |= self._of(definition.file, definition.body)
        if unseen:
            passed = {(d.module, d.name) for d in names.definitions(above) if d.kind != "function"}
            modules = {(module, "") for module, _ in passed}
            bits |= self._of_files(file for file, found in self.imports.items() if found & (passed | modules))
        return bits

    def _of(self, file: str, lines: Iterable[int]) -> int:
        bits, known = 0, self.lines.get(file, {})
        for line in lines:
            bits |= known.get(line, 0)
        return bits

    def _of_files(self, files: Iterable[str]) -> int:
        bits = 0
        for file in files:
            bits |= self._by_file.get(file, 0)
        return bits

    @cached_property
    def _by_file(self) -> dict[str, int]:
        found: dict[str, int] = defaultdict(int)
        for place, test in enumerate(self.tests):
            found[test.file] |= 1 << place
        return dict(found)


def _tier(test: KnownTest, mutant: Mutant) -> int:
    tier = sum(test.seconds > limit for limit in _TIERS_S)
    return max(0, tier - _NEARER_TIERS) if _is_of_module(test.file, mutant.file) else tier


def _names_file(test: str, file: str) -> bool:
    return file.partition("/")[2] in test.partition("[")[2]


def _is_of_module(test_file: str, file: str) -> bool:
    """Whether tests/io/test_storage.py, or test_storage_full.py, is of tofmix/io/storage.py."""
    test, module = Path(test_file), Path(file)
    if test.parts[1:-1] != module.parts[1:-1]:
        return False
    return re.fullmatch(rf"test_{re.escape(module.stem.strip('_'))}(_.*)?", test.stem) is not None


_Run = tuple[str, int, set[str]]
"""A file, a line, and whom it belongs to."""


def failed_once(folder: Path) -> list[KnownTest]:
    """Return the tests that failed while they were followed: perhaps because they were."""
    found = (test for path in sorted(folder.glob("*.json")) for test in json.loads(path.read_text())["tests"].values())
    return [_test(test) for test in found if "failed" in test["outcomes"] and "end" in test]


def not_followed(folder: Path) -> list[str]:
    """Return the tests that were collected, and are not known to have ended: their worker crashed, or was stopped."""
    noted = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    ended = {test["id"] for one in noted for test in one["tests"].values() if "end" in test}
    return sorted({test for one in noted for test in one["collected"]} - ended)


def gathered(folder: Path, checkout: Path, names: Names, failing: Iterable[str]) -> CoverageMap:
    """Read what the workers of a followed run wrote into `folder`; leave out the tests `failing`."""
    noted = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    found: dict[str, dict[str, Any]] = {label: test for one in noted.values() for label, test in one["tests"].items()}
    left_out = set(failing)
    labels = [
        label
        for label, test in found.items()
        if "end" in test and "skipped" not in test["outcomes"] and test["id"] not in left_out
    ]
    places = {label: place for place, label in enumerate(labels)}
    owned = _tests_of_owners(noted, places)
    lines: dict[str, dict[int, int]] = defaultdict(lambda: defaultdict(int))
    for path in sorted(folder.glob("tests.*")):
        _add(lines, _runs(path), owned, checkout)
    popens = {path.relative_to(checkout).as_posix() for path in _starting_processes(checkout)}
    talking = 0  # tests that run a line of a module which starts processes
    for file in popens:
        for bits in lines.get(file, {}).values():
            talking |= bits
    outliving = _Outliving(found, places, noted, talking)
    for path in sorted(folder.glob("process.*")):
        if path.suffix != ".ini":
            runs, end = _runs(path), path.stat().st_mtime
            owners = {owner for _, _, found_there in runs for owner in found_there}
            _add(lines, runs, {owner: owned.get(owner, 0) | outliving.bits(owner, end) for owner in owners}, checkout)
    tests = [_test(found[label]) for label in labels]
    files = sorted({test.file for test in tests})
    return CoverageMap(
        tests=tests,
        lines={file: dict(inner) for file, inner in lines.items()},
        sources={
            path.relative_to(checkout).as_posix(): path.read_text() for path in (checkout / "tofmix").rglob("*.py")
        },
        imports={file: _imported(checkout / file, checkout, names) for file in files},
        readers={file for file in files if re.search(r"\b(tofmix|package)\.__file__", (checkout / file).read_text())},
        failed=sorted(left_out),
    )


def _test(noted: dict[str, Any]) -> KnownTest:
    return KnownTest(id=noted["id"], seconds=round(noted["seconds"], 3), marks=tuple(noted["marks"]))


def _tests_of_owners(noted: dict[str, Any], places: dict[str, int]) -> dict[str, int]:
    """The tests to which each owner's lines count, as bits."""
    uses = {label: used for one in noted.values() for label, used in one["uses"].items()}
    owned: dict[str, int] = defaultdict(int)
    for label, place in places.items():
        reached, new = set[str](), [label]
        while new:
            owner = new.pop()
            if owner not in reached:
                reached.add(owner)
                owned[owner] |= 1 << place
                new += uses.get(owner, ())
    return owned


def _runs(path: Path) -> list[_Run]:
    """Read a file of coverage: none if its process was killed while it wrote it."""
    from coverage import CoverageData, exceptions  # needed for mapping alone

    data = CoverageData(str(path))
    try:
        data.read()
        by_file = {file: data.contexts_by_lineno(file) for file in data.measured_files()}
    except exceptions.DataError:
        return []
    return [(file, line, set(owners)) for file, found in by_file.items() for line, owners in found.items()]


def _add(lines: dict[str, dict[int, int]], runs: list[_Run], owned: dict[str, int], checkout: Path) -> None:
    for file, line, owners in runs:
        inner = lines[Path(file).relative_to(checkout).as_posix()]
        for owner in owners:
            inner[line] |= owned.get(owner, 0)


class _Outliving:
    """Processes that live on after their test: every test of their time that talks to processes counts."""

    def __init__(
        self, found: dict[str, dict[str, Any]], places: dict[str, int], noted: dict[str, Any], talking: int
    ) -> None:
        self._found, self._places, self._talking = found, places, talking
        self._uses = {label: set(used) for one in noted.values() for label, used in one["uses"].items()}
        self._no_test = {label for one in noted.values() for label, name in one["owners"].items() if not name}

    def bits(self, owner: str, end: float) -> int:
        """Return the tests that the lines of a process count for, beside the owner's own; it ended at `end`."""
        test = self._found.get(owner, {"start": 0.0, "end": 0.0} if owner in self._no_test else None)
        if test is None or end < test.get("end", end) + _OUTLIVES_S:
            return 0
        bits = 0
        for label, place in self._places.items():
            other = self._found[label]
            same_worker = label.rpartition("-")[0] == owner.rpartition("-")[0]
            if same_worker and other["end"] > test["start"] and other["start"] < end:
                shares = self._uses.get(label, set()) & self._uses.get(owner, set())
                bits |= (1 << place) & (-1 if shares else self._talking)
        return bits


def _starting_processes(checkout: Path) -> Iterator[Path]:
    for path in (checkout / "tofmix").rglob("*.py"):
        if "Popen(" in path.read_text():
            yield path


def _imported(path: Path, checkout: Path, names: Names) -> set[Name]:
    """What a test file imports of the package: itself, through helpers of the tests, and its folder's fixtures."""
    tests, found, done = checkout / "tests", set[Name](), set[Path]()
    fixtures = [folder / "conftest.py" for folder in path.parents if tests in folder.parents]
    new = [path, *(fixture for fixture in fixtures if fixture.exists())]
    while new:
        path = new.pop()
        if path in done:
            continue
        done.add(path)
        source = path.read_text()
        found |= names.imported_by(source)
        for node in ast.walk(ast.parse(source)):
            inner = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                inner = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            helpers = (tests / f"{module.replace('.', '/')}.py" for module in inner)
            new += [helper for helper in helpers if helper.exists()]
    return found
