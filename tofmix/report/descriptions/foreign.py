"""Description of a file of another program, which `tofmix import` reads."""

from typing import TYPE_CHECKING, Any, Protocol

from tofmix.report.descriptions.description import Description, Section
from tofmix.report.summary.findings import Finding

if TYPE_CHECKING:
    import numpy as np


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
