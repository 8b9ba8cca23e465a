"""pytest plugin: notes which lines of the package each test runs, and for how long.

`map` loads it into each worker of pytest-xdist (`-p mutation.follow`). Lines belong to whoever runs them:

- a test, its function-scoped fixtures, and the processes that these start;
- a fixture of a wider scope: its lines count for every test that uses the fixture;
- a cached function of the tests (`functools.cache`): its lines count for every test that calls it.

Processes are followed by coverage's own start-up file: `COVERAGE_PROCESS_START` names the settings, `COVERAGE_OWNER`
the owner. Caches of the package are emptied before each test, so that a test's lines do not depend on the tests before
it. All modules of the package are imported first, so that code that runs at import belongs to no test.
"""

import functools
import importlib
import json
import os
import pkgutil
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import coverage
import pytest
from numba.core import event

FOLDER = Path(os.environ["MUTATION_MAP"])
SOURCE = Path(os.environ["MUTATION_SOURCE"])
"""The package's folder."""
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")


class Compiling(event.Listener):
    """Counts the processor time that compiling takes."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._depth = 0
        self._start = 0.0

    def on_start(self, event: object) -> None:  # noqa: ARG002  numba's signature
        """Begin, unless it is a part of another."""
        if not self._depth:
            self._start = cpu_s()
        self._depth += 1

    def on_end(self, event: object) -> None:  # noqa: ARG002  numba's signature
        self._depth -= 1
        if not self._depth:
            self.seconds += cpu_s() - self._start


class Follower:
    """The owners of lines, and what is known of each test."""

    def __init__(self) -> None:
        self._coverage = coverage.Coverage(
            data_file=str(FOLDER / f"tests.{WORKER}"), data_suffix=True, source=[str(SOURCE)], config_file=False
        )
        self._coverage.set_option("run:patch", ["_exit"])
        self.collected: list[str] = []
        self._labels: dict[str, str] = {}
        self._owners: list[str] = []
        self._uses: dict[str, set[str]] = defaultdict(set)
        self._tests: dict[str, dict[str, Any]] = {}
        self._compiling = Compiling()
        event.register("numba:compiler_lock", self._compiling)  # type: ignore[no-untyped-call]

    def start(self) -> None:
        """Begin, with what runs at import."""
        self._coverage.start()
        package = importlib.import_module(SOURCE.name)
        for module in pkgutil.walk_packages(package.__path__, f"{SOURCE.name}."):
            if not module.name.endswith(("__main__", "structure_process")):  # programs: they would run
                with suppress(ImportError):  # an extra that is not installed
                    importlib.import_module(module.name)
        settings = FOLDER / f"process.{WORKER}.ini"
        settings.write_text(
            f"[run]\ndata_file = {FOLDER}/process.{WORKER}\nparallel = true\nsource = {SOURCE}\npatch = _exit\n"
            "context = ${COVERAGE_OWNER}\n"
        )
        os.environ |= {"COVERAGE_PROCESS_START": str(settings), "COVERAGE_OWNER": self._label("")}
        self._switch()

    @contextmanager
    def owned_by(self, owner: str) -> Iterator[None]:
        """Lines belong to `owner` meanwhile, and to the owners in whose time it is."""
        for outer in self._owners:
            self._uses[self._label(outer)].add(self._label(owner))
        self._owners.append(owner)
        self._switch()
        try:
            yield
        finally:
            self._owners.pop()
            self._switch()

    @contextmanager
    def test(self, item: pytest.Item) -> Iterator[None]:
        """One test from set-up to tear-down."""
        empty_caches()
        label = self._label(item.nodeid)
        fixtures = getattr(item, "_fixtureinfo", None)
        for definitions in getattr(fixtures, "name2fixturedefs", {}).values():
            self._uses[label].update(self._label(_owner_name(d)) for d in definitions if d.scope != "function")
        start, spent, compiled = time.time(), cpu_s(), self._compiling.seconds
        marks = sorted({mark.name for mark in item.iter_markers()})
        self._tests[label] = {"id": item.nodeid, "marks": marks, "start": start, "outcomes": []}
        with self.owned_by(item.nodeid):
            yield
        spent = cpu_s() - spent - (self._compiling.seconds - compiled)
        self._tests[label] |= {"end": time.time(), "seconds": max(0.001, spent)}

    def report(self, report: pytest.TestReport) -> None:
        """Keep a phase's outcome."""
        self._tests[self._label(report.nodeid)]["outcomes"].append(report.outcome)

    def end(self) -> None:
        """Write everything."""
        self._coverage.stop()
        self._coverage.save()
        uses = {label: sorted(used) for label, used in self._uses.items()}
        found = {"tests": self._tests, "uses": uses, "owners": {label: name for name, label in self._labels.items()}}
        found["collected"] = self.collected
        (FOLDER / f"{WORKER}.json").write_text(json.dumps(found))

    def share_cached(self, folder: Path) -> None:
        """Give the cached functions of modules in `folder` an owner of their own for each set of arguments."""
        wrapped: dict[int, Callable[..., Any]] = {}
        for module in list(sys.modules.values()):
            if not str(getattr(module, "__file__", None) or "").startswith(f"{folder}{os.sep}"):
                continue
            for name, value in list(vars(module).items()):
                if isinstance(value, functools._lru_cache_wrapper) and not value.__module__.startswith(SOURCE.name):
                    setattr(module, name, wrapped.setdefault(id(value), self._shared(value)))

    def _shared(self, cached: Any) -> Callable[..., Any]:  # noqa: ANN401  a function of any kind
        @functools.wraps(cached)
        def call(*args: object, **named: object) -> object:
            with self.owned_by(f"cached {cached.__module__}.{cached.__qualname__} {args!r:.300} {named!r:.300}"):
                return cached(*args, **named)

        call.cache_clear, call.cache_info = cached.cache_clear, cached.cache_info  # type: ignore[attr-defined]
        return call

    def _label(self, owner: str) -> str:
        return self._labels.setdefault(owner, f"{WORKER}-{len(self._labels)}")

    def _switch(self) -> None:
        label = self._label(self._owners[-1] if self._owners else "")
        self._coverage.switch_context(label)
        os.environ["COVERAGE_OWNER"] = label


