"""``tofmix surfaces``: layers in; surfaces, their edges and a finer range image out."""

import json
from pathlib import Path
from typing import Any

import click

from tofmix.cli.options import (
    HDF5_PATH,
    PATH,
    examples,
    json_option,
    overwrite_option,
    projection_option,
    suspect_option,
    view_of,
)
from tofmix.cli.reporter import CommandReporter
from tofmix.wording import counted, left_out_words


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
    "--factor",
    type=click.IntRange(2, 32),
    default=8,
    show_default=True,
    help="Subdivision of a pixel in the fine range image: FACTOR x FACTOR parts.",
)
@click.option(
    "--fov", metavar="HxV", help="Full field of view in degrees, by --projection.  [default: the layers file's]"
)
@projection_option
@suspect_option
@json_option
@overwrite_option
def surfaces(
    layers: Path,
    output: Path | None,
    factor: int,
    fov: str | None,
    projection: str,
    suspect: bool,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Find the surfaces in LAYERS, a file that tofmix estimate wrote.

    The command joins layers of neighbouring pixels into surfaces: planes, and smooth
    surfaces where they bend. The shares locate the edge of each surface within a pixel. The result
    has edge lines with their standard errors, and a range image with FACTOR x
    FACTOR parts a pixel. Each window is independent. The layers file must have the
    camera's field of view. docs/how-to/surfaces.md shows how other programs read
    the file.
    """
    from tofmix.jobs.files import surfaces_path
    from tofmix.jobs.surfaces import write_surfaces

    output, view = output or surfaces_path(layers), view_of(fov)
    values, placed = write_surfaces(
        layers,
        output,
        CommandReporter(),
        factor=factor,
        view_deg=view,
        projection=projection,
        suspect=suspect,
        overwrite=overwrite,
    )
    left_out = left_out_words(values.get("suspect_left_out", 0))
    said = json.dumps({"output": str(output), **values}) if as_json else f"{output}: {_line(values)}{left_out}{placed}"
    click.echo(said)


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
