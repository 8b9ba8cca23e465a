"""From an open source to a recording, block by block: memory does not grow with the frames."""

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tofmix.errors import BadInputError
from tofmix.io.importers.base import BLOCK_BYTES, Frame, FrameSource
from tofmix.io.importers.conversion import Conversion
from tofmix.io.importers.times import Settled, Twins, ascends, settled
from tofmix.io.locks import scratch_folder
from tofmix.io.recording.range_check import refuse_metres
from tofmix.io.recording.recording_writer import CHUNK_FRAMES, RecordingWriter
from tofmix.io.samples import is_camera_matrix
from tofmix.recording import SAMPLE_BYTES
from tofmix.sensor import Sensor
from tofmix.wording import counted

Target = Literal["nearest", "strongest"]
"""Which of several targets is kept."""

_MATRIX = (1, 3, 3)  # frames, rows and columns that a camera matrix may have
_MEDIAN_SAMPLES = 1 << 14  # of a block, at most


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """Sizes of the written recording, and doubts."""

    # frames, samples, valid: Frames; samples; samples that are valid.
    frames: int
    samples: int
    valid: int
    outside: int  # valid samples outside the sensor's working range
    without_amplitude: int  # frames without an amplitude where the source has some; they hold NaN
    dropped: dict[str, int]  # values that were dropped, by reason
    median_mm: float | None  # median of some of the valid samples, mm; None without any
    remarks: tuple[str, ...] = ()  # changes of the order and the times of frames


