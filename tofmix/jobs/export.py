"""Export layers and surfaces to the formats of other programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tofmix.errors import BadInputError
from tofmix.flags import Mixing
from tofmix.io import exporters
from tofmix.io.exporters.edge_lines import edge_lines
from tofmix.io.exporters.image import RangeImage
from tofmix.io.exporters.outlines import outlines
from tofmix.io.exporters.placing import FinePoints
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.storage import locked
from tofmix.io.surfaces_file import SurfacesFile, open_surfaces
from tofmix.jobs.files import check_window, placed_words, sensor_of_view
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.layers import SUSPECT
from tofmix.points import LayerPoints, PointFilter, PointSource, fields_of_names
from tofmix.wording import counted, left_out_words

_WITH_INTENSITY = (".ply", ".pcd")

Made = tuple[str, dict[str, Any]]
"""What was written, as a line and for JSON."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportRequest:
    """The options of an export."""

    file: Path
    output: Path
    what: str  # edges, points, image or planes
    window: int | None  # all without it
    chosen: PointFilter
    fields: Sequence[str]  # further datasets of points
    view_deg: tuple[float, float] | None
    projection: str
    layer: int
    scale_mm: float
    overwrite: bool


def export_file(asked: ExportRequest, reporter: Reporter, *, of_surfaces: bool) -> Made:
    """Write a layers file, or a surfaces file, for another program."""
    with locked(asked.output, overwrite=asked.overwrite, inputs=(asked.file,)):
        if of_surfaces:
            with open_surfaces(asked.file) as surfaces:
                _check_windows(surfaces, asked, reporter)
                return _export_surfaces(surfaces, asked, reporter)
        with open_layers(asked.file) as layers:
            _check_windows(layers, asked, reporter)
            export = _export_image if asked.what == exporters.IMAGE else _export_points
            return export(layers, asked, reporter)


def _check_windows(file: LayersFile | SurfacesFile, asked: ExportRequest, reporter: Reporter) -> None:
    check_window(file, asked.window, reporter)
    if asked.what == exporters.IMAGE and asked.window is None and file.shape[0] > 1:
        raise OptionError(f"{file.path} has {file.shape[0]} windows; choose one with {reporter.option('window')}")


def _windows(file: LayersFile | SurfacesFile, asked: ExportRequest) -> Sequence[int]:
    return range(file.shape[0]) if asked.window is None else [asked.window]


def _export_points(file: LayersFile, asked: ExportRequest, reporter: Reporter) -> Made:
    windows, output, view = _windows(file, asked), asked.output, asked.view_deg
    try:
        further = fields_of_names(asked.fields, file.names)
    except ValueError as error:
        raise OptionError(f"{reporter.option('fields')} {','.join(asked.fields)}: {file.path}: {error}") from error
    try:
        sensor = sensor_of_view(file, view, asked.projection, reporter)
        if sensor.optics is None:
            raise BadInputError(
                f"{file.path}: sensor: no field of view, so points cannot be placed; give it with --fov HxV"
            )
        points = LayerPoints(
            file,
            optics=sensor.optics,
            windows=windows,
            chosen=asked.chosen,
            further=further,
            intensity=output.suffix.lower() in _WITH_INTENSITY,
        )
    except ValueError as error:
        raise (OptionError if view else BadInputError)(f"{'--fov' if view else file.path}: {error}") from error
    count = _write_points(points, len(windows), f"layers of {file.provenance.source}", "window", asked, reporter)
    if count == 0:
        reporter.warn(f"{output}: no layer passed the filters, so the file has no point")
    left_out = 0 if asked.chosen.suspect else sum(file.suspects(number) for number in windows)
    line = f"{output}: {counted(count, 'point', ',')} of {counted(len(windows), 'window')}{left_out_words(left_out)}"
    line += placed_words(sensor, view, file.shape[1:]).replace("; ", "; placed by ", 1)
    made: dict[str, Any] = {"points": count, "windows": len(windows)}
    made |= {"suspect_left_out": left_out} if left_out else {}
    return line, made | ({"fields": [spec.name for spec in points.fields]} if further else {})


def _write_points(
    points: PointSource, steps: int, title: str, unit: str, asked: ExportRequest, reporter: Reporter
) -> int:
    with reporter.steps(steps, "export", unit):
        return exporters.export_points(
            asked.output,
            points,
            title=title,
            progress=reporter.progress,
            overwrite=asked.overwrite,
            inputs=(asked.file,),
        )


