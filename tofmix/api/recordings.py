"""Recordings in Python: opened from a file, or made of an array.

What a job says is a warning of Python (`PythonReporter`); its notes are none.
"""

import inspect
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tofmix.arrays import IMAGE_RANK, Float32Array, FloatArray, IntArray
from tofmix.errors import BadInputError, DoubtWarning
from tofmix.jobs.reporter import Reporter
from tofmix.options import DepthAxis, Units
from tofmix.recording import ArrayRecording, CameraSource
from tofmix.sensor import NoiseCurve, Sensor

if TYPE_CHECKING:
    from tofmix.sensors import Camera
    from tofmix.simulation.events import Truth
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tofmix.report.summary.findings import Finding


_REMEDIES = {
    "scatter_off_curve": "noise='auto' measures it.",
    "sigma_off_curve": "noise='auto' measures it.",
    "drift": "Take a shorter window.",
    "close_layers": "Take a shorter window, or noise='auto'.",
    "all_layers_used": "A larger max_layers shows them.",
    "not_converged": "Take a larger max_iter.",
    "too_few_samples": "Take a longer window.",
    "frames_of_two_kinds": "from_array(numpy.delete(recording.range_mm, frames, axis=0), ...) leaves frames out.",
    "flying_pixels_counted": "from_array takes amplitude=..., with_sensor modulation_frequency_hz=...",
}
"""Remedies of findings, as parameters of `estimate`."""


class PythonReporter(Reporter):
    """Warns of doubts, at the line that called the package."""

    def warn(self, text: str) -> None:
        """Warn of a doubt."""
        frame, level = inspect.currentframe(), 1
        while frame is not None and frame.f_globals["__name__"].startswith(("tofmix.", "contextlib")):
            frame, level = frame.f_back, level + 1
        warnings.warn(text, DoubtWarning, stacklevel=level)

    def finding(self, about: object, finding: "Finding") -> None:  # noqa: ARG002  the text does without it
        """Warn of it with its remedy in Python."""
        if not finding.is_note:
            self.warn(f"{finding.text} {_REMEDIES.get(finding.code, '')}".strip())


UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Length of each unit of `from_array`, mm."""


class Recording:
    """Samples of a camera, in memory or in a file.

    Made by `tofmix.open`, `tofmix.from_array` and `tofmix.simulate`. A file is opened when it is read, and then
    closed again.

    Parameters
    ----------
    source : Path or ArrayRecording
        The file, or the samples.
    sensor : Sensor
        The camera.
    shape : (int, int, int)
        Frames, rows, columns.
    targets : int
        Targets of a pixel and frame in a file that has such an axis.
    time_s : (frame,) float64, optional
        Start of each frame, s, of samples in memory.
    truth : Truth, optional
        Of a simulated recording.
    model_text : str
        The model file of a simulated recording.
    averaged : bool
        Whether the samples are marked as means that the camera made.
    dropped : dict
        Number of values that `from_array` took for no samples, by reason.
    """

    def __init__(
        self,
        source: Path | ArrayRecording,
        sensor: Sensor,
        *,
        shape: tuple[int, int, int],
        targets: int = 0,
        time_s: FloatArray | None = None,
        truth: "Truth | None" = None,
        model_text: str = "",
        averaged: bool = False,
        dropped: Mapping[str, int] | None = None,
    ) -> None:
        self._source, self._sensor, self._shape, self._targets = source, sensor, shape, targets
        self.averaged = averaged
        self._time_s, self._truth, self._model_text = time_s, truth, model_text
        self._dropped = dict(dropped or {})

    def __repr__(self) -> str:
        frames, rows, cols = self._shape
        return f"<Recording {self.name}: {frames} frames of {rows} x {cols} pixels, {self._sensor.name}>"

    @property
    def path(self) -> Path | None:
        """The file; None for samples in memory."""
        return self._source if isinstance(self._source, Path) else None

    @property
    def name(self) -> str:
        """The file's name, or ``array``."""
        return self._source.name if isinstance(self._source, Path) else "array"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""
        return self._shape

    @property
    def targets(self) -> int:
        """Targets that a pixel returns in one frame at most; 0 where the recording has no such axis."""
        return self._targets

    @property
    def dropped(self) -> dict[str, int]:
        """Number of values that `from_array` took for no samples, by reason; empty for a file."""
        return dict(self._dropped)

    @property
    def sensor(self) -> Sensor:
        """The camera, as far as it is known."""
        return self._sensor

    @property
    def truth(self) -> "Truth | None":
        """The true surfaces of each pixel, of a recording from `tofmix.simulate`."""
        return self._truth

    def with_sensor(self, sensor: Sensor | None = None, **changes: Any) -> Self:  # noqa: ANN401  fields of several types
        """The same samples with another camera, or with some of its properties changed.

        Parameters
        ----------
        sensor : Sensor, optional
            The camera; that of the recording without it.
        **changes
            Fields of `tofmix.sensor.Sensor`, for example ``range_max_mm=7500.0``.

        Raises
        ------
        ValueError
            If a value is out of its bounds.
        """
        changed = replace(sensor or self._sensor, **changes)
        return type(self)(
            self._source,
            changed,
            shape=self._shape,
            targets=self._targets,
            time_s=self._time_s,
            truth=self._truth,
            model_text=self._model_text,
            averaged=self.averaged,
            dropped=self._dropped,
        )

    @contextmanager
    def opened(self) -> Iterator[CameraSource]:
        """Open the samples for reading in blocks, with this recording's camera.

        Raises
        ------
        BadInputError
            If the file cannot be read.
        """
        if isinstance(self._source, ArrayRecording):
            yield self._source.with_sensor(self._sensor)
            return
        from tofmix.io.recording.recording_file import open_recording

        with open_recording(self._source) as file:
            yield file.with_sensor(self._sensor)

    @property
    def range_mm(self) -> Float32Array:
        """All samples (frame, row, col) float32, mm; NaN where invalid. A file is read again at each use.

        They are (frame, target, row, col) where a pixel returns several targets.
        """
        with self.opened() as source:
            return self._by_frame(source.read_range(slice(None), slice(None)))

    def _by_frame(self, samples: Float32Array) -> Float32Array:
        return samples.reshape(self._shape[0], self._targets, *self._shape[1:]) if self._targets else samples

    @property
    def amplitude(self) -> Float32Array | None:
        """All amplitudes float32, of the shape of `range_mm`; None where the recording has none."""
        from tofmix.recording import amplitude_source

        with self.opened() as source:
            light = amplitude_source(source)
            return None if light is None else self._by_frame(light.read_amplitude(slice(None), slice(None)))

    @property
    def time_s(self) -> FloatArray | None:
        """Start of each frame (frame,) float64, s; None where it is not known."""
        if isinstance(self._source, ArrayRecording):
            return self._time_s
        from tofmix.io.recording.recording_file import open_recording

        with open_recording(self._source) as file:
            return file.read_time()

    @property
    def temperature_c(self) -> FloatArray | None:
        """Temperature of the camera (frame,) float64, degC; None where it is not known."""
        if isinstance(self._source, ArrayRecording):
            return None
        from tofmix.io.recording.recording_file import open_recording

        with open_recording(self._source) as file:
            return file.read_temperature()

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the samples as a recording, ranges as float32.

        Parameters
        ----------
        path : str or Path
            The new file.
        overwrite : bool
            Whether it may be replaced.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            If the file exists and must not be replaced.
        StorageError
            If it cannot be written.
        """
        from tofmix.io.recording.recording_writer import RecordingWriter

        target, range_mm, amplitude, time_s = Path(path), self.range_mm, self.amplitude, self.time_s
        temperature_c = self.temperature_c
        writer = RecordingWriter(
            target,
            shape=self._shape,
            targets=self._targets,
            sensor=self._sensor,
            truth=self._truth,
            model_text=self._model_text,
            has_amplitude=amplitude is not None,
            has_time=time_s is not None,
            has_temperature=temperature_c is not None,
            dtype="f4",
            overwrite=overwrite,
            inputs=() if self.path is None else (self.path,),
            attributes={"averaged": int(self.averaged)},
        )
        with writer:
            writer.write(
                0,
                range_mm,
                amplitude=amplitude,
                time_s=time_s,
                temperature_c=None if temperature_c is None else temperature_c.astype(np.float32),
            )
        return target


def opened_recording(path: Path) -> Recording:
    """Open a recording; layers are refused.

    Raises
    ------
    BadInputError
        If the file is missing, damaged or no recording, or its ranges are probably not in mm.

    Warns
    -----
    DoubtWarning
        If samples are exactly 0 and count as ranges, or no camera measures its median.
    """
    from tofmix.io.hdf5 import format_of
    from tofmix.io.layers.layers_file import FORMAT
    from tofmix.jobs import files

    if format_of(path) == FORMAT:
        raise BadInputError(f"{path}: a layers file, not a recording; tofmix.open reads it as it is")
    with files.opened_recording(path, PythonReporter()) as source:
        shape = source.frames, *source.shape[1:]
        return Recording(path, source.sensor, shape=shape, targets=source.targets, averaged=source.averaged)


def from_array(
    ranges: ArrayLike,
    *,
    units: Units,
    sensor: Sensor | str | None = None,
    integration_time_ms: float | None = None,
    noise: NoiseCurve | None = None,
    invalid: tuple[float, ...] = (),
    status: ArrayLike | None = None,
    valid_status: tuple[int, ...] | None = None,
    keep_values: bool = False,
    amplitude: ArrayLike | None = None,
    time_s: ArrayLike | None = None,
    depth_axis: DepthAxis = "ray",
    intrinsics: tuple[float, float, float, float] | None = None,
    fov_deg: tuple[float, float] | None = None,
) -> Recording:
    """Make a recording of an array of ranges.

    Parameters
    ----------
    ranges : (frame, row, col) array_like
        Distances along each pixel's beam. What `tofmix.io.samples.no_sample` names is invalid: NaN, infinities, 0,
        negative numbers and fill values, such as the ends of an integer type; and masked values. `Recording.dropped`
        counts them.
    units : {"mm", "cm", "m"}
        Unit of `ranges`.
    sensor : Sensor or str, optional
        The camera, or the name of a built-in one, whose noise is that of `integration_time_ms`. Without it nothing is
        known of the camera.
    integration_time_ms : float, optional
        Integration time of one sample; without it, that of the sensor, or a built-in camera's default.
    noise : NoiseCurve, optional
        sigma(r), mm. Without it, that of the sensor; without one there, `tofmix.estimate` measures it.
    invalid : tuple of float
        Further invalid values of `ranges`, for example ``(9999,)``.
    status : (frame, row, col) array_like of int, optional
        Status code of each sample.
    valid_status : tuple of int, optional
        Codes of valid samples; without it, those of a built-in camera.
    keep_values : bool
        Whether zeros and fill values are ranges. NaN, infinite and negative ones are invalid all the same.
    amplitude : (frame, row, col) array_like, optional
        Amplitude of each sample.
    time_s : (frame,) array_like, optional
        Start of each frame, s, by any clock, or as a date (`numpy.datetime64`, `datetime.datetime`); the recording's
        begins with 0. Frames whose times do not ascend are put in order as `tofmix import` does it.
    depth_axis : {"ray", "z"}
        What `ranges` are along: the beam of each pixel, or the axis of the camera, as the depth images of most drivers
        are. Depths along z become ranges by the lens.
    intrinsics : (float, float, float, float), optional
        Focal lengths fx, fy and centre cx, cy of the lens, pixels; without them, `fov_deg`, else those of the sensor.
    fov_deg : (float, float), optional
        Full field of view, horizontal and vertical, degrees: of an ideal pinhole where depths are along z, else of
        equal angles between pixels.

    Returns
    -------
    Recording
        In memory.

    Raises
    ------
    ValueError
        If the unit is not known, a shape does not fit, no codes of valid samples are known, depths along z have no
        lens, times are neither numbers nor dates, rows and columns are those of the camera, swapped, or the array is a
        camera matrix.
    BadInputError
        If there is no built-in camera of that name.

    Warns
    -----
    DoubtWarning
        If values were dropped that are none of `invalid`, no sample is left, no camera measures the median range, most
        ranges are outside of the camera's, its images have another size, frames were put in order, times count another
        unit than s since 1970, a field of view may be in radians, or the centre of the lens is far outside of the
        image.
    """
    if units not in UNITS_MM:
        raise ValueError(f"units: {units!r} is not one of {', '.join(UNITS_MM)}")
    from tofmix.io.samples import is_camera_matrix

    masked: np.ma.MaskedArray[Any, Any] = np.ma.asarray(ranges)
    raw = np.asarray(masked.data)
    if raw.dtype.kind not in "iuf":
        raise ValueError(f"ranges: expected integers or floats, got {raw.dtype}")
    if is_camera_matrix(raw[0] if raw.shape[:1] == (1,) else raw):
        raise ValueError("ranges: one 3 x 3 array that ends in 0 0 1 is a camera matrix, not ranges")
    range_mm = raw.astype(np.float64) * UNITS_MM[units]
    bad, dropped = _no_sample(raw, np.ma.getmaskarray(masked), UNITS_MM[units], invalid, keep_values=keep_values)
    if status is not None:
        unfit = ~bad & ~np.isin(_status(status, raw.shape), _valid_codes(valid_status, sensor))
        bad, dropped = bad | unfit, _counted(dropped, status=unfit)
    range_mm[bad] = np.nan
    built_in = _built_in(sensor, integration_time_ms)
    camera = built_in.sensor() if sensor is None or isinstance(sensor, str) else sensor
    if integration_time_ms is not None:
        camera = replace(camera, integration_time_ms=integration_time_ms)
    if range_mm.ndim >= IMAGE_RANK:
        image = range_mm.shape[-2], range_mm.shape[-1]
        if reason := built_in.turned(image):
            raise ValueError(f"ranges: {reason}; give ranges.swapaxes(-2, -1)")
        camera = built_in.sensor_of(image) if isinstance(sensor, str) else camera
        camera, along = _seen_by(camera, depth_axis, intrinsics, fov_deg, image)
        range_mm *= along
    _say_doubts(range_mm, built_in, camera, dropped, UNITS_MM[units])
    if noise is not None:
        camera = replace(camera, noise=noise)
    light = None if amplitude is None else np.asarray(amplitude)
    time = None
    if time_s is not None:
        order, time = _in_time(_seconds(time_s), range_mm)
        range_mm, light = range_mm[order], None if light is None else light[order]
    samples = ArrayRecording(range_mm, camera, light)
    return Recording(samples, camera, shape=samples.shape, time_s=time, dropped=dropped)


def _no_sample(
    raw: NDArray[Any], masked: NDArray[np.bool_], unit_mm: float, invalid: tuple[float, ...], *, keep_values: bool
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Values that are no samples, and their number by reason; those below a mask count as masked alone."""
    from tofmix.io.samples import no_sample

    seen = raw[~masked] if masked.any() else raw
    found = no_sample(seen, unit_mm=unit_mm, invalid=invalid, keep_values=keep_values)
    bad = masked.copy()
    bad[~masked] = found.bad.ravel()
    dropped = _counted({}, masked=masked)
    return bad, dropped | found.dropped


