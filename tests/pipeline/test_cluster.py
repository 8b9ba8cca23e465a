"""What a worker checks before it computes, and how the work is cut for it."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.files import boards, write_recording

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.estimation.settings import EstimateOptions
from tofmix.grid import plan_grid, plan_windows
from tofmix.io.recording.recording_file import open_recording
from tofmix.pipeline import cluster
from tofmix.pipeline.cluster import Block, identity, run_block
from tofmix.pipeline.job import Job, plan_job


@pytest.fixture
def job(tmp_path: Path) -> Job:
    with open_recording(write_recording(tmp_path / "a.h5", boards(40))) as source:
        return plan_job(source, plan_windows(40, window=10), EstimateOptions(), {})


def block(job: Job) -> Block:
    status = job.recording.stat()
    return Block(
        job=job, cells=(0,), memory_bytes=10**9, identity=identity(), size=status.st_size, mtime_ns=status.st_mtime_ns
    )


def test_block_gives_the_layers_of_its_cells(job: Job) -> None:
    [(index, encoded)] = run_block(block(job))
    assert index == 0
    assert sum(encoded.tally) == 4 * 4 * 6


def test_worker_accepts_a_copy_and_refuses_another_file(job: Job) -> None:
    asked = block(job)
    os.utime(job.recording, ns=(1, 1))
    assert len(run_block(asked)) == 1
    data = bytearray(job.recording.read_bytes())
    data[-1] ^= 1
    job.recording.write_bytes(data)
    with pytest.raises(BadInputError, match=r"a\.h5: another file on the worker .* same path"):
        run_block(asked)
    job.recording.unlink()
    with pytest.raises(BadInputError, match=r"a\.h5: No such file or directory on the worker"):
        run_block(asked)


@pytest.mark.parametrize("name", ["tofmix", "numba", "python", "kernels"])
def test_a_worker_of_another_version_refuses(job: Job, name: str) -> None:
    with pytest.raises(UsageError, match=f"would not give the same bytes: {name} .* there, 0.0 here"):
        run_block(replace(block(job), identity=identity() | {name: "0.0"}))


@given(
    frames=st.integers(1, 3000),
    window=st.integers(1, 200),
    rows=st.integers(1, 300),
    cols=st.integers(1, 300),
    chunk=st.integers(1, 2000),
    wanted_step=st.integers(1, 3),
)
def test_blocks_hold_each_wanted_cell_once_and_enough_of_them(
    frames: int, window: int, rows: int, cols: int, chunk: int, wanted_step: int
) -> None:
    windows = plan_windows(max(frames, window), window=window)
    grid = plan_grid(windows, (rows, cols))
    groups, bands = cluster._block_step(grid, chunk)
    samples = groups * bands * grid.step[0] * grid.step[1] * cols * window
    assert samples >= cluster.BLOCK_SAMPLES or (groups, bands) == (grid.groups, grid.bands)
    wanted = list(grid.cells())[::wanted_step]
    job = Job.__new__(Job)
    for key, value in (("grid", grid), ("chunk_frames", chunk)):
        object.__setattr__(job, key, value)
    blocks = list(cluster._blocks(job, wanted))
    assert sorted(index for cells in blocks for index in cells) == [cell.index for cell in wanted]


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install 'tofmix\[cluster\]'"), cluster.open_cluster("x", memory_bytes=1):
        pass


class Ended:
    """A task that has ended with an error."""

    def __init__(self, error: Exception, status: str = "error") -> None:
        self.status, self._error = status, error

    def result(self) -> object:
        raise self._error


def test_errors_of_a_block_keep_their_kind() -> None:
    given_up = type("KilledWorker", (Exception,), {"__module__": "distributed.scheduler"})
    with pytest.raises(StorageError, match="a block failed on several workers: after 3 tries"):
        cluster._result(Ended(given_up("after 3 tries")))
    with pytest.raises(StorageError, match="a block failed on several workers: CancelledError"):
        cluster._result(Ended(type("CancelledError", (Exception,), {})(), status="cancelled"))
    with pytest.raises(BadInputError, match="another file"):
        cluster._result(Ended(BadInputError("another file")))
    with pytest.raises(ZeroDivisionError):  # a bug of ours keeps its name
        cluster._result(Ended(ZeroDivisionError()))


class Scheduler:
    """A client of a scheduler whose workers answer so."""

    def __init__(self, answer: dict[str, dict[str, str]] | Exception) -> None:
        self._answer = answer

    def get_versions(self, *, check: bool) -> None:
        assert check
        if isinstance(self._answer, Exception):
            raise self._answer

    def run(self, _: object) -> object:
        return self._answer


def test_workers_with_other_versions_are_refused_before_any_work() -> None:
    cluster._check_workers(Scheduler({"a": identity(), "b": identity()}), "here")
    with pytest.raises(UsageError, match=r"numba 0\.1 there"):
        cluster._check_workers(Scheduler({"a": identity(), "b": identity() | {"numba": "0.1"}}), "here")
    with pytest.raises(UsageError, match="here: its workers cannot run tofmix: no module"):
        cluster._check_workers(Scheduler(ValueError("no module")), "here")


@pytest.mark.parametrize(
    ("scheduler", "error", "text"),
    [
        ("none.json", BadInputError, "none.json: no such file"),
        ("http://host:8786", UsageError, "http:// is none of"),
        ("host", UsageError, "neither an address such as tcp://host:8786 nor a scheduler file"),
        ("host:port", UsageError, "neither an address such as tcp://host:8786 nor a scheduler file"),
        ("tcp://host", UsageError, "neither an address such as tcp://host:8786 nor a scheduler file"),
    ],
)
def test_what_is_no_scheduler_is_refused_in_one_line(scheduler: str, error: type[Exception], text: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(error, match=text), cluster.open_cluster(scheduler, memory_bytes=1):
        pass


@pytest.mark.parametrize("content", ["", "{}", "[1]", "\x89HDF", '{"other": 1}'])
def test_a_file_that_is_no_scheduler_file_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "scheduler.json").write_text(content)
    with pytest.raises(BadInputError, match=r"scheduler\.json: no scheduler file"):
        cluster._place(str(tmp_path / "scheduler.json"))


class _Client:
    """A client whose workers and scheduler are as told."""

    def __init__(self, *, status: str, workers: dict[str, object]) -> None:
        self.status, self._workers = status, workers
        self.scheduler = type("Scheduler", (), {"address": "tcp://host:8786"})

    def scheduler_info(self) -> dict[str, object]:
        return {"workers": self._workers}


class _Waiting:
    """Futures that never end."""

    def count(self) -> int:
        return 1

    def has_ready(self) -> bool:
        return False


@pytest.mark.parametrize(
    ("status", "text"), [("running", "has had no worker for 0.1 s; --resume continues"), ("closed", "has ended; --res")]
)
def test_a_run_without_workers_or_scheduler_ends(status: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_WORKER_TIMEOUT_S", 0.1)
    with pytest.raises(StorageError, match=text):
        next(cluster._while_there_are_workers(_Client(status=status, workers={}), _Waiting()))
