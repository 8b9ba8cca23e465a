"""``tofmix export``: layers and surfaces in the formats of other programs."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from tofmix.cli.options import (
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
from tofmix.errors import BadInputError, UsageError
from tofmix.wording import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tofmix.io.exporters.image import RangeImage
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.io.surfaces.surfaces_file import SurfacesFile
    from tofmix.layers import LayerField
    from tofmix.optics.projection import Projection
    from tofmix.points import PointFilter

_POINTS_ONLY = ("min_weight", "min_probability", "fields", "fov", "projection")
_WITH_INTENSITY = (".ply", ".pcd")
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
    "-o", "--output", type=PATH, required=True,
    help="File to write; the extension sets the format: .las, .laz, .ply, .pcd, .csv; .png, .tif; .geojson, .json,"
    " .obj.",
)  # fmt: skip
@click.option(
    "--what", type=click.Choice(_WHAT),
    help="Content to write; edges and planes need a surfaces file.  [default: by the extension, in the order edges,"
    " planes, image, points]",
)  # fmt: skip
@click.option(
    "--window", type=click.IntRange(0), help="Window to write; an image of several windows needs it.  [default: all]"
)
@click.option("--min-weight", type=click.FloatRange(0, 1), help="Points: smallest share of a layer.")
@click.option("--min-probability", type=click.FloatRange(0, 1), help="Points: smallest probability of a layer.")
@click.option(
    "--fields", metavar="NAMES",
    help="Points: further datasets of the layers file, with commas between them: amplitude, n_samples, invalid_share,"
    " mixing, suspect, ..., or all that it has.",
)  # fmt: skip
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
    from tofmix.io.atomic.storage import locked
    from tofmix.io.exporters import IMAGE, OF_LAYERS, OF_SURFACES, choose_what
    from tofmix.io.file_kind import format_of
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.io.surfaces.fields import FORMAT as SURFACES_FORMAT
    from tofmix.io.surfaces.surfaces_file import open_surfaces

    # Those of the environment are for outputs of any kind: they give way where they do not belong.
    given = {
        name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }  # fmt: skip
    of_surfaces = format_of(file) == SURFACES_FORMAT
    if not of_surfaces:
        _check_not_of_surfaces(file, output, what)
    what = choose_what(output, what, OF_SURFACES if of_surfaces else OF_LAYERS)
    _check_options(given, what, output, of_surfaces=of_surfaces)
    with locked(output, overwrite=overwrite, inputs=(file,)):
        if of_surfaces:
            with open_surfaces(file) as surfaces:
                _check_window(surfaces, window, as_image=what == IMAGE)
                line, made = _export_surfaces(surfaces, output, what, window, scale, overwrite)
        else:
            with open_layers(file) as layers:
                _check_window(layers, window, as_image=what == IMAGE)
                if what == IMAGE:
                    line, made = _export_image(
                        layers, output, window or 0, layer, scale, overwrite, undecided=undecided, suspect=suspect
                    )
                else:
                    from tofmix.points import PointFilter

                    chosen = PointFilter(
                        min_weight=min_weight, min_probability=min_probability, undecided=undecided, suspect=suspect
                    )
                    further = _further_fields(layers, fields)
                    line, made = _export_points(layers, output, window, (fov, projection), chosen, further, overwrite)
    click.echo(json.dumps({"output": str(output), **made}) if as_json else line)


def _check_not_of_surfaces(layers: Path, output: Path, what: str | None) -> None:
    """Refuse content that only a surfaces file has; the message names the commands that make one and export it."""
    from tofmix.cli.surfaces import surfaces_path
    from tofmix.io.exporters import EDGES, OF_LAYERS, OF_SURFACES
    from tofmix.io.next_command import next_command

    ends = {name: {end for of_one in known.values() for end in of_one} for name, known in
            (("layers", OF_LAYERS), ("surfaces", OF_SURFACES))}  # fmt: skip
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


def _check_window(file: "LayersFile | SurfacesFile", window: int | None, *, as_image: bool) -> None:
    count = file.shape[0]
    if window is not None and window >= count:
        raise UsageError(f"--window {window}: {file.path} has windows 0 to {count - 1}")
    if as_image and window is None and count > 1:
        raise UsageError(f"{file.path} has {count} windows; choose one with --window")


def _further_fields(file: "LayersFile", names: str | None) -> "tuple[LayerField, ...]":
    """The fields of --fields, which the file must have."""
    from tofmix.points import fields_of_names

    try:
        return fields_of_names([part.strip() for part in names.split(",")] if names else (), file.names)
    except ValueError as error:
        raise UsageError(f"--fields {names}: {file.path}: {error}") from error


def _export_points(
    file: "LayersFile",
    output: Path,
    window: int | None,
    view: tuple[str | None, str],
    chosen: "PointFilter",
    further: "tuple[LayerField, ...]",
    overwrite: bool,
) -> tuple[str, dict[str, Any]]:
    from tofmix.io.exporters import export_points
    from tofmix.jobs.view import view_words
    from tofmix.points import LayerPoints

    windows = range(file.shape[0]) if window is None else [window]
    try:
        optics = _optics(file, *view)
        points = LayerPoints(
            file, optics=optics, windows=windows, chosen=chosen, further=further,
            intensity=output.suffix.lower() in _WITH_INTENSITY,
        )  # fmt: skip
    except ValueError as error:
        fov = view[0]
        raise (UsageError if fov else BadInputError)(f"{'--fov' if fov else file.path}: {error}") from error
    title = f"layers of {file.provenance.source}"
    with Progress(len(windows), "export", "window") as bar:
        count = export_points(
            output, points, title=title, progress=bar.update, overwrite=overwrite, inputs=(file.path,)
        )
    if count == 0:
        click.echo(f"tofmix: {output}: no layer passed the filters, so the file has no point", err=True)
    line = f"{output}: {counted(count, 'point', ',')} of {counted(len(windows), 'window')}"
    left_out = 0 if chosen.suspect else sum(file.suspects(number) for number in windows)
    line += left_out_words(left_out)
    if view[0] is not None:
        line += f"; placed by {view_words(optics, file.shape[1:], view_of(view[0]))}"
    made: dict[str, Any] = {"points": count, "windows": len(windows)}
    made |= {"suspect_left_out": left_out} if left_out else {}
    return line, made | ({"fields": [spec.name for spec in points.fields]} if further else {})


def _optics(file: "LayersFile", fov: str | None, projection: str) -> "Projection":
    """The projection: --fov by --projection, or from the layers file."""
    from tofmix.jobs.view import view_note, viewed

    view = view_of(fov)
    if view is not None:
        sensor = viewed(file.provenance.sensor, view, projection, file.shape[1:])
        if doubt := view_note(view, projection, file.shape[1:]):
            click.echo(f"tofmix: {doubt}", err=True)
        assert sensor.optics is not None  # noqa: S101  for the type checker: it has a view
        return sensor.optics
    optics = file.provenance.sensor.optics
    if optics is None:
        raise BadInputError(
            f"{file.path}: sensor: no field of view, so points cannot be placed; give it with --fov HxV"
        )
    return optics


def _export_image(
    file: "LayersFile", output: Path, window: int, layer: int, scale: float, overwrite: bool, *, undecided: bool,
    suspect: bool,
) -> tuple[str, dict[str, Any]]:  # fmt: skip
    import numpy as np

    from tofmix.flags import Mixing
    from tofmix.io.exporters.image import RangeImage
    from tofmix.layers import SUSPECT

    if layer > file.max_layers:
        raise UsageError(f"--layer {layer}: {file.path} has layers 1 to {file.max_layers}")
    range_mm = file.read_field("range", window)[..., layer - 1]
    if "mixing" in file.names and not undecided:
        range_mm = np.where(file.read_field("mixing", window) == int(Mixing.UNDECIDED), np.float32(np.nan), range_mm)
    left_out = 0
    if SUSPECT.name in file.names and not suspect:
        marked = file.read_field(SUSPECT.name, window)[..., layer - 1] > 0
        left_out = int(np.count_nonzero(marked))
        range_mm = np.where(marked, np.float32(np.nan), range_mm)
    title = f"layer {layer} of {file.provenance.source}, window {window}"
    image = RangeImage(range_mm=range_mm, scale_mm=scale, title=title)
    filled = _write_image(file, output, image, overwrite)
    line = f"{output}: {counted(filled, 'pixel', ',')} with a layer {layer}, {scale:g} mm a count, 0 = none"
    made = {"pixels": filled, "window": window, "layer": layer, "scale_mm": scale}
    return line + left_out_words(left_out), made | ({"suspect_left_out": left_out} if left_out else {})


def _write_image(file: "LayersFile | SurfacesFile", output: Path, image: "RangeImage", overwrite: bool) -> int:
    """Write an image; return how many places of it have a range."""
    from tofmix.io.exporters import export_image

    try:
        export_image(output, image, overwrite=overwrite, inputs=(file.path,))
    except BadInputError as error:
        raise BadInputError(f"{file.path}: {error}") from error
    return int((image.counts() > 0).sum())


def _export_surfaces(
    file: "SurfacesFile", output: Path, what: str, window: int | None, scale: float, overwrite: bool
) -> tuple[str, dict[str, Any]]:
    import numpy as np

    from tofmix.io import exporters

    windows = range(file.shape[0]) if window is None else [window]
    if what == exporters.IMAGE:
        return _export_fine_image(file, output, windows[0], scale, overwrite)
    if what == exporters.POINTS:
        return _export_fine_points(file, output, windows, overwrite)
    title = f"{what} of {file.provenance.source}"
    if what == exporters.EDGES:
        from tofmix.io.exporters.edge_lines import edge_lines

        lines = edge_lines(file, windows)
        exporters.export_edges(output, lines, title=title, overwrite=overwrite, inputs=(file.path,))
        count = len({line.line for line in lines})
        shared = len(lines) - count  # pieces of a line have one point in common
        made = {"lines": count, "points": sum(len(line.row) for line in lines) - shared}
        text = f"{counted(made['lines'], 'edge line', ',')} of {counted(made['points'], 'point', ',')}"
    else:
        from tofmix.io.exporters.outlines import outlines

        found = outlines(file, windows)
        exporters.export_planes(output, file, found, title=title, overwrite=overwrite)
        made = {"surfaces": len(found), "polygons": sum(len(outline.polygons) for outline in found)}
        text = f"{counted(made['surfaces'], 'surface', ',')} with {counted(made['polygons'], 'polygon', ',')}"
        left_out = int((file.planes.is_smooth & np.isin(file.surface_window, list(windows))).sum())
        if left_out:
            text += f"; {counted(left_out, 'smooth surface', ',')} left out: no plane"
    if not any(made.values()):
        click.echo(f"tofmix: {output}: {file.path} has no surface there, so the file is empty", err=True)
    if what == exporters.PLANES:
        made["smooth_left_out"] = left_out
    return f"{output}: {text}", {"what": what, **made, "windows": len(windows)}


def _export_fine_image(
    file: "SurfacesFile", output: Path, window: int, scale: float, overwrite: bool
) -> tuple[str, dict[str, Any]]:
    from tofmix.io.exporters.image import RangeImage

    range_mm = file.read_image("range_fine", window)
    title = f"fine range image of {file.provenance.source}, window {window}, {file.factor} x {file.factor} a pixel"
    image = RangeImage(range_mm=range_mm, scale_mm=scale, title=title, none="no return")
    filled = _write_image(file, output, image, overwrite)
    rows, cols = range_mm.shape
    line = f"{output}: range image {rows} x {cols}, {filled:,} with a range, {scale:g} mm a count, 0 = none"
    return line, {"what": "image", "rows": rows, "cols": cols, "filled": filled, "window": window, "scale_mm": scale}


def _export_fine_points(
    file: "SurfacesFile", output: Path, windows: "Sequence[int]", overwrite: bool
) -> tuple[str, dict[str, Any]]:
    from tofmix.io.exporters import export_points
    from tofmix.io.exporters.fine_points import FinePoints

    points = FinePoints(file, windows)
    title = f"fine range image of {file.provenance.source}"
    with Progress(len(points), "export", "block") as bar:
        count = export_points(
            output, points, title=title, progress=bar.update, overwrite=overwrite, inputs=(file.path,)
        )
    line = f"{output}: {counted(count, 'point', ',')} of {counted(len(windows), 'window')}"
    return line, {"what": "points", "points": count, "windows": len(windows)}
