"""The camera of `tofmix import`: its profile, its field of view, and the conversion of depths along z."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.arrays import FloatArray
    from tofmix.io.importers.base import FrameSource
    from tofmix.io.importers.intrinsics import Calibration
    from tofmix.optics.pinhole import Pinhole
    from tofmix.optics.projection import Projection
    from tofmix.sensor import Sensor
    from tofmix.sensors.sheet import CameraSheet

_INTRINSICS = 4  # numbers: FX, FY, CX, CY
_PAIR = re.compile(r"\s*([0-9.eE+-]+)\s*[x,]\s*([0-9.eE+-]+)\s*")
_MOST_DEG = 360.0, 180.0
"""Largest field of view, degrees: a whole turn, and from pole to pole."""


def camera_of(name: str | None) -> "CameraSheet":
    """Properties of the camera of ``--sensor``; empty without it.

    Raises
    ------
    BadInputError
        If there is no such file or built-in sensor, or the file describes none.
    """
    from tofmix.io.atomic.storage import read_text
    from tofmix.io.model_file import maps_of_model
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
    if "about" in parse_toml(text, source=name):
        return parse_profile(text, source=name)
    return parse_sensor(text, source=name, read_map=maps_of_model(Path(name)))


def sensor_of(camera: "CameraSheet", shape: tuple[int, int]) -> "Sensor":
    """The camera as a recording of an image (rows, cols) describes it.

    A projection is of an image of one size alone: where pixels of another look stays unknown.
    """
    sensor = camera.sensor()
    if sensor.projection is None or (camera.rows or shape[0], camera.cols or shape[1]) == tuple(shape):
        return sensor
    return replace(sensor, projection=None)


def with_frequency(sensor: "Sensor", frequency_hz: float | None) -> "Sensor":
    """The camera with the modulation frequency, Hz, of ``--modulation-frequency``; the same without the option.

    Raises
    ------
    UsageError
        If the camera is known to measure no phase, or no camera has such a frequency.
    """
    if frequency_hz is None:
        return sensor
    if sensor.is_lock_in is False:
        raise UsageError(
            f"--modulation-frequency: {sensor.name} is no lock-in camera (measurement: {sensor.measurement})"
        )
    try:
        return replace(sensor, modulation_frequency_hz=frequency_hz)
    except ValueError as error:
        raise UsageError(f"--modulation-frequency: {error}") from error


def with_share_law(sensor: "Sensor", law: str | None) -> "Sensor":
    """The camera with the law of ``--shares``; the same without the option."""
    from tofmix.share_law import share_law_of

    return sensor if law is None else replace(sensor, share_law=share_law_of(law))


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


def intrinsics_of(text: str | None) -> "Pinhole | Calibration | None":
    """Intrinsics from a text such as 210,210,88,72, in pixels, or from a calibration file that it names.

    Raises
    ------
    UsageError
        If it is neither, or PyYAML is missing.
    BadInputError
        If the file is no calibration, or the numbers are no camera's.
    """
    from tofmix.io.importers.intrinsics import read_calibration
    from tofmix.optics.pinhole import Pinhole

    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == _INTRINSICS:
        try:
            return Pinhole(fx=numbers[0], fy=numbers[1], cx=numbers[2], cy=numbers[3])
        except ValueError as error:
            raise BadInputError(f"--intrinsics: {error}") from error
    if numbers or not Path(text).exists():
        raise UsageError(
            f"--intrinsics: {text!r} is not FX,FY,CX,CY in pixels, such as 210,210,88,72, nor a calibration file"
        )
    return read_calibration(Path(text))


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Options of the lens: intrinsics, and a field of view (horizontal, vertical) in degrees."""

    intrinsics: "Pinhole | Calibration | None" = None
    view_deg: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Geometry:
    """Conversion of depths.

    Parameters
    ----------
    factor : (row, col) float64 or None
        Range along the beam over depth along z; None where depths are ranges.
    sensor : Sensor
        The camera, with the directions of its pixels if they are known.
    text : str
        The same in words.
    notes : tuple of str
        Notes for the user.
    """

    factor: "FloatArray | None"
    sensor: "Sensor"
    text: str
    notes: tuple[str, ...] = ()


