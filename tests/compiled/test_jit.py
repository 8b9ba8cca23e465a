"""The decorator compiles, and its cache notices a change in any kernel's source."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.measured import coverage_environment

import tofmix
from tofmix.compiled import jit

PROGRAM = """
from tofmix.compiled.jit import cache_folder
import numpy as np
from tofmix.estimation.peaks.density import density
from tofmix.sensor import NoiseCurve
p = density([1000.0], [1000.0], NoiseCurve(np.array([0.0]), np.array([10.0])))
print(p[0], len(list(cache_folder().rglob("*.nbc"))))
"""


def _run(folder: Path, environment: dict[str, str]) -> tuple[float, int]:
    out = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=folder, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    return float(out[0]), int(out[1])


@pytest.mark.slow
def test_a_change_in_a_called_kernel_reaches_its_callers(tmp_path: Path) -> None:
    package = tmp_path / "tofmix"
    source = Path(tofmix.__file__).parent
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = {"PATH": "", "PYTHONPATH": str(tmp_path), "HOME": str(tmp_path)}
    before, cached = _run(tmp_path, environment)
    assert cached > 0
    density = package / "estimation" / "peaks" / "density.py"
    density.write_text(density.read_text().replace("exp_minus(0.5 * z * z)", "2.0"))
    after, _ = _run(tmp_path, environment)
    assert after == pytest.approx(2 * before)


def test_a_read_only_package_and_home_fall_back_to_a_private_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr("tofmix.compiled.jit._writable", lambda _: False)
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    folder = jit._base_folder()
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o077 == 0
    # Somebody else could write there: it is not used.
    folder.chmod(0o777)
    assert jit._base_folder() != folder


@pytest.mark.slow
def test_a_second_run_compiles_nothing_where_package_and_home_are_read_only(tmp_path: Path) -> None:
    # Even root cannot write there: a file stands where the package's cache would, and /proc takes no folder.
    package, temporary = tmp_path / "tofmix", tmp_path / "tmp"
    shutil.copytree(Path(tofmix.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "__pycache__").touch()
    temporary.mkdir()
    environment = {"PATH": "", "PYTHONPATH": str(tmp_path), "HOME": "/proc/none", "TMPDIR": str(temporary)}
    first = _run(tmp_path, environment)
    compiled = {path: path.stat().st_mtime_ns for path in temporary.rglob("*.nbc")}
    assert len(compiled) == first[1] > 0
    assert _run(tmp_path, environment) == first
    assert {path: path.stat().st_mtime_ns for path in temporary.rglob("*.nbc")} == compiled


def test_numba_cache_dir_is_honoured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert jit._base_folder() == tmp_path


def test_a_constant_argument_compiles_nothing_more() -> None:
    @jit.jit
    def shifted(value: int, by: int) -> int:
        return value + by

    @jit.jit
    def both(value: int) -> int:
        return shifted(value, 1) + shifted(1, value) + shifted(value, by=value)

    assert both(2) == 3 + 3 + 4
    callee = getattr(shifted, "get_overload", None)
    assert callee is None or len(callee.__self__._compiled) == 1


def test_compiled_function_returns_its_value() -> None:
    def twice(values: np.ndarray) -> float:
        return float(2 * values.sum())

    assert jit.jit(twice)(np.arange(4.0)) == 12


@pytest.mark.slow
def test_a_damaged_cache_or_a_full_disk_does_not_fail_a_run(tmp_path: Path) -> None:
    script = tmp_path / "kernel.py"
    script.write_text("from tofmix.compiled.jit import jit\n@jit\ndef twice(x):\n    return 2 * x\nprint(twice(21))\n")
    full = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"
    (tmp_path / "full.py").write_text(full + script.read_text())
    environment = {"PATH": "", "PYTHONPATH": str(Path(tofmix.__file__).parents[1]), "HOME": str(tmp_path)}
    environment |= {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} | coverage_environment()

    def run(path: Path) -> str:
        return subprocess.run(
            [sys.executable, str(path)], env=environment, capture_output=True, text=True, check=True
        ).stdout

    def kept() -> list[Path]:
        return sorted((tmp_path / "cache").rglob("*.nb?"))

    assert run(script) == "42\n"
    assert len(kept()) == 2  # an index and a kernel
    for content in (b"", b"damaged"):
        for path in kept():
            path.write_bytes(content)
        assert run(script) == "42\n"
        assert all(path.stat().st_size > 10 for path in kept())
    assert run(tmp_path / "full.py") == "42\n"
