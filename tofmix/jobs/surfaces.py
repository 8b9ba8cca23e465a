"""Find the surfaces of a layers file, window by window, and write them."""

from pathlib import Path
from typing import Any

import numpy as np

from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.recording.recording_file import file_sha256
from tofmix.io.storage import locked
from tofmix.io.surfaces_file import SurfacesWriter
from tofmix.jobs.files import check_view, placed_words, sensor_of_view
from tofmix.jobs.reporter import Reporter
from tofmix.sensor import Sensor
from tofmix.surfaces.found import SurfacesProvenance, WindowSurfaces
from tofmix.surfaces.reconstruct import reconstruct
from tofmix.version import __version__


def write_surfaces(
    layers: Path,
    output: Path,
    reporter: Reporter,
    *,
    factor: int,
    view_deg: tuple[float, float] | None,
    projection: str,
    suspect: bool,
    overwrite: bool,
) -> tuple[dict[str, Any], str]:
    """Write the surfaces file of a layers file.

    Returns
    -------
    (dict, str)
        Counts over all windows, and how pixels were placed by a given field of view, in words.
    """
    with locked(output, overwrite=overwrite, inputs=(layers,)), open_layers(layers) as file:
        if view_deg is None:
            check_view(file, own_remedy="give them with --fov HxV, or ")
        sensor = sensor_of_view(file, view_deg, projection, reporter)
        options: dict[str, str | int | float] = {"factor": factor, **({"suspect": 1} if suspect else {})}
        provenance = SurfacesProvenance(
            source=layers.name,
            source_sha256=file_sha256(layers),
            version=__version__,
            sensor=sensor,
            options=options,
        )
        windows, rows, cols = file.shape
        tally, left_out = _Tally(), 0
        writer = SurfacesWriter(
            output,
            shape=file.shape,
            max_layers=file.max_layers,
            factor=factor,
            provenance=provenance,
            overwrite=overwrite,
            inputs=(layers,),
        )
        with reporter.steps(windows, "surfaces", "window"), writer:
            for window in range(windows):
                left_out += 0 if suspect else file.suspects(window)
                one = _reconstruct(file, sensor, window, factor, suspect=suspect)
                writer.write(one)
                tally.add(one)
                reporter.progress(1)
        values = tally.values() | {
            "rows_fine": rows * factor,
            "cols_fine": cols * factor,
            "factor": factor,
            "windows": windows,
        }
        values |= {"suspect_left_out": left_out} if left_out else {}
        return values, placed_words(sensor, view_deg, (rows, cols))


def _reconstruct(file: LayersFile, sensor: Sensor, window: int, factor: int, *, suspect: bool) -> WindowSurfaces:
    layers = file.read_window(window)
    try:
        return reconstruct(layers.trusted() if suspect else layers, sensor, factor=factor)
    except ValueError as error:
        raise BadInputError(f"{file.path}: window {window}: {error}") from error


class _Tally:
    """Counts over all windows."""

    def __init__(self) -> None:
        self._surfaces = self._smooth = self._lines = self._assumed = 0
        self._stderr: list[Any] = []

    def add(self, found: WindowSurfaces) -> None:
        self._surfaces += len(found.planes)
        self._smooth += int(found.planes.is_smooth.sum())
        self._lines += len(found.edges.lines())
        self._stderr.append(found.edges.stderr)
        self._assumed += found.assumed

    def values(self) -> dict[str, Any]:

        stderr = np.concatenate(self._stderr)
        known = stderr[np.isfinite(stderr)]
        median = float(np.median(known)) if len(known) else None
        return {
            "surfaces": self._surfaces,
            "smooth_surfaces": self._smooth,
            "edge_lines": self._lines,
            "edge_points": len(stderr),
            "edge_stderr_median": median,
            "pixels_shares_assumed_areas": self._assumed,
        }
