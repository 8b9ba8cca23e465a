"""Descriptions of sources: cameras, models, recordings, and files of other programs.

A recording is described from its header and the times of its frames, a model by its camera, the recording that it
gives, its surfaces and effects.
"""

import tomllib
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.report.descriptions.description import Description, Section, noise_table, sensor_section, view_findings
from tofmix.report.summary.findings import Finding, Remedy, light_findings, split_notes, target_findings
from tofmix.sensors.camera import Camera
from tofmix.simulation.model import Model
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.importers.base import FrameSource
    from tofmix.io.recording.recording_file import RecordingFile


def describe_sensor(camera: Camera, *, name: str) -> Description:
    """Describe a camera's own file."""
    sections = {"sensor": profile_section(camera) | {"outlier_probability": camera.outlier_probability}}
    if camera.sources:
        sections["sources"] = {str(number): text for number, text in enumerate(camera.sources, 1)}
    return Description(
        kind="sensor",
        name=name,
        sections=sections,
        warnings=profile_findings(camera),
        table=noise_table(camera.sensor()),
    )


def profile_section(camera: Camera) -> Section:
    """The section of a camera with its image."""
    return {"rows": camera.rows, "cols": camera.cols} | sensor_section(camera.sensor())


def profile_findings(camera: Camera) -> tuple[Finding, ...]:
    """A warning if nobody has confirmed the figures of a camera that names its sources."""
    if camera.confirmed or not camera.sources:
        return ()
    text = f"Figures of {camera.name} are unconfirmed; its sources give the origin of each."
    return (Finding(code="unconfirmed_sensor", text=text),)


def describe_model(model: Model, *, name: str, sample_bytes: int = 6) -> Description:
    """Describe a model: its camera, recording settings, surfaces and effects.

    `sample_bytes` are about those of a simulated sample in its file.
    """
    plan, camera = model.recording, model.sensor
    effects = tomllib.loads(model.text).get("effect", []) if model.text else []
    surfaces: list[dict[str, Any]] = [
        {
            "name": surface.name,
            "center_mm": list(surface.center_mm),
            "size_mm": list(surface.size_mm),
            "yaw_deg": surface.yaw_deg,
            "pitch_deg": surface.pitch_deg,
            "roll_deg": surface.roll_deg,
            "reflectivity": surface.reflectivity,
        }
        for surface in model.surfaces
    ]
    size = plan.frames * camera.rows * camera.cols * sample_bytes
    sections: dict[str, Section] = {
        "recording": {
            "frames": plan.frames,
            "frame_rate_hz": plan.frame_rate_hz,
            "seed": plan.seed,
            "bytes_before_compression": size,
        },
        "scene": {"surfaces": surfaces, "effects": effects},
        "sensor": profile_section(camera),
    }
    warnings = list(profile_findings(camera))
    if not model.surfaces:
        warnings.append(Finding(code="no_surface", text="The model has no surface: no pixel returns a range."))
    return Description(kind="model", name=name, sections=sections, warnings=tuple(warnings))


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


def describe_source(source: "FrameSource", *, name: str, command: str) -> Description:
    """Describe a file that `tofmix import` reads; `command` imports it."""
    frames, rows, cols = source.shape
    sizes: Section = {"frames": frames, "rows": rows, "cols": cols}
    if source.targets:
        sizes["targets"] = source.targets
    depths: Section = {
        "kind": source.kind,
        "type": str(source.dtype),
        "unit_mm": source.unit_mm,
        "along": "z" if source.depth_axis == "z" else "the beam",
        "amplitude": source.has_amplitude,
        "time": source.has_time,
    }
    warnings = [Finding(code="note", text=note) for note in source.notes]
    warnings.append(Finding(code="not_a_recording", text=f"Not a recording yet: {command}"))
    return Description(kind="source", name=name, sections={"sizes": sizes, "depths": depths}, warnings=tuple(warnings))
