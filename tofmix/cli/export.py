"""``tofmix export``: layers in the formats of other programs."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, progress_bar
from tofmix.errors import BadInputError, UsageError
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.layers_file import LayersFile
    from tofmix.points import PointFilter
    from tofmix.projection import Projection

_POINTS_ONLY = {"min_weight": "--min-weight", "min_probability": "--min-probability", "fov": "--fov"}
_IMAGES_ONLY = {"layer": "--layer", "scale": "--scale"}


@examples(
    """
tofmix export boards.layers.h5 -o boards.las
tofmix export boards.layers.h5 -o boards.ply --min-weight 0.1 --min-probability 0.99
tofmix export foreign.layers.h5 -o foreign.csv --fov 47x39
tofmix export boards.layers.h5 -o second.png --layer 2 --scale 0.25
"""
)
@click.command(short_help="Write layers as a point cloud or as range images.")
@click.argument("layers", type=PATH)
@click.option(
    "-o", "--output", type=PATH, required=True,
    help="File to write; its end names the format: .las, .laz, .ply, .pcd, .csv; .png, .tif.",
)  # fmt: skip
@click.option(
    "--window", type=click.IntRange(0), help="One window.  [default: all as points; the only one as an image]"
)
@click.option("--min-weight", type=click.FloatRange(0, 1), help="Points: leave out layers of a lesser share.")
@click.option("--min-probability", type=click.FloatRange(0, 1), help="Points: leave out layers that less surely exist.")
@click.option("--undecided", is_flag=True, help="Write pixels as well in which mixed surfaces cannot be told.")
@click.option(
    "--fov", metavar="HxV", help="Points: field of view in degrees, of equal angles.  [default: the layers file's]"
)
@click.option("--layer", type=click.IntRange(1), default=1, show_default=True, help="Images: which layer, 1 = nearest.")
@click.option(
    "--scale", type=click.FloatRange(0, min_open=True), default=1.0, show_default=True, help="Images: mm of one count."
)
@json_option
@overwrite_option
@click.pass_context
def export(
    context: click.Context,
    /,
    layers: Path,
    output: Path,
    window: int | None,
    min_weight: float | None,
    min_probability: float | None,
    undecided: bool,
    fov: str | None,
    layer: int,
    scale: float,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Write LAYERS, a layers file, for other programs.

    As points: one for each layer, in the sensor's frame in metres (x right, y down, z
    forward), with the layer's number, the pixel's number of layers, share, sigma,
    standard errors, probability, row, column and window. As images: the ranges of one
    layer in 16 bits, 0 where there is none. LAS, LAZ, PNG and TIFF need the extra
    tofmix[export].
    """
    from tofmix.io.exporters import IMAGE_WRITERS, check_suffix
    from tofmix.io.layers_file import open_layers
    from tofmix.io.storage import claimed

    check_suffix(output)
    as_image = output.suffix.lower() in IMAGE_WRITERS
    for name, option in (_POINTS_ONLY if as_image else _IMAGES_ONLY).items():
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise UsageError(f"{option} does not belong to {output.suffix}")
    with open_layers(layers) as file, claimed(output, overwrite=overwrite, inputs=(layers,)):
        if window is not None and window >= file.shape[0]:
            raise UsageError(f"--window {window}: {layers} has windows 0 to {file.shape[0] - 1}")
        if as_image:
            line, made = _export_image(file, output, window, layer, scale, overwrite, undecided=undecided)
        else:
            from tofmix.points import PointFilter

            chosen = PointFilter(min_weight=min_weight, min_probability=min_probability, undecided=undecided)
            line, made = _export_points(file, output, window, fov, chosen, overwrite)
    click.echo(json.dumps({"output": str(output), **made}) if as_json else line)


def _export_points(
    file: "LayersFile", output: Path, window: int | None, fov: str | None, chosen: "PointFilter", overwrite: bool
) -> tuple[str, dict[str, Any]]:
    from tofmix.io.exporters import export_points
    from tofmix.points import LayerPoints

    windows = range(file.shape[0]) if window is None else [window]
    try:
        points = LayerPoints(file, optics=_optics(file, fov), windows=windows, chosen=chosen)
    except ValueError as error:
        raise (UsageError if fov else BadInputError)(f"{'--fov' if fov else file.path}: {error}") from error
    title = f"layers of {file.provenance.source}"
    with progress_bar(len(windows), "export", "window") as bar:
        count = export_points(
            output, points, title=title, progress=bar.update, overwrite=overwrite, inputs=(file.path,)
        )
    if count == 0:
        click.echo(f"tofmix: {output}: no layer passed, so there is no point in it", err=True)
    line = f"{output}: {counted(count, 'point', ',')} of {counted(len(windows), 'window')}"
    return line, {"points": count, "windows": len(windows)}


def _optics(file: "LayersFile", fov: str | None) -> "Projection":
    """Where the pixels look: --fov, with equal angles, or as the layers file says."""
    from tofmix.cli.import_camera import view_of
    from tofmix.equiangular import Equiangular

    view = view_of(fov)
    if view is not None:
        return Equiangular(fov_horizontal_deg=view[0], fov_vertical_deg=view[1])
    optics = file.provenance.sensor.optics
    if optics is None:
        raise BadInputError(
            f"{file.path}: sensor: no field of view, so points cannot be placed; give it with --fov HxV"
        )
    return optics


def _export_image(
    file: "LayersFile", output: Path, window: int | None, layer: int, scale: float, overwrite: bool, *, undecided: bool
) -> tuple[str, dict[str, Any]]:
    import numpy as np

    from tofmix.flags import Mixing
    from tofmix.io.exporters import export_image
    from tofmix.io.exporters.image import RangeImage

    if window is None and file.shape[0] > 1:
        raise UsageError(f"{file.path} has {file.shape[0]} windows; choose the image's with --window")
    if layer > file.max_layers:
        raise UsageError(f"--layer {layer}: {file.path} has layers 1 to {file.max_layers}")
    chosen = window or 0
    range_mm = file.read_field("range", chosen)[..., layer - 1]
    if "mixing" in file.names and not undecided:
        range_mm = np.where(file.read_field("mixing", chosen) == int(Mixing.UNDECIDED), np.float32(np.nan), range_mm)
    title = f"layer {layer} of {file.provenance.source}, window {chosen}"
    image = RangeImage(range_mm=range_mm, scale_mm=scale, title=title)
    try:
        export_image(output, image, overwrite=overwrite, inputs=(file.path,))
    except BadInputError as error:
        raise BadInputError(f"{file.path}: {error}") from error
    filled = int((image.counts() > 0).sum())
    line = f"{output}: {counted(filled, 'pixel', ',')} with a layer {layer}, {scale:g} mm a count, 0 = none"
    return line, {"pixels": filled, "window": chosen, "layer": layer, "scale_mm": scale}
