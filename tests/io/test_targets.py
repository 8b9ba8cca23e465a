"""Recordings with several targets a pixel and frame: read in any block, and as series of each target."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.recording.recording_file import open_recording
from tofmix.io.recording.recording_writer import RecordingWriter
from tofmix.recording import ArrayRecording, FrameSpan, TargetSeries, by_target, samples_a_frame
from tofmix.sensor import Sensor

FRAMES, TARGETS, ROWS, COLS = 7, 3, 10, 5


def samples() -> NDArray[np.float32]:
    values = np.random.default_rng(1).uniform(500, 3000, (FRAMES, TARGETS, ROWS, COLS)).astype("f4")
    values[2, 1], values[:, 2, :4] = np.nan, np.nan
    return values


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "r.h5"
    writer = RecordingWriter(
        path,
        shape=(FRAMES, ROWS, COLS),
        targets=TARGETS,
        sensor=Sensor(name="zones"),
        has_time=True,
        dtype="f4",
        chunk_frames=2,
    )
    with writer:
        for start in range(0, FRAMES, 2):
            part = samples()[start : start + 2]
            writer.write(start, part, amplitude=-part, time_s=np.arange(start, start + len(part)) / 10)
    return path


def test_targets_of_a_frame_are_samples_that_follow_each_other(recording: Path) -> None:
    flat = samples().reshape(FRAMES * TARGETS, ROWS, COLS)
    with open_recording(recording) as file:
        assert (file.frames, file.targets, file.shape) == (FRAMES, TARGETS, flat.shape)
        assert (file.frame_step, file.row_step, samples_a_frame(file)) == (6, 8, 3)
        for frames in (slice(None), slice(0, 1), slice(4, 11), slice(20, 21), slice(5, 5)):
            for rows in (slice(None), slice(3, 9)):
                np.testing.assert_array_equal(file.read_range(frames, rows), flat[frames, rows])
                np.testing.assert_array_equal(file.read_amplitude(frames, rows), -flat[frames, rows])
        assert file.read_time() is not None


def test_each_target_is_a_series_of_its_own(recording: Path) -> None:
    by_row = samples().transpose(0, 2, 1, 3).reshape(FRAMES, ROWS * TARGETS, COLS)
    with open_recording(recording) as file:
        series = by_target(file)
        assert isinstance(series, TargetSeries)
        assert series.shape == by_row.shape
        assert (series.frame_step, series.row_step) == (2, 24)
        for frames in (slice(None), slice(2, 5)):
            for rows in (slice(None), slice(1, 2), slice(4, 23), slice(29, 30)):
                np.testing.assert_array_equal(series.read_range(frames, rows), by_row[frames, rows])
                np.testing.assert_array_equal(series.read_amplitude(frames, rows), -by_row[frames, rows])


def test_some_frames_have_all_their_targets(recording: Path) -> None:
    with open_recording(recording) as file:
        part = FrameSpan(file, 2, 4)
        assert part.shape == (2 * TARGETS, ROWS, COLS)
        np.testing.assert_array_equal(part.read_range(slice(None), slice(None)), samples()[2:4].reshape(-1, ROWS, COLS))
        with pytest.raises(ValueError, match="frames 2 to 8 asked for, the recording has 7"):
            FrameSpan(file, 2, 8)


def test_a_recording_without_targets_is_itself() -> None:
    plain = ArrayRecording(np.ones((4, 2, 2)), Sensor(name="a"))
    assert by_target(plain) is plain
    assert samples_a_frame(plain) == 1


@pytest.mark.parametrize("scales", [(), ("frame", "row", "col", "target"), ("frame", "target", "col", "row")])
def test_four_axes_without_names_are_refused(tmp_path: Path, scales: tuple[str, ...]) -> None:
    path = tmp_path / "r.h5"
    with h5py.File(path, "w") as root:
        root["range"] = np.ones((3, 3, 3, 3), "u2")
        for axis, name in enumerate(scales):
            root[name] = np.arange(3)
            root[name].make_scale(name)
            root["range"].dims[axis].attach_scale(root[name])
    with pytest.raises(BadInputError, match=r"tofmix import .* --axes frame,target,row,col"), open_recording(path):
        pass


def test_more_targets_than_any_sensor_returns_are_refused(tmp_path: Path, recording: Path) -> None:
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as root:
        root["range"] = np.ones((2, 65, 2, 2), "u2")
        for axis, name in enumerate(("frame", "target", "row", "col")):
            root[name] = np.arange(root["range"].shape[axis])
            root[name].make_scale(name)
            root["range"].dims[axis].attach_scale(root[name])
    with pytest.raises(BadInputError, match="65 targets; no more than 64"), open_recording(path):
        pass
    with h5py.File(recording, "r+") as root:
        del root["amplitude"]
        root["amplitude"] = np.ones((FRAMES, ROWS, COLS))
    with pytest.raises(BadInputError, match="amplitude: shape"), open_recording(recording):
        pass
