"""``tofmix import``: recordings from other programs' files."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import (
    HDF5_PATH,
    PATH,
    examples,
    json_option,
    note,
    only_one_of,
    overwrite_option,
    shares_option,
)
from tofmix.cli.progress import Progress
from tofmix.errors import BadInputError, UsageError
from tofmix.wording import readable

if TYPE_CHECKING:
    from tofmix.io.importers.base import FrameSource, Request
    from tofmix.io.importers.writing import Imported, Target
    from tofmix.sensor import Sensor
    from tofmix.sensors.sheet import CameraSheet

MOSTLY = 0.5
"""Share of samples outside the working range that is reported."""


@examples(
    """
tofmix import bag.mcap -o bag.h5
tofmix import zones.csv -o zones.h5 --shape 8x8 --units mm --sensor vl53l5cx
tofmix import depth.npy -o depth.h5 --units m
tofmix import frames/ -o frames.h5 --fov 70x55 --frame-rate 25 --scale 0.25
tofmix import other.h5 -o rec.h5 --dataset entry/data --invalid 65535
tofmix import depth.tif -o depth.h5 --intrinsics 210,210,88,72
tofmix import frames/ -o frames.h5 --intrinsics head_camera.yaml --frame-rate 30
tofmix import samples.mat -o samples.h5 --sensor sr3000 --dataset r --axes row,col,frame
tofmix import log.csv -o log.h5 --columns y=row,x=col,depth=range --valid-status status=5,9
tofmix import ranges.npy -o lock_in.h5 --amplitude amplitudes.npy --modulation-frequency 30e6
tofmix import targets.npy -o targets.h5 --axes frame,row,col,target
tofmix import targets.h5 -o nearest.h5 --target nearest
"""
)
@click.command("import", short_help="Make a recording of a bag, images, arrays, HDF5 or CSV.")
@click.argument("source", type=PATH)
@click.option("-o", "--output", type=HDF5_PATH, required=True, help="Recording to write.")
@click.option(
    "--sensor", metavar="PROFILE|FILE",
    help="The camera: a built-in sensor such as sr3000, or a TOML file with a [sensor] table.  [default: not known]",
)  # fmt: skip
@click.option(
    "--dataset", "--topic", "topic", metavar="NAME",
    help="Dataset, array, topic, channel or sequence of images with the depths; of a file of one stream its name, if"
    " that says something else.  [default: the only one that fits]",
)  # fmt: skip
@click.option(
    "--amplitude", metavar="NAME|PATH",
    help="Topic or array of the amplitudes; for images, .npy and CSV the path of their source.",
)  # fmt: skip
@click.option(
    "--modulation-frequency", metavar="HZ", type=click.FloatRange(0, min_open=True),
    help="The one modulation frequency of a lock-in camera's ranges and amplitudes.  [default: the source's, else the"
    " sensor's]",
)  # fmt: skip
@shares_option
@click.option(
    "--camera-info", metavar="TOPIC", help="Bags: topic of the intrinsics.  [default: camera_info beside the depths]"
)
@click.option(
    "--depth-axis", type=click.Choice(["z", "ray"]),
    help="Direction of the depths: along z, or along each pixel's ray.  [default: z in images and bags, else ray]",
)  # fmt: skip
@click.option(
    "--intrinsics", metavar="FX,FY,CX,CY|FILE",
    help="Pinhole camera, in pixels, or a file with its calibration and distortion: YAML of ROS or OpenCV (extra"
    " tofmix[ros]).",
)  # fmt: skip
@click.option(
    "--fov", metavar="HxV",
    help="Full field of view, degrees, such as 70x55: an ideal pinhole's if depths are along z, else of equal angles.",
)  # fmt: skip
@click.option(
    "--units", type=click.Choice(["mm", "cm", "m"]), help="Unit of the depths.  [default: the source's, else mm]"
)
@click.option(
    "--scale", type=click.FloatRange(0, min_open=True),
    help="Millimetres of one unit of the depths, instead of --units. A scale_factor of the source is applied before.",
)  # fmt: skip
@click.option(
    "--invalid", type=float, multiple=True,
    help="Value of invalid samples, in the source's units; repeatable. 0, NaN and infinities are always invalid.",
)  # fmt: skip
@click.option(
    "--valid-status", metavar="NAME=CODES",
    help="Column, dataset or array of status codes beside the ranges, and the codes of valid samples: status=5,9."
    "  [default: codes of the sensor's profile for status]",
)  # fmt: skip
@click.option(
    "--keep-values", is_flag=True,
    help="Keep zeros and fill values, such as 65535 and netCDF's, as ranges. NaN, infinite and negative ones cannot be"
    " kept.",
)  # fmt: skip
@click.option(
    "--columns", metavar="THEIRS=OURS,...",
    help="CSV with a sample a line: meanings of its columns, as in y=row,x=col,depth=range. Ours are frame, time, row,"
    " col, target, range, amplitude, status.",
)  # fmt: skip
@click.option(
    "--axes", metavar="NAMES",
    help="Order of an array's axes: frame,row,col in any order, with target if a pixel returns several."
    "  [default: frame,row,col; .mat by size]",
)  # fmt: skip
@click.option(
    "--shape", metavar="ROWSxCOLS", help="Image size; needed if the source stores a frame as one line or one axis."
)
@click.option(
    "--target", type=click.Choice(["nearest", "strongest"]),
    help="Keep one of several targets of each pixel and frame: the nearest, or the one of the largest amplitude."
    "  [default: keep all]",
)  # fmt: skip
@click.option(
    "--time-unit", type=click.Choice(["s", "ms", "us", "ns"]),
    help="Unit of the times.  [default: the source's, else s]",
)  # fmt: skip
@click.option(
    "--frame-rate", type=click.FloatRange(0, min_open=True), help="Frames per second, for a source without times."
)
@json_option
@overwrite_option
def import_(
    source: Path,
    output: Path,
    sensor: str | None,
    topic: str | None,
    amplitude: str | None,
    modulation_frequency: float | None,
    shares: str | None,
    camera_info: str | None,
    depth_axis: str | None,
    intrinsics: str | None,
    fov: str | None,
    units: str | None,
    scale: float | None,
    invalid: tuple[float, ...],
    valid_status: str | None,
    keep_values: bool,
    columns: str | None,
    axes: str | None,
    shape: str | None,
    target: "Target | None",
    time_unit: str | None,
    frame_rate: float | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Write SOURCE as a recording that tofmix estimate reads.

    SOURCE is a ROS 1 bag, a ROS 2 bag, an MCAP file (extra tofmix[ros]); a folder of 16-bit PNG or TIFF images, a
    multi-page TIFF (extra tofmix[images]); an .npy, .npz or .mat; any HDF5 file; CSV, a frame a line (--shape) or a
    sample a line (a header with frame,row,col,range, optionally target, amplitude, time). Depths of images and bags are
    along z. They become ranges along each pixel's beam by the intrinsics of the bag or of --intrinsics, by --fov, or by
    the sensor's field of view. Other sources hold ranges along the beam. Properties missing from SOURCE and --sensor
    stay unknown; the command lists them. Frames are read and written in blocks.
    """
    from tofmix.cli.import_camera import (
        Lens,
        camera_of,
        geometry_of,
        intrinsics_of,
        not_known,
        sensor_of,
        shape_of,
        view_of,
        with_frequency,
        with_share_law,
    )
    from tofmix.cli.import_columns import columns_of, status_of
    from tofmix.io.atomic.storage import locked
    from tofmix.io.importers import open_source
    from tofmix.io.importers.axes import check_axes
    from tofmix.io.importers.base import Request
    from tofmix.io.importers.conversion import Conversion
    from tofmix.io.importers.units import TIME_UNITS_S
    from tofmix.io.importers.writing import write_recording
    from tofmix.io.length_units import UNITS_MM
    from tofmix.io.samples import guessed
    from tofmix.io.sensor_group import check_maps

    for name, value in (("--scale", scale), ("--frame-rate", frame_rate)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name}: {value} is not finite")
    units, scale = only_one_of("unit", units=units, scale=scale)
    intrinsics, fov, camera_info = only_one_of("lens", intrinsics=intrinsics, fov=fov, camera_info=camera_info)
    camera = camera_of(sensor)
    lens = Lens(intrinsics=intrinsics_of(intrinsics), view_deg=view_of(fov))
    unit_mm = scale if units is None else UNITS_MM[units]
    request = Request(
        topic=topic, amplitude=amplitude, camera_info=camera_info, axes=None if axes is None else check_axes(axes),
        shape=shape_of(shape), unit_mm=unit_mm, lens_given=intrinsics is not None or fov is not None,
        image=None if camera.rows is None or camera.cols is None else (camera.rows, camera.cols),
        columns=columns_of(columns), valid_status=status_of(valid_status), status_codes=camera.valid_status or (),
        time_unit_s=None if time_unit is None else TIME_UNITS_S[time_unit], keep_values=keep_values,
    )  # fmt: skip
    inputs = [Path(name) for name in (source, sensor, amplitude, intrinsics) if name is not None]
    inputs += [file for folder in inputs if folder.is_dir() for file in folder.iterdir()]
    with locked(output, overwrite=overwrite, inputs=tuple(inputs)), open_source(source, request) as frames:
        targets = _targets_kept(target, frames, source)
        known = frames.sensor if sensor is None and frames.sensor is not None else sensor_of(camera, frames.shape[1:])
        known = with_share_law(with_frequency(known, modulation_frequency), shares)
        check_maps(known, frames.shape[1:], source if sensor is None else Path(sensor))
        if frames.unit_unknown and unit_mm is None:
            raise BadInputError(f"{source}: {frames.unit_unknown}; give --scale, mm of one count, or --units")
        _refuse_turned(frames.shape[1:], camera, request, source)
        geometry = geometry_of(frames, known, lens, depth_axis, source)
        used_mm = unit_mm or frames.unit_mm or 1.0
        conversion = Conversion(
            dtype=frames.dtype, unit_mm=used_mm * frames.scale_factor, offset_mm=used_mm * frames.add_offset,
            invalid=(*frames.invalid, *invalid), valid_span=frames.valid_span, status_valid=frames.status_valid,
            ray_over_depth=geometry.factor, unit_known=unit_mm is not None or frames.unit_mm is not None,
            keep_values=keep_values,
        )  # fmt: skip
        attributes: dict[str, str | int | float] = {
            "source": readable(source.name), "source_kind": frames.kind, "unit_mm": conversion.unit_mm,
            "geometry": geometry.text,
        }  # fmt: skip
        with Progress(frames.shape[0], "import", "frame") as bar:
            imported = write_recording(
                frames, output, what=source, sensor=geometry.sensor, conversion=conversion,
                again=lambda: open_source(source, request), target=target, frame_rate_hz=frame_rate,
                attributes=attributes, progress=bar.update, overwrite=overwrite,
                inputs=tuple(inputs),
            )  # fmt: skip
        how = [
            *frames.notes,
            *imported.remarks,
            *_scaled(scale, frames, source),
            *_unused_rate(frames, frame_rate, source),
        ]
        doubts = [*geometry.notes, *_doubts(frames, imported, camera, geometry.sensor, source, used_mm)]
    _say(how, doubts)
    _, rows, cols = frames.shape
    unknown = not_known(
        geometry.sensor, has_optics=geometry.sensor.optics is not None, has_amplitude=frames.has_amplitude,
        targets=targets,
        has_time=frames.has_time or frame_rate is not None or imported.frames == 1,
    )  # fmt: skip
    if as_json:
        made = {
            "source": str(source), "output": str(output), "frames": imported.frames, "rows": rows, "cols": cols,
            "targets": targets, "kind": frames.kind, "unit_mm": conversion.unit_mm, "geometry": geometry.text,
            "not_known": unknown, "dropped": imported.dropped,
            "notes": [*how, *doubts],
        }  # fmt: skip
        click.echo(json.dumps(made))
        return
    click.echo(
        f"{output}: {imported.frames:,} frame{'s' * (imported.frames != 1)} of {rows} x {cols} pixels"
        f"{f' of {targets} targets' if targets else f', the {target} target,' if target else ''} from"
        f" {frames.kind}, {conversion.unit_mm:g} mm a unit; {geometry.text}"
    )
    if declared := [f"{number:,} {reason}" for reason, number in imported.dropped.items() if not guessed({reason: 1})]:
        click.echo(f"no samples: {', '.join(declared)}")
    if unknown:
        click.echo(f"not known: {', '.join(unknown)}")