def cpu_s() -> float:
    """Return the processor time of this process and of those that it has waited for: a busy machine changes little."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def empty_caches() -> None:
    """Empty every `functools.cache` at the top level of the package's modules."""
    for name, module in list(sys.modules.items()):
        if name.split(".")[0] == SOURCE.name:
            for value in list(vars(module).values()):
                if isinstance(value, functools._lru_cache_wrapper):
                    value.cache_clear()


def _owner_name(definition: Any) -> str:  # noqa: ANN401  pytest's FixtureDef
    return f"fixture {definition.baseid}::{definition.argname}"


FOLLOWER = Follower() if WORKER else None
"""None in the process that only hands the tests out."""
if FOLLOWER is not None:
    FOLLOWER.start()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Know the cached functions of all test modules."""
    if FOLLOWER is not None:
        FOLLOWER.collected = [item.nodeid for item in session.items]
        FOLLOWER.share_cached(session.config.rootpath / "tests")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Lines belong to the test."""
    if FOLLOWER is None:
        return (yield)
    with FOLLOWER.test(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[Any]:  # noqa: ANN401  pytest's FixtureDef
    """Lines of a shared fixture belong to the fixture."""
    if FOLLOWER is None or fixturedef.scope == "function":
        return (yield)
    with FOLLOWER.owned_by(_owner_name(fixturedef)):
        return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep outcomes."""
    if FOLLOWER is not None:
        FOLLOWER.report(report)


def pytest_unconfigure() -> None:
    """Write what was noted."""
    if FOLLOWER is not None:
        FOLLOWER.end()
