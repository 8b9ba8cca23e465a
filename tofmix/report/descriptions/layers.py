"""Description of a layers file. `tofmix.report.summary.summary` describes the results of an estimate."""

from typing import TYPE_CHECKING, Any

from tofmix.report.descriptions.description import Description, Section
from tofmix.report.descriptions.sections import noise_section, noise_table, sensor_section, view_findings
from tofmix.report.summary.findings import count_findings, suspect_findings, target_findings
from tofmix.report.summary.summary import Counts, remedy_for

if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile

_COUNTED = ("n_modes", "status", "suspect", "invalid_share")


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
        "made_from": {
            "source": provenance.source,
            "source_sha256": provenance.source_sha256,
            "tofmix_version": provenance.version,
        },
        "options": dict(sorted(provenance.options.items())),
        "sensor": sensor_section(provenance.sensor),
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