def _say(how: list[str], doubts: list[str]) -> None:
    """Print lines on how the source was read, which --quiet suppresses, and doubts about it, which it does not."""
    for line in how:
        note(line)
    for line in doubts:
        click.echo(f"tofmix: {line}", err=True)


def _scaled(scale: float | None, frames: "FrameSource", source: Path) -> list[str]:
    """Note on a --scale that is multiplied by a factor of the source."""
    if scale is None or frames.scale_factor == 1.0:
        return []
    factor = frames.scale_factor
    product = f"--scale {scale:g} times the source's scale_factor {factor:g}"
    return [f"{source}: one stored number is {scale * factor:g} mm: {product}"]


def _unused_rate(frames: "FrameSource", frame_rate: float | None, source: Path) -> list[str]:
    """Note on ``--frame-rate`` of a source that has times."""
    unused = frame_rate is not None and frames.has_time
    return [f"{source}: --frame-rate is not used: the frames have times"] if unused else []


def _targets_kept(target: "Target | None", frames: "FrameSource", source: Path) -> int:
    """Targets of a pixel and frame in the new recording; 0 without such an axis.

    Refuses ``--target`` where pixels return one sample, and the strongest one without amplitudes.
    """
    if target is not None and not frames.targets:
        raise UsageError(f"--target {target}: {source} has one sample for each pixel and frame; leave the option out")
    if target == "strongest" and not frames.has_amplitude:
        raise BadInputError(
            f"{source}: amplitude: there is none, so the strongest target is not known: give --amplitude, or use"
            " --target nearest"
        )
    return frames.targets if target is None else 0


