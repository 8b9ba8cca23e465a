"""Descriptions of files for `tofmix info`: sizes, units, options, camera, and warnings.

Use `describe_recording`, `describe_layers`, `describe_surfaces` or `describe_model`. Headers are read, not samples; of
layers also the counts and the status. `tofmix.report.summary.summary` describes the results of an estimate.
"""

import textwrap
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.flags import Status, status_name
from tofmix.projection import projection_values
from tofmix.report.sources import LayersSource
from tofmix.report.summary.findings import Finding, count_findings, target_findings
from tofmix.report.summary.noise_numbers import noise_numbers
from tofmix.report.summary.summary import remedy_for
from tofmix.report.summary.tables import printable
from tofmix.sensor import RARE_SENSOR_NUMBERS, SENSOR_NUMBERS, NoiseCurve, Sensor
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.sheet import CameraSheet
from tofmix.simulation.model import Model
from tofmix.surfaces.found import SurfacesProvenance
from tofmix.wording import counted, number

GAP = 1.5
"""A step of `time` longer than this many median steps is a gap."""

_BYTES_A_SAMPLE = 6  # approximate bytes of a simulated sample in its file
_NAME_WIDTH = 26  # characters of the column of names
_TEXT_WIDTH = 100  # characters of a line
_LONGEST_SENTENCE = 1000  # characters of a sentence from a file before it is cut
_LONGEST_VALUE = 120  # characters of a value from a file before it is cut
_SENTENCES = ("found",)
"""Names of values that are sentences, and are not cut."""
_OF_SENTENCES = ("sources", "next_steps")
"""Sections whose values are sentences."""

