"""`verify` finds each fault that is put into a whole file, names it in one line, and finds none in a whole one."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording

from tofmix.grid import Windows
from tofmix.io.layers.layers_file import LayersFile, LayersWriter
from tofmix.io.recording.recording_writer import RecordingWriter
from tofmix.io.verify import verify
from tofmix.layers import Provenance
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.simulation.events import Truth

Change = Callable[[h5py.File], object]
CAMERA = Sensor(name="camera", range_max_mm=7500.0, noise=NoiseCurve(np.array([500.0]), np.array([10.0])))


@pytest.fixture
def layers(tmp_path: Path) -> Path:
    from support.made_up import made_up_layers

    path = tmp_path / "a.layers.h5"
    provenance = Provenance(
        source="a.h5", source_sha256="0" * 64, version="1", sensor=CAMERA, options={"window": 20, "stride": 20}
    )
    with LayersWriter(
        path, windows=Windows(20, 20, 5, 0), image=(6, 7), max_layers=3, tile=(2, 4), provenance=provenance
    ) as writer:
        writer.write(slice(None), slice(None), made_up_layers((5, 6, 7), 3))
    return path


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "a.h5"
    image = (16, 20)
    truth = Truth(
        n_modes=np.ones(image, "u1"),
        range_true=np.full((*image, 2), [1000.0, np.nan], "f4"),
        weight_true=np.full((*image, 2), [0.9, np.nan], "f4"),
        weight_no_return=np.full(image, 0.1, "f4"),
        surface=np.full((*image, 2), [0, -1], "i2"),
        amplitude=np.full((*image, 2), [9.0, 0.0], "f4"),
    )
    samples = boards(120, *image)
    with RecordingWriter(path, shape=samples.shape, sensor=CAMERA, truth=truth, has_temperature=True) as writer:
        for start in (0, 100):
            part = samples[start : start + 100]
            writer.write(
                start,
                part,
                time_s=(start + np.arange(len(part))) / 25.0,
                amplitude=part.astype("f4"),
                temperature_c=np.full(len(part), 30.0, "f4"),
            )
    return path


def put(name: str, index: tuple[int, ...], value: float) -> Change:
    def change(root: h5py.File) -> None:
        root[name][index] = value

    return change


def attribute(item: str, name: str, value: Any) -> Change:  # noqa: ANN401  what h5py takes
    def change(root: h5py.File) -> None:
        root[item].attrs[name] = value

    return change


def options(text: str) -> Change:
    """Other options, in a file of a version that had no checksum over them."""

    def change(root: h5py.File) -> None:
        root.attrs["options"] = text
        del root.attrs["provenance_crc32"]

    return change


def flip(name: str, number: int = 0) -> Change:
    """Flip a bit in the middle of a stored chunk."""

    def change(root: h5py.File) -> None:
        chunk = root[name].id.get_chunk_info(number)
        path = Path(root.filename)
        root.flush()
        with path.open("r+b") as file:
            file.seek(chunk.byte_offset + chunk.size // 2)
            byte = file.read(1)[0]
            file.seek(-1, 1)
            file.write(bytes([byte ^ 4]))

    return change


def without_checksum(root: h5py.File) -> None:
    dataset = root["weight"].id
    _, data = dataset.read_direct_chunk((0, 0, 0, 0))
    bit = [dataset.get_create_plist().get_filter(k)[0] for k in range(3)].index(3)
    dataset.write_direct_chunk((0, 0, 0, 0), data[:-4], 1 << bit)


def reshaped(name: str, shape: tuple[int, ...]) -> Change:
    """A dataset of that name and of another shape."""

    def change(root: h5py.File) -> None:
        del root[name]
        root[name] = np.zeros(shape, "f4")

    return change


def emptied(root: h5py.File) -> None:
    """Make a dataset anew, with all but its first chunk missing."""
    old = root["n_samples"]
    values, settings = old[:2, :4], {"chunks": old.chunks, "fletcher32": True, "dtype": old.dtype}
    del root["n_samples"]
    new = root.create_dataset("n_samples", (5, 6, 7), **settings)
    new[:2, :4] = values
    new.attrs["units"] = "1"


def test_valid_files_have_no_fault(layers: Path, recording: Path) -> None:
    for path, kind, datasets in ((layers, "layers", 17), (recording, "recording", 8)):
        findings = verify(path)
        assert findings.lines() == []
        assert findings.notes == []
        assert (findings.kind, findings.checked) == (kind, datasets)
        json.dumps(findings.as_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (put("weight", (3, 4, 5, 0), 0.99), "weight: broken: sums to 1 .*window 3, row 4, col 5"),
        (put("status", (4, 5, 6), 9), r"status: broken: one of 0, 1.* \(window 4, row 5, col 6\)"),
        (attribute("range", "units", "m"), "range: units 'm', expected 'mm'"),
        (attribute("window_stop", "units", "s"), "window_stop: units 's', expected '1'"),
        (
            put("window_start", (2,), 5),
            r"window_start: windows must ascend, .*\n.*not of 20 frames, .*\n.*without one of the n_samples",
        ),
        (flip("sigma", 1), r"sigma: cannot be read: .* \(from window 0, row 4 on\)"),
        (without_checksum, "weight: 1 stored chunks have no checksum, the others have"),
        (emptied, r"n_samples: 5 stored chunks are missing.*\n.*without one of the n_samples"),
        (attribute("/", "format_version", "9.0"), "format_version '9.0'"),
        (attribute("/", "options", "["), "attribute options .*: their checksum differs"),
        (options("["), "attribute options: not JSON"),
        (options('{"window": 7}'), "window_stop: windows are not of 7 frames"),
        (lambda root: root.move("sigma", "sigmas"), "no dataset sigma"),
    ],
)
def test_each_fault_of_layers_is_named(layers: Path, change: Change, line: str) -> None:
    with h5py.File(layers, "r+") as root:
        change(root)
    findings = verify(layers)
    assert not findings.ok
    text = "\n".join(findings.lines())
    assert len(findings.lines()) == 1 + line.count(r"\n"), text

    assert re.search(line, text), text


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (attribute("amplitude", "units", "V"), "amplitude: units 'V', expected '1'"),
        (put("time", (5,), 0.0), r"time: broken: ascending \(frame 5\)"),
        (put("time", (5,), np.nan), "time: no time of 1 frame"),
        (put("truth/range_true", (1, 2, 1), 500.0), r"truth/range_true: broken: .* \(row 1, col 2\)"),
        (put("truth/weight_no_return", (1, 2), 0.5), r"truth/weight_true: broken: between 0 and 1, .*row 1, col 2"),
        (flip("range", 1), r"range: cannot be read: .* \(from frame 0, row 8 on\)"),
        (flip("amplitude", 3), r"amplitude: cannot be read: .* \(from frame \d+, row \d+ on\)"),
        (flip("temperature"), "temperature: cannot be read"),
        (flip("truth/n_modes"), "truth/n_modes: cannot be read"),
        (attribute("sensor", "range_max_mm", -1.0), "sensor: range_max_mm"),
        (reshaped("temperature", (7,)), r"temperature: expected one number a frame, got float32 of shape \(7,\)"),
        (reshaped("truth/n_modes", (16, 21)), r"truth/n_modes: shape \(16, 21\) does not match range"),
        (reshaped("truth/range_true", (16, 20)), r"truth/range_true: shape \(16, 20\) does not match range"),
        (reshaped("truth/weight_true", (16, 20, 3)), r"truth/weight_true: shape \(16, 20, 3\) differs from range_true"),
    ],
)
def test_each_fault_of_recordings_is_named(recording: Path, change: Change, line: str) -> None:

    with h5py.File(recording, "r+") as root:
        change(root)
    findings = verify(recording)
    assert not findings.ok
    assert any(re.search(line, found) for found in findings.lines()), findings.lines()


def test_foreign_recordings_get_notes_of_missing_features(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", np.zeros((4, 5, 6), "u2"), noise=None)
    findings = verify(path)
    assert findings.ok
    assert [note.partition(":")[0] for note in findings.notes] == ["range", "range", "sensor"]
    write_recording(path, np.full((4, 5, 6), -3.0, "f4"), chunks=(1, 5, 6))
    assert verify(path).lines() == ["range: broken: not below 0 mm (frame 0, row 0, col 0 and 119 more)"]


def test_file_that_does_not_open_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("no")
    (tmp_path / "bad.toml").write_text("[sensor")
    assert verify(tmp_path / "none.h5").lines() == ["file: No such file or directory"]
    assert verify(tmp_path / "text.h5").lines() == ["file: not an HDF5 file"]
    assert len(verify(tmp_path / "bad.toml").lines()) == 1


def test_every_value_is_read_once_and_in_small_blocks(layers: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = np.zeros((5, 6), dtype=int)
    real = LayersFile.read_block

    def counted(self: LayersFile, windows: slice, rows: slice) -> object:
        seen[windows, rows] += 1
        assert seen[windows, rows].size <= 2 * 4
        return real(self, windows, rows)

    monkeypatch.setattr(LayersFile, "read_block", counted)
    assert verify(layers).ok
    assert (seen == 1).all()


GAP = {
    "verdict": "agree",
    "effects": [],
    "where": [],
    "candidates": [],
    "aliases": [],
    "panel": [],
    "gap": {"before": 1.0, "after": 1.0, "floor": 1.0, "closed": None},
}


@pytest.mark.parametrize(
    ("gap", "line"),
    [
        (GAP, None),
        (GAP | {"verdict": "fine"}, "gap.json: verdict 'fine', expected one of agree"),
        (GAP | {"where": 3}, "gap.json: where: expected a list"),
        (GAP | {"considered": [], "complete": False}, None),
        (GAP | {"considered": {}}, "gap.json: considered: expected a list"),
        (GAP | {"complete": "yes"}, "gap.json: complete: expected true or false, got 'yes'"),
        (GAP | {"gap": {"before": -1.0, "after": 1.0, "floor": 1.0}}, "gap.json: gap: before: expected a number"),
        ([], "expected an object"),
        ("[" * 100_000, "not JSON"),
    ],
)
def test_folders_of_reconcile_are_checked(tmp_path: Path, gap: object, line: str | None) -> None:
    from tofmix.simulation import builtin_text

    folder = tmp_path / "gap"
    folder.mkdir()
    (folder / "model.toml").write_text(builtin_text("three-boards"))
    (folder / "gap.json").write_text(gap if isinstance(gap, str) else json.dumps(gap))
    assert verify(folder).lines() == ["report.html: missing; the output of reconcile is incomplete"]
    (folder / "report.html").write_text("")
    found = verify(folder).lines()
    assert found == [] if line is None else len(found) == 1 and line in found[0]
