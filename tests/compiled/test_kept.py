"""Kept code: found where it may be read, compiled again where it is stale or damaged, and never why a run fails."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.measured import coverage_environment
from support.modules import MODULES, nodes

import tofmix
from tofmix.compiled import kept
from tofmix.compiled.kept import CANNOT_KEEP, SUFFIX
from tofmix.compiled.watching import FIRST_RUN

PROGRAM = """
from tofmix.estimation.peaks.density import density
import numpy as np
from tofmix.sensor import NoiseCurve
print(density([1000.0], [1000.0], NoiseCurve(np.array([0.0]), np.array([10.0])))[0])
"""
SCRIPT = "from tofmix.compiled.jit import jit\n@jit\ndef twice(x):\n    return 2 * x\nprint(twice(21))\n"
FULL_DISK = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"

pytestmark = pytest.mark.compiled("there is nothing to keep")


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


@pytest.mark.slow
def test_a_change_in_a_called_kernel_reaches_its_callers(tmp_path: Path) -> None:
    package, environment = _copied_package(tmp_path), _environment(tmp_path)
    before = float(_run(PROGRAM, environment)[0])
    assert _files(tmp_path / "__pycache__")
    density = package / "estimation" / "peaks" / "density.py"
    density.write_text(density.read_text().replace("exp_minus(0.5 * z * z)", "2.0"))
    assert float(_run(PROGRAM, environment)[0]) == pytest.approx(2 * before)


@pytest.mark.slow
def test_every_module_with_a_kernel_is_in_the_key() -> None:
    has_jit = [
        module
        for module in MODULES
        if any(isinstance(node, ast.ImportFrom) and node.module == "tofmix.compiled.jit" for node in nodes(module))
    ]
    assert len(has_jit) > 50
    assert set(has_jit) <= set(kept.kernel_files())


def test_code_lies_beside_the_package_so_that_its_removal_leaves_nothing_to_import(tmp_path: Path) -> None:
    package, environment = _copied_package(tmp_path), _environment(tmp_path)
    _run(PROGRAM, environment)
    assert _files(tmp_path / "__pycache__")
    assert not _files(package)
    assert not list(tmp_path.rglob("*.nbi"))  # numba's own cache keeps nothing


@pytest.mark.slow
def test_a_second_run_compiles_nothing_where_only_a_temporary_folder_can_be_written(tmp_path: Path) -> None:
    # Even root cannot write there: a file stands where the package's cache would, and /proc takes no folder.
    _copied_package(tmp_path)
    (tmp_path / "__pycache__").touch()
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    environment = _environment(tmp_path, HOME="/proc/none", TMPDIR=str(temporary), PYTHONDONTWRITEBYTECODE="1")
    first = _run(PROGRAM, environment)
    compiled = _files(temporary)
    assert compiled
    assert FIRST_RUN in first[1]
    assert _run(PROGRAM, environment) == (first[0], "")
    assert _files(temporary) == compiled


@pytest.mark.slow
def test_code_is_read_from_a_later_folder_and_written_to_the_first(tmp_path: Path) -> None:
    _copied_package(tmp_path)
    environment = _environment(tmp_path)
    _run(PROGRAM, environment)  # beside the package
    chosen = tmp_path / "chosen"
    assert _run(PROGRAM, environment | {"NUMBA_CACHE_DIR": str(chosen)})[1] == ""
    assert not _files(chosen)
    _run(SCRIPT_IN_FILE.format(tmp_path / "script.py"), environment | {"NUMBA_CACHE_DIR": str(chosen)})
    assert len(_files(chosen)) == 1


SCRIPT_IN_FILE = f"import pathlib, runpy; p = pathlib.Path('{{}}'); p.write_text({SCRIPT!r}); runpy.run_path(str(p))"


@pytest.mark.slow
def test_a_damaged_or_foreign_file_is_compiled_again(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    environment = _environment(Path(tofmix.__file__).parents[1], NUMBA_CACHE_DIR=str(folder), HOME=str(tmp_path))
    assert _run(SCRIPT, environment)[0] == "42\n"
    [path] = _files(folder)
    whole = path.read_bytes()
    foreign = kept._HEADER + kept._CHECKSUM(b"\x80\x04N.").digest() + b"\x80\x04N."  # a pickle of None
    for content in (b"", b"damaged", whole[:-1], whole[:-1] + b"\0", foreign):
        path.write_bytes(content)
        assert _run(SCRIPT, environment) == ("42\n", f"tofmix: {FIRST_RUN}\n")
        assert len(path.read_bytes()) == len(whole)
    assert _run(SCRIPT, environment) == ("42\n", "")


def test_where_nothing_can_be_kept_one_line_names_the_variable(tmp_path: Path) -> None:
    environment = _environment(Path(tofmix.__file__).parents[1], NUMBA_CACHE_DIR=str(tmp_path))
    out, err = _run(FULL_DISK + SCRIPT.replace("print(", "twice(1.0)\nprint("), environment)
    assert out == "42\n"
    assert err.splitlines() == [f"tofmix: {FIRST_RUN}", f"tofmix: {CANNOT_KEEP}"]
    assert "NUMBA_CACHE_DIR" in err
    assert not list(tmp_path.rglob("*"))[1:]  # but the folder of the key


def test_another_package_that_compiles_first_does_no_harm(tmp_path: Path) -> None:
    environment = _environment(Path(tofmix.__file__).parents[1], NUMBA_CACHE_DIR=str(tmp_path))
    told = "from tofmix.compiled.kept import processor_class, V3\nprint(processor_class() == V3)\n"
    first = "import numba\n@numba.njit\ndef half(x):\n    return 0.5 * x\nhalf(1.0)\n"
    assert _run(first + SCRIPT + told, environment)[0] == "42\nFalse\n"
    assert _run(SCRIPT + told, environment)[0].startswith("42\n")
    after = "import numba\nprint(numba.config.CPU_NAME, numba.config.CPU_FEATURES)\n"
    assert _run(SCRIPT + after, environment)[0] == "42\nNone None\n"


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


def test_the_working_folder_is_no_temporary_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.delenv("TMPDIR", raising=False)
    assert tmp_path not in {folder.parent for folder in kept._bases()}
