"""``tofmix import``: recordings from other programs' files."""

import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import (
    HDF5_PATH,
    PATH,
    examples,
    json_option,
    only_one_of,
    overwrite_option,
    shares_option,
    view_of,
)
from tofmix.cli.reporter import CommandReporter
from tofmix.errors import BadInputError, UsageError
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.importers.intrinsics import Calibration
    from tofmix.io.importers.writing import Target
    from tofmix.optics.pinhole import Pinhole

MEANINGS = ("frame", "time", "row", "col", "target", "range", "amplitude", "status")
"""Meanings of a column."""


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
    "--sensor",
    metavar="PROFILE|FILE",
    help="The camera: a built-in sensor such as sr3000, or a TOML file with a [sensor] table.  [default: not known]",
)
@click.option(
    "--dataset",
    "--topic",
    "topic",
    metavar="NAME",
    help="Dataset, array, topic, channel or sequence of images with the depths; of a file of one stream its name, if"
    " that says something else.  [default: the only one that fits]",
)
@click.option(
    "--amplitude",
    metavar="NAME|PATH",
    help="Topic or array of the amplitudes; for images, .npy and CSV the path of their source.",
)
@click.option(
    "--modulation-frequency",
    metavar="HZ",
    type=click.FloatRange(0, min_open=True),
    help="The one modulation frequency of a lock-in camera's ranges and amplitudes.  [default: the source's, else the"
    " sensor's]",
)
@shares_option
@click.option(
    "--camera-info", metavar="TOPIC", help="Bags: topic of the intrinsics.  [default: camera_info beside the depths]"
)
@click.option(
    "--depth-axis",
    type=click.Choice(["z", "ray"]),
    help="Direction of the depths: along z, or along each pixel's ray.  [default: z in images and bags, else ray]",
)
@click.option(
    "--intrinsics",
    metavar="FX,FY,CX,CY|FILE",
    help="Pinhole camera, in pixels, or a file with its calibration and distortion: YAML of ROS or OpenCV (extra"
    " tofmix[ros]).",
)
@click.option(
    "--fov",
    metavar="HxV",
    help="Full field of view, degrees, such as 70x55: an ideal pinhole's if depths are along z, else of equal angles.",
)
@click.option(
    "--units", type=click.Choice(["mm", "cm", "m"]), help="Unit of the depths.  [default: the source's, else mm]"
)
@click.option(
    "--scale",
    type=click.FloatRange(0, min_open=True),
    help="Millimetres of one unit of the depths, instead of --units. A scale_factor of the source is applied before.",
)
@click.option(
    "--invalid",
    type=float,
    multiple=True,
    help="Value of invalid samples, in the source's units; repeatable. 0, NaN and infinities are always invalid.",
)
@click.option(
    "--valid-status",
    metavar="NAME=CODES",
    help="Column, dataset or array of status codes beside the ranges, and the codes of valid samples: status=5,9."
    "  [default: codes of the sensor's profile for status]",
)
@click.option(
    "--keep-values",
    is_flag=True,
    help="Keep zeros and fill values, such as 65535 and netCDF's, as ranges. NaN, infinite and negative ones cannot be"
    " kept.",
)
@click.option(
    "--columns",
    metavar="THEIRS=OURS,...",
    help="CSV with a sample a line: meanings of its columns, as in y=row,x=col,depth=range. Ours are frame, time, row,"
    " col, target, range, amplitude, status.",
)
@click.option(
    "--axes",
    metavar="NAMES",
    help="Order of an array's axes: frame,row,col in any order, with target if a pixel returns several."
    "  [default: frame,row,col; .mat by size]",
)
@click.option(
    "--shape", metavar="ROWSxCOLS", help="Image size; needed if the source stores a frame as one line or one axis."
)
@click.option(
    "--target",
    type=click.Choice(["nearest", "strongest"]),
    help="Keep one of several targets of each pixel and frame: the nearest, or the one of the largest amplitude."
    "  [default: keep all]",
)
@click.option(
    "--time-unit",
    type=click.Choice(["s", "ms", "us", "ns"]),
    help="Unit of the times.  [default: the source's, else s]",
)
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
    from tofmix.io.importers.base import SourceRequest, check_axes
    from tofmix.io.recording.range_check import TIME_UNITS_S, UNITS_MM
    from tofmix.io.samples import guessed
    from tofmix.jobs.import_ import ImportRequest, Lens, camera_of, import_file

    for name, value in (("--scale", scale), ("--frame-rate", frame_rate)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name}: {value} is not finite")
    units, scale = only_one_of("unit", units=units, scale=scale)
    intrinsics, fov, camera_info = only_one_of("lens", intrinsics=intrinsics, fov=fov, camera_info=camera_info)
    camera = camera_of(sensor)
    lens = Lens(intrinsics=_intrinsics_of(intrinsics), view_deg=view_of(fov))
    unit_mm = scale if units is None else UNITS_MM[units]
    request = SourceRequest(
        topic=topic,
        amplitude=amplitude,
        camera_info=camera_info,
        axes=None if axes is None else check_axes(axes),
        shape=_shape_of(shape),
        unit_mm=unit_mm,
        lens_given=intrinsics is not None or fov is not None,
        image=None if camera.rows is None or camera.cols is None else (camera.rows, camera.cols),
        columns=columns_of(columns),
        valid_status=status_of(valid_status),
        status_codes=camera.valid_status or (),
        time_unit_s=None if time_unit is None else TIME_UNITS_S[time_unit],
        keep_values=keep_values,
    )
    inputs = [Path(name) for name in (source, sensor, amplitude, intrinsics) if name is not None]
    inputs += [file for folder in inputs if folder.is_dir() for file in folder.iterdir()]
    asked = ImportRequest(
        source=source,
        output=output,
        request=request,
        sensor=sensor,
        camera=camera,
        lens=lens,
        inputs=inputs,
        unit_mm=unit_mm,
        scale=scale,
        modulation_frequency_hz=modulation_frequency,
        shares=shares,
        depth_axis=depth_axis,
        invalid=invalid,
        target=target,
        frame_rate_hz=frame_rate,
        overwrite=overwrite,
    )
    reporter = CommandReporter()
    made = import_file(asked, reporter)
    (rows, cols), imported = made.image, made.imported
    if as_json:
        said = {
            "source": str(source),
            "output": str(output),
            "frames": imported.frames,
            "rows": rows,
            "cols": cols,
            "targets": made.targets,
            "kind": made.kind,
            "unit_mm": made.unit_mm,
            "geometry": made.geometry,
            "not_known": made.unknown,
            "dropped": imported.dropped,
            "notes": made.notes,
        }
        click.echo(json.dumps(said))
        return
    of_targets = f" of {made.targets} targets" if made.targets else f", the {target} target," if target else ""
    click.echo(
        f"{output}: {counted(imported.frames, 'frame', ',')} of {rows} x {cols} pixels{of_targets} from {made.kind},"
        f" {made.unit_mm:g} mm a unit; {made.geometry}"
    )
    if declared := [f"{number:,} {reason}" for reason, number in imported.dropped.items() if not guessed({reason: 1})]:
        click.echo(f"no samples: {', '.join(declared)}")
    if made.unknown:
        click.echo(f"not known: {', '.join(made.unknown)}")


