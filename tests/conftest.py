"""Fixtures and helpers that several folders of tests share."""

import functools
import os
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from tofmix.compiled.kept import config as numba_config
from tofmix.sensor import NoiseCurve, Sensor

PLAIN = bool(numba_config.DISABLE_JIT)
"""Kernels run as plain Python, some hundred times slower: for branch coverage, or a debugger."""

WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")
"""Name of this process among pytest's workers: gw0, gw1, ...; empty where there are none."""

SHARED_PROCESSES = {"cluster", "pool"}
"""Fixtures that start processes, for seconds: a cluster of tests/cli, warm processes of tests/faults."""

# The first call of a kernel compiles it: no deadline. One seed: CI sees what we saw.
settings.register_profile("tofmix", deadline=None, derandomize=True)
settings.register_profile("plain", settings.get_profile("tofmix"), max_examples=10)
settings.load_profile("plain" if PLAIN else "tofmix")

# `import naive`, `import scenes_in_memory`, `import cli_page`: helpers beside the tests, and scripts of the docs.
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "docs/generators")]


def pytest_configure(config: pytest.Config) -> None:
    """Take the kernels of an installed copy, and give each of pytest's workers one thread for linear algebra.

    `python -m pytest` imports the package of the checkout; what the installed one has compiled of the same sources
    serves it too. Threads of several workers would wait for each other. What kernels divide by zero is inf or NaN; as
    plain Python, NumPy's numbers say so each time.
    """
    installed = Path(sysconfig.get_path("purelib")) / "__pycache__"
    if any(installed.glob("tofmix-kernels-*")):
        os.environ.setdefault("NUMBA_CACHE_DIR", str(installed))  # workers and what they start inherit it
    if config.getoption("numprocesses", None):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # likewise
    if PLAIN:
        config.addinivalue_line(
            "filterwarnings", "ignore:(overflow|divide by zero|invalid value) encountered:RuntimeWarning"
        )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests first that share processes, so that one worker starts them, then long ones; skip some in plain Python.

    Where kernels run as plain Python, those are skipped that are about compiling or take too many pixels.
    """
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    items.sort(key=lambda item: SHARED_PROCESSES.isdisjoint(getattr(item, "fixturenames", ())))
    for item in items:
        mark = item.get_closest_marker("compiled")
        if PLAIN and mark is not None:
            item.add_marker(pytest.mark.skip(reason=f"kernels are not compiled: {mark.args[0]}"))


def pytest_sessionstart() -> None:
    """Let pytest's workers compile the kernels together; without workers, each test compiles what it needs."""
    if WORKER and not PLAIN:
        from support import compiling

        with suppress(Exception):  # a kernel that cannot be compiled fails its own tests
            compiling.begin(int(WORKER.removeprefix("gw")))


def pytest_collection_finish() -> None:
    """Wait for the kernels that other workers compile, and then run tests."""
    if WORKER and not PLAIN:
        from support import compiling

        with suppress(Exception):  # likewise
            compiling.finish()


@pytest.fixture(autouse=PLAIN, scope="session")
def _twins() -> Iterator[None]:
    """As plain Python these would take hours: they go over samples with the kernels' twins, which other tests hold."""
    from support import cast_twin, reconcile_twins

    from tofmix.reconciliation.likelihood import likelihood
    from tofmix.simulation.casting import cast

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cast, "cast_row", cast_twin.cast_row)
        patch.setattr(cast, "cast_cells", cast_twin.cast_cells)
        patch.setattr(likelihood, "log_likelihood", reconcile_twins.sorted_log_likelihood)
        patch.setattr(likelihood, "transform", reconcile_twins.transform)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20080922)


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thresholds from a few hundred draws a cell: near enough where none is asked to hold a promise."""
    from tofmix.estimation.learnt.bootstrap import calibrate

    fewer = functools.partial(calibrate, draws=300)
    monkeypatch.setattr("tofmix.estimation.learnt.recordings.known_thresholds", fewer)


@pytest.fixture
def sensor() -> Sensor:
    """A camera whose noise grows with range, unlike any built-in one."""
    noise = NoiseCurve(np.array([400.0, 1500.0, 3000.0, 6000.0]), np.array([12.0, 25.0, 60.0, 200.0]))
    return Sensor(name="test camera", range_min_mm=300.0, range_max_mm=6000.0, noise=noise)
