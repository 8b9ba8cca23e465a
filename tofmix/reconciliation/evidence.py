"""Recordings in memory, and the frames and pixels that fits may use.

Several recordings of one camera are joined frame after frame, because their pixels are the same. Frames are held out in
short blocks: with long blocks a rare burst would lie on one side only. Pixels are held out in square blocks: otherwise
an effect that gives each pixel its own bias would explain every static bias.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.simulation.model import Model
from tofmix.wording import counted

BLOCK_FRAMES = 5  # held out together, at most a quarter of the recording
BLOCK_PIXELS = 4  # side of a square that is held out
LEAST_PIXELS = 12  # of a surface or a part of the image, for a median, or a pose of three numbers
_LEAST_FRAMES = 8  # four blocks of two: two to fit and two to judge


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangedPart:
    """A part of the image in which a recording shows something else than the measured scene.

    Parameters
    ----------
    is_new : bool
        Whether something new is seen, at another range than all surfaces; else what stood there has gone, and a surface
        behind it is seen.
    surfaces : tuple of str
        What the measured scene has there.
    rows, cols : (int, int)
        First and last.
    pixels : int
        Their number.
    range_mm, before_mm : float
        Medians of the ranges that are seen, and of those of the measured scene; None if it has no surface there.
    """

    is_new: bool
    surfaces: tuple[str, ...]
    rows: tuple[int, int]
    cols: tuple[int, int]
    pixels: int
    range_mm: float
    before_mm: float | None

    @property
    def moved_mm(self) -> float | None:
        """Seen minus earlier range; None if there was no surface."""
        return None if self.before_mm is None else self.range_mm - self.before_mm

    def as_dict(self) -> dict[str, Any]:
        """As `gap.json` has it."""
        numbers = {"range_mm": self.range_mm, "before_mm": self.before_mm}
        return {
            "change": "new" if self.is_new else "gone",
            "surfaces": list(self.surfaces),
            "rows": list(self.rows),
            "cols": list(self.cols),
            "pixels": self.pixels,
            **{name: None if value is None else round(value, 1) for name, value in numbers.items()},
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """One recording, or several of one camera frame after frame, as (frame, pixel).

    Parameters
    ----------
    samples : (frame, pixel) uint16
        Whole mm, 0 where invalid.
    time_s : (frame,) float64
        Time since the first frame of its recording, s.
    image : (int, int)
        Rows, columns.
    fit_frames : (frame,) bool
        Frames that fits may use.
    fit_pixels : (pixel,) bool
        Pixels that fits may use before gains are scored.
    starts : tuple of int
        The first frame of each recording.
    amplitude : (pixel,) float64 or None
        Median amplitude of each pixel's valid samples, NaN where there is none; of one recording by itself.
    temperature_c : (frame,) float64 or None
        Of one recording by itself.
    integration_time_ms : float or None
        Of one sample, as the first recording has it; None if it is not known.
    repeated : int
        Number of frames that were left out, because they repeat the frame before sample by sample.
    others : (pixel,) bool or None
        Pixels that were left out, because they do not follow what moves; None if none were.
    changed : tuple of ChangedPart
        Parts of a measured scene that have changed; their pixels and those of their edges were left out.
    """

    samples: NDArray[np.uint16]
    time_s: FloatArray
    image: tuple[int, int]
    fit_frames: BoolArray
    fit_pixels: BoolArray
    starts: tuple[int, ...] = (0,)
    amplitude: FloatArray | None = None
    temperature_c: FloatArray | None = None
    integration_time_ms: float | None = None
    repeated: int = 0
    others: BoolArray | None = None
    changed: tuple[ChangedPart, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Frames, pixels."""
        frames, pixels = self.samples.shape
        return frames, pixels

    @property
    def recordings(self) -> tuple[slice, ...]:
        """The frames of each recording."""
        stops = (*self.starts[1:], len(self.samples))
        return tuple(slice(start, stop) for start, stop in zip(self.starts, stops, strict=True))

    @property
    def frame_number(self) -> IntArray:
        """Number (frame,) of each frame in its recording; numbers of different recordings are far apart."""
        lengths = [r.stop - r.start for r in self.recordings]
        apart = 1_000_000  # frame numbers between two recordings: longer than any burst, a multiple of any block
        return np.concatenate([np.arange(n) + k * apart for k, n in enumerate(lengths)])

    def recording(self, frames: slice) -> "Evidence":
        """One of the recordings, not copied."""
        if len(self.starts) == 1:
            return self
        own = (self.samples[frames], self.time_s[frames], self.fit_frames[frames])
        return replace(self, samples=own[0], time_s=own[1], fit_frames=own[2], starts=(0,))

    def part(self, *, fit: bool, split: str = "frames,pixels") -> tuple[IntArray, IntArray]:
        """Frames and pixels of the fitting data, or of the held-out data.

        A single pixel cannot be split; it is in both.
        """
        frames = self.fit_frames == fit if "frames" in split else np.ones(self.shape[0], dtype=bool)
        pixels = self.fit_pixels == fit if "pixels" in split else np.ones(self.shape[1], dtype=bool)
        if not pixels.any():
            pixels[:] = True
        return np.flatnonzero(frames), np.flatnonzero(pixels)


