"""`tofmix estimate --scheduler`: a scheduler and two workers as processes of their own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording
from support.lock_in import made, two_boards, write_sums

from tofmix.errors import ExitCode
from tofmix.grid import plan_grid, plan_windows
from tofmix.io.layers.layers_file import open_layers
from tofmix.pipeline import cluster as pipeline_cluster
from tofmix.report.summary.summary import find, remedy_for

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed"),
]

DASK = (sys.executable, "-m", "distributed.cli.dask_scheduler"), (sys.executable, "-m", "distributed.cli.dask_worker")
SMALL_BLOCK_SAMPLES = 1 << 17
SMALL_BLOCKS = (
    "import sys, tofmix.pipeline.cluster as cluster\n"
    f"cluster.BLOCK_SAMPLES = {SMALL_BLOCK_SAMPLES}\n"
    "from tofmix.cli.main import run\nrun(sys.argv[1:])\n"
)
TOFMIX = (sys.executable, "-c", SMALL_BLOCKS)


class Cluster:
    """Processes of one cluster, and the scheduler file by which they find each other."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self.folder = folder
        self.workers: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start(
            *DASK[0], "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", self.file
        )
        while not self.file.exists():
            assert self.scheduler.poll() is None, "the scheduler did not start"
            time.sleep(0.05)

    def _start(self, *command: object) -> "subprocess.Popen[bytes]":
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(
                [str(part) for part in command], stdout=log, stderr=log, cwd=self.folder, env=environment
            )

    def add_worker(self) -> None:
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", self.folder / "scratch")
        self.workers.append(self._start(*DASK[1], "--scheduler-file", self.file, *options))

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        cluster.add_worker()
        cluster.add_worker()
        yield cluster
    finally:
        cluster.close()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    return write_recording(folder / "a.h5", boards(600, 20, 24), chunks=(100, 5, 24), compression="gzip")


def arguments(recording: Path, output: Path, *extra: object) -> tuple[object, ...]:
    return "estimate", recording, "-o", output, "--window", 40, "--stride", 8, "--mixing", "events", *extra


def command(*parts: object) -> list[str]:
    """The same in a process of its own, as a cluster's client."""
    return [*TOFMIX, *(str(part) for part in parts)]


def run(recording: Path, output: Path, *extra: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command(*arguments(recording, output, *extra)), capture_output=True, text=True, check=False)


_EXPECTED: list[bytes] = []
"""The layers file of a local run, made by the first test that needs it."""


@pytest.fixture
def expected(tofmix: Tofmix, recording: Path) -> bytes:
    if not _EXPECTED:
        output = recording.with_name("local")
        tofmix.done(*arguments(recording, output))
        _EXPECTED.append(output.read_bytes())
    return _EXPECTED[0]


