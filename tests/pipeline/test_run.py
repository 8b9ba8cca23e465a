"""A job's last look at its recording comes before its output has a name."""

from pathlib import Path

import pytest
from support.files import boards, write_recording

from tofmix.errors import BadInputError
from tofmix.estimation.settings import EstimateOptions
from tofmix.io.layers.journal import journal_path
from tofmix.io.recording.recording_file import RecordingFile, open_recording
from tofmix.pipeline.job import PROGRAM_BYTES, LocalEngine, plan_job
from tofmix.pipeline.run import run_job
from tofmix.windows import plan_windows


def run(source: RecordingFile, target: Path) -> None:
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
        run(source, target)
    assert not target.exists()
    assert not journal_path(target).exists()


def test_change_of_the_recording_after_the_end_is_accepted(tmp_path: Path) -> None:
    path, target = write_recording(tmp_path / "a.h5", boards(30, 6, 5)), tmp_path / "a.layers.h5"
    with open_recording(path) as source:
        run(source, target)
        path.write_bytes(b"")
    assert target.exists()
