"""``tofmix import``: recordings from other programs' files."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import PATH, examples, overwrite_option, progress_bar
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.arrays import FloatArray
    from tofmix.io.importers.base import Axes, FrameSource, Pinhole
    from tofmix.io.importers.writing import Imported
    from tofmix.sensors.profile import SensorProfile

MOSTLY = 0.5
"""Share of samples outside the working range that is worth a word."""

_AXES = ("frame,row,col", "row,col,frame")
_INTRINSICS = 4


@examples(
    """
tofmix import bag.mcap -o bag.h5 --sensor sr3000
tofmix import run.bag -o run.h5 --sensor camera.toml --topic /depth/image --amplitude /ir/image
tofmix import frames/ -o frames.h5 --sensor sr3000 --frame-rate 25 --scale 0.25
tofmix import depth.tif -o depth.h5 --sensor sr3000 --depth-axis z --intrinsics 210,210,88,72
tofmix import samples.mat -o samples.h5 --sensor sr3000 --topic r --axes row,col,frame
"""
)
@click.command("import", short_help="Make a recording of a ROS bag, images or arrays.")
@click.argument("source", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Recording to write.")
@click.option(
    "--sensor", required=True, metavar="PROFILE|FILE",
    help="The camera: a built-in sensor such as sr3000, or a TOML file with a [sensor] table.",
)  # fmt: skip
@click.option(
    "--topic", metavar="NAME", help="Bags, .npz, .mat: topic or array of the depths.  [default: the only one that fits]"
)
@click.option(
    "--amplitude", metavar="NAME|PATH",
    help="Topic or array of the amplitudes; for images and .npy the path of such a source.",
)  # fmt: skip
@click.option(
    "--camera-info", metavar="TOPIC", help="Bags: topic of the intrinsics.  [default: camera_info beside the depths]"
)
@click.option(
    "--depth-axis", type=click.Choice(["z", "ray"]),
    help="What depths are measured along.  [default: z in bags, else ray]",
)  # fmt: skip
@click.option("--intrinsics", metavar="FX,FY,CX,CY", help="Pinhole camera of depths along z, in pixels.")
@click.option(
    "--scale", type=click.FloatRange(0, min_open=True),
    help="mm of one unit.  [default: 1; 1000 in bags with 32FC1]",
)  # fmt: skip
@click.option(
    "--invalid", type=float, multiple=True,
    help="Value that is no sample, in the source's units; may be repeated. 0, NaN and infinities never are.",
)  # fmt: skip
@click.option(
    "--axes", type=click.Choice(_AXES), help="Order of an array's axes.  [default: frame first; .mat by size]"
)
@click.option("--frame-rate", type=click.FloatRange(0, min_open=True), help="Frames a second, where no time is stored.")
@overwrite_option
def import_(
    source: Path,
    output: Path,
    sensor: str,
    topic: str | None,
    amplitude: str | None,
    camera_info: str | None,
    depth_axis: str | None,
    intrinsics: str | None,
    scale: float | None,
    invalid: tuple[float, ...],
    axes: "Axes | None",
    frame_rate: float | None,
    overwrite: bool,
) -> None:
    """Write SOURCE as a recording that tofmix estimate reads.

    SOURCE is a ROS 1 bag, a ROS 2 bag, an MCAP file (extra tofmix[ros]); a folder of
    16-bit PNG or TIFF images, a multi-page TIFF (extra tofmix[images]); an .npy, .npz
    or .mat. Depths along z become ranges along each pixel's beam, by the intrinsics of
    the bag or of --intrinsics (a pinhole), else by the sensor's field of view (equal
    angles between pixels). Frames are read and written in blocks.
    """
    from tofmix.io.importers import open_source
    from tofmix.io.importers.base import Request
    from tofmix.io.importers.conversion import Conversion
    from tofmix.io.importers.writing import write_recording
    from tofmix.io.storage import claimed

    for name, value in (("--scale", scale), ("--frame-rate", frame_rate)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name}: {value} is not finite")
    camera = _camera(sensor)
    given = None if intrinsics is None else _pinhole(intrinsics)
    request = Request(
        topic=topic, amplitude=amplitude, camera_info=camera_info, axes=axes,
        image=(camera.rows, camera.cols),
    )  # fmt: skip
    inputs = [Path(name) for name in (source, sensor, amplitude) if name is not None]
    inputs += [file for folder in inputs if folder.is_dir() for file in folder.iterdir()]
    with claimed(output, overwrite=overwrite, inputs=tuple(inputs)), open_source(source, request) as frames:
        over_depth, geometry = _geometry(frames, camera, depth_axis or frames.depth_axis, given, source)
        conversion = Conversion(
            dtype=frames.dtype, unit_mm=scale or frames.unit_mm, invalid=invalid, ray_over_depth=over_depth
        )
        attributes: dict[str, str | int | float] = {
            "source": source.name, "source_kind": frames.kind, "unit_mm": conversion.unit_mm, "geometry": geometry
        }  # fmt: skip
        with progress_bar(frames.shape[0], "import", "frame") as bar:
            imported = write_recording(
                frames, output, what=source, sensor=camera.sensor(), conversion=conversion, frame_rate_hz=frame_rate,
                attributes=attributes, progress=bar.update, overwrite=overwrite,
                inputs=tuple(inputs),
            )  # fmt: skip
        _say(frames, imported, camera, source)
    _, rows, cols = frames.shape
    click.echo(
        f"{output}: {imported.frames:,} frame{'s' * (imported.frames != 1)} of {rows} x {cols} pixels from"
        f" {frames.kind}, {conversion.unit_mm:g} mm a unit; {geometry}"
    )


def _camera(name: str) -> "SensorProfile":
    from tofmix.io.storage import read_text
    from tofmix.sensors import PROFILES, load_profile
    from tofmix.sensors.profile_toml import parse_profile
    from tofmix.sensors.sensor_file import parse_sensor
    from tofmix.toml_table import parse_toml

    if name in PROFILES and not Path(name).is_file():
        return load_profile(name)
    if not Path(name).exists():
        raise BadInputError(f"--sensor: {name}: no such file, and not a built-in sensor ({', '.join(PROFILES)})")
    text = read_text(Path(name))
    return (parse_profile if "about" in parse_toml(text, source=name) else parse_sensor)(text, source=name)


def _pinhole(text: str) -> "Pinhole":
    from tofmix.io.importers.base import Pinhole

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != _INTRINSICS:
        raise UsageError(f"--intrinsics: {text!r} is not FX,FY,CX,CY in pixels, such as 210,210,88,72")
    return Pinhole(focal_px=(numbers[0], numbers[1]), centre_px=(numbers[2], numbers[3]))


def _geometry(
    frames: "FrameSource", camera: "SensorProfile", axis: str, given: "Pinhole | None", source: Path
) -> tuple["FloatArray | None", str]:
    """Range over depth of each pixel, and what to say of it."""
    from tofmix.geometry import beam_directions, largest_angle_deg, pinhole_directions, ray_over_depth

    _, rows, cols = frames.shape
    if axis == "ray":
        if given is not None:
            raise UsageError("--intrinsics goes with depths along z (--depth-axis z)")
        return None, "depths along the beam, taken as ranges"
    view = camera.fov_horizontal_deg, camera.fov_vertical_deg
    pinhole = given or frames.pinhole
    try:
        grid = beam_directions(rows, cols, fov_horizontal_deg=view[0], fov_vertical_deg=view[1])
        if pinhole is None:
            text = f"field of view {view[0]:g} x {view[1]:g} degrees, equal angles"
            return ray_over_depth(grid), f"depths along z made ranges by {text}"
        beams = pinhole_directions(rows, cols, focal_px=pinhole.focal_px, centre_px=pinhole.centre_px)
        factor = ray_over_depth(beams)
    except ValueError as error:
        where = "--intrinsics" if given is not None else str(source)
        raise BadInputError(f"{where}: {error}") from error
    angle = largest_angle_deg(grid, beams)
    if angle > min(view[0] / cols, view[1] / rows):
        click.echo(
            f"tofmix: {source}: the pinhole's pixels look up to {angle:.1f} degrees beside the recording's, which have"
            f" equal angles over {view[0]:g} x {view[1]:g} degrees; ranges are right, exported points are off by that",
            err=True,
        )
    (fx, fy), (cx, cy) = pinhole.focal_px, pinhole.centre_px
    return factor, f"depths along z made ranges by pinhole fx {fx:g} fy {fy:g} cx {cx:g} cy {cy:g}"


def _say(frames: "FrameSource", imported: "Imported", camera: "SensorProfile", source: Path) -> None:
    """Say on stderr what the user should know of a source."""
    notes = list(frames.notes)
    _, rows, cols = frames.shape
    if (rows, cols) != (camera.rows, camera.cols):
        notes.append(
            f"{source}: {rows} x {cols} pixels, {camera.name} has {camera.rows} x {camera.cols};"
            " its field of view is taken for the image's"
        )
    if imported.valid == 0:
        notes.append(f"{source}: no valid sample; check --invalid and --scale")
    elif imported.outside / imported.valid > MOSTLY:
        notes.append(
            f"{source}: {100 * imported.outside / imported.valid:.0f} % of the samples lie outside the sensor's"
            f" {camera.range_min_mm:g} to {camera.range_max_mm:g} mm; check --scale"
        )
    if imported.without_amplitude:
        notes.append(f"{source}: {imported.without_amplitude} frames without an amplitude image of their stamp")
    for note in notes:
        click.echo(f"tofmix: {note}", err=True)