def make_evidence(
    model: Model,
    range_mm: FloatArray | Float32Array,
    *,
    time_s: FloatArray | None = None,
    amplitude: FloatArray | Float32Array | None = None,
    temperature_c: FloatArray | None = None,
    integration_time_ms: float | None = None,
    begins_s: float = 0.0,
) -> Evidence:
    """Prepare a recording for reconciliation.

    Parameters
    ----------
    model : Model
        The model with which it is compared.
    range_mm : (frame, row, col) float
        Samples in mm, NaN where invalid.
    time_s : (frame,), optional
        Start of each frame, s; without it, from the model's frame rate.
    amplitude : (frame, row, col), optional
        Of each sample, NaN where it has none.
    temperature_c : (frame,), optional
        The camera's.
    integration_time_ms : float, optional
        The recording's, of one sample.
    begins_s : float
        Time of the first frame: since the middle of the reference, if it is the beginning of the same recording.

    Raises
    ------
    BadInputError
        If pixels have several targets, the image differs from the model's camera, no sample is valid, most samples are
        far below its range, the times do not ascend, or there are too few frames to hold some out. Frames that repeat
        the one before do not count. Frames of one time are put between this time and the next.
    """
    dimensions = 3  # of samples: frame, row, col
    if range_mm.ndim != dimensions:
        raise BadInputError(
            f"range: {range_mm.ndim} dimensions instead of frame, row and col; of several targets keep one:"
            " tofmix import --target nearest"
        )
    frames, rows, cols = range_mm.shape
    if (rows, cols) != (model.sensor.rows, model.sensor.cols):
        raise BadInputError(
            f"range: an image of {rows} x {cols} pixels; the model's camera has "
            f"{model.sensor.rows} x {model.sensor.cols}; give [sensor] of the model rows = {rows}, cols = {cols}, or"
            " take the recording of that camera"
        )
    if frames < _LEAST_FRAMES:
        raise BadInputError(
            f"range: {counted(frames, 'frame')}; at least {_LEAST_FRAMES} are needed, to hold some out: record"
            f" {_LEAST_FRAMES - frames} more"
        )
    valid = np.isfinite(range_mm)
    if not valid.any():
        raise BadInputError("range: no sample is valid")
    middle, most = float(np.median(range_mm[valid])), model.sensor.range_max_mm
    far_below = 0.002  # of the largest range; values in metres are a thousandth
    if middle < far_below * most:
        raise BadInputError(
            f"range: half of the samples are below {middle:.3g} mm, of a camera that measures up to {most:g} mm; "
            "are they in metres?"
        )
    samples = np.where(valid, np.clip(np.rint(np.nan_to_num(range_mm)), 1, 65_534), 0).astype(np.uint16)
    now = np.arange(frames) / model.recording.frame_rate_hz if time_s is None else np.asarray(time_s, dtype=np.float64)
    now = _told_apart(now)
    new = ~_repeats(samples)
    if new.sum() < _LEAST_FRAMES:
        raise BadInputError(
            f"range: {counted(int(frames - new.sum()), 'frame')} of {frames} repeat the frame before sample by sample;"
            f" at least {_LEAST_FRAMES} others are needed, to hold some out"
        )
    samples, now, valid = samples[new], now[new], valid[new]
    if amplitude is not None:
        amplitude = amplitude[new]
    if temperature_c is not None:
        temperature_c = np.asarray(temperature_c, dtype=np.float64)[new]
    block = np.arange(len(now)) // min(BLOCK_FRAMES, len(now) // 4) % 2 == 0
    row, col = np.divmod(np.arange(rows * cols), cols)
    size = BLOCK_PIXELS if max(rows, cols) >= 2 * BLOCK_PIXELS else 1
    pixel_block = (row // size + col // size) % 2 == 0
    return Evidence(
        samples=samples.reshape(len(now), rows * cols),
        time_s=now - now[0] + begins_s,
        image=(rows, cols),
        fit_frames=block,
        fit_pixels=pixel_block,
        amplitude=None if amplitude is None else _typical(amplitude, valid).reshape(-1),
        temperature_c=None if temperature_c is None else np.asarray(temperature_c, dtype=np.float64),
        integration_time_ms=integration_time_ms,
        repeated=int(frames - new.sum()),
    )


def _told_apart(time_s: FloatArray) -> FloatArray:
    """Times (frame,), s, that ascend: frames of one stamp lie evenly between this stamp and the next.

    Some drivers give two frames one stamp now and then.

    Raises
    ------
    BadInputError
        If a time is not finite, the times descend, or all are equal.
    """
    steps = np.diff(time_s)
    back = np.flatnonzero(~(steps >= 0))
    if back.size or not np.isfinite(time_s).all():
        frame = int(back[0]) + 1 if back.size else int(np.flatnonzero(~np.isfinite(time_s))[0])
        raise BadInputError(
            f"time: the frames' times do not ascend: frame {frame} has {time_s[frame]:g} s; tofmix import puts frames"
            " in order"
        )
    starts = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > 0)
    if starts.size == 1 < time_s.size:
        raise BadInputError(
            f"time: the frames' times do not ascend: all are {time_s[0]:g} s; leave the dataset out, and the model's"
            " frame_rate_hz is used"
        )
    if starts.size == time_s.size:
        return time_s
    stamps, sizes = time_s[starts], np.diff(starts, append=time_s.size)
    gaps = np.diff(stamps, append=stamps[-1] + np.median(np.diff(stamps)))
    within = np.arange(time_s.size) - np.repeat(starts, sizes)
    return np.asarray(np.repeat(stamps, sizes) + within * np.repeat(gaps / sizes, sizes))


