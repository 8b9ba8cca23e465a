"""The local engine within its memory, a first run, and a job's last look at its recording."""

import importlib
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from support.commandline import succeed
from support.files import boards, write_recording

import tofmix
from tofmix.arrays import Float32Array
from tofmix.compiled import kept
from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.estimation.settings import EstimateOptions
from tofmix.grid import plan_windows
from tofmix.io.layers.chunks import EncodedCell
from tofmix.io.layers.journal import journal_path
from tofmix.io.recording.recording_file import RecordingFile, open_recording
from tofmix.io.recording.scratch import on_scratch
from tofmix.pipeline import first_run
from tofmix.pipeline.first_run import CompilerProcess, start_beside
from tofmix.pipeline.job import PROGRAM_BYTES, LocalEngine, plan_job
from tofmix.pipeline.run import run_job
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable

CHUNKS = (3, 10, 8)
"""Stored in chunks of 3 frames and 10 rows, which bands of a few rows cut through."""


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", 24)  # cells of 3 rows
    return write_recording(tmp_path / "a.h5", boards(90, 20, 8), chunks=CHUNKS, compression="gzip")


def run(path: Path, folder: Path, memory_bytes: int) -> tuple[dict[int, EncodedCell], Counter[tuple[int, int]]]:
    """Return the cells, and how often each stored chunk was read."""
    reads = Counter[tuple[int, int]]()
    with open_recording(path) as source:
        read: Callable[..., Float32Array] = source.read_range

        def counted(frames: slice, rows: slice) -> Float32Array:
            times = {frame // CHUNKS[0] for frame in range(frames.start, frames.stop)}
            reads.update(
                (time, row) for time in times for row in {r // CHUNKS[1] for r in range(rows.start, rows.stop)}
            )
            return read(frames, rows)

        source.read_range = counted  # type: ignore[method-assign]
        job = plan_job(source, plan_windows(90), EstimateOptions(), {})
        engine = LocalEngine(source=source, workers=1, memory_bytes=memory_bytes, folder=folder)
        cells = {cell.index: encoded for cell, encoded in engine(job, list(job.grid.cells()))}
    return cells, reads


def test_little_memory_changes_neither_the_cells_nor_how_often_a_chunk_is_read(recording: Path, tmp_path: Path) -> None:
    plenty, reads = run(recording, tmp_path, 10**9)
    assert set(reads.values()) == {1}
    scarce, reads = run(recording, tmp_path, PROGRAM_BYTES + 80_000)
    assert set(reads.values()) == {1}, "it was laid out anew"
    assert scarce == plenty
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_too_small_memory_is_refused_with_a_sufficient_size(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"a\.h5: one row of one window takes .* pass --memory 221MB or more"):
        run(recording, tmp_path, PROGRAM_BYTES + 1000)


def test_no_room_for_scratch_is_a_storage_error(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(StorageError, match=r"No space left on device; 0\.0 GB of scratch space are needed"):
        run(recording, tmp_path, PROGRAM_BYTES + 80_000)


def test_scratch_holds_the_samples_of_its_part(tmp_path: Path, rng: np.random.Generator) -> None:
    samples = rng.normal(1000, 10, (23, 11, 5)).astype("f4")
    samples[3, 4, 1] = np.nan

    class Chunked(ArrayRecording):
        frame_step, row_step = 4, 3

    source = Chunked(samples, Sensor(name="x"))
    with on_scratch(source, tmp_path, frames=slice(2, 21), rows=slice(4, 11)) as scratch:
        assert list(tmp_path.iterdir()) == []
        for frames, rows in ((slice(2, 21), slice(4, 11)), (slice(5, 6), slice(10, 11)), (slice(3, 19), slice(5, 9))):
            np.testing.assert_array_equal(scratch.read_range(frames, rows), samples[frames, rows])


def test_a_recording_stored_in_tall_chunks_needs_no_scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", 24)
    monkeypatch.setattr("tofmix.pipeline.job.on_scratch", None)
    path = write_recording(tmp_path / "a.h5", boards(90, 20, 8), chunks=(90, 3, 8))
    with open_recording(path) as source:
        assert isinstance(source, RecordingFile)
        job = plan_job(source, plan_windows(90), EstimateOptions(), {})
        engine = LocalEngine(source=source, workers=2, memory_bytes=PROGRAM_BYTES + 200_000, folder=tmp_path)
        assert len(list(engine(job, list(job.grid.cells())))) == job.grid.count


def run_run(source: RecordingFile, target: Path) -> None:
    job = plan_job(source, plan_windows(30), EstimateOptions(), {})
    engine = LocalEngine(source=source, workers=1, memory_bytes=PROGRAM_BYTES + 10**8, folder=target.parent)
    run_job(job, engine, target, verify_source=source.verify_unchanged)


def test_change_of_the_recording_before_the_end_leaves_no_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, target = write_recording(tmp_path / "a.h5", boards(30, 6, 5)), tmp_path / "a.layers.h5"
    verify_source = RecordingFile.verify_unchanged

    def changed(self: RecordingFile) -> None:
        with path.open("ab") as file:
            file.write(b"more")
        verify_source(self)

    monkeypatch.setattr(RecordingFile, "verify_unchanged", changed)
    with pytest.raises(BadInputError, match="the file changed during reading"), open_recording(path) as source:
        run_run(source, target)
    assert not target.exists()
    assert not journal_path(target).exists()


def test_change_of_the_recording_after_the_end_is_accepted(tmp_path: Path) -> None:
    path, target = write_recording(tmp_path / "a.h5", boards(30, 6, 5)), tmp_path / "a.layers.h5"
    with open_recording(path) as source:
        run_run(source, target)
        path.write_bytes(b"")
    assert target.exists()


SAMPLE = Path(tofmix.__file__).parents[1] / "sample_data" / "tmf8829_edge.h5"


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


@pytest.mark.compiled("there is nothing to compile")
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


@pytest.mark.compiled("there is nothing to compile")
@pytest.mark.parametrize(
    "kernels", [[first_run._LAYERS], first_run._UNMIXING, first_run._LEARNT_FIRST, first_run._LEARNT_LATER]
)
def test_the_named_kernels_are_there(kernels: list[str]) -> None:
    for kernel in (*kernels, first_run._kernel_of(EstimateOptions().counter)):
        module, _, name = kernel.rpartition(".")
        function = getattr(importlib.import_module(f"tofmix.{module}"), name)
        assert function._cache.kernel == kernel


@pytest.mark.compiled("there is nothing to compile")
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


@pytest.mark.compiled("there is nothing to compile")
def test_a_second_process_that_fails_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "_elsewhere", [])
    beside = CompilerProcess(["nothing.of_this_name"], ["no such task"])
    assert not kept._elsewhere[0]("another.kernel")
    assert not kept._elsewhere[0]("nothing.of_this_name")
    beside.end()
