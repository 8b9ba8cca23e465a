"""Description of a camera's own file, and the camera of a model."""

from tofmix.report.descriptions.description import Description, Section
from tofmix.report.descriptions.sections import noise_table, sensor_section
from tofmix.report.summary.findings import Finding
from tofmix.sensors.camera import Camera


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
