"""Import a recording from another program's file: its camera, its geometry, and what is doubtful about it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.importers import open_source, takes_axes
from tofmix.io.importers.base import FrameSource, SourceRequest
from tofmix.io.importers.conversion import Conversion
from tofmix.io.importers.intrinsics import Calibration
from tofmix.io.importers.writing import Imported, Target, write_recording
from tofmix.io.model_file import maps_of_model
from tofmix.io.recording.range_check import implausible, outside_doubt
from tofmix.io.samples import guessed
from tofmix.io.sensor_group import check_maps
from tofmix.io.storage import locked, read_text
from tofmix.jobs.files import view_note, view_words, viewed
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import Projection, centre_doubt, projection_of_view, ray_factor
from tofmix.report.summary.findings import OPTIONS, lacking
from tofmix.sensor import Sensor, with_lens
from tofmix.sensor_schema import share_law_of
from tofmix.sensors import PROFILES, UNKNOWN, Camera, load_camera, parse_camera, parse_profile
from tofmix.toml_table import parse_toml
from tofmix.wording import readable


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportRequest:
    """The options of an import."""

    source: Path
    output: Path
    request: SourceRequest
    sensor: str | None  # a built-in camera, or a TOML file; None: not known
    camera: Camera  # of `sensor`
    lens: "Lens"
    inputs: Sequence[Path]  # files that are read, which the output must not be
    unit_mm: float | None  # mm of one unit; the source's without it
    scale: float | None  # `unit_mm`, if it was given as a number
    modulation_frequency_hz: float | None
    shares: str | None
    depth_axis: str | None
    invalid: tuple[float, ...]
    target: Target | None
    frame_rate_hz: float | None
    overwrite: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedFile:
    """A recording that was written; `targets` is 0 without such an axis."""

    imported: Imported
    kind: str
    image: tuple[int, int]
    targets: int
    unit_mm: float
    geometry: str
    unknown: list[str]
    notes: list[str]


def import_file(asked: ImportRequest, reporter: Reporter) -> ImportedFile:
    """Write a recording."""
    source, camera, request = asked.source, asked.camera, asked.request
    inputs = tuple(asked.inputs)
    with locked(asked.output, overwrite=asked.overwrite, inputs=inputs), open_source(source, request) as frames:
        shape = frames.shape[1:]
        targets = _targets_kept(asked.target, frames, source)
        known = frames.sensor if asked.sensor is None and frames.sensor is not None else camera.sensor_of(shape)
        known = with_frequency(known, asked.modulation_frequency_hz)
        if asked.shares is not None:
            known = replace(known, share_law=share_law_of(asked.shares))
        check_maps(known, shape, source if asked.sensor is None else Path(asked.sensor))
        if frames.unit_unknown and asked.unit_mm is None:
            raise BadInputError(f"{source}: {frames.unit_unknown}; give --scale, mm of one count, or --units")
        # Images of a turned camera are read as they are.
        if request.axes is None and takes_axes(source) and (reason := camera.turned(shape)):
            raise BadInputError(f"{source}: {reason}; give their order: --axes frame,col,row")
        geometry = geometry_of(frames, known, asked.lens, asked.depth_axis, source)
        used_mm = asked.unit_mm or frames.unit_mm or 1.0
        conversion = Conversion(
            dtype=frames.dtype,
            unit_mm=used_mm * frames.scale_factor,
            offset_mm=used_mm * frames.add_offset,
            invalid=(*frames.invalid, *asked.invalid),
            valid_span=frames.valid_span,
            status_valid=frames.status_valid,
            ray_over_depth=geometry.factor,
            unit_known=asked.unit_mm is not None or frames.unit_mm is not None,
            keep_values=request.keep_values,
        )
        attributes: dict[str, str | int | float] = {
            "source": readable(source.name),
            "source_kind": frames.kind,
            "unit_mm": conversion.unit_mm,
            "geometry": geometry.text,
        }
        with reporter.steps(frames.shape[0], "import", "frame"):
            imported = write_recording(
                frames,
                asked.output,
                what=source,
                sensor=geometry.sensor,
                conversion=conversion,
                again=lambda: open_source(source, request),
                target=asked.target,
                frame_rate_hz=asked.frame_rate_hz,
                attributes=attributes,
                progress=reporter.progress,
                overwrite=asked.overwrite,
                inputs=inputs,
            )
        how = [*frames.notes, *imported.remarks, *_unused(asked, frames)]
        doubts = [*geometry.notes, *_doubts(frames, imported, camera, geometry.sensor, source, used_mm)]
        has_time = frames.has_time or asked.frame_rate_hz is not None or imported.frames == 1
        unknown = not_known(
            geometry.sensor,
            has_optics=geometry.sensor.optics is not None,
            has_amplitude=frames.has_amplitude,
            targets=targets,
            has_time=has_time,
        )
    for line in how:
        reporter.note(line)
    for line in doubts:
        reporter.warn(line)
    return ImportedFile(
        imported=imported,
        kind=frames.kind,
        image=shape,
        targets=targets,
        unit_mm=conversion.unit_mm,
        geometry=geometry.text,
        unknown=unknown,
        notes=[*how, *doubts],
    )


def _unused(asked: ImportRequest, frames: FrameSource) -> list[str]:
    """Notes on a --scale that is multiplied by a factor of the source, and on a --frame-rate beside times."""
    notes, scale, factor = [], asked.scale, frames.scale_factor
    if scale is not None and factor != 1.0:
        product = f"--scale {scale:g} times the source's scale_factor {factor:g}"
        notes.append(f"{asked.source}: one stored number is {scale * factor:g} mm: {product}")
    if asked.frame_rate_hz is not None and frames.has_time:
        notes.append(f"{asked.source}: --frame-rate is not used: the frames have times")
    return notes


def _targets_kept(target: Target | None, frames: FrameSource, source: Path) -> int:
    """Targets of a pixel and frame in the new recording; 0 without such an axis.

    Refuses ``--target`` where pixels return one sample, and the strongest one without amplitudes.
    """
    if target is not None and not frames.targets:
        raise OptionError(f"--target {target}: {source} has one sample for each pixel and frame; leave the option out")
    if target == "strongest" and not frames.has_amplitude:
        raise BadInputError(
            f"{source}: amplitude: there is none, so the strongest target is not known: give --amplitude, or use"
            " --target nearest"
        )
    return frames.targets if target is None else 0


def _doubts(
    frames: FrameSource, imported: Imported, camera: Camera, sensor: Sensor, source: Path, unit_mm: float
) -> list[str]:
    """Doubts about a source, each a line for the user."""
    notes = [camera.size_doubt(frames.shape[1:])]
    doubt = "" if imported.median_mm is None else implausible(imported.median_mm, sensor, unit_mm=unit_mm, path=source)
    if dropped := guessed(imported.dropped):
        notes.append(f"no samples: {dropped} (--keep-values keeps fill values)")
    if imported.valid == 0:
        notes.append("no valid sample; check --invalid and --units")
    else:
        notes.append(doubt or outside_doubt(imported.outside / imported.valid, sensor, "--units"))
    if imported.without_amplitude:
        few = "frame" if imported.without_amplitude == 1 else "frames"
        notes.append(f"{imported.without_amplitude} {few} without an amplitude image of the same time stamp")
    return [f"{source}: {text}" for text in notes if text]


def camera_of(name: str | None) -> Camera:
    """Properties of the camera of ``--sensor``; empty without it."""
    if name is None:
        return UNKNOWN
    if name in PROFILES and not Path(name).is_file():
        return load_camera(name)
    if not Path(name).exists():
        raise BadInputError(f"--sensor: {name}: no such file, and not a built-in sensor ({', '.join(PROFILES)})")
    text = read_text(Path(name))
    if "about" in parse_toml(text, source=name):
        return parse_profile(text, source=name)
    return parse_camera(text, source=name, read_map=maps_of_model(Path(name)))


def with_frequency(sensor: Sensor, frequency_hz: float | None) -> Sensor:
    """The camera with the modulation frequency, Hz, of ``--modulation-frequency``; the same without the option."""
    if frequency_hz is None:
        return sensor
    if sensor.is_lock_in is False:
        raise OptionError(
            f"--modulation-frequency: {sensor.name} is no lock-in camera (measurement: {sensor.measurement})"
        )
    try:
        return replace(sensor, modulation_frequency_hz=frequency_hz)
    except ValueError as error:
        raise OptionError(f"--modulation-frequency: {error}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Options of the lens: intrinsics, and a field of view (horizontal, vertical) in degrees."""

    intrinsics: Pinhole | Calibration | None = None
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

    factor: FloatArray | None
    sensor: Sensor
    text: str
    notes: tuple[str, ...] = ()


def geometry_of(frames: FrameSource, sensor: Sensor, lens: Lens, axis: str | None, source: Path) -> Geometry:
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
    """
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
    optics: Projection | None, shape: tuple[int, int], lens: Lens, where: str, *, along_z: bool
) -> tuple[str, ...]:
    """Notes on a field of view that may be in radians, and on a centre far outside of the image."""
    narrow = "" if lens.view_deg is None else view_note(lens.view_deg, projection_of_view(along_z=along_z), shape)
    centre = centre_doubt(optics, shape)
    return tuple(filter(None, (narrow, centre and f"{where}: {centre}")))


def _with_optics(frames: FrameSource, sensor: Sensor, lens: Lens, source: Path, *, along_z: bool) -> tuple[Sensor, str]:
    """The camera with the directions of its pixels, and the source of these."""
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


def not_known(
    sensor: Sensor, *, has_optics: bool, has_time: bool, has_amplitude: bool = True, targets: int = 0
) -> list[str]:
    """Missing data of the camera and of its clock, with the commands that need them."""
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