def geometry_of(frames: "FrameSource", sensor: "Sensor", lens: Lens, axis: str | None, source: Path) -> Geometry:
    """Settle how depths become ranges, and where pixels look.

    The first of these that is known is used: ``--intrinsics``, ``--fov``, the intrinsics of the source, the sensor.
    ``--fov`` is that of an ideal pinhole where depths are along z, else of equal angles.

    Parameters
    ----------
    frames : FrameSource
        The source.
    sensor : Sensor
        The camera, from ``--sensor`` or the source.
    lens : Lens
        The lens options.
    axis : {"z", "ray"} or None
        ``--depth-axis``; without it, the default of the kind of source.
    source : Path
        For messages.

    Raises
    ------
    BadInputError
        If depths along z cannot become ranges, as the lens is not known, or the lens cannot be.
    """
    from tofmix.optics.view import ray_factor

    along_z = (axis or frames.depth_axis) == "z"
    sensor, where = _with_optics(frames, sensor, lens, source, along_z=along_z)
    shape = frames.shape[1:]
    by_view = lens.intrinsics is None and lens.view_deg is not None
    try:
        optics = sensor.optics
        if optics is not None:
            optics.check(shape)
        notes = _lens_doubts(optics, shape, lens, where, along_z=along_z)
        if not along_z:
            otherwise = "" if axis else " (--depth-axis z if they are along z)"
            seen = f"; {view_words(optics, shape, None)}" if by_view and optics is not None else ""
            text = f"depths along the beam, taken as ranges{otherwise}{seen}"
            return Geometry(factor=None, sensor=sensor, text=text, notes=notes)
        if optics is None:
            reason = f"; {frames.lens_unknown}" if frames.lens_unknown else ""
            raise BadInputError(
                f"{source}: depths along z need a lens to become ranges: give --intrinsics FX,FY,CX,CY"
                f" or --fov HxV, or --depth-axis ray if they are along the beam{reason}"
            )
        factor = ray_factor(optics, shape)
    except ValueError as error:
        raise BadInputError(f"{where}: {error}") from error
    otherwise = "" if axis else " (--depth-axis ray if they are along the beam)"
    how = view_words(optics, shape, lens.view_deg if by_view else None)
    text = f"depths along z converted to ranges by {how}{otherwise}"
    return Geometry(factor=factor, sensor=sensor, text=text, notes=notes)


def _lens_doubts(
    optics: "Projection | None", shape: tuple[int, int], lens: Lens, where: str, *, along_z: bool
) -> tuple[str, ...]:
    """Notes on a field of view that may be in radians, and on a centre far outside of the image."""
    from tofmix.optics.view import centre_doubt, projection_of_view

    narrow = "" if lens.view_deg is None else view_note(lens.view_deg, projection_of_view(along_z=along_z), shape)
    centre = centre_doubt(optics, shape)
    return tuple(filter(None, (narrow, centre and f"{where}: {centre}")))


def view_note(view_deg: tuple[float, float], projection: str, shape: tuple[int, int]) -> str:
    """Note on a ``--fov`` that may be in radians; empty if it may not."""
    from tofmix.optics.view import view_doubt

    doubt = view_doubt(view_deg, projection, shape)
    return doubt and f"--fov: {doubt}"


def _with_optics(
    frames: "FrameSource", sensor: "Sensor", lens: Lens, source: Path, *, along_z: bool
) -> "tuple[Sensor, str]":
    """The camera with the directions of its pixels, and the source of these."""
    from tofmix.optics.pinhole import Pinhole
    from tofmix.optics.view import projection_of_view
    from tofmix.sensors.view import with_lens

    rows, cols = frames.shape[1:]
    pinhole, where = frames.pinhole, str(source)
    if isinstance(lens.intrinsics, Pinhole):
        pinhole, where = lens.intrinsics, "--intrinsics"
    elif lens.intrinsics is not None:
        if not lens.intrinsics.calibrated:
            raise BadInputError(f"{lens.intrinsics.what}: not calibrated: a focal length is not above 0")
        pinhole = lens.intrinsics.pinhole((rows, cols), rectified=frames.rectified)
        where = lens.intrinsics.what
    elif lens.view_deg is not None:
        return viewed(sensor, lens.view_deg, projection_of_view(along_z=along_z), (rows, cols)), "--fov"
    return (sensor if pinhole is None else with_lens(sensor, pinhole)), where


def viewed(
    sensor: "Sensor", view_deg: tuple[float, float], projection: str, shape: tuple[int, int], option: str = "--fov"
) -> "Sensor":
    """The camera with the directions of an image's pixels by a field of view; `UsageError` if no pinhole sees it."""
    from tofmix.sensors.view import with_view

    try:
        return with_view(sensor, view_deg, projection, shape)
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from error


def view_words(optics: "Projection", shape: tuple[int, int], view_deg: tuple[float, float] | None) -> str:
    """A projection in words; an ideal pinhole by its field of view, if that is what was given."""
    from tofmix.optics.pinhole import Pinhole

    if not isinstance(optics, Pinhole):
        return f"field of view {optics.words(shape)}, equal angles"
    how = "pinhole" if view_deg is None else f"an ideal pinhole of {view_deg[0]:g} x {view_deg[1]:g} degrees,"
    lens = "" if not optics.distortion else f" distortion {' '.join(f'{k:g}' for k in optics.distortion)}"
    return f"{how} fx {optics.fx:g} fy {optics.fy:g} cx {optics.cx:g} cy {optics.cy:g}{lens}"


def not_known(
    sensor: "Sensor", *, has_optics: bool, has_time: bool, has_amplitude: bool = True, targets: int = 0
) -> list[str]:
    """Missing data of the camera and of its clock, with the commands that need them."""
    from tofmix.report.summary.light import OPTIONS, lacking

    missing = []
    if not has_optics:
        missing.append("field of view (export, map and surfaces need it: import --fov)")
    if sensor.range_max_mm is None:
        missing.append("largest range (share without a return)")
    if sensor.noise is None:
        missing.append("noise curve (estimate measures it)")
    if not has_time:
        missing.append("times of the frames (reconcile needs them for effects in time: import --frame-rate)")
    if sensor.is_lock_in is not False and not targets:
        condition = "" if sensor.is_lock_in else "if this is a lock-in camera, "
        missing += [
            f"{name} ({condition}flying pixels are counted as surfaces without: import {' '.join(OPTIONS[name])})"
            for name in lacking(sensor, has_amplitude=has_amplitude)
        ]
    return missing