@pytest.mark.compiled("6,480 fits, twice")
def test_unmixed_layers_of_phasor_sums_have_the_bytes_of_a_local_run(
    cluster: Cluster, tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one image is unmixed from the cells of two tasks."""
    view = (72, 90, 24.0, 19.5)
    sums = write_sums(tmp_path / "sums.h5", made(two_boards(np.random.default_rng(1)), 1, view=view).recording)
    grid = plan_grid(plan_windows(40, window=40), view[:2])
    monkeypatch.setattr(pipeline_cluster, "BLOCK_SAMPLES", SMALL_BLOCK_SAMPLES)
    groups, bands = pipeline_cluster._block_step(grid, 40)
    assert grid.bands > 1
    assert (grid.groups // groups) * (grid.bands // bands) > 1
    given = "estimate", sums, "--window", 40, "--noise", "file", "--mixing", "phasor"
    tofmix.done(*given, "-o", tmp_path / "local.layers.h5")
    program = command(*given, "-o", tmp_path / "cluster.layers.h5", "--scheduler", cluster.file)
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "cluster.layers.h5").read_bytes() == (tmp_path / "local.layers.h5").read_bytes()
    with open_layers(tmp_path / "local.layers.h5") as layers:
        assert layers.mixing_law is not None


def first_blocks_of(running: "subprocess.Popen[str]", folder: Path) -> None:
    """Wait until the first blocks are in the journal."""
    journal = folder / ".a.layers.h5.journal-wal"
    while running.poll() is None and not (journal.exists() and journal.stat().st_size > 200_000):
        time.sleep(0.01)
    assert running.poll() is None, "it ended too early"


@pytest.mark.compiled("34,080 fits")
def test_ctrl_c_cancels_remaining_blocks_and_keeps_finished_ones(
    cluster: Cluster, tofmix: Tofmix, recording: Path, expected: bytes, tmp_path: Path
) -> None:
    output = tmp_path / "a.layers.h5"
    running = subprocess.Popen(
        command(*arguments(recording, output, "--scheduler", cluster.file)), stderr=subprocess.PIPE, text=True
    )
    first_blocks_of(running, tmp_path)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == -signal.SIGINT
    assert err == "tofmix: interrupted\ntofmix: finished blocks are kept; --resume continues\n"
    count = (
        "import sys, time\nfrom distributed import Client\n"
        "with Client(scheduler_file=sys.argv[1]) as client:\n"
        "    tasks = lambda dask_scheduler: len(dask_scheduler.tasks)\n"
        "    while client.run_on_scheduler(tasks):\n        time.sleep(0.1)\n"
    )
    subprocess.run([sys.executable, "-c", count, cluster.file], check=True, timeout=60)
    resumed = tofmix(*arguments(recording, output, "--resume"))
    assert "blocks from the interrupted run" in resumed.err
    assert output.read_bytes() == expected


def doubts(output: Path, recording: Path) -> set[str]:
    """What the recordings of these tests make doubtful: they scatter less than their curve says."""
    with open_layers(output) as file:
        return {
            f"tofmix: {output}: {f.line}"
            for f in find(file, remedy_for(file.provenance, file.shape[0], str(recording)))
        }


def test_the_bytes_are_those_of_a_local_run(cluster: Cluster, tofmix: Tofmix, tmp_path: Path) -> None:
    few = write_recording(tmp_path / "a.h5", boards(56, 4, 6))
    outputs = tmp_path / "local", tmp_path / "cluster"
    local, done = tofmix(*arguments(few, outputs[0])), run(few, outputs[1], "--scheduler", cluster.file)
    assert (local.code, done.returncode) == (0, 0), done.stderr
    for output, said in zip(outputs, (local.err, done.stderr), strict=True):
        assert set(said.splitlines()) <= doubts(output, few)
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


@pytest.mark.compiled("34,080 fits")
def test_the_bytes_are_those_of_a_local_run_though_a_worker_is_killed(
    cluster: Cluster, recording: Path, expected: bytes, tmp_path: Path
) -> None:
    output = tmp_path / "a.layers.h5"
    running = subprocess.Popen(
        command(*arguments(recording, output, "--scheduler", cluster.file)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    first_blocks_of(running, tmp_path)
    cluster.workers[0].kill()
    out, err = running.communicate(timeout=120)
    assert running.returncode == 0, err
    assert "pixels by surfaces" in out
    assert set(err.splitlines()) <= doubts(output, recording)
    assert output.read_bytes() == expected
    assert [path.name for path in tmp_path.iterdir()] == ["a.layers.h5"]


def test_path_missing_on_worker_exits_with_3(cluster: Cluster, recording: Path, tmp_path: Path) -> None:
    # The workers' view of the file is that of /proc/self, which is another one in each process.
    with recording.open("rb") as file:
        os.dup2(file.fileno(), 77)
        done = subprocess.run(
            command(*arguments(Path("/proc/self/fd/77"), tmp_path / "out", "--scheduler", cluster.file)),
            capture_output=True,
            text=True,
            check=False,
            pass_fds=(77,),
        )
        os.close(77)
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr.startswith("tofmix: /proc/self/fd/77: ")
    assert "recordings must lie where every worker sees them by the same path" in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_missing_scheduler_is_a_storage_error(recording: Path, tmp_path: Path) -> None:
    program = SMALL_BLOCKS.replace(f"BLOCK_SAMPLES = {SMALL_BLOCK_SAMPLES}", "_CONNECT_TIMEOUT_S = 0.2")
    given = map(str, arguments(recording, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1"))
    done = subprocess.run([sys.executable, "-c", program, *given], capture_output=True, text=True, check=False)
    assert done.returncode == ExitCode.STORAGE
    assert done.stderr.startswith("tofmix: --scheduler tcp://127.0.0.1:1: cannot be reached")
    assert done.stderr.count("\n") == 1
