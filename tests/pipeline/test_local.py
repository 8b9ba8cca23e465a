"""The local engine within its memory, also where a recording's layout is against it."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from support.files import boards, write_recording

from tofmix.arrays import Float32Array
from tofmix.errors import StorageError, UsageError
from tofmix.estimation.settings import EstimateOptions
from tofmix.io.layers.chunks import EncodedCell
from tofmix.io.recording.recording_file import RecordingFile, open_recording
from tofmix.io.recording.scratch import on_scratch
from tofmix.pipeline.job import PROGRAM_BYTES, LocalEngine, plan_job
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.windows import plan_windows

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
