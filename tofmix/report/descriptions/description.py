"""A description of any file for `tofmix info`, and the sections that several kinds of files have.

A description is sections of named values, warnings, and their text for the terminal. The common sections are the
camera, its noise and its view.
"""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tofmix.noise_shape import BackgroundDensity, NoiseShape
from tofmix.optics.projection import projection_values
from tofmix.report.summary.findings import Finding
from tofmix.report.summary.noise_numbers import noise_numbers
from tofmix.report.summary.tables import printable
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor
from tofmix.sensor_schema import DENSITY_LISTS, LAW_LISTS, RARE_SENSOR_NUMBERS, SENSOR_NUMBERS, SHAPE_LISTS
from tofmix.sensors.camera_toml import noise_toml
from tofmix.wording import finite_or_none, number

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
    return textwrap.wrap(
        printable(str(value), _LONGEST_SENTENCE), _TEXT_WIDTH, initial_indent="  - ", subsequent_indent="    "
    )


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
