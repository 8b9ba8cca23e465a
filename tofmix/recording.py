"""A recording: its sizes, its sensor, and blocks of samples.

Anything with the methods of `SampleSource` can be estimated: a file
(`tofmix.io.recording.recording_file`), or an array in memory (`ArrayRecording`).

Use `independent_samples` before samples are fitted, or noise is learnt from them: a camera that filters ranges over
time is then read as its independent samples. Without a filter it is the recording.
"""

import hashlib
from collections.abc import Callable
from copy import copy
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import Float32Array
from tofmix.sensor import Sensor
from tofmix.sensor_schema import NUMBERS
from tofmix.temporal_filter import TemporalFilter

_DIMS = ("frame", "row", "col")

MOST_PIXELS_A_SIDE = int(NUMBERS["rows"].high)
"""Of an image, as for a camera; a damaged header must not ask for terabytes."""

MOST_FRAMES = 1 << 26  # of a recording: a month at 25 Hz

MOST_TARGETS = 64
"""Targets that a pixel returns in one frame; lidars and zone sensors return up to four."""

SAMPLE_BYTES = np.dtype(np.float32).itemsize
"""A sample in memory."""

DECODED_SAMPLES = 1 << 20
"""About how many samples a source may hold in their stored form while it reads, where stored chunks are smaller."""


class SampleSource(Protocol):
    """A recording that can be read in blocks."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""

    @property
    def sensor(self) -> Sensor:
        """The camera."""

    @property
    def row_step(self) -> int:
        """Rows that are stored together: blocks of a multiple of it are read fastest."""

    @property
    def frame_step(self) -> int:
        """Frames that are stored together, likewise."""

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""


@runtime_checkable
class TargetSource(Protocol):
    """A recording whose pixels may return several targets in one frame.

    Its `shape`, its steps and its blocks count samples: the targets of a frame follow each other.
    """

    @property
    def targets(self) -> int:
        """Targets that a pixel returns in one frame at most; 0 for a recording without such an axis."""


class CameraSource(SampleSource, Protocol):
    """A recording that a job reads: it has a name for messages, and can be read as that of another camera."""

    @property
    def name(self) -> str:
        """The file, or ``array``."""

    @property
    def averaged(self) -> bool:
        """Whether its frames are marked as means that the camera made."""

    @property
    def targets(self) -> int:
        """As of a `TargetSource`."""

    @property
    def has_amplitude(self) -> bool:
        """As of an `AmplitudeSource`."""

    def with_sensor(self, sensor: Sensor) -> Self:
        """The same samples, not copied, of another camera."""

    def sha256(self) -> str:
        """Checksum of the file, or of the samples."""


@runtime_checkable
class TypedSource(Protocol):
    """A recording that knows the type of its stored ranges."""

    @property
    def stored_type(self) -> str:
        """Type of the stored ranges, such as ``uint16``."""


def samples_a_frame(source: SampleSource) -> int:
    """Samples that a recording holds of each pixel and frame: its targets, or 1."""
    return max(1, source.targets) if isinstance(source, TargetSource) else 1


class SourceAround:
    """A recording that is read from another: its camera, shape and steps are that one's, unless a class says more."""

    def __init__(self, source: SampleSource) -> None:
        self._source = source

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        return self._source.sensor

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""
        return self._source.shape

    @property
    def row_step(self) -> int:
        """Rows that are stored together."""
        return self._source.row_step

    @property
    def frame_step(self) -> int:
        """Frames that are stored together."""
        return self._source.frame_step


