"""Whether a recording is whole and keeps its contract; part of `tofmix.io.verify.verify`."""

import h5py
import numpy as np

from tofmix.errors import BadInputError
from tofmix.invariants import SUM_TOLERANCE
from tofmix.io.guard import guard
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.schema import RANGE, RECORDING_FIELDS, TRUTH_FIELDS
from tofmix.io.verify.findings import Findings, blocks, check_fields, check_storage
from tofmix.wording import counted

_BLOCK_SAMPLES = 1 << 22  # samples that are checked at once


def verify_recording(root: h5py.File, recording: RecordingFile, findings: Findings, *, ours: bool) -> None:
    """Check an open recording, whose header has passed already; `ours`: it is marked as of the tofmix format."""
    with guard.reading(recording.path, RANGE.name):  # the units of the ranges are of the header
        check_storage(root[RANGE.name], RANGE.name, findings, ours=ours)
    check_fields(root, RECORDING_FIELDS[1:], recording.path, findings, ours=ours)
    valid = _check_samples(recording, findings)
    if not valid and findings.ok:
        findings.notes.append("range: no valid sample")
    with findings.errors(recording.path):
        _check_per_frame(recording, findings)
    if recording.has_truth:
        with findings.errors(recording.path):
            _check_truth(root, recording, findings)
    if recording.sensor.noise is None:
        findings.notes.append("sensor: no noise curve; estimate measures one, or takes --noise PROFILE")


def _check_samples(recording: RecordingFile, findings: Findings) -> int:
    """Read every sample, for its checksum; return how many are valid."""
    valid = 0
    readers = {"range": recording.read_range}
    if recording.has_amplitude:
        readers["amplitude"] = recording.read_amplitude
    high, deep = recording.row_step, recording.frame_step
    deep *= max(1, _BLOCK_SAMPLES // (recording.shape[2] * high * deep))
    for name, read in readers.items():
        for frames, rows in blocks(recording.shape, (deep, high)):
            with findings.errors(recording.path, first=f"from frame {frames.start}, row {rows.start} on"):
                block = read(frames, rows)
                if name == "range":
                    valid += int(np.isfinite(block).sum())
                    with np.errstate(invalid="ignore"):
                        negative = block < 0
                    place = ("sample" if recording.targets else "frame", "row", "col")
                    findings.add_broken(name, "not below 0 mm", negative, place, (frames.start, rows.start, 0))
        findings.checked += 1
    return valid


def _check_per_frame(recording: RecordingFile, findings: Findings) -> None:
    time_s = recording.read_time()
    if time_s is not None:
        findings.checked += 1
        if not np.isfinite(time_s).all():
            findings.add("time", f"no time of {counted(int((~np.isfinite(time_s)).sum()), 'frame')}")
        else:
            findings.add_broken("time", "ascending", np.diff(time_s, prepend=-np.inf) <= 0, ("frame",), (0,))
    findings.checked += recording.read_temperature() is not None


def _check_truth(root: h5py.File, recording: RecordingFile, findings: Findings) -> None:
    """Check the truth of a synthetic recording: patterns of NaN, order, shares."""
    path, image = recording.path, recording.shape[1:]
    arrays = {}
    for spec in TRUTH_FIELDS:
        what = f"truth/{spec.name}"
        dataset = guard.checked_dataset(root, what, path)
        if dataset.shape[:2] != image or dataset.ndim != len(spec.dims):
            raise BadInputError(f"{path}: {what}: shape {dataset.shape} does not match range {recording.shape}")
        with guard.reading(path, what):
            check_storage(dataset, what, findings, ours=True)
            arrays[spec.name] = np.asarray(dataset[...])
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
