"""Description of a surfaces file."""

from typing import TYPE_CHECKING

from tofmix.report.descriptions.description import Description, Section
from tofmix.report.descriptions.sections import noise_section, noise_table, sensor_section, view_findings

if TYPE_CHECKING:
    from tofmix.io.surfaces.surfaces_file import SurfacesFile


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
        "made_from": {
            "source": provenance.source,
            "source_sha256": provenance.source_sha256,
            "tofmix_version": provenance.version,
        },
        "options": dict(sorted(provenance.options.items())),
        "sensor": sensor_section(provenance.sensor),
    }
    noise = noise_section(provenance.sensor)
    sections |= {"noise": noise} if noise else {}
    found = tuple(view_findings(provenance.sensor, (rows, cols)))
    table = noise_table(provenance.sensor)
    return Description(kind="surfaces", name=name, sections=sections, warnings=found, table=table)