def _refuse_turned(shape: tuple[int, int], camera: "CameraSheet", request: "Request", source: Path) -> None:
    """Refuse an array whose rows and columns are those of the camera, swapped; images of a turned camera are read."""
    from tofmix.io.importers import takes_axes

    if request.axes is None and takes_axes(source) and shape[0] != shape[1] and shape == (camera.cols, camera.rows):
        raise BadInputError(
            f"{source}: images of {shape[0]} x {shape[1]} pixels, {camera.name} has {camera.rows} x {camera.cols}: rows"
            " and columns are swapped; give their order: --axes frame,col,row"
        )


def _doubts(
    frames: "FrameSource",
    imported: "Imported",
    camera: "CameraSheet",
    sensor: "Sensor",
    source: Path,
    unit_mm: float,
) -> list[str]:
    """Doubts about a source, each a line for the user."""
    from tofmix.io.recording.range_check import implausible
    from tofmix.io.samples import guessed

    notes = []
    _, rows, cols = frames.shape
    if camera.rows is not None and camera.cols is not None and (rows, cols) != (camera.rows, camera.cols):
        view = "field of view is used" if camera.projection is None else "projection is not used"
        notes.append(
            f"{source}: {rows} x {cols} pixels, {camera.name} has {camera.rows} x {camera.cols};"
            f" its {view} for this image"
        )
    doubt = "" if imported.median_mm is None else implausible(imported.median_mm, sensor, unit_mm=unit_mm, path=source)
    if dropped := guessed(imported.dropped):
        notes.append(f"{source}: no samples: {dropped} (--keep-values keeps fill values)")
    if imported.valid == 0:
        notes.append(f"{source}: no valid sample; check --invalid and --units")
    elif doubt:
        notes.append(f"{source}: {doubt}")
    elif imported.outside / imported.valid > MOSTLY:
        limits = sensor.range_min_mm or 0.0, math.inf if sensor.range_max_mm is None else sensor.range_max_mm
        notes.append(
            f"{source}: {100 * imported.outside / imported.valid:.0f} % of the samples lie outside the sensor's"
            f" {limits[0]:g} to {limits[1]:g} mm; check --units"
        )
    if imported.without_amplitude:
        few = "frame" if imported.without_amplitude == 1 else "frames"
        notes.append(f"{source}: {imported.without_amplitude} {few} without an amplitude image of the same time stamp")
    return notes