def _export_image(file: LayersFile, asked: ExportRequest, reporter: Reporter) -> Made:
    window, layer, scale = asked.window or 0, asked.layer, asked.scale_mm
    if layer > file.max_layers:
        raise OptionError(f"{reporter.option('layer')} {layer}: {file.path} has layers 1 to {file.max_layers}")
    range_mm = file.read_field("range", window)[..., layer - 1]
    if "mixing" in file.names and not asked.chosen.undecided:
        range_mm = np.where(file.read_field("mixing", window) == int(Mixing.UNDECIDED), np.float32(np.nan), range_mm)
    left_out = 0
    if SUSPECT.name in file.names and not asked.chosen.suspect:
        marked = file.read_field(SUSPECT.name, window)[..., layer - 1] > 0
        left_out = int(np.count_nonzero(marked))
        range_mm = np.where(marked, np.float32(np.nan), range_mm)
    title = f"layer {layer} of {file.provenance.source}, window {window}"
    filled = _write_image(RangeImage(range_mm=range_mm, scale_mm=scale, title=title), asked)
    line = f"{asked.output}: {counted(filled, 'pixel', ',')} with a layer {layer}, {scale:g} mm a count, 0 = none"
    made = {"pixels": filled, "window": window, "layer": layer, "scale_mm": scale}
    return line + left_out_words(left_out), made | ({"suspect_left_out": left_out} if left_out else {})


def _write_image(image: RangeImage, asked: ExportRequest) -> int:
    """Write an image; return how many places of it have a range."""
    try:
        exporters.export_image(asked.output, image, overwrite=asked.overwrite, inputs=(asked.file,))
    except BadInputError as error:
        raise BadInputError(f"{asked.file}: {error}") from error
    return int((image.counts() > 0).sum())


def _export_surfaces(file: SurfacesFile, asked: ExportRequest, reporter: Reporter) -> Made:
    windows, output, what = _windows(file, asked), asked.output, asked.what
    if what == exporters.IMAGE:
        return _export_fine_image(file, asked, windows[0])
    if what == exporters.POINTS:
        return _export_fine_points(file, asked, windows, reporter)
    title = f"{what} of {file.provenance.source}"
    if what == exporters.EDGES:
        lines = edge_lines(file, windows)
        exporters.export_edges(output, lines, title=title, overwrite=asked.overwrite, inputs=(file.path,))
        count = len({line.line for line in lines})
        shared = len(lines) - count  # pieces of a line have one point in common
        made = {"lines": count, "points": sum(len(line.row) for line in lines) - shared}
        text = f"{counted(made['lines'], 'edge line', ',')} of {counted(made['points'], 'point', ',')}"
    else:
        found = outlines(file, windows)
        exporters.export_planes(output, file, found, title=title, overwrite=asked.overwrite)
        made = {"surfaces": len(found), "polygons": sum(len(outline.polygons) for outline in found)}
        text = f"{counted(made['surfaces'], 'surface', ',')} with {counted(made['polygons'], 'polygon', ',')}"
        left_out = int((file.planes.is_smooth & np.isin(file.surface_window, list(windows))).sum())
        if left_out:
            text += f"; {counted(left_out, 'smooth surface', ',')} left out: no plane"
    if not any(made.values()):
        reporter.warn(f"{output}: {file.path} has no surface there, so the file is empty")
    if what == exporters.PLANES:
        made["smooth_left_out"] = left_out
    return f"{output}: {text}", {"what": what, **made, "windows": len(windows)}


def _export_fine_image(file: SurfacesFile, asked: ExportRequest, window: int) -> Made:
    range_mm, scale = file.read_image("range_fine", window), asked.scale_mm
    title = f"fine range image of {file.provenance.source}, window {window}, {file.factor} x {file.factor} a pixel"
    filled = _write_image(RangeImage(range_mm=range_mm, scale_mm=scale, title=title, none="no return"), asked)
    rows, cols = range_mm.shape
    line = f"{asked.output}: range image {rows} x {cols}, {filled:,} with a range, {scale:g} mm a count, 0 = none"
    return line, {"what": "image", "rows": rows, "cols": cols, "filled": filled, "window": window, "scale_mm": scale}


def _export_fine_points(file: SurfacesFile, asked: ExportRequest, windows: Sequence[int], reporter: Reporter) -> Made:
    points = FinePoints(file, windows)
    title = f"fine range image of {file.provenance.source}"
    count = _write_points(points, len(points), title, "block", asked, reporter)
    line = f"{asked.output}: {counted(count, 'point', ',')} of {counted(len(windows), 'window')}"
    return line, {"what": "points", "points": count, "windows": len(windows)}
