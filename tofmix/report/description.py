"""A description of any file for `tofmix info`: its sections, those of sources, and those of results.

A description is sections of named values, warnings, and their text for the terminal. The common sections are the
camera, its noise and its view. Sources are cameras, models, recordings, and files of other programs: a recording is
described from its header and the times of its frames, a model by its camera, the recording that it gives, its surfaces
and effects. Results are layers files (`tofmix.report.summary.summary`), surfaces files, and the folder of a
reconciliation, described from its `gap.json`.
"""

import textwrap
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.layers import Provenance
from tofmix.noise_shape import BackgroundDensity, NoiseShape
from tofmix.optics.projection import projection_values
from tofmix.report.summary.findings import (
    Finding,
    Remedy,
    count_findings,
    light_findings,
    split_notes,
    suspect_findings,
    target_findings,
)
from tofmix.report.summary.summary import Counts, noise_numbers, remedy_for
from tofmix.report.summary.tables import printable
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor
from tofmix.sensor_schema import DENSITY_LISTS, LAW_LISTS, RARE_SENSOR_NUMBERS, SENSOR_NUMBERS, SHAPE_LISTS
from tofmix.sensors.camera import Camera
from tofmix.sensors.camera_toml import noise_toml
from tofmix.simulation.model import Model
from tofmix.surfaces.found import SurfacesProvenance
from tofmix.wording import counted, finite_or_none, number

if TYPE_CHECKING:
    from tofmix.io.importers.base import FrameSource
    from tofmix.io.recording.recording_file import RecordingFile
if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.io.surfaces_file import SurfacesFile


_LONGEST_SENTENCE = 1000  # characters of a sentence from a file before it is cut
_SENTENCES = ("found",)
"""Names of values that are sentences, and are not cut."""
_OF_SENTENCES = ("sources", "next_steps")
"""Sections whose values are sentences."""