def write_recording(
    source: FrameSource,
    output: Path,
    *,
    what: Path,
    sensor: Sensor,
    conversion: Conversion,
    again: Callable[[], AbstractContextManager[FrameSource]] | None = None,
    target: Target | None = None,
    frame_rate_hz: float | None = None,
    attributes: dict[str, str | int | float] | None = None,
    progress: Callable[[int], object] | None = None,
    overwrite: bool = False,
    inputs: tuple[Path, ...] = (),
) -> Imported:
    """Write the frames of a source as a recording, whose times ascend from 0.

    Times that do not ascend are settled by `tofmix.io.importers.times.settled`; the source is then read again.

    Parameters
    ----------
    source : FrameSource
        Frames; they are used up.
    output : Path
        The new recording.
    what : Path
        The source, for messages.
    conversion : Conversion
        From the source's numbers to ranges.
    again : callable, optional
        Opens the source a second time. Without it times that do not ascend are refused.
    target : {"nearest", "strongest"}, optional
        The one valid target of each pixel and frame that is kept, where pixels return several; all without it.
    frame_rate_hz : float, optional
        Gives `time` where the source has none.
    attributes : dict, optional
        Root attributes.
    progress : callable, optional
        Called with the frames of each block.
    overwrite, inputs
        As for `AtomicFile`.

    Returns
    -------
    Imported
        Counts.
    """
    layers = max(1, source.targets)
    frame_bytes = source.shape[1] * source.shape[2] * layers * SAMPLE_BYTES
    step = max(1, min(CHUNK_FRAMES, BLOCK_BYTES // frame_bytes))

    def written(frames: FrameSource, clock: _Clock) -> Imported:
        blocks = _Blocks(frames, what, sensor, conversion, clock, target, frame_rate_hz)
        with RecordingWriter(
            output,
            shape=frames.shape,
            targets=source.targets if target is None else 0,
            sensor=sensor,
            title=f"recording imported from {what.name}",
            has_amplitude=source.has_amplitude,
            has_time=source.has_time or frame_rate_hz is not None,
            dtype="u2" if conversion.stored_dtype == "u2" else "f4",
            chunk_frames=step,
            attributes=attributes,
            overwrite=overwrite,
            inputs=inputs,
        ) as writer:
            blocks.write(writer, step, progress)
        return blocks.tally.result(frames.shape[0])

    clock = _Clock()
    try:
        return written(source, clock)
    except _UnsettledError:
        if again is None:
            raise BadInputError(f"{what}: the times of its frames do not ascend") from None
    order = clock.settled()
    with again() as fresh, scratch_folder() as folder:
        imported = written(_in_order(fresh, order, folder), _Clock())
    return replace(imported, remarks=tuple(f"{what}: {remark}" for remark in order.remarks))


class _Blocks:
    """Converts frames in the order in which they come; arguments are those of `write_recording`."""

    def __init__(
        self,
        source: FrameSource,
        what: Path,
        sensor: Sensor,
        conversion: Conversion,
        clock: "_Clock",
        target: Target | None,
        rate: float | None,
    ) -> None:
        self._source, self._what, self._sensor, self._conversion = source, what, sensor, conversion
        self._clock, self._target, self._rate = clock, target, rate
        self._doubtful = conversion.is_doubtful
        self.tally = _Tally(sensor)

    def write(self, writer: RecordingWriter, step: int, progress: Callable[[int], object] | None) -> None:
        """Write all frames, `step` at once; `_UnsettledError` at the end if their times do not ascend."""
        frames, start = self._source.shape[0], 0
        while block := list(islice(self._source.frames, step)):
            if start + len(block) > frames:
                text = f"{counted(frames, 'frame')} declared, more found; write the source again"
                raise BadInputError(f"{self._what}: {text}")
            if start == 0 and self._source.shape == _MATRIX:
                _refuse_matrix(block[0].depth, self._what)
            ranges, amplitude = self._converted(block)
            time_s = self._clock.times_of(block) if self._source.has_time else _time(start, len(block), self._rate)
            writer.write(start, ranges, time_s=time_s, amplitude=amplitude)
            start += len(block)
            if progress is not None:
                progress(len(block))
        if start < frames:
            raise BadInputError(f"{self._what}: ends after {start} of {frames} frames; the rest of it is missing")
        if not self._clock.ascends:
            raise _UnsettledError

    def _converted(self, block: list[Frame]) -> tuple[Any, Any]:
        """Ranges, mm, and amplitudes, if there are any."""
        converted = [self._conversion(frame.depth, frame.status) for frame in block]
        ranges: Any = np.stack([one.range_mm for one in converted])
        amplitude: Any = _amplitude(block) if self._source.has_amplitude else None
        if self._target is not None:
            ranges, amplitude = one_target(ranges, amplitude, self._target)
        if self._doubtful and np.isfinite(ranges).any():
            refuse_metres(ranges, self._sensor, self._what)
            self._doubtful = False
        self.tally.add(ranges, block if self._source.has_amplitude else [])
        self.tally.drop(one.dropped for one in converted)
        return ranges, amplitude


def one_target(
    ranges: "np.ndarray[Any, Any]", amplitude: "np.ndarray[Any, np.dtype[np.float32]] | None", target: Target
) -> "tuple[np.ndarray[Any, Any], np.ndarray[Any, np.dtype[np.float32]] | None]":
    """One target of each pixel and frame, with its amplitude.

    Parameters
    ----------
    ranges : (frame, target, row, col) uint16 or float32
        Ranges, mm; 0 or NaN where there is no target.
    amplitude : (frame, target, row, col) float32, optional
        Of each target.
    target : {"nearest", "strongest"}
        Least range, or largest amplitude, among the valid targets. A target without an amplitude is the weakest.

    Returns
    -------
    (frame, row, col) arrays
        Of the same types; invalid where no target is valid.

    Raises
    ------
    ValueError
        If the strongest is asked for, and there are no amplitudes.
    """
    valid = np.isfinite(ranges) if ranges.dtype.kind == "f" else ranges != 0
    if target == "nearest":
        rank = np.where(valid, ranges, np.inf)
    elif amplitude is None:
        raise ValueError("the strongest target is not known without amplitudes")
    else:
        rank = np.where(valid, -np.nan_to_num(amplitude, nan=0.0), np.inf)
    best = rank.argmin(axis=1)[:, None]
    kept = np.take_along_axis(ranges, best, axis=1)[:, 0]
    return kept, None if amplitude is None else np.take_along_axis(amplitude, best, axis=1)[:, 0]


class _UnsettledError(Exception):
    """The times of the frames do not ascend; nothing was written."""


class _Clock:
    """Times of the frames as they come, and marks of frames that are equal to an earlier one of the same time."""

    def __init__(self) -> None:
        self._stamps_s: list[float] = []
        self._earlier = Twins()
        self._twins: list[bool] = []
        self._starts: list[int] = []

    def times_of(self, block: list[Frame]) -> "np.ndarray[Any, np.dtype[np.float64]]":
        """Times of some frames, s, from the first frame on."""
        for frame in block:
            stamp = math.nan if frame.time_s is None else frame.time_s
            if frame.new_start:
                self._starts.append(len(self._stamps_s))
                self._earlier = Twins()
            self._twins.append(self._earlier.is_twin(stamp, frame.depth))
            self._stamps_s.append(stamp)
        return np.array(self._stamps_s[-len(block) :]) - self._stamps_s[0]

    @property
    def ascends(self) -> bool:
        """Whether each frame is later than the one before; also without any times."""
        return ascends(np.array(self._stamps_s))

    def settled(self) -> Settled:
        """The frames to keep, their order and their times."""
        starts = np.array(self._starts, dtype=np.int64)
        return settled(np.array(self._stamps_s), np.array(self._twins, dtype=np.bool_), starts)


def _in_order(source: FrameSource, order: Settled, folder: Path) -> FrameSource:
    """The frames of a source in another order: kept in a folder meanwhile, so that memory does not grow with them."""
    kept: dict[str, np.memmap[Any, Any]] = {}
    held = np.zeros(source.shape[0], dtype=np.bool_)
    for number, frame in enumerate(source.frames):
        for name in ("depth", "amplitude", "status"):
            image = getattr(frame, name)
            if image is None:
                continue
            if name not in kept:
                shape = (source.shape[0], *image.shape)
                kept[name] = np.memmap(folder / name, dtype=image.dtype, mode="w+", shape=shape)
            kept[name][number] = image
            held[number] |= name == "amplitude"

    def images() -> Iterator[Frame]:
        for number, time_s in zip(order.order, order.time_s, strict=True):
            amplitude = kept["amplitude"][number] if held[number] else None
            status = kept["status"][number] if "status" in kept else None
            yield Frame(depth=kept["depth"][number], amplitude=amplitude, status=status, time_s=float(time_s))

    return replace(source, shape=(len(order.order), *source.shape[1:]), frames=images())


def _refuse_matrix(depth: "np.ndarray[Any, Any]", what: Path) -> None:
    """Refuse a camera matrix, which is no image."""
    if is_camera_matrix(depth):
        raise BadInputError(f"{what}: one 3 x 3 array that ends in 0 0 1 is a camera matrix, not depths")


def _time(start: int, count: int, rate: float | None) -> "np.ndarray[Any, Any] | None":
    return None if rate is None else (start + np.arange(count)) / rate


def _amplitude(block: list[Frame]) -> "np.ndarray[Any, np.dtype[np.float32]]":
    nothing = np.full(block[0].depth.shape, np.nan, dtype=np.float32)
    with np.errstate(over="ignore"):
        images = [nothing if frame.amplitude is None else frame.amplitude.astype(np.float32) for frame in block]
    return np.stack(images)


class _Tally:
    """Counts over blocks."""

    def __init__(self, sensor: Sensor) -> None:
        self._limits = sensor.range_min_mm or 0.0, sensor.range_max_mm or math.inf
        self._samples = self._valid = self._outside = self._without = 0
        self._dropped: dict[str, int] = {}
        self._some: list[np.ndarray[Any, Any]] = []

    def add(self, ranges: "np.ndarray[Any, Any]", with_amplitude: list[Frame]) -> None:
        valid = np.isfinite(ranges) if ranges.dtype.kind == "f" else ranges != 0
        outside = valid & ((ranges < self._limits[0]) | (ranges > self._limits[1]))
        seen = ranges[valid]
        self._some.append(seen[:: 1 + seen.size // _MEDIAN_SAMPLES].astype(np.float32))
        self._samples += ranges.size
        self._valid += int(valid.sum())
        self._outside += int(outside.sum())
        self._without += sum(frame.amplitude is None for frame in with_amplitude)

    def drop(self, counts: Iterable[dict[str, int]]) -> None:
        for count in counts:
            for reason, number in count.items():
                self._dropped[reason] = self._dropped.get(reason, 0) + number

    def result(self, frames: int) -> Imported:
        some = np.concatenate(self._some) if self._some else np.zeros(0, dtype=np.float32)
        return Imported(
            frames=frames,
            samples=self._samples,
            valid=self._valid,
            outside=self._outside,
            without_amplitude=self._without,
            dropped=self._dropped,
            median_mm=float(np.median(some)) if some.size else None,
        )
