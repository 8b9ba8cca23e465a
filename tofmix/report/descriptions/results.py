"""Descriptions of results: layers files, surfaces files, and the folder of a reconciliation.

`tofmix.report.summary.summary` describes the results of an estimate. A reconciliation is described from its `gap.json`.
"""

from typing import TYPE_CHECKING, Any

from tofmix.report.descriptions.description import (
    Description,
    Section,
    Value,
    noise_section,
    noise_table,
    sensor_section,
    view_findings,
)
from tofmix.report.summary.findings import count_findings, suspect_findings, target_findings
from tofmix.report.summary.summary import Counts, remedy_for
from tofmix.wording import finite_or_none

if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.io.surfaces_file import SurfacesFile


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