def _counted(dropped: dict[str, int], **masks: NDArray[np.bool_]) -> dict[str, int]:
    """The numbers with those of further reasons that occur."""
    return dropped | {reason: count for reason, mask in masks.items() if (count := int(np.count_nonzero(mask)))}


def _seen_by(
    camera: Sensor,
    depth_axis: DepthAxis,
    intrinsics: tuple[float, float, float, float] | None,
    fov_deg: tuple[float, float] | None,
    image: tuple[int, int],
) -> tuple[Sensor, FloatArray | float]:
    """The camera with its lens, and the range of each pixel over its number in the array."""
    from tofmix.optics.pinhole import Pinhole
    from tofmix.optics.projection import centre_doubt, projection_of_view, ray_factor, view_doubt
    from tofmix.sensor import with_lens, with_view

    if depth_axis not in get_args(DepthAxis):
        raise ValueError(f"depth_axis: {depth_axis!r} is not one of {', '.join(get_args(DepthAxis))}")
    along_z = depth_axis == "z"
    if intrinsics is not None:
        fx, fy, cx, cy = intrinsics
        camera = with_lens(camera, Pinhole(fx=fx, fy=fy, cx=cx, cy=cy))
    elif fov_deg is not None:
        projection = projection_of_view(along_z=along_z)
        camera = with_view(camera, fov_deg, projection, image)
        if doubt := view_doubt(fov_deg, projection, image, option="fov_deg=({:.4g}, {:.4g})"):
            warnings.warn(f"from_array: fov_deg: {doubt}", DoubtWarning, stacklevel=3)
    if doubt := centre_doubt(camera.optics, image):
        warnings.warn(f"from_array: {doubt}", DoubtWarning, stacklevel=3)
    if not along_z:
        return camera, 1.0
    if camera.optics is None:
        raise ValueError("depth_axis='z': depths along z need a lens to become ranges: give intrinsics or fov_deg")
    camera.optics.check(image)
    return camera, ray_factor(camera.optics, image)