Value = str | int | float | bool | None | list[float] | list[dict[str, Any]]
Section = dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """A file in words and numbers.

    Parameters
    ----------
    kind : str
        ``recording``, ``layers``, ``surfaces``, ``model``, ``sensor``, ``source`` or ``reconciliation``.
    name : str
        The file, as given.
    sections : dict of str to dict
        Names of values within each section carry their units; None means unknown.
    warnings : tuple of Finding
        What to be wary of.
    """

    kind: str
    name: str
    sections: dict[str, Section]
    warnings: tuple[Finding, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the same for JSON: None for numbers that are not finite."""
        warnings = [{"code": finding.code, "text": finding.line} for finding in self.warnings]
        sections = {title: {k: _no_nan(v) for k, v in part.items()} for title, part in self.sections.items()}
        return {"kind": self.kind, "file": self.name, **sections, "warnings": warnings}


class RecordingHeader(Protocol):
    """Interface of a recording, as `tofmix.io.recording.recording_file.RecordingFile` has it."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Samples of a pixel, rows, columns."""

    @property
    def frames(self) -> int:
        """Frames."""

    @property
    def targets(self) -> int:
        """Targets of a pixel and frame; 0 without such an axis."""

    @property
    def sensor(self) -> Sensor:
        """The camera."""

    @property
    def stored_type(self) -> str:
        """Type of the stored ranges."""

    @property
    def fill(self) -> float | None:
        """Value of invalid samples in addition to NaN."""

    @property
    def has_amplitude(self) -> bool:
        """Whether amplitudes are there."""

    @property
    def has_truth(self) -> bool:
        """Whether the truth is there."""

    def attributes(self) -> dict[str, str | int | float]:
        """Root attributes."""

    def read_time(self) -> FloatArray | None:
        """Start of each frame, s."""


class LayersHeader(LayersSource, Protocol):
    """Interface of a layers file, as `tofmix.io.layers.layers_file.LayersFile` has it."""

    def read_field(self, name: str, window: int) -> NDArray[Any]:
        """One dataset of one window."""


class SurfacesHeader(Protocol):
    """Interface of a surfaces file, as `tofmix.io.surfaces_file.SurfacesFile` has it."""

    max_layers: int
    factor: int
    provenance: SurfacesProvenance

    @property
    def shape(self) -> tuple[int, int, int]:
        """Windows, rows, columns."""

    @property
    def surfaces(self) -> int:
        """Surfaces."""

    @property
    def edge_points(self) -> int:
        """Points of edges."""

    @property
    def edge_lines(self) -> int:
        """Lines of edges."""


def describe_recording(
    file: RecordingHeader, *, name: str, file_bytes: int, doubts: Mapping[str, str | None] = MappingProxyType({})
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
    sections["sensor"] = _sensor_section(file.sensor)
    sections["attributes"] = dict(file.attributes())
    of_samples = [Finding(code=code, text=f"Range: {text}.") for code, text in doubts.items() if text is not None]
    warnings = [*of_samples, *_recording_findings(file), *_time_findings(time_s)]
    return Description(kind="recording", name=name, sections=sections, warnings=tuple(warnings))


def describe_layers(file: LayersHeader, *, name: str, file_bytes: int) -> Description:
    """Describe a layers file from its header, its counts and its status, read window by window."""
    windows, rows, cols = file.shape
    provenance = file.provenance
    surfaces = np.zeros(file.max_layers + 1, dtype=np.int64)
    by_status: dict[str, int] = dict.fromkeys((status_name(s) for s in Status), 0)
    for window in range(windows):
        counts = np.bincount(file.read_field("n_modes", window).ravel(), minlength=file.max_layers + 1)
        surfaces += counts[: file.max_layers + 1]
        status = file.read_field("status", window)
        for known in Status:
            by_status[status_name(known)] += int((status == known).sum())
    sections: dict[str, Section] = {
        "sizes": {
            "windows": windows, "rows": rows, "cols": cols, "max_layers": file.max_layers, "file_bytes": file_bytes,
            "window_frames": int(file.window_stop[0] - file.window_start[0]),
            "frames_left_out": provenance.frames_left_out,
        },
        "units": {"range": "mm", "sigma": "mm", "range_stderr": "mm", "weight": "1"},
        "made_from": {
            "source": provenance.source, "source_sha256": provenance.source_sha256, "tofmix_version": provenance.version
        },
        "options": dict(sorted(provenance.options.items())),
        "sensor": _sensor_section(provenance.sensor),
    }  # fmt: skip
    noise = _noise_section(provenance.sensor)
    sections |= {"noise": noise} if noise else {}
    law = file.mixing_law
    sections |= {"mixing": {"law": law.words(), **law.as_dict()}} if law is not None else {}
    warnings = count_findings(
        pixels=windows * rows * cols, by_status=by_status, by_surfaces=surfaces.tolist(), max_layers=file.max_layers,
        remedy=remedy_for(provenance, windows),
    )  # fmt: skip
    return Description(
        kind="layers",
        name=name,
        sections=sections,
        warnings=(*warnings, *target_findings(provenance.targets), *_view_findings(provenance.sensor, (rows, cols))),
    )


def describe_surfaces(file: SurfacesHeader, *, name: str, file_bytes: int) -> Description:
    """Describe a surfaces file from its header."""
    windows, rows, cols = file.shape
    provenance = file.provenance
    sections: dict[str, Section] = {
        "sizes": {
            "windows": windows, "rows": rows, "cols": cols, "max_layers": file.max_layers, "file_bytes": file_bytes,
            "factor": file.factor, "rows_fine": rows * file.factor, "cols_fine": cols * file.factor,
        },
        "found": {"surfaces": file.surfaces, "edge_lines": file.edge_lines, "edge_points": file.edge_points},
        "units": {"range_fine": "mm", "edge_row": "pixel", "edge_stderr": "pixel", "plane_offset_mm": "mm"},
        "made_from": {
            "source": provenance.source, "source_sha256": provenance.source_sha256, "tofmix_version": provenance.version
        },
        "options": dict(sorted(provenance.options.items())),
        "sensor": _sensor_section(provenance.sensor),
    }  # fmt: skip
    noise = _noise_section(provenance.sensor)
    sections |= {"noise": noise} if noise else {}
    found = tuple(_view_findings(provenance.sensor, (rows, cols)))
    return Description(kind="surfaces", name=name, sections=sections, warnings=found)


def describe_model(model: Model, *, name: str) -> Description:
    """Describe a model: its camera, recording settings, surfaces and effects."""
    plan, camera = model.recording, model.sensor
    effects = tomllib.loads(model.text).get("effect", []) if model.text else []
    surfaces: list[dict[str, Any]] = [
        {
            "name": surface.name,
            "center_mm": list(surface.center_mm),
            "size_mm": list(surface.size_mm),
            "yaw_deg": surface.yaw_deg,
            "pitch_deg": surface.pitch_deg,
            "reflectivity": surface.reflectivity,
        }
        for surface in model.surfaces
    ]
    size = plan.frames * camera.rows * camera.cols * _BYTES_A_SAMPLE
    sections: dict[str, Section] = {
        "recording": {
            "frames": plan.frames, "frame_rate_hz": plan.frame_rate_hz, "seed": plan.seed,
            "bytes_before_compression": size,
        },
        "scene": {"surfaces": surfaces, "effects": effects},
        "sensor": _profile_section(camera),
    }  # fmt: skip
    warnings = list(_profile_findings(camera))
    if not model.surfaces:
        warnings.append(Finding(code="no_surface", text="The model has no surface: no pixel returns a range."))
    return Description(kind="model", name=name, sections=sections, warnings=tuple(warnings))


def describe_sensor(camera: CameraSheet, *, name: str) -> Description:
    """Describe a camera's own file."""
    sections = {"sensor": _profile_section(camera) | {"outlier_probability": camera.outlier_probability}}
    if camera.sources:
        sections["sources"] = {str(number): text for number, text in enumerate(camera.sources, 1)}
    return Description(kind="sensor", name=name, sections=sections, warnings=_profile_findings(camera))


def format_description(description: Description) -> str:
    """Format a description for the terminal, without a newline at the end."""
    lines = [f"{printable(description.name)}: {description.kind}"]
    for title, section in description.sections.items():
        lines += ["", title.replace("_", " ")]
        for key, value in section.items():
            lines += _wrapped(value) if title in _OF_SENTENCES else _lines(key, value)
    if description.warnings:
        lines.append("")
    lines += [f"warning: {finding.line}" for finding in description.warnings]
    return "\n".join(lines)


def _wrapped(value: Value) -> list[str]:
    return textwrap.wrap(
        printable(str(value), _LONGEST_SENTENCE), _TEXT_WIDTH, initial_indent="  - ", subsequent_indent="    "
    )


def _no_nan(value: Value) -> Value:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _lines(key: str, value: Value) -> list[str]:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        rows = (", ".join(f"{k} {_shown(v)}" for k, v in item.items()) for item in value)
        return [f"  {key} {number}: {printable(row, 160)}" for number, row in enumerate(rows, 1)]
    longest = _LONGEST_SENTENCE if key in _SENTENCES else _LONGEST_VALUE
    return [f"  {printable(key, _NAME_WIDTH):<{_NAME_WIDTH}} {printable(_shown(value), longest)}"]


def _shown(value: object) -> str:
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return " ".join(_shown(item) for item in value) or "none"
    return number(value, ".9g") if isinstance(value, float) else str(value)


def _sensor_section(sensor: Sensor) -> Section:
    section: Section = {"name": sensor.name}
    section |= {key: getattr(sensor, key) for key in SENSOR_NUMBERS}
    section |= {key: getattr(sensor, key) for key in RARE_SENSOR_NUMBERS if getattr(sensor, key) is not None}
    if sensor.projection is not None:
        section["projection"] = sensor.projection.name
        for key, value in projection_values(sensor.projection).items():
            section[key] = list(value) if isinstance(value, tuple) else value
    noise = sensor.noise
    section["noise_range_mm"] = None if noise is None else noise.range_mm.tolist()
    section["noise_sigma_mm"] = None if noise is None else noise.sigma_mm.tolist()
    if noise is not None and noise.law is not None:
        section["noise_reference_amplitude"] = noise.law.reference.tolist()
        section["noise_amplitude"] = noise.law.amplitude.tolist()
        section["noise_amplitude_factor"] = noise.law.factor.tolist()
    if noise is not None:
        section |= _noise_parts(noise)
    return section


def _noise_parts(noise: NoiseCurve) -> Section:
    """Parts of a noise curve beyond sigma; empty if the error is Gaussian and equal in all pixels."""
    parts: Section = {}
    if noise.shape is not None:
        parts["noise_shape_z"] = noise.shape.z.tolist()
        parts["noise_shape_density"] = noise.shape.density.tolist()
        parts["noise_shape_skewness"], parts["noise_shape_excess_kurtosis"] = noise.shape.moments()[2:]
    if noise.width_spread:
        parts["noise_width_spread"] = noise.width_spread
    if noise.background is not None:
        low, middle, high = np.quantile(noise.background, (0.0, 0.5, 1.0))
        parts |= {"noise_background_least": low, "noise_background_median": middle, "noise_background_most": high}
    return {key: float(value) if isinstance(value, np.floating) else value for key, value in parts.items()}


def _noise_section(sensor: Sensor) -> Section:
    """The noise of a layers file in a line and part by part; nothing where it is a Gaussian of the curve."""
    numbers = noise_numbers(sensor)
    if numbers is None:
        return {}
    section: Section = {"found": numbers.line, "shape": numbers.shape}
    parts: Section = {
        "skewness": numbers.skewness,
        "excess_kurtosis": numbers.excess_kurtosis,
        "width_spread": numbers.width_spread,
        "drift_mm": numbers.drift_mm,
        "memory": numbers.memory,
    }
    if numbers.background is not None:
        parts |= {f"background_{name}": getattr(numbers.background, name) for name in ("q05", "q50", "q95")}
    return section | {key: value for key, value in parts.items() if value is not None}


def _profile_section(camera: SensorProfile | CameraSheet) -> Section:
    return {"rows": camera.rows, "cols": camera.cols} | _sensor_section(camera.sensor())


def _profile_findings(camera: SensorProfile | CameraSheet) -> tuple[Finding, ...]:
    if camera.confirmed or not camera.sources:
        return ()
    text = f"Figures of {camera.name} are unconfirmed; its sources give the origin of each."
    return (Finding(code="unconfirmed_sensor", text=text),)


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


def _recording_findings(file: RecordingHeader) -> list[Finding]:
    found = []
    sensor = file.sensor
    if sensor.noise is None:
        text = "No noise curve: estimate measures one, or uses a built-in sensor's with --noise."
        found.append(Finding(code="no_noise_curve", text=text))
    if sensor.range_max_mm is None:
        text = "No range_max_mm: samples without a return may count as a surface."
        found.append(Finding(code="no_range_max", text=text))
    found += _view_findings(sensor, file.shape[1:])
    found += target_findings(file.targets)
    if file.frames == 1:
        text = "One frame only: a single sample cannot show several surfaces."
        found.append(Finding(code="one_frame", text=text))
    return found


def _view_findings(sensor: Sensor, shape: tuple[int, int]) -> list[Finding]:
    try:
        if sensor.optics is not None:
            sensor.optics.check(shape)
            return []
    except ValueError as error:
        return [Finding(code="unfit_projection", text=f"Points cannot be placed: {error}.")]
    return [Finding(code="no_field_of_view", text="No field of view: points cannot be placed; export needs --fov.")]