def _repeats(samples: NDArray[np.uint16]) -> BoolArray:
    """Whether each frame (frame,) of an image (frame, row, col) repeats the one before, as some drivers deliver it.

    Pixels that never change are ignored. There must be enough others, so that noise alone gives no repetition.
    """
    alive = (samples != samples[0]).any(axis=0)
    out = np.zeros(len(samples), dtype=bool)
    least_alive = 8  # pixels whose samples change
    if alive.sum() >= least_alive:
        out[1:] = [bool((now[alive] == before[alive]).all()) for before, now in pairwise(samples)]
    return out


def _typical(amplitude: FloatArray | Float32Array, valid: BoolArray) -> FloatArray:
    """Median over frames (row, col) of valid samples, row by row to save memory; NaN where there is none."""
    out = np.full(amplitude.shape[1:], np.nan)
    for row in range(len(out)):
        values = np.where(valid[:, row], amplitude[:, row], np.nan)
        some = np.isfinite(values).any(axis=0)
        out[row, some] = np.nanmedian(values[:, some], axis=0)
    return out


def join(recordings: Sequence[Evidence]) -> Evidence:
    """Put recordings of one camera, each of one image, frame after frame."""
    if len(recordings) == 1:
        return recordings[0]
    lengths = [e.shape[0] for e in recordings]
    return replace(
        recordings[0],
        samples=np.concatenate([e.samples for e in recordings]),
        time_s=np.concatenate([e.time_s for e in recordings]),
        fit_frames=np.concatenate([e.fit_frames for e in recordings]),
        amplitude=None,
        temperature_c=None,
        starts=tuple(int(n) for n in np.cumsum([0, *lengths[:-1]])),
        repeated=sum(e.repeated for e in recordings),
    )