def _seconds(times: ArrayLike) -> FloatArray:
    """Times as numbers of s: dates count from the first one; NaN where one is missing."""
    from tofmix.io.importers.times import epoch_unit_s, times_of_array
    from tofmix.io.recording.range_check import TIME_UNITS_S

    stamps = np.asarray(times)
    if stamps.dtype.kind not in "mM":
        try:
            numbers = stamps.astype(np.float64)
        except (TypeError, ValueError):
            stamps = _dates(stamps)
        else:
            known = numbers[np.isfinite(numbers)]
            unit_s = epoch_unit_s(float(known[0])) if known.size else None
            if unit_s not in (None, 1.0):
                unit = next(name for name, length_s in TIME_UNITS_S.items() if length_s == unit_s)
                text = (
                    f"time_s: {known[0]:.4g}; numbers of this size count {unit} since 1970: time_s=times * {unit_s:g}"
                )
                warnings.warn(f"from_array: {text}", DoubtWarning, stacklevel=3)
            return numbers
    return times_of_array(stamps, stamps.size, "time_s")[0].reshape(stamps.shape)


def _dates(stamps: NDArray[Any]) -> NDArray[np.datetime64]:
    """Dates of Python, or as text, in microseconds; those with a time zone in UTC."""
    from datetime import UTC, datetime

    def plain(moment: object) -> object:
        aware = isinstance(moment, datetime) and moment.tzinfo is not None
        return moment.astimezone(UTC).replace(tzinfo=None) if aware else moment  # type: ignore[attr-defined]

    try:
        return np.array([plain(moment) for moment in stamps.ravel().tolist()], "M8[us]").reshape(stamps.shape)
    except (TypeError, ValueError) as error:
        raise ValueError(f"time_s: neither numbers nor dates, such as {stamps.ravel()[0]}") from error


