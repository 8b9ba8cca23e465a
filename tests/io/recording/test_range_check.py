"""Floats that are not in mm, and zeros that may be no ranges."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commandline import succeed
from support.files import boards, write_recording

from tofmix.errors import BadInputError
from tofmix.io.recording.range_check import check_whole_numbers, implausible, look, unit_doubt, zeros_doubt
from tofmix.io.recording.recording_file import RecordingFile, open_recording
from tofmix.sensor import Sensor


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


def test_without_limits_the_check_is_by_the_median_alone(tmp_path: Path) -> None:
    near = np.full((5, 4, 6), 50.0)
    with open_recording(_floats(tmp_path / "a.h5", near, attributes={"range_min_mm": 20.0})) as recording:
        assert recording.remarks == ()
    with (
        pytest.raises(BadInputError),
        open_recording(_floats(tmp_path / "b.h5", near - 1, attributes={"range_min_mm": 20.0})),
    ):
        pass


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


def test_integers_have_no_doubtful_unit_and_no_doubtful_zeros(tmp_path: Path) -> None:
    samples = (boards() // 1000).astype("u2")
    samples[::2] = 0
    with open_recording(write_recording(tmp_path / "a.h5", samples)) as recording:
        found = look(recording)
        assert unit_doubt(recording, found) is None
        assert zeros_doubt(recording, found) is None


@pytest.mark.parametrize("unit", ["m", "cm", "metre", "centimetre"])
def test_another_unit_is_refused_with_the_import_that_converts_it(tmp_path: Path, unit: str) -> None:
    path = _floats(tmp_path / "a.h5", boards() * 1e-3, units=unit)
    short = "m" if unit.startswith("m") else "cm"
    with pytest.raises(BadInputError, match=f"tofmix import {path} --units {short} "), open_recording(path):
        pass


def test_an_unknown_unit_is_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(BadInputError, match=r"'furlong', expected 'mm'$"),
        open_recording(_floats(tmp_path / "a.h5", boards(), units="furlong")),
    ):
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


@pytest.mark.parametrize("dtype", ["f4", "u2"])
def test_zeros_beside_another_fill_value_are_counted(tmp_path: Path, dtype: str) -> None:
    samples = boards(40).astype(dtype)
    samples[::4, 2], samples[1::4, 1, 1] = 0, 65535
    path = write_recording(tmp_path / "a.h5", samples, fill=65535)
    with open_recording(path) as recording:
        (line,) = (*recording.remarks, *check_whole_numbers(recording))
    assert "60 of 960 checked samples are exactly 0 and count as ranges of 0 mm" in line
    assert "_FillValue" not in line
    again = tmp_path / "a_mm.h5"
    succeed("import", path, "-o", again, "--invalid", "0")
    with open_recording(again) as recording:
        assert (*recording.remarks, *check_whole_numbers(recording)) == ()


@pytest.mark.parametrize(
    ("unit", "option"), [("um", "--scale 0.001"), ("inch", "--scale 25.4"), ("feet", "--scale 304.8")]
)
def test_a_unit_without_an_option_of_its_own_is_refused_with_its_scale(tmp_path: Path, unit: str, option: str) -> None:
    path = _floats(tmp_path / "a.h5", boards(), units=unit)
    with pytest.raises(BadInputError, match=f"tofmix import {path} {option} -o"), open_recording(path):
        pass


def test_zeros_are_not_taken_for_metres(tmp_path: Path) -> None:
    """Most samples of a mask are 0: the median is that of the others."""
    samples = boards().astype("f4")
    samples[:, :3] = 0
    with open_recording(_floats(tmp_path / "a.h5", samples)) as recording:
        assert len(recording.remarks) == 1


def test_a_recording_without_any_range_is_not_refused(tmp_path: Path) -> None:
    with open_recording(_floats(tmp_path / "a.h5", np.full((5, 4, 6), np.nan))) as recording:
        assert recording.remarks == ()


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
