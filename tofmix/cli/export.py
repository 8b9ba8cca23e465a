"""``tofmix export``: layers and surfaces in the formats of other programs.

``tofmix surfaces``: layers in; surfaces, their edges and a finer range image out.
"""

import json
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

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
from tofmix.errors import UsageError
from tofmix.wording import counted, left_out_words

_POINTS_ONLY = ("min_weight", "min_probability", "fields", "fov", "projection")
_IMAGES_ONLY = ("layer", "scale")
_LAYERS_ONLY = (*_POINTS_ONLY, "undecided", "suspect", "layer")
_WHAT = ("edges", "points", "image", "planes")


@examples(
    """
tofmix export boards.layers.h5 -o boards.las
tofmix export boards.layers.h5 -o boards.ply --min-weight 0.1 --min-probability 0.99
tofmix export boards.layers.h5 -o boards.pcd --fields amplitude,n_samples,invalid_share
tofmix export foreign.layers.h5 -o foreign.csv --fov 47x39
tofmix export boards.layers.h5 -o second.png --layer 2 --scale 0.25
tofmix export boards.surfaces.h5 -o edges.geojson
tofmix export boards.surfaces.h5 -o fine.ply --what points
tofmix export boards.surfaces.h5 -o fine.png --scale 0.25
tofmix export boards.surfaces.h5 -o boards.obj --what planes
"""
)
@click.command(short_help="Write layers and surfaces for other programs: points, images, edges, planes.")
@click.argument("file", type=PATH)
@click.option(
    "-o",
    "--output",
    type=PATH,
    required=True,
    help="File to write; the extension sets the format: .las, .laz, .ply, .pcd, .csv; .png, .tif; .geojson, .json,"
    " .obj.",
)
@click.option(
    "--what",
    type=click.Choice(_WHAT),
    help="Content to write; edges and planes need a surfaces file.  [default: by the extension, in the order edges,"
    " planes, image, points]",
)
@click.option(
    "--window", type=click.IntRange(0), help="Window to write; an image of several windows needs it.  [default: all]"
)
@click.option("--min-weight", type=click.FloatRange(0, 1), help="Points: smallest share of a layer.")
@click.option("--min-probability", type=click.FloatRange(0, 1), help="Points: smallest probability of a layer.")
@click.option(
    "--fields",
    metavar="NAMES",
    help="Points: further datasets of the layers file, with commas between them: amplitude, n_samples, invalid_share,"
    " mixing, suspect, ..., or all that it has.",
)
@click.option("--undecided", is_flag=True, help="Write undecided pixels too.")
@suspect_option
@click.option(
    "--fov", metavar="HxV", help="Points: full field of view in degrees, by --projection.  [default: the layers file's]"
)
@projection_option
@click.option(
    "--layer", type=click.IntRange(1), default=1, show_default=True, help="Images: number of the layer, 1 = nearest."
)
@click.option(
    "--scale", type=click.FloatRange(0, min_open=True), default=1.0, show_default=True, help="Images: mm of one count."
)
@json_option
@overwrite_option
@click.pass_context
def export(
    context: click.Context,
    /,
    file: Path,
    output: Path,
    what: str | None,
    window: int | None,
    min_weight: float | None,
    min_probability: float | None,
    fields: str | None,
    undecided: bool,
    suspect: bool,
    fov: str | None,
    projection: str,
    layer: int,
    scale: float,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Write FILE, a layers file or a surfaces file, for other programs.

    From a layers file: points (.las, .laz, .ply, .pcd, .csv): one for each layer, in the sensor's frame in metres (x
    right, y down, z forward), with the layer's number, the pixel's number of layers, share, sigma, standard errors,
    probability, row, column and window, and --fields; or an image (.png, .tif): the ranges of one layer in 16 bits, 0
    for none.

    From a surfaces file: edges (.geojson, .json: lines in the image; .obj, .ply: lines in space), planes (.json: planes
    and outlines; .obj: triangles), an image (.png, .tif) or points (.pcd, .csv, .ply) of the fine range image.

    LAS, LAZ, PNG, TIFF and planes need the extra tofmix[export].
    """
    from tofmix.io.exporters import OF_LAYERS, OF_SURFACES, choose_what
    from tofmix.io.hdf5 import format_of
    from tofmix.io.surfaces_file import FORMAT as SURFACES_FORMAT
    from tofmix.jobs.export import ExportRequest, export_file
    from tofmix.points import PointFilter

    # Those of the environment are for outputs of any kind: they give way where they do not belong.
    given = {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    of_surfaces = format_of(file) == SURFACES_FORMAT
    if not of_surfaces:
        _check_not_of_surfaces(file, output, what)
    what = choose_what(output, what, OF_SURFACES if of_surfaces else OF_LAYERS)
    _check_options(given, what, output, of_surfaces=of_surfaces)
    chosen = PointFilter(min_weight=min_weight, min_probability=min_probability, undecided=undecided, suspect=suspect)
    asked = ExportRequest(
        file=file,
        output=output,
        what=what,
        window=window,
        chosen=chosen,
        fields=[part.strip() for part in fields.split(",")] if fields else (),
        view_deg=view_of(fov),
        projection=projection,
        layer=layer,
        scale_mm=scale,
        overwrite=overwrite,
    )
    line, made = export_file(asked, CommandReporter(), of_surfaces=of_surfaces)
    click.echo(json.dumps({"output": str(output), **made}) if as_json else line)


def _check_not_of_surfaces(layers: Path, output: Path, what: str | None) -> None:
    """Refuse content that only a surfaces file has; the message names the commands that make one and export it."""
    from tofmix.io.exporters import EDGES, OF_LAYERS, OF_SURFACES
    from tofmix.io.next_command import next_command
    from tofmix.jobs.files import surfaces_path

    ends = {
        name: {end for of_one in known.values() for end in of_one}
        for name, known in (("layers", OF_LAYERS), ("surfaces", OF_SURFACES))
    }
    if what is None and output.suffix.lower() in ends["surfaces"] - ends["layers"]:
        what = EDGES
    elif what is None or what in OF_LAYERS:
        return
    asked = () if what == EDGES else ("--what", what)
    export_it = next_command("export", surfaces_path(layers), "-o", str(output), *asked)
    raise UsageError(f"{layers} has no {what}: run {next_command('surfaces', layers)}, then {export_it}")


def _check_options(given: set[str], what: str, output: Path, *, of_surfaces: bool) -> None:
    """Refuse typed options without an effect."""
    from tofmix.io.exporters import IMAGE

    if of_surfaces:
        wrong = dict.fromkeys(_LAYERS_ONLY, "a surfaces file")
        if what != IMAGE:
            wrong["scale"] = f"{what} of a surfaces file"
    else:
        wrong = dict.fromkeys(_POINTS_ONLY if what == IMAGE else _IMAGES_ONLY, output.suffix)
    for name, place in wrong.items():
        if name in given:
            raise UsageError(f"--{name.replace('_', '-')} does not belong to {place}")


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
