"""Description of a recording, from its header and the times of its frames."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.report.descriptions.description import Description, Section
from tofmix.report.descriptions.sections import noise_table, sensor_section, view_findings
from tofmix.report.summary.findings import Finding, Remedy, split_notes, target_findings
from tofmix.report.summary.light import light_findings
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.recording.recording_file import RecordingFile

GAP = 1.5
"""A step of `time` longer than this many median steps is a gap."""


def describe_recording(
    file: "RecordingFile", *, name: str, file_bytes: int, doubts: Mapping[str, str | None] = MappingProxyType({})
) -> Description:
    """Describe a recording from its header and its frames' times.

    `doubts` about its samples are texts by code, or None (`tofmix.io.recording.range_check`).
    """
    _, rows, cols = file.shape
    time_s = file.read_time()
    samples: Section = {
        "units": None if doubts.get("range_units") else "mm",
        "type": file.stored_type,
        "invalid_value": file.fill,
        "amplitude": file.has_amplitude,
        "time": time_s is not None,
        "truth": file.has_truth,
    }
    sizes: Section = {"frames": file.frames, "rows": rows, "cols": cols, "file_bytes": file_bytes}
    sections: dict[str, Section] = {
        "sizes": sizes | ({"targets": file.targets} if file.targets else {}),
        "range": samples,
    }
    if time_s is not None:
        sections["time"] = _time_section(time_s)
    sections["sensor"] = sensor_section(file.sensor)
    sections["attributes"] = dict(file.attributes())
    of_samples = [Finding(code=code, text=f"Range: {text}.") for code, text in doubts.items() if text is not None]
    warnings = [*of_samples, *_recording_findings(file, name), *_time_findings(time_s)]
    return Description(
        kind="recording", name=name, sections=sections, warnings=tuple(warnings), table=noise_table(file.sensor)
    )


def _time_section(time_s: FloatArray) -> Section:
    section: Section = {"first_s": float(time_s[0]), "last_s": float(time_s[-1])}
    steps = np.diff(time_s)
    if steps.size and np.isfinite(steps).all() and np.median(steps) > 0:
        section["frame_rate_hz"] = float(1.0 / np.median(steps))
        section["longest_step_s"] = float(steps.max())
    return section


def _time_findings(time_s: FloatArray | None) -> list[Finding]:
    if time_s is None:
        return []
    steps = np.diff(time_s)
    if not np.isfinite(time_s).all() or (steps < 0).any():
        return [Finding(code="time_disordered", text="The times of the frames are not finite or decrease.")]
    gaps = int((steps > GAP * np.median(steps)).sum()) if steps.size else 0
    if not gaps:
        return []
    text = f"{counted(gaps, 'step')} of time longer than {GAP:g} times the median: frames are missing."
    return [Finding(code="time_gaps", text=text)]


def _recording_findings(file: "RecordingFile", name: str) -> list[Finding]:
    found = []
    sensor = file.sensor
    if sensor.noise is None:
        text = "No noise curve: estimate measures one, or uses a built-in sensor's with --noise."
        found.append(Finding(code="no_noise_curve", text=text))
    if sensor.range_max_mm is None:
        text = "No range_max_mm: samples without a return may count as a surface."
        found.append(Finding(code="no_range_max", text=text))
    found += view_findings(sensor, file.shape[1:])
    remedy = Remedy(recording=name, has_amplitude=file.has_amplitude)
    found += split_notes(light_findings(sensor, targets=file.targets, remedy=remedy))[0]
    found += target_findings(file.targets)
    if file.frames == 1:
        text = "One frame only: a single sample cannot show several surfaces."
        found.append(Finding(code="one_frame", text=text))
    return found
