"""A first run: two processes give the bytes of one, and the second is there only where it helps."""

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.commandline import succeed

import tofmix
from tofmix.compiled import kept
from tofmix.estimation.settings import EstimateOptions
from tofmix.pipeline import first_run
from tofmix.pipeline.first_run import CompilerProcess, start_beside

SAMPLE = Path(tofmix.__file__).parents[1] / "sample_data" / "tmf8829_edge.h5"

pytestmark = pytest.mark.compiled("there is nothing to compile")


def _estimate(folder: Path, name: str, processors: int) -> tuple[bytes, set[str]]:
    """Bytes of the layers of a run on so many processors, and the kernels that are kept after it."""
    output, kernels = folder / f"{name}.h5", folder / "kernels"
    environment = os.environ | {
        "PYTHONPATH": str(folder),
        "NUMBA_CACHE_DIR": str(kernels),
        "XDG_CACHE_HOME": str(folder / "none"),
    }
    allowed = sorted(os.sched_getaffinity(0))[:processors]
    subprocess.run(
        [sys.executable, "-P", "-m", "tofmix", "estimate", str(SAMPLE), "-o", str(output), "--noise", "file"],
        env=environment,
        check=True,
        capture_output=True,
        preexec_fn=lambda: os.sched_setaffinity(0, allowed),
    )
    return output.read_bytes(), {path.name.rpartition("-")[0] for path in kernels.rglob(f"*{kept.SUFFIX}")}


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.skipif(not SAMPLE.exists(), reason="the samples of a checkout are not there")
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to a processor")
def test_two_processes_keep_every_kernel_that_one_needs_and_write_the_bytes_of_one(tmp_path: Path) -> None:
    """The kernels of this process, which the bytes are held against, are those that one process compiles."""
    shutil.copytree(Path(tofmix.__file__).parent, tmp_path / "tofmix", ignore=shutil.ignore_patterns("__pycache__"))
    first = _estimate(tmp_path, "two", 2)
    assert _estimate(tmp_path, "one", 1) == first
    succeed("estimate", SAMPLE, "-o", tmp_path / "here.h5", "--noise", "file")
    assert (tmp_path / "here.h5").read_bytes() == first[0]


@pytest.mark.parametrize(
    "kernels", [[first_run._LAYERS], first_run._UNMIXING, first_run._LEARNT_FIRST, first_run._LEARNT_LATER]
)
def test_the_named_kernels_are_there(kernels: list[str]) -> None:
    for kernel in (*kernels, first_run._kernel_of(EstimateOptions().counter)):
        module, _, name = kernel.rpartition(".")
        function = getattr(importlib.import_module(f"tofmix.{module}"), name)
        assert function._cache.kernel == kernel


def test_no_second_process_is_started_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_run, "CompilerProcess", lambda *_: pytest.fail("a process was started"))
    monkeypatch.setattr(first_run, "is_kept", lambda _: True)
    assert start_beside(["a.b"], "learning") is None
    monkeypatch.setattr(first_run, "is_kept", lambda _: False)
    monkeypatch.setattr(first_run, "_processors", lambda: 1)
    assert start_beside(["a.b"], "learning") is None
    monkeypatch.setattr(first_run, "_processors", lambda: 2)
    monkeypatch.setattr(first_run, "cache_folder", lambda: None)
    assert start_beside(["a.b"], "learning") is None


def test_a_second_process_that_fails_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "_elsewhere", [])
    beside = CompilerProcess(["nothing.of_this_name"], ["no such task"])
    assert not kept._elsewhere[0]("another.kernel")
    assert not kept._elsewhere[0]("nothing.of_this_name")
    beside.end()
