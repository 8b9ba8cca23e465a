"""Recordings: what is read from any that fits, what is refused and how, several targets, and floats not in mm."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from numpy.typing import NDArray
from support.cameras import camera_of
from support.commandline import succeed
from support.files import boards, write_recording

from tofmix.errors import BadInputError
from tofmix.io.recording.range_check import (
    check_whole_numbers,
    fills_doubt,
    implausible,
    look,
)
from tofmix.io.recording.recording_file import RecordingFile, file_sha256, open_recording
from tofmix.io.recording.recording_writer import RecordingWriter
from tofmix.recording import ArrayRecording, FrameSpan, TargetSeries, by_target, samples_a_frame
from tofmix.sensor import Sensor

EVERYTHING = (slice(None), slice(None))


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4", "i2", "i4", "f2", "f4", "f8", ">u2"])
def test_any_number_type_is_read(tmp_path: Path, dtype: str) -> None:
    samples = np.array([[[1, 50]], [[100, 7]]], dtype=dtype)
    with open_recording(write_recording(tmp_path / "r.h5", samples), check_units=False) as recording:
        read = recording.read_range(*EVERYTHING)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, samples.astype(np.float32))


@pytest.mark.parametrize(
    ("values", "dtype", "fill", "expected"),
    [
        ([0, 5, 9], "u2", None, [np.nan, 5, 9]),
        ([0, 5, 9], "u2", 9, [0, 5, np.nan]),
        ([0.0, np.nan, np.inf], "f4", None, [0.0, np.nan, np.nan]),
        ([0.0, -1.0, np.nan], "f4", -1.0, [0.0, np.nan, np.nan]),
        ([0.0, 2.0, np.nan], "f4", np.nan, [0.0, 2.0, np.nan]),
    ],
)
def test_invalid_samples_follow_the_contract(
    tmp_path: Path, values: list[float], dtype: str, fill: float | None, expected: list[float]
) -> None:
    samples = np.array(values, dtype=dtype)[:, None, None]
    with open_recording(write_recording(tmp_path / "r.h5", samples, fill=fill), check_units=False) as recording:
        np.testing.assert_array_equal(recording.read_range(*EVERYTHING)[:, 0, 0], np.array(expected, dtype=np.float32))


@pytest.mark.parametrize("chunks", [None, (7, 3, 4), (1, 10, 6), (40, 1, 6)])
@pytest.mark.parametrize("decoded", [1, 50, 1 << 20])
def test_samples_are_decoded_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunks: tuple[int, int, int] | None, decoded: int
) -> None:
    samples = boards(40, 10).astype("f4")
    samples[3, 4, 5] = np.inf
    expected = np.where(np.isfinite(samples), samples, np.nan)
    path = write_recording(tmp_path / "r.h5", samples, chunks=chunks)
    monkeypatch.setattr("tofmix.io.recording.recording_file.DECODED_SAMPLES", decoded)
    with open_recording(path) as recording:
        assert recording.frame_step == (chunks or (1,))[0]
        for part in (EVERYTHING, (slice(5, 31), slice(2, 9)), (slice(6, 7), slice(9, 10))):
            np.testing.assert_array_equal(recording.read_range(*part), expected[part])


def test_a_file_without_a_sensor_is_read_as_unknown(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as root:
        root["range"] = boards()
    with open_recording(tmp_path / "r.h5") as recording:
        assert recording.sensor == Sensor(name="unknown")
        assert recording.row_step == 1
        assert not recording.has_amplitude
        with pytest.raises(BadInputError, match="no dataset amplitude"):
            recording.read_amplitude(*EVERYTHING)


def test_limits_that_are_not_finite_are_none(tmp_path: Path) -> None:
    attributes = {"range_max_mm": np.inf, "integration_time_ms": np.nan, "name": np.bytes_(b"stereo")}
    with open_recording(write_recording(tmp_path / "r.h5", boards(), attributes=attributes)) as recording:
        assert recording.sensor.range_max_mm is None
        assert recording.sensor.integration_time_ms is None
        assert recording.sensor.name == "stereo"
        assert recording.sensor.outlier_probability == 1e-4


def _put(name: str, value: Any) -> Callable[[h5py.File], None]:  # noqa: ANN401  what h5py takes
    def change(root: h5py.File) -> None:
        if name in root:
            del root[name]
        if value is not None:
            root[name] = value

    return change


def _attribute(item: str, name: str, value: Any) -> Callable[[h5py.File], None]:  # noqa: ANN401  what h5py takes
    def change(root: h5py.File) -> None:
        root[item].attrs[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_put("range", None), "no dataset range"),
        (_put("range", np.zeros((3, 4))), r"range: expected \(frame, row, col\), got shape \(3, 4\)"),
        (_put("range", np.zeros((3, 4, 5, 6))), "got shape"),
        (_put("range", np.zeros((0, 4, 5))), "holds no sample"),
        (_put("range", np.zeros((3, 4, 5), dtype="S3")), "expected integers or floats"),
        (_put("range", np.zeros((3, 4, 5), dtype=complex)), "expected integers or floats"),
        (_put("range/x", 1.0), "range: expected a dataset, got a group"),
        (_put("amplitude", np.zeros((3, 4, 5))), r"amplitude: shape \(3, 4, 5\) differs"),
        (_attribute("range", "units", "m"), "range: units 'm', expected 'mm'"),
        (_put("sensor", 3.0), "sensor: expected a group"),
        (_put("sensor/noise_sigma", [10.0, -5.0]), "sensor: noise curve: sigma is -5 mm at 5000 mm"),
        (_put("sensor/noise_sigma", [10.0, np.nan]), "sensor: noise curve: sigma is nan"),
        (_put("sensor/noise_sigma", [10.0]), "sensor: noise curve"),
        (_put("sensor/noise_sigma", None), "sensor/noise_sigma: missing; noise_range, noise_sigma go together"),
        (_put("sensor/noise_range", [5000.0, 500.0]), "do not ascend"),
        (_put("sensor/noise_range", ["a", "b"]), "sensor/noise_range: expected numbers"),
        (_attribute("sensor", "range_max_mm", -4.0), "sensor: range_max_mm"),
        (_attribute("sensor", "range_max_mm", "far"), "range_max_mm: expected one number"),
        (_attribute("sensor", "range_min_mm", [1.0, 2.0]), "range_min_mm: expected one number"),
        (_attribute("/", "format", "tofmix-layers"), "is a layers file, not a recording"),
    ],
)
def test_dataset_of_wrong_shape_or_type_is_refused_with_its_name(
    tmp_path: Path, change: Callable[[h5py.File], None], reason: str
) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with h5py.File(path, "r+") as root:
        if reason.startswith("range: expected a dataset"):
            del root["range"]
        change(root)
    with pytest.raises(BadInputError, match=reason) as caught, open_recording(path):
        pass
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_data_in_other_files_are_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(b"\x07\x00" * 24)
    with h5py.File(tmp_path / "external.h5", "w") as root:
        root.create_dataset("range", (2, 3, 4), "u2", external=[(str(secret), 0, 48)])
    whole = write_recording(tmp_path / "whole.h5", boards(4, 2, 2))
    with h5py.File(tmp_path / "link.h5", "w") as root:
        root["range"] = h5py.ExternalLink(whole, "/range")
    layout = h5py.VirtualLayout((4, 2, 2), "u2")
    layout[:] = h5py.VirtualSource(whole, "range", (4, 2, 2))
    with h5py.File(tmp_path / "virtual.h5", "w") as root:
        root.create_virtual_dataset("range", layout)
    for name in ("external", "link", "virtual"):
        with (
            pytest.raises(BadInputError, match=r"range: .* another file; refused"),
            open_recording(tmp_path / f"{name}.h5"),
        ):
            pass


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(BadInputError, match="not a regular file"), open_recording(tmp_path / "pipe.h5"):
        pass


def test_values_beyond_float32_are_invalid(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "r.h5", np.array([[[1e300]], [[500.0]]]))
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.read_range(*EVERYTHING)[:, 0, 0], [np.nan, 500.0])


def test_a_later_format_is_refused(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with h5py.File(path, "r+") as root:
        root.attrs["format"], root.attrs["format_version"] = "tofmix-recording", "2.1"
    with pytest.raises(BadInputError, match=r"format_version '2.1'"), open_recording(path):
        pass


def test_file_sha256_equals_hashlib(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"abc" * 1000)
    assert file_sha256(path) == hashlib.sha256(b"abc" * 1000).hexdigest()
    with pytest.raises(BadInputError, match="No such file"):
        file_sha256(tmp_path / "none")


CAMERA = camera_of([500.0, 5000.0], [10.0, 80.0], reach_mm=(300.0, 7500.0), name="camera", modulation_frequency_hz=20e6)


def _write(path: Path, samples: np.ndarray, **settings: Any) -> None:  # noqa: ANN401  the writer's own
    with RecordingWriter(path, shape=samples.shape, sensor=CAMERA, has_temperature=True, **settings) as writer:
        for start in range(0, len(samples), 100):
            part = samples[start : start + 100]
            writer.write(
                start,
                part,
                time_s=(start + np.arange(len(part))) / 25.0,
                amplitude=np.float32(1 / 7) * part.astype(np.float32),
                temperature_c=np.full(len(part), 31.5, "f4"),
            )


def test_a_written_recording_reads_back(tmp_path: Path) -> None:
    samples = boards(230)
    samples[5, 2, 3] = 0
    _write(tmp_path / "r.h5", samples)
    with open_recording(tmp_path / "r.h5") as recording:
        read = recording.read_range(*EVERYTHING)
        assert np.isnan(read[5, 2, 3])
        np.testing.assert_array_equal(np.nan_to_num(read), samples)
        amplitude = recording.read_amplitude(*EVERYTHING)
        np.testing.assert_array_equal(amplitude, np.float32(1 / 7) * samples.astype(np.float32))
        np.testing.assert_array_equal(recording.read_time(), np.arange(230) / 25.0)
        np.testing.assert_array_equal(recording.read_temperature(), np.full(230, 31.5))
        assert recording.sensor.modulation_frequency_hz == 20e6
        assert recording.sensor.noise is not None
        np.testing.assert_array_equal(recording.sensor.noise.sigma_mm, [10.0, 80.0])


def test_xarray_opens_it_with_named_dimensions(tmp_path: Path) -> None:
    samples = boards(12)
    _write(tmp_path / "r.h5", samples)
    with xarray.open_dataset(tmp_path / "r.h5", engine="h5netcdf") as data:
        assert data["range"].dims == ("frame", "row", "col")
        assert data["amplitude"].dims == ("frame", "row", "col")
        assert data["temperature"].dims == data["time"].dims == ("frame",)
        assert data["range"].attrs["units"] == "mm"
        np.testing.assert_array_equal(data["range"].values, samples)


def _floats(path: Path, samples: Any, *, units: str | None = None, **settings: Any) -> Path:  # noqa: ANN401  as h5py
    return write_recording(path, samples.astype("f4"), units=units, **settings)


@pytest.mark.parametrize(
    ("scale", "attributes"), [(1e-3, {}), (1e-3, {"range_min_mm": 0.0}), (0.1, {"range_min_mm": 3000.0})]
)
def test_floats_too_small_for_mm_are_refused_with_both_remedies(
    tmp_path: Path, scale: float, attributes: dict[str, float]
) -> None:
    path = _floats(tmp_path / "a.h5", boards() * scale, attributes=attributes)
    with pytest.raises(BadInputError, match=r"a\.h5: range: float32 without units") as refused, open_recording(path):
        pass
    assert f"tofmix import {path} --units m -o {tmp_path / 'a_mm.h5'}" in str(refused.value)
    assert "attribute units to mm" in str(refused.value)


def test_floats_marked_as_mm_are_read_with_a_note_where_no_camera_sees_so_near(tmp_path: Path) -> None:
    path = _floats(tmp_path / "a.h5", boards() * 1e-3, units="mm")
    with open_recording(path) as recording:
        (said,) = recording.remarks
    assert f"no camera sees so near; check the units; if the numbers are in m: tofmix import {path} --units m" in said


@pytest.mark.parametrize(
    ("median", "limits", "said"),
    [
        (60.0, {}, ""),
        (
            19.0,
            {},
            "below 19 mm; no camera sees so near; check the units; if the numbers are in m",
        ),
        (
            140_000.0,
            {},
            "above 140 m; no camera sees so far; check the units; if the numbers are in micr",
        ),
        (7000.0, {"range_max_mm": 4000.0}, ""),
        (9000.0, {"range_max_mm": 4000.0}, "above 9 m; the range of unknown ends at 4000 mm"),
        (300.0, {"range_min_mm": 350.0}, "below 300 mm; the range of unknown begins at 350 mm"),
    ],
)
def test_a_median_that_the_camera_cannot_measure_is_said(median: float, limits: dict[str, float], said: str) -> None:
    doubt = implausible(median, Sensor(name="unknown", **limits), unit_mm=1.0, path=Path("a.h5"))  # type: ignore[arg-type]
    assert doubt.startswith("half of the ranges are") == bool(said)
    assert said in doubt


@pytest.mark.parametrize(("most", "doubted"), [(1100.0, True), (2000.0, False), (3000.0, False), (5000.0, False)])
@pytest.mark.parametrize("dtype", ["u2", "f4"])
def test_samples_mostly_beyond_the_cameras_range_are_said(
    tmp_path: Path, most: float, doubted: bool, dtype: str
) -> None:
    # Boards at 1200 and 3000 mm in equal parts. One at the end of the range is as samples without a return are.
    path = write_recording(tmp_path / "a.h5", boards(40).astype(dtype), attributes={"range_max_mm": most})
    with open_recording(path) as recording:
        lines = (*recording.remarks, *check_whole_numbers(recording))
    said = f"outside the sensor's 300 to {most:g} mm; check range_min_mm and range_max_mm of its sensor"
    assert [said in line for line in lines] == [True] * doubted


@pytest.mark.parametrize("unit", ["m", "cm", "metre", "centimetre"])
def test_another_unit_is_refused_with_the_import_that_converts_it(tmp_path: Path, unit: str) -> None:
    path = _floats(tmp_path / "a.h5", boards() * 1e-3, units=unit)
    short = "m" if unit.startswith("m") else "cm"
    with pytest.raises(BadInputError, match=f"tofmix import {path} --units {short} "), open_recording(path):
        pass


def test_zeros_that_count_as_ranges_are_counted(tmp_path: Path) -> None:
    samples = boards(100).astype("f4")
    samples[:3, 0, 0] = 0
    with open_recording(_floats(tmp_path / "few.h5", samples)) as recording:
        (line,) = recording.remarks
    assert "3 of 2,400 checked samples are exactly 0" in line
    assert "--invalid 0" in line
    assert "_FillValue" in line
    with open_recording(_floats(tmp_path / "filled.h5", samples, fill=0.0)) as recording:
        assert recording.remarks == ()


@pytest.mark.parametrize(
    ("dtype", "value", "reason"),
    [
        ("u2", 65535, "fill value 65535"),
        ("i2", 32767, "fill value 32767"),
        ("u4", 4294967295, "above 1e+09 mm"),
        ("f4", 65535.0, "fill value 65535 mm"),
        ("f8", 9.97e36, "above 1e+09 mm"),
        ("f4", -1.0, "negative"),
    ],
)
def test_values_that_import_drops_and_the_file_does_not_name_are_counted(
    tmp_path: Path, dtype: str, value: float, reason: str
) -> None:
    samples = boards(40).astype(dtype)
    samples[::4, 2] = value
    path = write_recording(tmp_path / "a.h5", samples)
    with open_recording(path) as recording:
        (line,) = (*recording.remarks, *check_whole_numbers(recording))
    assert f"of 960 checked samples these count as ranges: 60 {reason}; if they mean no sample" in line
    again = tmp_path / "a_mm.h5"
    assert line.endswith(f"tofmix import {path} -o {again}")
    succeed("import", path, "-o", again)
    with open_recording(again) as recording:
        assert (*recording.remarks, *check_whole_numbers(recording)) == ()


def test_named_fill_values_and_a_surface_at_the_range_of_one_are_not_counted(tmp_path: Path) -> None:
    samples = boards(40).astype("u2")
    samples[::4, 2] = 65535
    with open_recording(write_recording(tmp_path / "named.h5", samples, fill=65535)) as recording:
        assert fills_doubt(recording, look(recording)) is None
    samples = (32768 + np.random.default_rng(3).integers(-12, 13, samples.shape)).astype("u2")
    with open_recording(write_recording(tmp_path / "surface.h5", samples)) as recording:
        assert look(recording).samples == samples.size
        assert fills_doubt(recording, look(recording)) is None


@pytest.mark.parametrize(
    ("unit", "option"), [("um", "--scale 0.001"), ("inch", "--scale 25.4"), ("feet", "--scale 304.8")]
)
def test_a_unit_without_an_option_of_its_own_is_refused_with_its_scale(tmp_path: Path, unit: str, option: str) -> None:
    path = _floats(tmp_path / "a.h5", boards(), units=unit)
    with pytest.raises(BadInputError, match=f"tofmix import {path} {option} -o"), open_recording(path):
        pass


@pytest.mark.parametrize("chunks", [None, (2000, 4, 8), (1, 16, 64), (64, 1, 64)])
def test_a_long_recording_is_read_in_a_few_blocks(
    tmp_path: Path, chunks: tuple[int, int, int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = np.arange(16, dtype="f4")[None, :, None]
    samples = np.broadcast_to(1000.0 + rows, (4000, 16, 64))
    path = _floats(tmp_path / "a.h5", samples, chunks=chunks)
    read: list[int] = []
    inner = RecordingFile.read_range

    def counting(self: RecordingFile, frames: slice, rows: slice) -> Any:  # noqa: ANN401  an array
        block = inner(self, frames, rows)
        read.append(block.size)
        return block

    monkeypatch.setattr(RecordingFile, "read_range", counting)
    with open_recording(path) as recording:
        first, again = look(recording), look(recording)
    assert first == again  # the same blocks
    assert max(read) <= 1 << 16
    assert len(read) == 3 * 4  # once by open_recording
    assert sum(read[:4]) < samples.size / 10


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


def test_targets_of_a_frame_follow_each_other_and_each_is_a_series(recording: Path) -> None:
    flat = samples().reshape(FRAMES * TARGETS, ROWS, COLS)
    with open_recording(recording) as file:
        assert (file.frames, file.targets, file.shape) == (FRAMES, TARGETS, flat.shape)
        assert (file.frame_step, file.row_step, samples_a_frame(file)) == (6, 8, 3)
        for frames in (slice(None), slice(0, 1), slice(4, 11), slice(20, 21), slice(5, 5)):
            for rows in (slice(None), slice(3, 9)):
                np.testing.assert_array_equal(file.read_range(frames, rows), flat[frames, rows])
                np.testing.assert_array_equal(file.read_amplitude(frames, rows), -flat[frames, rows])
        assert file.read_time() is not None
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
    with open_recording(recording) as file:
        part = FrameSpan(file, 2, 4)
        assert part.shape == (2 * TARGETS, ROWS, COLS)
        np.testing.assert_array_equal(part.read_range(slice(None), slice(None)), samples()[2:4].reshape(-1, ROWS, COLS))
        with pytest.raises(ValueError, match="frames 2 to 8 asked for, the recording has 7"):
            FrameSpan(file, 2, 8)
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
