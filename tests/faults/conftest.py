"""Warm processes that all tests of this folder share, with the shim where there is a C compiler."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from faults.fuzz import Fuzz
from faults.inject import Injection, compiled, with_shim
from faults.originals import Original, make
from faults.pool import Pool


@pytest.fixture(scope="session")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path | None:
    return compiled(tmp_path_factory.mktemp("shim"))


@pytest.fixture(scope="session")
def pool(shim: Path | None) -> Iterator[Pool]:
    processes = 1 if "PYTEST_XDIST_WORKER" in os.environ else 2  # pytest's workers keep the processors busy
    with Pool(processes, {} if shim is None else with_shim(shim)) as pool:
        yield pool


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("originals")


@pytest.fixture(scope="session")
def originals(pool: Pool, folder: Path) -> dict[str, Original]:
    return make(folder, pool)


@pytest.fixture(scope="session")
def fuzz(pool: Pool, folder: Path, originals: dict[str, Original]) -> Fuzz:
    return Fuzz(folder, pool, originals)


@pytest.fixture(scope="session")
def injection(pool: Pool, folder: Path, originals: dict[str, Original]) -> Injection:
    assert originals
    return Injection(folder, pool)
