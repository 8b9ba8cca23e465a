"""Kept code is found where it may be read, and made again where it is stale; who is told of compiling; vectors."""

import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.measured import coverage_environment
from support.modules import MODULES

import tofmix
from tofmix.compiled import kept, watching
from tofmix.compiled.jit import jit
from tofmix.compiled.kept import CANNOT_KEEP, SUFFIX
from tofmix.compiled.vector import exp_minus, log_of, moments_of, product_of, sums_of, total_of
from tofmix.compiled.watching import FIRST_RUN, watcher

PROGRAM = """
from tofmix.estimation.peaks.modes import density
import numpy as np
from tofmix.sensor import NoiseCurve
print(density([1000.0], [1000.0], NoiseCurve(np.array([0.0]), np.array([10.0])))[0])
"""
SCRIPT = "from tofmix.compiled.jit import jit\n@jit\ndef twice(x):\n    return 2 * x\nprint(twice(21))\n"
FULL_DISK = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"


def _copied_package(folder: Path) -> Path:
    """A copy of the package in `folder`, without any kept code."""
    package = folder / "tofmix"
    shutil.copytree(Path(tofmix.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    return package


def _environment(folder: Path, **more: str) -> dict[str, str]:
    return {"PATH": "", "PYTHONPATH": str(folder), "HOME": str(folder / "home")} | coverage_environment() | more


def _run(code: str, environment: dict[str, str]) -> tuple[str, str]:
    """What a program prints, and says on stderr."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], env=environment, capture_output=True, text=True, check=False, cwd="/"
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def _files(folder: Path) -> dict[Path, int]:
    """Files of kept code, with the time that each was written at."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob(f"*{SUFFIX}")}


@pytest.mark.compiled("there is nothing to keep")
@pytest.mark.slow
def test_a_change_in_a_called_kernel_reaches_its_callers(tmp_path: Path) -> None:
    package, environment = _copied_package(tmp_path), _environment(tmp_path)
    before = float(_run(PROGRAM, environment)[0])
    assert _files(tmp_path / "__pycache__")
    exponential = package / "compiled" / "vector.py"
    exponential.write_text(exponential.read_text().replace("    return p\n", "    return 2.0 * p\n", 1))
    assert float(_run(PROGRAM, environment)[0]) == pytest.approx(2 * before)


@pytest.mark.compiled("there is nothing to keep")
def test_every_module_with_a_kernel_is_in_the_key() -> None:
    has_jit = [module for module in MODULES if "\nfrom tofmix.compiled.jit import" in module.read_text()]
    assert len(has_jit) > 50
    assert set(has_jit) <= set(kept.kernel_files())


@pytest.mark.compiled("there is nothing to keep")
def test_code_lies_beside_the_package_so_that_its_removal_leaves_nothing_to_import(tmp_path: Path) -> None:
    package, environment = _copied_package(tmp_path), _environment(tmp_path)
    _run(SCRIPT, environment)
    assert _files(tmp_path / "__pycache__")
    assert not _files(package)
    assert not list(tmp_path.rglob("*.nbi"))  # numba's own cache keeps nothing


@pytest.mark.compiled("there is nothing to keep")
@pytest.mark.slow
def test_a_second_run_compiles_nothing_where_only_a_temporary_folder_can_be_written(tmp_path: Path) -> None:
    # Even root cannot write there: a file stands where the package's cache would, and /proc takes no folder.
    _copied_package(tmp_path)
    (tmp_path / "__pycache__").touch()
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    environment = _environment(tmp_path, HOME="/proc/none", TMPDIR=str(temporary), PYTHONDONTWRITEBYTECODE="1")
    first = _run(SCRIPT, environment)
    compiled = _files(temporary)
    assert compiled
    assert FIRST_RUN in first[1]
    assert _run(SCRIPT, environment) == (first[0], "")
    assert _files(temporary) == compiled


@pytest.mark.compiled("there is nothing to keep")
@pytest.mark.slow
def test_a_damaged_or_foreign_file_is_compiled_again(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    environment = _environment(Path(tofmix.__file__).parents[1], NUMBA_CACHE_DIR=str(folder), HOME=str(tmp_path))
    assert _run(SCRIPT, environment)[0] == "42\n"
    [path] = _files(folder)
    whole = path.read_bytes()
    foreign = kept._HEADER + kept._CHECKSUM(b"\x80\x04N.").digest() + b"\x80\x04N."  # a pickle of None
    middle = len(whole) // 2
    changed = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
    for content in (b"", changed, foreign):
        path.write_bytes(content)
        assert _run(SCRIPT, environment) == ("42\n", f"tofmix: {FIRST_RUN}\n")
        assert len(path.read_bytes()) == len(whole)
    assert _run(SCRIPT, environment) == ("42\n", "")


@pytest.mark.compiled("there is nothing to keep")
def test_where_nothing_can_be_kept_one_line_names_the_variable(tmp_path: Path) -> None:
    environment = _environment(Path(tofmix.__file__).parents[1], NUMBA_CACHE_DIR=str(tmp_path))
    out, err = _run(FULL_DISK + SCRIPT.replace("print(", "twice(1.0)\nprint("), environment)
    assert out == "42\n"
    assert err.splitlines() == [f"tofmix: {FIRST_RUN}", f"tofmix: {CANNOT_KEEP}"]
    assert "NUMBA_CACHE_DIR" in err
    assert not list(tmp_path.rglob("*"))[1:]  # but the folder of the key


@pytest.mark.compiled("there is nothing to keep")
def test_folders_are_those_of_the_variable_the_package_the_user_and_the_temporary_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setenv("XDG_CACHE_HOME", "/home/somebody/cache")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/chosen")
    beside = kept.PACKAGE.parent / "__pycache__"
    own = tmp_path / f"tofmix-{os.getuid()}"
    assert kept._bases() == [Path("/chosen"), beside, Path("/home/somebody/cache"), own]
    assert own.stat().st_mode & 0o077 == 0
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/somebody")
    assert kept._bases() == [beside, Path("/home/somebody/.cache"), own]
    own.chmod(0o777)  # somebody else could write there
    assert kept._bases() == [beside, Path("/home/somebody/.cache")]


@pytest.mark.compiled("there is nothing to keep")
def test_without_a_home_or_a_temporary_folder_there_are_the_other_folders(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def none() -> str:
        raise FileNotFoundError("no temporary folder")

    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("tempfile.gettempdir", none)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as where the user has no entry
    assert kept._bases() == [tmp_path, kept.PACKAGE.parent / "__pycache__"]


@pytest.mark.compiled("nothing is compiled")
def test_the_log_has_one_line_where_nobody_watches(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(watching, "_watchers", [watching._Log()])
    with caplog.at_level(logging.WARNING, logger="tofmix"):
        for kernel in ("a.b", "a.c"):
            watcher().begins(kernel)
            watcher().ends(kernel)
    assert caplog.messages == [f"tofmix: {FIRST_RUN}"]


@jit
def _each(x: np.ndarray, e: np.ndarray, log: np.ndarray) -> None:
    for j in range(len(x)):
        e[j] = exp_minus(x[j])
        log[j] = log_of(x[j])


def test_vector_exponential_and_logarithm_agree_with_numpy(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.uniform(0, 20, 5000), rng.uniform(20, 400, 1000), 10.0 ** rng.uniform(-300, 300, 5000)])
    x = np.concatenate([x, [1.0, np.sqrt(2), 2.0, np.nextafter(1, 0), 1e-300]])
    e, log = np.empty_like(x), np.empty_like(x)
    _each(x, e, log)
    near, far = x <= 20, (x > 20) & (x <= 400)
    np.testing.assert_allclose(e[near], np.exp(-x[near]), rtol=1e-10)
    np.testing.assert_allclose(e[far], np.exp(-x[far]), rtol=1e-2)
    assert np.all(e > 0)
    np.testing.assert_allclose(log, np.log(x), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 3, 4, 7, 8, 101])
def test_vector_sums_agree_with_numpy(n: int, rng: np.random.Generator) -> None:
    a, b, c = rng.normal(size=(3, n))
    longer = np.append(b, 99.0)
    assert total_of(a) == pytest.approx(a.sum())
    assert product_of(a, longer) == pytest.approx(a @ b)
    assert sums_of(a, longer) == pytest.approx((a.sum(), a @ b))
    away = a - 0.3
    expected = [(b * c).sum(), (b * c * away).sum(), (b * c * away**2).sum()]
    assert moments_of(a, longer, c, 0.3) == pytest.approx(expected)
