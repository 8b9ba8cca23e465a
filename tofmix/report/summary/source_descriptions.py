"""Descriptions of files of other programs, and of the folder of a reconciliation, for `tofmix info`."""

import math
from typing import TYPE_CHECKING, Any, Protocol

from tofmix.report.summary.descriptions import Description, Section, Value
from tofmix.report.summary.findings import Finding

if TYPE_CHECKING:
    import numpy as np

_MOST_SHOWN = 20
"""Effects and places that are listed."""


class ForeignSource(Protocol):
    """Interface of a source, as `tofmix.io.importers.base.FrameSource` has it."""

    @property
    def kind(self) -> str:
        """Kind of the source, in words."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""

    @property
    def targets(self) -> int:
        """Length of the axis of targets; 0 without one."""

    @property
    def dtype(self) -> "np.dtype[Any]":
        """Type of the depths."""

    @property
    def unit_mm(self) -> float | None:
        """mm of one unit; None if unknown."""  # noqa: D403  a unit's symbol

    @property
    def depth_axis(self) -> str:
        """Direction of the depths."""

    @property
    def has_amplitude(self) -> bool:
        """Whether amplitudes are there."""

    @property
    def has_time(self) -> bool:
        """Whether times are there."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for the user."""


def describe_source(source: ForeignSource, *, name: str, command: str) -> Description:
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


def describe_gap(gap: dict[str, Any], *, name: str) -> Description:
    """Describe the result of `tofmix reconcile`, from its `gap.json`."""
    effects: list[dict[str, Any]] = [
        {"kind": effect.get("kind"), **_flat(effect.get("parameters"))} for effect in _dicts(gap["effects"])
    ]
    places: list[dict[str, Any]] = [
        {key: place[key] for key in ("statistic", "axis", "interval", "size", "unit") if key in place}
        for place in _dicts(gap.get("where"))
    ]
    sections: dict[str, Section] = {
        "found": {"verdict": str(gap["verdict"]), "effects": effects[:_MOST_SHOWN], "where": places[:_MOST_SHOWN]},
        "gap": {key: _plain(gap["gap"].get(key)) for key in ("before", "after", "floor", "closed")},
    }
    steps = gap.get("next_steps")
    if isinstance(steps, list) and steps:
        sections["next_steps"] = {str(number): str(step) for number, step in enumerate(steps[:_MOST_SHOWN], 1)}
    return Description(kind="reconciliation", name=name, sections=sections, warnings=())


def _dicts(value: object) -> list[dict[str, Any]]:
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _flat(value: object) -> dict[str, Any]:
    return {str(key): _plain(item) for key, item in value.items()} if isinstance(value, dict) else {}


def _plain(value: object) -> Value:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool) or value is None else str(value)
