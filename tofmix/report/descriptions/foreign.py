"""Description of a file of another program, which `tofmix import` reads."""

from typing import TYPE_CHECKING

from tofmix.report.descriptions.description import Description, Section
from tofmix.report.summary.findings import Finding

if TYPE_CHECKING:
    from tofmix.io.importers.base import FrameSource


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
