"""What `tofmix import` knows of the camera: its profile, its field of view, and what depths along z need."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.arrays import FloatArray
    from tofmix.io.importers.base import FrameSource, Pinhole
    from tofmix.sensor import Sensor
    from tofmix.sensors.sheet import CameraSheet

_INTRINSICS = 4
_PAIR = re.compile(r"\s*([0-9.eE+-]+)\s*[x,]\s*([0-9.eE+-]+)\s*")
_MOST_DEG = 360.0, 180.0
_FLAT_DEG = 180.0
"""A pinhole images less than that."""


def camera_of(name: str | None) -> "CameraSheet":
    """What is known of the camera that ``--sensor`` names; nothing without it.

    Raises
    ------
    BadInputError
        If there is no such file or built-in sensor, or the file describes none.
    """
    from tofmix.io.storage import read_text
    from tofmix.sensors import PROFILES, load_sheet
    from tofmix.sensors.profile_toml import parse_profile
    from tofmix.sensors.sensor_file import parse_sensor
    from tofmix.sensors.sheet import UNKNOWN
    from tofmix.toml_table import parse_toml

    if name is None:
        return UNKNOWN
    if name in PROFILES and not Path(name).is_file():
        return load_sheet(name)
    if not Path(name).exists():
        raise BadInputError(f"--sensor: {name}: no such file, and not a built-in sensor ({', '.join(PROFILES)})")
    text = read_text(Path(name))
    return (parse_profile if "about" in parse_toml(text, source=name) else parse_sensor)(text, source=name)


def view_of(text: str | None) -> tuple[float, float] | None:
    """Field of view (horizontal, vertical), degrees, from a text such as 70x55.

    Raises
    ------
    UsageError
        If it is none.
    """
    if text is None:
        return None
    try:
        found = _PAIR.fullmatch(text)
        view = (float(found[1]), float(found[2])) if found else (0.0, 0.0)
    except ValueError:
        view = (0.0, 0.0)
    if not all(0.0 < angle <= most for angle, most in zip(view, _MOST_DEG, strict=True)):
        raise UsageError(f"--fov: {text!r} is not HxV in degrees, up to 360x180, such as 70x55")
    return view


def shape_of(text: str | None) -> tuple[int, int] | None:
    """Rows and columns, from a text such as 8x8.

    Raises
    ------
    UsageError
        If it is none.
    """
    if text is None:
        return None
    found = re.fullmatch(r"\s*([0-9]{1,5})\s*x\s*([0-9]{1,5})\s*", text)
    shape = (int(found[1]), int(found[2])) if found else (0, 0)
    if min(shape) < 1:
        raise UsageError(f"--shape: {text!r} is not ROWSxCOLS, such as 8x8")
    return shape


def pinhole_of(text: str | None) -> "Pinhole | None":
    """Intrinsics in pixels, from a text such as 210,210,88,72.

    Raises
    ------
    UsageError
        If it is none.
    """
    from tofmix.io.importers.base import Pinhole

    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != _INTRINSICS:
        raise UsageError(f"--intrinsics: {text!r} is not FX,FY,CX,CY in pixels, such as 210,210,88,72")
    return Pinhole(focal_px=(numbers[0], numbers[1]), centre_px=(numbers[2], numbers[3]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """What is said of the lens: intrinsics, and a field of view (horizontal, vertical) in degrees."""

    pinhole: "Pinhole | None" = None
    view_deg: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Geometry:
    """What becomes of depths.

    Parameters
    ----------
    factor : (row, col) float64 or None
        Range along the beam over depth along z; None where depths are ranges.
    sensor : Sensor
        The camera with where its pixels look, as far as that is known.
    text : str
        The same in words.
    notes : tuple of str
        What the user should know.
    """

    factor: "FloatArray | None"
    sensor: "Sensor"
    text: str
    notes: tuple[str, ...] = ()


def geometry_of(frames: "FrameSource", sensor: "Sensor", lens: Lens, axis: str | None, source: Path) -> Geometry:
    """Settle how depths become ranges, and where pixels look.

    Along z, the first of these that is known is used: ``--intrinsics``, ``--fov`` (an ideal pinhole), the intrinsics of
    the source, the sensor's field of view (equal angles, as its recordings have).

    Parameters
    ----------
    frames : FrameSource
        The source.
    sensor : Sensor
        The camera, from ``--sensor`` or the source.
    lens : Lens
        What was said of the lens.
    axis : {"z", "ray"} or None
        ``--depth-axis``; without it, as the source's kind has it.
    source : Path
        For messages.

    Raises
    ------
    UsageError
        If intrinsics are given for depths along the beam.
    BadInputError
        If depths along z cannot become ranges, as the lens is not known or cannot be.
    """
    if lens.view_deg is not None:
        sensor = replace(sensor, fov_horizontal_deg=lens.view_deg[0], fov_vertical_deg=lens.view_deg[1])
    if (axis or frames.depth_axis) == "ray":
        if lens.pinhole is not None:
            raise UsageError("--intrinsics goes with depths along z (--depth-axis z)")
        otherwise = "" if axis else " (--depth-axis z if they are along z)"
        return Geometry(factor=None, sensor=sensor, text=f"depths along the beam, taken as ranges{otherwise}")
    otherwise = "" if axis else " (--depth-axis ray if they are along the beam)"
    factor, how, notes = _along_z(frames, sensor, lens, source)
    return Geometry(factor=factor, sensor=sensor, text=f"depths along z made ranges by {how}{otherwise}", notes=notes)


def _along_z(
    frames: "FrameSource", sensor: "Sensor", lens: Lens, source: Path
) -> "tuple[FloatArray, str, tuple[str, ...]]":
    """Range over depth of each pixel, by what it is, and what to say of it."""
    from tofmix.geometry import beam_directions, largest_angle_deg, pinhole_directions, ray_over_depth
    from tofmix.io.importers.base import Pinhole

    _, rows, cols = frames.shape
    view = None
    if sensor.fov_horizontal_deg is not None and sensor.fov_vertical_deg is not None:
        view = sensor.fov_horizontal_deg, sensor.fov_vertical_deg
    pinhole, where = lens.pinhole or frames.pinhole, "--intrinsics" if lens.pinhole else str(source)
    how = "pinhole"
    if lens.pinhole is None and lens.view_deg is not None:
        where, how = "--fov", f"an ideal pinhole of {lens.view_deg[0]:g} x {lens.view_deg[1]:g} degrees,"
        focal, centre = _ideal(rows, cols, lens.view_deg)
        pinhole = Pinhole(focal_px=focal, centre_px=centre)
    if pinhole is None and view is None:
        raise BadInputError(
            f"{source}: depths along z are no ranges along the beam without the lens: give --intrinsics FX,FY,CX,CY or"
            " --fov HxV, or --depth-axis ray if they are along the beam"
        )
    try:
        grid = (
            None if view is None else beam_directions(rows, cols, fov_horizontal_deg=view[0], fov_vertical_deg=view[1])
        )
        if pinhole is None and grid is not None and view is not None:
            return ray_over_depth(grid), f"field of view {view[0]:g} x {view[1]:g} degrees, equal angles", ()
        assert pinhole is not None  # noqa: S101  for the type checker: refused above
        beams = pinhole_directions(rows, cols, focal_px=pinhole.focal_px, centre_px=pinhole.centre_px)
        factor = ray_over_depth(beams)
    except ValueError as error:
        raise BadInputError(f"{where}: {error}") from error
    notes: tuple[str, ...] = ()
    if grid is not None and view is not None:
        angle = largest_angle_deg(grid, beams)
        if angle > min(view[0] / cols, view[1] / rows):
            text = (
                f"{source}: the pinhole's pixels look up to {angle:.1f} degrees beside the recording's, which have"
                f" equal angles over {view[0]:g} x {view[1]:g} degrees; ranges are right, exported points are off by"
                " that"
            )
            notes = (text,)
    (fx, fy), (cx, cy) = pinhole.focal_px, pinhole.centre_px
    return factor, f"{how} fx {fx:g} fy {fy:g} cx {cx:g} cy {cy:g}", notes


def _ideal(rows: int, cols: int, view_deg: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Focal lengths and centre, pixels, of a pinhole whose image's outer edges are at the field of view.

    Raises
    ------
    UsageError
        If no pinhole sees that much.
    """
    import math

    if max(view_deg) >= _FLAT_DEG:
        raise UsageError(f"--fov: {view_deg[0]:g} x {view_deg[1]:g} degrees; a pinhole sees less than 180")
    fx, fy = (size / 2 / math.tan(math.radians(angle) / 2) for size, angle in zip((cols, rows), view_deg, strict=True))
    return (fx, fy), ((cols - 1) / 2, (rows - 1) / 2)


def not_known(sensor: "Sensor", *, has_optics: bool) -> list[str]:
    """What a recording does not say of its camera, and what needs it."""
    missing = []
    if not has_optics:
        missing.append("field of view (export, map: --fov)")
    if sensor.range_max_mm is None:
        missing.append("largest range (share without a return)")
    if sensor.noise is None:
        missing.append("noise curve (estimate measures it)")
    return missing