class _AroundAmplitudes(SourceAround):
    """Such a recording, with the amplitudes of the other one."""

    @property
    def has_amplitude(self) -> bool:
        """Whether the recording has amplitudes."""
        return amplitude_source(self._source) is not None

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes (frame, row, col) float32, as they are stored; a ValueError if there are none."""
        return self._light().read_amplitude(frames, rows)

    def _light(self) -> "AmplitudeSource":
        light = amplitude_source(self._source)
        if light is None:
            raise ValueError("the recording has no amplitudes")
        return light


class TargetSeries(_AroundAmplitudes):
    """A recording with each target as a separate pixel: (frame, row and target, col); no array is copied.

    Use it where the samples of a pixel must follow each other in time, as for its noise.

    Parameters
    ----------
    source : SampleSource
        The recording.
    """

    def __init__(self, source: SampleSource) -> None:
        super().__init__(source)
        self._targets = samples_a_frame(source)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows times targets, columns."""
        samples, rows, cols = self._source.shape
        return samples // self._targets, rows * self._targets, cols

    @property
    def row_step(self) -> int:
        """Rows that are stored together."""
        return self._source.row_step * self._targets

    @property
    def frame_step(self) -> int:
        """Frames that are stored together."""
        return max(1, self._source.frame_step // self._targets)

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row and target, col) float32 in mm, NaN where invalid."""
        return self._by_target(self._source.read_range, frames, rows)

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes of the same shape; a ValueError if there are none."""
        return self._by_target(self._light().read_amplitude, frames, rows)

    def _by_target(self, read: Callable[[slice, slice], Float32Array], frames: slice, rows: slice) -> Float32Array:
        count, (length, height, cols) = self._targets, self.shape
        first, last, _ = frames.indices(length)
        top, bottom, _ = rows.indices(height)
        high = slice(top // count, -(-bottom // count))
        block = read(slice(first * count, last * count), high)
        by_row = block.reshape(last - first, count, high.stop - high.start, cols).transpose(0, 2, 1, 3)
        whole = by_row.reshape(last - first, (high.stop - high.start) * count, cols)
        return whole[:, top - high.start * count : bottom - high.start * count]


def by_target(source: SampleSource) -> SampleSource:
    """A recording with each target as a separate pixel; the recording itself if it has no targets."""
    return TargetSeries(source) if samples_a_frame(source) > 1 else source


@runtime_checkable
class AmplitudeSource(Protocol):
    """A recording that may know the amplitude of its samples."""

    @property
    def has_amplitude(self) -> bool:
        """Whether it does."""

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes (frame, row, col) float32; NaN where one is not known."""


def amplitude_source(source: SampleSource) -> AmplitudeSource | None:
    """Return the recording itself where it knows the amplitude of its samples."""
    return source if isinstance(source, AmplitudeSource) and source.has_amplitude else None


def wanted_amplitudes(source: SampleSource, *, phasors: bool = False) -> AmplitudeSource | None:
    """The recording's amplitudes, if the noise curve or the phasors need them."""
    noise = source.sensor.noise
    return amplitude_source(source) if phasors or (noise is not None and noise.law is not None) else None


def has_phasors(source: SampleSource) -> bool:
    """Whether the samples are phasors: amplitudes and one modulation frequency are known, one sample a frame."""
    known = source.sensor.modulation_frequency_hz is not None and amplitude_source(source) is not None
    return known and samples_a_frame(source) == 1


class ArrayRecording:
    """A recording in memory.

    Parameters
    ----------
    range_mm : (frame, row, col) array_like of float32
        Samples, mm; NaN or infinite where invalid. They are copied.
    sensor : Sensor
        The camera.
    amplitude : (frame, row, col) array_like of float32, optional
        Amplitude of each sample. They are copied.
    averaged : bool
        Whether the samples are marked as means that the camera made.

    Raises
    ------
    ValueError
        If the samples do not have three dimensions, or there are none, or the amplitudes have another shape.
    """

    name = "array"
    targets = 0

    def __init__(
        self, range_mm: ArrayLike, sensor: Sensor, amplitude: ArrayLike | None = None, *, averaged: bool = False
    ) -> None:
        self.averaged = averaged
        self._samples: Float32Array = np.array(range_mm, dtype=np.float32, copy=True)
        if self._samples.ndim != len(_DIMS) or self._samples.size == 0:
            raise ValueError(f"range: expected (frame, row, col), got shape {self._samples.shape}")
        self._samples[~np.isfinite(self._samples)] = np.nan
        self._sensor = sensor
        self._amplitude = None if amplitude is None else np.array(amplitude, dtype=np.float32, copy=True)
        if self._amplitude is not None and self._amplitude.shape != self._samples.shape:
            raise ValueError(f"amplitude: shape {self._amplitude.shape} differs from range {self._samples.shape}")

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        return self._sensor

    def with_sensor(self, sensor: Sensor) -> Self:
        """The same samples, not copied, of another camera."""
        other = copy(self)
        other._sensor = sensor  # noqa: SLF001  of its own class
        return other

    def sha256(self) -> str:
        """SHA-256 of the ranges."""
        return hashlib.sha256(np.ascontiguousarray(self._samples).tobytes()).hexdigest()

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""
        frames, rows, cols = self._samples.shape
        return frames, rows, cols

    @property
    def row_step(self) -> int:
        """Any number of rows is as good."""
        return 1

    @property
    def frame_step(self) -> int:
        """Any number of frames is as good."""
        return 1

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""
        return self._samples[frames, rows]

    @property
    def has_amplitude(self) -> bool:
        """Whether amplitudes were given."""
        return self._amplitude is not None

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes (frame, row, col) float32.

        Raises
        ------
        ValueError
            If there are none.
        """
        if self._amplitude is None:
            raise ValueError("the recording has no amplitudes")
        return self._amplitude[frames, rows]


class FrameSpan(SourceAround):
    """Some frames of a recording, as a recording of their own; nothing is copied.

    Parameters
    ----------
    source : SampleSource
        The recording.
    start, stop : int
        Its frames [start, stop), with all their targets.

    Raises
    ------
    ValueError
        If the recording has no such frames.
    """

    def __init__(self, source: SampleSource, start: int, stop: int) -> None:
        each = samples_a_frame(source)
        if not 0 <= start < stop <= source.shape[0] // each:
            raise ValueError(f"frames {start} to {stop} asked for, the recording has {source.shape[0] // each}")
        super().__init__(source)
        self._start, self._stop = start * each, stop * each

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""
        return self._stop - self._start, *self._source.shape[1:]

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""
        first, last, step = frames.indices(self._stop - self._start)
        return self._source.read_range(slice(self._start + first, self._start + last, step), rows)


class IndependentSamples(_AroundAmplitudes):
    """A recording with its filter undone; frames that add no sample are invalid. Nothing is kept in memory.

    Parameters
    ----------
    source : SampleSource
        The recording, as the camera stored it.
    filter_ : TemporalFilter
        The camera's filter.
    marks : bool
        Whether frames that add no sample are infinite: they are not lost, as the invalid ones are.
    """

    def __init__(self, source: SampleSource, filter_: TemporalFilter, *, marks: bool = False) -> None:
        super().__init__(source)
        self._filter, self._marks = filter_, marks

    @property
    def targets(self) -> int:
        """Targets that a pixel returns in one frame at most."""
        return self._source.targets if isinstance(self._source, TargetSource) else 0

    @property
    def stored_type(self) -> str:
        """Type of the ranges, such as ``uint16``; that of the samples where they are no longer the stored values."""
        if self._filter.keeps_values and isinstance(self._source, TypedSource):
            return self._source.stored_type
        return "float32"

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Independent samples (frame, row, col) float32 in mm, not finite where there is none."""
        first, last, step = frames.indices(self.shape[0])
        spans = self._filter.spans(first, last, self.shape[0])
        found = np.concatenate([self._samples(span, rows) for span in spans] or [self._source.read_range(frames, rows)])
        start = spans[0].start if spans else first
        return np.ascontiguousarray(found[first - start : last - start : step])

    def _samples(self, span: slice, rows: slice) -> Float32Array:
        """Independent samples of a span of frames."""
        stored = self._source.read_range(span, rows)
        found = self._filter.independent(stored, span.start)
        if not self._marks:
            return found
        adds_none = np.where(np.isfinite(stored), np.float32(np.inf), np.float32(np.nan))
        return np.where(np.isfinite(found), found, adds_none)


def independent_samples(source: SampleSource, *, for_noise: bool = False) -> SampleSource:
    """The recording as its independent samples; the recording itself if its sensor has no filter.

    With `for_noise`, those that noise is learnt from (`TemporalFilter.for_noise`).
    """
    found = source.sensor.temporal_filter
    if found is None or isinstance(source, IndependentSamples):
        return source
    used = found.for_noise() if for_noise else found.with_noise(source.sensor.noise)
    return IndependentSamples(source, used, marks=not for_noise)