def _shape_of(text: str | None) -> tuple[int, int] | None:
    """Rows and columns, from a text such as 8x8."""
    if text is None:
        return None
    found = re.fullmatch(r"\s*([0-9]{1,5})\s*x\s*([0-9]{1,5})\s*", text)
    shape = (int(found[1]), int(found[2])) if found else (0, 0)
    if min(shape) < 1:
        raise UsageError(f"--shape: {text!r} is not ROWSxCOLS, such as 8x8")
    return shape


def _intrinsics_of(text: str | None) -> "Pinhole | Calibration | None":
    """Intrinsics from a text such as 210,210,88,72, in pixels, or from a calibration file that it names."""
    from tofmix.io.importers.intrinsics import read_calibration
    from tofmix.optics.pinhole import Pinhole

    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    intrinsics = 4  # numbers: FX, FY, CX, CY
    if len(numbers) == intrinsics:
        try:
            return Pinhole(fx=numbers[0], fy=numbers[1], cx=numbers[2], cy=numbers[3])
        except ValueError as error:
            raise BadInputError(f"--intrinsics: {error}") from error
    if numbers or not Path(text).exists():
        raise UsageError(
            f"--intrinsics: {text!r} is not FX,FY,CX,CY in pixels, such as 210,210,88,72, nor a calibration file"
        )
    return read_calibration(Path(text))


def columns_of(text: str | None) -> dict[str, str]:
    """Meanings of columns by their names, lower case, from a text such as ``y=row,x=col,depth=range``."""
    pairs = [part.partition("=") for part in (text or "").split(",") if part.strip()]
    found = {theirs.strip().lower(): ours.strip().lower() for theirs, _, ours in pairs}
    for theirs, ours in found.items():
        if not theirs or ours not in MEANINGS:
            raise UsageError(f"--columns: {text!r}: {theirs}={ours}; the right side is one of {', '.join(MEANINGS)}")
    if text is not None and (not found or len(set(found.values())) < len(pairs)):
        raise UsageError(f"--columns: {text!r} is not THEIRS=OURS,..., each once, such as y=row,x=col,depth=range")
    return found


def status_of(text: str | None) -> tuple[str, tuple[int, ...]] | None:
    """Name of a column of codes, and the valid ones, from a text such as ``status=5,9``."""
    if text is None:
        return None
    name, _, codes = text.rpartition("=")
    try:
        found = tuple(int(code) for code in codes.split(","))
    except ValueError:
        found = ()
    if not name.strip() or not found:
        raise UsageError(f"--valid-status: {text!r} is not NAME=CODE,..., such as status=5,9")
    return name.strip(), found
