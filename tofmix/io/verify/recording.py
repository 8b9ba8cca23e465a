"""Whether a recording is whole and keeps its contract; part of `tofmix.io.verify.verify`."""

from collections.abc import Iterator

import h5py
import numpy as np

from tofmix.errors import BadInputError
from tofmix.invariants import SUM_TOLERANCE
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.verify.findings import Findings
from tofmix.io.verify.storage import check_storage
from tofmix.wording import counted

_BLOCK_SAMPLES = 1 << 22  # samples that are checked at once
_UNITS = {"amplitude": "1", "time": "s", "temperature": "degC"}


def verify_recording(root: h5py.File, recording: RecordingFile, findings: Findings, *, ours: bool) -> None:
    """Check an open recording: its header has passed already.

    Parameters
    ----------
    root : h5py.File
        The file.
    recording : RecordingFile
        The recording in it.
    findings : Findings
        Receives the findings.
    ours : bool
        Whether the file is marked as of the tofmix format.
    """
    for name in ("range", *_UNITS):
        with guard.reading(recording.path, name):
            if name in root:
                check_storage(root[name], name, recording.path, findings, ours=ours)
                _check_units(root, name, findings, ours=ours)
    valid = _check_samples(recording, findings)
    if not valid and findings.ok:
        findings.notes.append("range: no valid sample")
    try:
        _check_per_frame(root, recording, findings)
    except BadInputError as error:
        findings.add_error(error, recording.path)
    if recording.has_truth:
        try:
            _check_truth(root, recording, findings)
        except BadInputError as error:
            findings.add_error(error, recording.path)
    if recording.sensor.noise is None:
        findings.notes.append("sensor: no noise curve; estimate measures one, or takes --noise PROFILE")


def _check_units(root: h5py.File, name: str, findings: Findings, *, ours: bool) -> None:
    expected = _UNITS.get(name)
    found = hdf5.text_attribute(root[name], "units")
    if expected is not None and found != expected and (ours or found is not None):
        findings.add(name, f"units {found!r}, expected {expected!r}")


def _check_samples(recording: RecordingFile, findings: Findings) -> int:
    """Read every sample, for its checksum; return how many are valid."""
    valid = 0
    readers = {"range": recording.read_range}
    if recording.has_amplitude:
        readers["amplitude"] = recording.read_amplitude
    for name, read in readers.items():
        for frames, rows in _blocks(recording):
            try:
                block = read(frames, rows)
            except BadInputError as error:
                findings.add_error(error, recording.path, first=f"from frame {frames.start}, row {rows.start} on")
                continue
            if name == "range":
                valid += int(np.isfinite(block).sum())
                with np.errstate(invalid="ignore"):
                    negative = block < 0
                place = ("sample" if recording.targets else "frame", "row", "col")
                findings.add_broken(name, "not below 0 mm", negative, place, (frames.start, rows.start, 0))
        findings.checked += 1
    return valid


def _blocks(recording: RecordingFile) -> Iterator[tuple[slice, slice]]:
    """Frames and rows of whole stored chunks, as many as fit in a little memory."""
    frames, rows, cols = recording.shape
    high = recording.row_step
    deep = recording.frame_step * max(1, _BLOCK_SAMPLES // (cols * high * recording.frame_step))
    for frame in range(0, frames, deep):
        for row in range(0, rows, high):
            yield slice(frame, min(frame + deep, frames)), slice(row, min(row + high, rows))


def _check_per_frame(root: h5py.File, recording: RecordingFile, findings: Findings) -> None:
    time_s = recording.read_time()
    if time_s is not None:
        findings.checked += 1
        if not np.isfinite(time_s).all():
            findings.add("time", f"no time of {counted(int((~np.isfinite(time_s)).sum()), 'frame')}")
        elif (np.diff(time_s) <= 0).any():
            findings.add_broken("time", "ascending", np.r_[False, np.diff(time_s) <= 0], ("frame",), (0,))
    with guard.reading(recording.path, "temperature"):
        has_temperature = "temperature" in root
    if has_temperature:
        dataset = guard.checked_dataset(root, "temperature", recording.path)
        if dataset.shape != (recording.frames,) or dataset.dtype.kind not in "iuf":
            got = f"{dataset.dtype} of shape {dataset.shape}"
            raise BadInputError(f"{recording.path}: temperature: expected one number a frame, got {got}")
        with guard.reading(recording.path, "temperature"):
            dataset[...]
        findings.checked += 1


def _check_truth(root: h5py.File, recording: RecordingFile, findings: Findings) -> None:
    """Check the truth of a synthetic recording: patterns of NaN, order, shares."""
    path, image = recording.path, recording.shape[1:]
    arrays = {}
    for name in ("n_modes", "range_true", "weight_true", "weight_no_return"):
        what = f"truth/{name}"
        dataset = guard.checked_dataset(root, what, path)
        if dataset.shape[:2] != image or dataset.ndim != (3 if name in ("range_true", "weight_true") else 2):
            raise BadInputError(f"{path}: {what}: shape {dataset.shape} does not match range {recording.shape}")
        check_storage(dataset, what, path, findings, ours=True)
        with guard.reading(path, what):
            arrays[name] = np.asarray(dataset[...])
        findings.checked += 1
    n, ranges, weights, no_return = arrays.values()
    if ranges.shape != weights.shape:
        raise BadInputError(f"{path}: truth/weight_true: shape {weights.shape} differs from range_true {ranges.shape}")
    present = np.arange(ranges.shape[2]) < n[..., None]
    shares = np.where(present, weights, 0).sum(-1, dtype=np.float64) + no_return
    pattern = "finite for the first n_modes layers, NaN past them"
    with np.errstate(invalid="ignore"):
        shared = ((weights < 0) & present).any(-1) | ~(shares <= 1 + SUM_TOLERANCE) | ~(no_return >= 0)
        rules = (
            ("range_true", pattern, (np.isfinite(ranges) != present).any(-1)),
            ("weight_true", pattern, (np.isfinite(weights) != present).any(-1)),
            ("range_true", "near to far", (np.diff(ranges, axis=-1) < 0).any(-1)),
            ("weight_true", "between 0 and 1, and so its sum with weight_no_return", shared),
        )
    for name, text, broken in rules:
        findings.add_broken(f"truth/{name}", text, np.asarray(broken), ("row", "col"), (0, 0))