Value = str | int | float | bool | None | list[float] | list[dict[str, Any]]
Section = dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """A file in words and numbers."""

    kind: str  # ``recording``, ``layers``, ``surfaces``, ``model``, ``sensor``, ``source`` or ``reconciliation``
    name: str  # the file, as given
    sections: dict[str, Section]  # names of values within each section carry their units; None means unknown
    warnings: tuple[Finding, ...]  # what to be wary of
    # The noise curve with all its numbers, as a table of a model file, for the terminal alone; empty without one.
    table: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the same for JSON: None for numbers that are not finite."""
        warnings = [{"code": finding.code, "text": finding.line} for finding in self.warnings]
        sections = {title: {k: finite_or_none(v) for k, v in part.items()} for title, part in self.sections.items()}
        return {"kind": self.kind, "file": self.name, **sections, "warnings": warnings}


def format_description(description: Description) -> str:
    """Format a description for the terminal, without a newline at the end."""
    lines = [f"{printable(description.name)}: {description.kind}"]
    for title, section in description.sections.items():
        lines += ["", title.replace("_", " ")]
        for key, value in section.items():
            lines += _wrapped(value) if title in _OF_SENTENCES else _lines(key, value)
    if description.table:
        lines += ["", "noise curve, to paste into a model", description.table.rstrip()]
    if description.warnings:
        lines.append("")
    lines += [f"warning: {finding.line}" for finding in description.warnings]
    return "\n".join(lines)


def _wrapped(value: Value) -> list[str]:
    text_width = 100  # characters of a line
    return textwrap.wrap(
        printable(str(value), _LONGEST_SENTENCE), text_width, initial_indent="  - ", subsequent_indent="    "
    )


def _lines(key: str, value: Value) -> list[str]:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        rows = (", ".join(f"{k} {_shown(v)}" for k, v in item.items()) for item in value)
        return [f"  {key} {number}: {printable(row, 160)}" for number, row in enumerate(rows, 1)]
    longest_value = 120  # characters of a value from a file before it is cut
    longest = _LONGEST_SENTENCE if key in _SENTENCES else longest_value
    name_width = 26  # characters of the column of names
    return [f"  {printable(key, name_width):<{name_width}} {printable(_shown(value), longest)}"]


def _shown(value: object) -> str:
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return " ".join(_shown(item) for item in value) or "none"
    return number(value, ".9g") if isinstance(value, float) else str(value)


def sensor_section(sensor: Sensor) -> Section:
    """The section of a camera; None means unknown numbers."""
    section: Section = {"name": sensor.name}
    section |= {} if sensor.measurement is None else {"measurement": sensor.measurement.value}
    section |= {} if sensor.share_law is None else {"share_law": sensor.share_law.value}
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
        section |= _lists(noise.law, LAW_LISTS)
    if noise is not None:
        section |= _noise_parts(noise)
    if sensor.range_step_mm is not None:
        section["range_step_mm"] = float(np.median(sensor.range_step_mm))
    return section


def _noise_parts(noise: NoiseCurve) -> Section:
    """Parts of a noise curve beyond sigma; empty if the error is Gaussian and equal in all pixels."""
    parts: Section = {}
    if noise.shape is not None:
        parts |= _lists(noise.shape, SHAPE_LISTS)
        parts["noise_shape_skewness"], parts["noise_shape_excess_kurtosis"] = noise.shape.moments()[2:]
    if noise.width_spread:
        parts["noise_width_spread"] = noise.width_spread
    if noise.background is not None:
        low, middle, high = np.quantile(noise.background, (0.0, 0.5, 1.0))
        parts |= {"noise_background_least": low, "noise_background_median": middle, "noise_background_most": high}
    if noise.background_density is not None:
        parts |= _lists(noise.background_density, DENSITY_LISTS)
    return {key: float(value) if isinstance(value, np.floating) else value for key, value in parts.items()}


def _lists(part: AmplitudeLaw | NoiseShape | BackgroundDensity, names: Mapping[str, str]) -> Section:
    """The lists of a part of a noise curve, under their names in files."""
    return {f"noise_{name}": getattr(part, key).tolist() for name, key in names.items()}


def noise_table(sensor: Sensor) -> str:
    """The noise curve of a camera as a table of a model file; empty without one."""
    if sensor.noise is None:
        return ""
    return noise_toml(sensor.noise, integration_time_ms=sensor.integration_time_ms)


def noise_section(sensor: Sensor) -> Section:
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
    if numbers.background_range_mm is not None:
        parts |= dict(zip(("background_from_mm", "background_to_mm"), numbers.background_range_mm, strict=True))
    return section | {key: value for key, value in parts.items() if value is not None}


def view_findings(sensor: Sensor, shape: tuple[int, int]) -> list[Finding]:
    """A warning if points cannot be placed: no field of view, or one that the image (rows, columns) cannot have."""
    try:
        if sensor.optics is not None:
            sensor.optics.check(shape)
            return []
    except ValueError as error:
        return [Finding(code="unfit_projection", text=f"Points cannot be placed: {error}.")]
    return [Finding(code="no_field_of_view", text="No field of view: points cannot be placed; export needs --fov.")]


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


_COUNTED = ("n_modes", "status", "suspect", "invalid_share")


def _made_from(provenance: Provenance | SurfacesProvenance) -> dict[str, Section]:
    """Source, options and camera of layers or surfaces."""
    return {
        "made_from": {
            "source": provenance.source,
            "source_sha256": provenance.source_sha256,
            "tofmix_version": provenance.version,
        },
        "options": dict(sorted(provenance.options.items())),
        "sensor": sensor_section(provenance.sensor),
    }


def describe_layers(file: "LayersFile", *, name: str, file_bytes: int) -> Description:
    """Describe a layers file from its header, its counts and its status, read window by window."""
    windows, rows, cols = file.shape
    provenance = file.provenance
    counts = Counts(file)
    for window in range(windows):
        read: dict[str, Any] = {
            field: file.read_field(field, window) if field in file.names else None for field in _COUNTED
        }
        counts.count(**read)
    sections: dict[str, Section] = {
        "sizes": {
            "windows": windows,
            "rows": rows,
            "cols": cols,
            "max_layers": file.max_layers,
            "file_bytes": file_bytes,
            "window_frames": int(file.window_stop[0] - file.window_start[0]),
            "frames_left_out": provenance.frames_left_out,
        },
        "units": {"range": "mm", "sigma": "mm", "range_stderr": "mm", "weight": "1"},
        **_made_from(provenance),
    }
    if (losses := counts.lost.numbers()) is not None:
        sections["lost_samples"] = {
            "mean_share": losses.mean_share,
            "median_share": losses.share.q50,
            "pixels_without_sample": losses.pixels_without_sample,
            "pixels_at_limit": losses.pixels_at_limit,
        }
    noise = noise_section(provenance.sensor)
    sections |= {"noise": noise} if noise else {}
    law = file.mixing_law
    sections |= {"mixing": {"law": law.words(), **law.as_dict()}} if law is not None else {}
    sections |= {"suspect_layers": {**counts.suspicions}} if any(counts.suspicions.values()) else {}
    warnings = count_findings(
        pixels=windows * rows * cols,
        by_status=counts.by_status(),
        by_surfaces=counts.surfaces,
        max_layers=file.max_layers,
        remedy=remedy_for(provenance, windows),
        lost=counts.lost.too_few,
    )
    of_losses = [finding for finding in counts.lost.findings() if not finding.is_note]
    return Description(
        kind="layers",
        name=name,
        sections=sections,
        warnings=(
            *of_losses,
            *warnings,
            *target_findings(provenance.targets),
            *suspect_findings(counts.suspicions),
            *view_findings(provenance.sensor, (rows, cols)),
        ),
        table=noise_table(provenance.sensor),
    )


def describe_surfaces(file: "SurfacesFile", *, name: str, file_bytes: int) -> Description:
    """Describe a surfaces file from its header."""
    windows, rows, cols = file.shape
    provenance = file.provenance
    sections: dict[str, Section] = {
        "sizes": {
            "windows": windows,
            "rows": rows,
            "cols": cols,
            "max_layers": file.max_layers,
            "file_bytes": file_bytes,
            "factor": file.factor,
            "rows_fine": rows * file.factor,
            "cols_fine": cols * file.factor,
        },
        "found": {
            "surfaces": file.surfaces,
            "smooth_surfaces": file.smooth_surfaces,
            "edge_lines": file.edge_lines,
            "edge_points": file.edge_points,
        },
        "units": {"range_fine": "mm", "edge_row": "pixel", "edge_stderr": "pixel", "plane_offset_mm": "mm"},
        **_made_from(provenance),
    }
    noise = noise_section(provenance.sensor)
    sections |= {"noise": noise} if noise else {}
    found = tuple(view_findings(provenance.sensor, (rows, cols)))
    table = noise_table(provenance.sensor)
    return Description(kind="surfaces", name=name, sections=sections, warnings=found, table=table)


def describe_gap(gap: dict[str, Any], *, name: str, most_shown: int = 20) -> Description:
    """Describe the result of `tofmix reconcile`, from its `gap.json`.

    Of effects and of places `most_shown` each are listed.
    """
    effects: list[dict[str, Any]] = [
        {"kind": effect.get("kind"), **_flat(effect.get("parameters"))} for effect in _dicts(gap["effects"])
    ]
    places: list[dict[str, Any]] = [
        {key: place[key] for key in ("statistic", "axis", "interval", "size", "unit") if key in place}
        for place in _dicts(gap.get("where"))
    ]
    sections: dict[str, Section] = {
        "found": {"verdict": str(gap["verdict"]), "effects": effects[:most_shown], "where": places[:most_shown]},
        "gap": {key: _plain(gap["gap"].get(key)) for key in ("before", "after", "floor", "closed")},
    }
    steps = gap.get("next_steps")
    if isinstance(steps, list) and steps:
        sections["next_steps"] = {str(number): str(step) for number, step in enumerate(steps[:most_shown], 1)}
    return Description(kind="reconciliation", name=name, sections=sections, warnings=())


def _dicts(value: object) -> list[dict[str, Any]]:
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _flat(value: object) -> dict[str, Any]:
    return {str(key): _plain(item) for key, item in value.items()} if isinstance(value, dict) else {}


def _plain(value: object) -> Value:
    known = finite_or_none(value)
    return known if isinstance(known, str | int | float | None) else str(known)