def _in_time(stamps_s: FloatArray, frames: FloatArray) -> tuple[IntArray, FloatArray]:
    """Frames to keep, in the order of time, and their times from 0 on, s; a warning says what is changed."""
    from tofmix.io.importers.times import Twins, ascends, settled

    if stamps_s.shape != frames.shape[:1]:
        raise ValueError(f"time_s: expected one number a frame, {frames.shape[0]}, got shape {stamps_s.shape}")
    if ascends(stamps_s):
        return np.arange(stamps_s.size), stamps_s - stamps_s[:1]
    earlier = Twins()
    twins = [earlier.is_twin(float(stamp), frame) for stamp, frame in zip(stamps_s, frames, strict=True)]
    order = settled(stamps_s, np.array(twins, dtype=np.bool_))
    for remark in order.remarks:
        warnings.warn(f"from_array: {remark}", DoubtWarning, stacklevel=3)
    return order.order, order.time_s


def _status(status: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    codes = np.asarray(status)
    if codes.shape != shape:
        raise ValueError(f"status: expected the shape of ranges, {shape}, got {codes.shape}")
    return codes


def _valid_codes(given: tuple[int, ...] | None, sensor: Sensor | str | None) -> tuple[int, ...]:
    """Codes of valid samples: the given ones, or those of a built-in camera."""
    from tofmix.sensors import load_camera

    of_camera = load_camera(sensor).valid_status if given is None and isinstance(sensor, str) else given
    if not of_camera:
        raise ValueError("status: no codes of valid samples are known; give valid_status=(5, 9), or the sensor's own")
    return of_camera


def _say_doubts(
    range_mm: FloatArray, built_in: "Camera", camera: Sensor, dropped: dict[str, int], unit_mm: float
) -> None:
    """Warn of an image of another size, of values dropped unnamed, and of ranges that are not the camera's."""
    from tofmix.io.recording.range_check import implausible, is_outside, outside_doubt
    from tofmix.io.samples import guessed

    doubts = [built_in.size_doubt(range_mm.shape[-2:]) if range_mm.ndim >= IMAGE_RANK else ""]
    if unnamed := guessed(dropped):
        doubts.append(f"no samples: {unnamed}; keep_values=True keeps fill values")
    seen = range_mm[np.isfinite(range_mm)]
    if seen.size:
        doubt = implausible(float(np.median(seen)), camera, unit_mm=unit_mm, path=None)
        doubts.append(doubt or outside_doubt(float(is_outside(seen, camera).mean()), camera, "units"))
    elif range_mm.size:
        doubts.append(f"no valid sample: {', '.join(f'{number:,} {reason}' for reason, number in dropped.items())}")
    for text in filter(None, doubts):
        warnings.warn(f"from_array: {text}", DoubtWarning, stacklevel=3)


def _built_in(sensor: Sensor | str | None, integration_time_ms: float | None) -> "Camera":
    """The built-in camera of a name; empty for any other."""
    from tofmix.sensors import UNKNOWN, load_camera

    if not isinstance(sensor, str):
        return UNKNOWN
    camera = load_camera(sensor)
    return camera if integration_time_ms is None else replace(camera, integration_time_ms=integration_time_ms)
