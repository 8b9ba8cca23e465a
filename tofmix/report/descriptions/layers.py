"""Description of a layers file. `tofmix.report.summary.summary` describes the results of an estimate."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tofmix.flags import Status, status_name
from tofmix.layers import SUSPECT
from tofmix.report.descriptions.description import Description, Section
from tofmix.report.descriptions.sections import noise_section, noise_table, sensor_section, view_findings
from tofmix.report.sources import LayersSource
from tofmix.report.summary.findings import count_findings, suspect_findings, target_findings
from tofmix.report.summary.lost import LostTally
from tofmix.report.summary.summary import remedy_for
from tofmix.suspicion.counting import count_suspects


class LayersHeader(LayersSource, Protocol):
    """Interface of a layers file, as `tofmix.io.layers.layers_file.LayersFile` has it."""

    @property
    def names(self) -> tuple[str, ...]:
        """Datasets that are there."""

    def read_field(self, name: str, window: int) -> NDArray[Any]:
        """One dataset of one window."""


def describe_layers(file: LayersHeader, *, name: str, file_bytes: int) -> Description:
    """Describe a layers file from its header, its counts and its status, read window by window."""
    windows, rows, cols = file.shape
    provenance = file.provenance
    surfaces = np.zeros(file.max_layers + 1, dtype=np.int64)
    lost, frames = LostTally(), int(file.window_stop[0] - file.window_start[0])
    suspects = count_suspects(None)
    by_status: dict[str, int] = dict.fromkeys((status_name(s) for s in Status), 0)
    for window in range(windows):
        counts = np.bincount(file.read_field("n_modes", window).ravel(), minlength=file.max_layers + 1)
        surfaces += counts[: file.max_layers + 1]
        marks = file.read_field(SUSPECT.name, window) if SUSPECT.name in file.names else None
        for kind, count in count_suspects(marks).items():
            suspects[kind] += count
        status = file.read_field("status", window)
        if "invalid_share" in file.names:
            lost.add(file.read_field("invalid_share", window), status, frames)
        for known in Status:
            by_status[status_name(known)] += int((status == known).sum())
    sections: dict[str, Section] = {
        "sizes": {
            "windows": windows,
            "rows": rows,
            "cols": cols,
            "max_layers": file.max_layers,
            "file_bytes": file_bytes,
            "window_frames": frames,
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
    if (losses := lost.numbers()) is not None:
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
    sections |= {"suspect_layers": {**suspects}} if any(suspects.values()) else {}
    warnings = count_findings(
        pixels=windows * rows * cols,
        by_status=by_status,
        by_surfaces=surfaces.tolist(),
        max_layers=file.max_layers,
        remedy=remedy_for(provenance, windows),
        lost=lost.too_few,
    )
    of_losses = [finding for finding in lost.findings() if not finding.is_note]
    return Description(
        kind="layers",
        name=name,
        sections=sections,
        warnings=(
            *of_losses,
            *warnings,
            *target_findings(provenance.targets),
            *suspect_findings(suspects),
            *view_findings(provenance.sensor, (rows, cols)),
        ),
        table=noise_table(provenance.sensor),
    )
