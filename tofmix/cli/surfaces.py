"""``tofmix surfaces``: layers in; surfaces, their edges and a finer range image out."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import (
    HDF5_PATH,
    PATH,
    examples,
    json_option,
    left_out_words,
    overwrite_option,
    projection_option,
    suspect_option,
    view_of,
)
from tofmix.cli.progress import Progress
from tofmix.errors import BadInputError
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.sensor import Sensor
    from tofmix.surfaces.found import WindowSurfaces

_ENDING, _FROM = ".surfaces.h5", ".layers.h5"


@examples(
    """
tofmix surfaces boards.layers.h5
tofmix surfaces boards.layers.h5 -o fine.surfaces.h5 --factor 16
tofmix export boards.surfaces.h5 -o edges.geojson
tofmix export boards.surfaces.h5 -o boards.obj --what planes
"""
)
@click.command(short_help="Find surfaces, their edges below a pixel, and a finer range image.")
@click.argument("layers", type=PATH)
@click.option("-o", "--output", type=HDF5_PATH, help="Surfaces file to write.  [default: LAYERS with .surfaces.h5]")
@click.option(
    "--factor", type=click.IntRange(2, 32), default=8, show_default=True,
    help="Subdivision of a pixel in the fine range image: FACTOR x FACTOR parts.",
)  # fmt: skip
@click.option(
    "--fov", metavar="HxV", help="Full field of view in degrees, by --projection.  [default: the layers file's]"
)
@projection_option
@suspect_option
@json_option
@overwrite_option
def surfaces(
    layers: Path, output: Path | None, factor: int, fov: str | None, projection: str, suspect: bool, as_json: bool,
    overwrite: bool,
) -> None:  # fmt: skip
    """Find the surfaces in LAYERS, a file that tofmix estimate wrote.

    The command joins layers of neighbouring pixels into surfaces: planes, and smooth
    surfaces where they bend. The shares locate the edge of each surface within a pixel. The result
    has edge lines with their standard errors, and a range image with FACTOR x
    FACTOR parts a pixel. Each window is independent. The layers file must have the
    camera's field of view. docs/how-to/surfaces.md shows how other programs read
    the file.
    """
    from tofmix.io.atomic.storage import locked
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.io.recording.recording_file import file_sha256
    from tofmix.io.surfaces.surfaces_writer import SurfacesWriter
    from tofmix.jobs.view import check_view, view_note, view_words, viewed
    from tofmix.surfaces.found import SurfacesProvenance
    from tofmix.version import __version__

    output = output or surfaces_path(layers)
    with locked(output, overwrite=overwrite, inputs=(layers,)), open_layers(layers) as file:
        sensor, view = file.provenance.sensor, view_of(fov)
        if view is None:
            check_view(file, own_remedy="give them with --fov HxV, or ")
        else:
            sensor = viewed(sensor, view, projection, file.shape[1:])
            if doubt := view_note(view, projection, file.shape[1:]):
                click.echo(f"tofmix: {doubt}", err=True)
        options: dict[str, str | int | float] = {"factor": factor}
        if suspect:
            options["suspect"] = 1
        provenance = SurfacesProvenance(
            source=layers.name,
            source_sha256=file_sha256(layers),
            version=__version__,
            sensor=sensor,
            options=options,
        )
        tally = _Tally()
        with (
            Progress(file.shape[0], "surfaces", "window") as bar,
            SurfacesWriter(
                output, shape=file.shape, max_layers=file.max_layers, factor=factor, provenance=provenance,
                overwrite=overwrite, inputs=(layers,),
            ) as writer,
        ):  # fmt: skip
            left_out_of = [file.suspects(window) for window in range(file.shape[0])]
            for window in range(file.shape[0]):
                found = _reconstruct(file, sensor, window, factor, suspect=suspect)
                writer.write(found)
                tally.add(found)
                bar.update()
    values = tally.values() | {
        "rows_fine": file.shape[1] * factor, "cols_fine": file.shape[2] * factor, "factor": factor,
        "windows": file.shape[0],
    }  # fmt: skip
    left_out = 0 if suspect else sum(left_out_of)
    values |= {"suspect_left_out": left_out} if left_out else {}
    placed = "" if view is None or sensor.optics is None else f"; {view_words(sensor.optics, file.shape[1:], view)}"
    click.echo(
        json.dumps({"output": str(output), **values})
        if as_json
        else f"{output}: {_line(values)}{left_out_words(left_out)}{placed}"
    )


def surfaces_path(layers: Path) -> Path:
    """Default path of the surfaces of a layers file."""
    return layers.parent / f"{layers.name.removesuffix(_FROM).removesuffix('.h5')}{_ENDING}"


def _reconstruct(file: "LayersFile", sensor: "Sensor", window: int, factor: int, *, suspect: bool) -> "WindowSurfaces":
    from tofmix.surfaces.reconstruct import reconstruct

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

    def add(self, found: "WindowSurfaces") -> None:
        self._surfaces += len(found.planes)
        self._smooth += int(found.planes.is_smooth.sum())
        self._lines += len(found.edges.lines())
        self._stderr.append(found.edges.stderr)
        self._assumed += found.assumed

    def values(self) -> dict[str, Any]:
        import numpy as np

        stderr = np.concatenate(self._stderr)
        known = stderr[np.isfinite(stderr)]
        median = float(np.median(known)) if len(known) else None
        return {
            "surfaces": self._surfaces, "smooth_surfaces": self._smooth, "edge_lines": self._lines,
            "edge_points": len(stderr), "edge_stderr_median": median, "pixels_shares_assumed_areas": self._assumed,
        }  # fmt: skip


def _line(values: dict[str, Any]) -> str:
    median = values["edge_stderr_median"]
    error = "" if median is None else f" (median error {median:.3f} pixels)"
    assumed = "; edges assume that shares are areas" if values["pixels_shares_assumed_areas"] else ""
    windows = f" of each of {values['windows']:,} windows" if values["windows"] > 1 else ""
    smooth = f" ({values['smooth_surfaces']:,} smooth, no plane)" if values["smooth_surfaces"] else ""
    return (
        f"{counted(values['surfaces'], 'surface', ',')}{smooth},"
        f" {counted(values['edge_lines'], 'edge line', ',')} of {counted(values['edge_points'], 'point', ',')}{error},"
        f" range image {values['rows_fine']} x {values['cols_fine']}{windows}{assumed}"
    )
