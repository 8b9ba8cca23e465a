"""Cells computed by the workers of a dask.distributed scheduler.

Use `open_cluster`. Workers open the recording by its path and send encoded cells back;
the journal and the layers file are written here. The scheduler gives the tasks of a dead worker to another worker, and
removes the tasks of a dead client.
"""

import json
import logging
import platform
import secrets
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from tempfile import gettempdir
from typing import Any

from tofmix.errors import BadInputError, StorageError, TofmixError, UsageError, os_error_text
from tofmix.grid import Cell, Grid
from tofmix.io.layers.chunks import EncodedCell
from tofmix.io.recording.recording_file import file_sha256, open_recording
from tofmix.pipeline.job import Job, LocalEngine
from tofmix.version import __version__

BLOCK_SAMPLES = 1 << 22
"""Samples of a task: at least half a second of work, compared with which dask's 2 ms are negligible."""

_CONNECT_TIMEOUT_S = 10  # s to wait for an answer of a scheduler
_WORKER_TIMEOUT_S = 30  # s to wait for a worker


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One task: some cells of a job. `identity` and `size`, `mtime_ns` must match the file on the worker."""

    job: Job
    cells: tuple[int, ...]
    memory_bytes: int
    identity: dict[str, str]
    size: int
    mtime_ns: int


def identity() -> dict[str, str]:
    """Properties that must be equal on both sides for equal bytes: versions, and the sources of the kernels."""
    from tofmix.compiled.kept import sources

    versions = {name: version(name) for name in ("numpy", "numba", "llvmlite")}
    return {"tofmix": __version__, "python": platform.python_version(), **versions, "kernels": sources()}


def run_block(block: Block) -> list[tuple[int, EncodedCell]]:
    """Compute a block, on a worker.

    Raises
    ------
    UsageError
        If the worker's versions differ.
    BadInputError
        If the worker does not see the recording, or sees another file at its path.
    """
    _check_identity(block.identity, identity())
    job = block.job
    _check_visible(block)
    with open_recording(job.recording, check_units=False) as source:
        own = source.with_sensor(job.provenance.sensor)
        engine = LocalEngine(source=own, workers=1, memory_bytes=block.memory_bytes, folder=Path(gettempdir()))
        wanted = [job.grid.cell(index) for index in block.cells]
        return [(cell.index, encoded) for cell, encoded in engine(job, wanted)]


def _check_identity(ours: dict[str, str], theirs: dict[str, str]) -> None:
    differing = [
        f"{name} {theirs.get(name)} there, {ours[name]} here" for name in ours if theirs.get(name) != ours[name]
    ]
    if differing:
        raise UsageError(
            f"a worker on {platform.node()} would not give the same bytes: {'; '.join(differing)};"
            " install the same versions there"
        )


def _check_visible(block: Block) -> None:
    path = block.job.recording
    remedy = "recordings must lie where every worker sees them by the same path"
    try:
        status = path.stat()
    except OSError as error:
        raise BadInputError(f"{os_error_text(error, path)} on the worker {platform.node()}; {remedy}") from error
    same = status.st_size == block.size and (
        status.st_mtime_ns == block.mtime_ns
        or _checksum(path, status.st_size, status.st_mtime_ns) == block.job.provenance.source_sha256
    )
    if not same:
        raise BadInputError(f"{path}: another file on the worker {platform.node()}; {remedy}")


@cache
def _checksum(path: Path, _size: int, _mtime_ns: int) -> str:
    """Checksum of a copy with another time, computed once in a process."""
    return file_sha256(path)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterEngine:
    """An `Engine` on the workers of a scheduler; made by `open_cluster`.

    Parameters
    ----------
    client : distributed.Client
        The connection.
    memory_bytes : int
        Limit of a task's memory.
    """

    client: Any
    memory_bytes: int

    def __call__(self, job: Job, wanted: Sequence[Cell]) -> Iterator[tuple[Cell, EncodedCell]]:
        """Yield each wanted cell when its block is done; remaining blocks are cancelled if the caller stops.

        Raises
        ------
        TofmixError
            The error of a worker.
        StorageError
            If the scheduler or too many workers have ended.
        """
        from distributed import as_completed

        # Workers run in other folders.
        job = replace(job, recording=job.recording.absolute())
        status = job.recording.stat()
        block = Block(
            job=job,
            cells=(),
            memory_bytes=self.memory_bytes,
            identity=identity(),
            size=status.st_size,
            mtime_ns=status.st_mtime_ns,
        )
        run = secrets.token_hex(6)
        futures = [
            self.client.submit(run_block, replace(block, cells=cells), key=f"tofmix-{run}-{number}", pure=False)
            for number, cells in enumerate(_blocks(job, wanted))
        ]
        waiting = as_completed(futures, loop=self.client.loop)
        try:
            for future in _while_there_are_workers(self.client, waiting):
                for index, encoded in _result(future):
                    yield job.grid.cell(index), encoded
                futures.remove(future)
                future.release()
        finally:
            self.client.cancel(futures, force=True)


def _while_there_are_workers(client: Any, waiting: Any) -> Iterator[Any]:  # noqa: ANN401  distributed's own
    """Futures in the order of their ends.

    Raises
    ------
    StorageError
        If no worker has been there for `_WORKER_TIMEOUT_S`, or the scheduler has ended.
    """
    last_seen_s = time.monotonic()
    look_s = 0.05  # s between two looks for a block that is done
    while waiting.count():
        if waiting.has_ready():
            yield next(waiting)
            last_seen_s = time.monotonic()
            continue
        time.sleep(look_s)
        if client.status not in ("running", "connecting"):
            raise StorageError(f"the scheduler {client.scheduler.address} has ended; --resume continues")
        if client.scheduler_info().get("workers"):
            last_seen_s = time.monotonic()
        elif time.monotonic() - last_seen_s > _WORKER_TIMEOUT_S:
            raise StorageError(
                f"the scheduler {client.scheduler.address} has had no worker for {_WORKER_TIMEOUT_S} s;"
                " --resume continues"
            )


def _result(future: Any) -> list[tuple[int, EncodedCell]]:  # noqa: ANN401  distributed's own
    """Result of a task; raises its error as one of tofmix."""
    try:
        result: list[tuple[int, EncodedCell]] = future.result()
    except TofmixError:
        raise
    except Exception as error:
        if future.status == "cancelled" or type(error).__module__.startswith(("distributed", "dask", "concurrent")):
            raise StorageError(f"a block failed on several workers: {str(error) or type(error).__name__}") from error
        raise
    return result


def _blocks(job: Job, wanted: Sequence[Cell]) -> Iterator[tuple[int, ...]]:
    """Divide the wanted cells into blocks that share stored chunks of the recording, on one grid of blocks."""
    grid, block = job.grid, _block_step(job.grid, job.chunk_frames)
    members: dict[tuple[int, int], list[int]] = {}
    for cell in wanted:
        group, band = divmod(cell.index, grid.bands)
        members.setdefault((group // block[0], band // block[1]), []).append(cell.index)
    return (tuple(cells) for cells in members.values())


def _block_step(grid: Grid, chunk_frames: int) -> tuple[int, int]:
    """Groups and bands of cells of a block: first as many windows as a stored chunk holds, then rows, then windows."""
    windows, rows = grid.step
    cell_samples = windows * rows * grid.image[1] * grid.windows.length
    groups = max(1, min(grid.groups, chunk_frames // (windows * grid.windows.stride)))
    bands = min(grid.bands, -(-BLOCK_SAMPLES // (groups * cell_samples)))
    if bands == grid.bands:
        groups = min(grid.groups, -(-BLOCK_SAMPLES // (bands * cell_samples)))
    return groups, bands


@contextmanager
def open_cluster(scheduler: str, *, memory_bytes: int) -> Iterator[ClusterEngine]:
    """Connect to a scheduler.

    Parameters
    ----------
    scheduler : str
        Its address, such as ``tcp://host:8786``, or the path of its scheduler file.
    memory_bytes : int
        Limit of a task's memory.

    Yields
    ------
    ClusterEngine
        With at least one worker, all of the same versions as here.

    Raises
    ------
    UsageError
        If distributed is not installed, or versions differ.
    StorageError
        If the scheduler cannot be reached, or has no worker.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("--scheduler needs dask.distributed: pip install 'tofmix[cluster]'") from error
    where = _place(scheduler)
    for logger in ("distributed", "distributed.client"):  # the second logger has a separate level
        logging.getLogger(logger).setLevel(logging.CRITICAL)  # its errors become one line of tofmix
    try:
        client = Client(**where, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StorageError(
            f"--scheduler {scheduler}: cannot be reached ({str(error) or type(error).__name__})"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WORKER_TIMEOUT_S)
        except TimeoutError as error:
            raise StorageError(f"--scheduler {scheduler}: no worker joined within {_WORKER_TIMEOUT_S} s") from error
        _check_workers(client, scheduler)
        yield ClusterEngine(client=client, memory_bytes=memory_bytes)


def _place(scheduler: str) -> dict[str, str]:
    """Where a scheduler is, as a client takes it.

    Raises
    ------
    UsageError
        If it is no address.
    BadInputError
        If the file is no scheduler file.
    """
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import backends

    path = Path(scheduler)
    if path.is_file():
        try:
            address = json.loads(path.read_text(encoding="utf-8"))["address"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise BadInputError(
                f"--scheduler {scheduler}: no scheduler file, which `dask scheduler --scheduler-file` writes"
            ) from error
        return {"address": str(address)}
    if "://" not in scheduler and (path.suffix or "/" in scheduler) and ":" not in scheduler:
        raise BadInputError(f"--scheduler {scheduler}: no such file")
    try:
        protocol, host = parse_address(scheduler)
        parse_host_port(host)  # a client that fails over it leaves a traceback behind
    except ValueError as error:
        raise UsageError(
            f"--scheduler {scheduler}: neither an address such as tcp://host:8786 nor a scheduler file"
        ) from error
    if protocol not in backends:
        raise UsageError(f"--scheduler {scheduler}: {protocol}:// is none of {', '.join(sorted(backends))}")
    return {"address": scheduler}


def _check_workers(client: Any, scheduler: str) -> None:  # noqa: ANN401  distributed's own
    """Refuse workers that would compute something else; one that joins later is checked with its first block."""
    try:
        client.get_versions(check=True)
        found = client.run(identity)
    except Exception as error:
        raise UsageError(f"--scheduler {scheduler}: its workers cannot run tofmix: {error}") from error
    for theirs in found.values():
        _check_identity(identity(), theirs)
