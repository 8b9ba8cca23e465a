"""Description of a model: its camera, the recording that it gives, its surfaces and effects."""

import tomllib
from typing import Any

from tofmix.report.descriptions.camera import profile_findings, profile_section
from tofmix.report.descriptions.description import Description, Section
from tofmix.report.summary.findings import Finding
from tofmix.simulation.model import Model


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
