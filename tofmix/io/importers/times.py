"""Times of frames: their units, and an order that a recording can hold.

A recording's times ascend from 0. Sources have clocks that are set back, messages out of order, and frames that were
stored twice; `settled` gives the frames to keep, their order and their times.
"""

import hashlib
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.wording import counted

_UNITS_S = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "millis": 1e-3,
    "millisecond": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "usec": 1e-6, "micros": 1e-6,
    "microsecond": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "nsec": 1e-9, "nanos": 1e-9, "nanosecond": 1e-9,
    "nanoseconds": 1e-9, "min": 60.0, "minute": 60.0, "minutes": 60.0, "h": 3600.0, "hr": 3600.0, "hour": 3600.0,
    "hours": 3600.0, "d": 86400.0, "day": 86400.0, "days": 86400.0,
}  # fmt: skip

SET_BACK_S = 1.0
"""A clock that goes back by more than this has been set, or started again; by less, messages overtook one another."""

_DIGITS = 9
"""Stamps are whole nanoseconds: those of ROS are, and floats that differ by less are equal."""

_EPOCH_S = 1.0e8, 1.0e10
"""Seconds since 1970 in the years 1973 to 2286."""


def time_unit_s(text: str) -> float | None:
    """Seconds of the unit that a text names, such as ``ms`` or CF's ``seconds since 2024-05-01``; None if unknown."""
    name = re.split(r"\s+since\s+", text.strip().lower())[0].strip()
    return _UNITS_S.get(name)


def epoch_unit_s(stamp: float) -> float | None:
    """Unit of a stamp that counts from 1970, told by its size; None where the stamp is no such number."""
    for unit_s in (1.0, 1e-3, 1e-6, 1e-9):
        if _EPOCH_S[0] <= stamp * unit_s < _EPOCH_S[1]:
            return unit_s
    return None


class Settled(NamedTuple):
    """Frames to keep, in order, and their times.

    `order` (kept,) are frames of the source; `time_s` (kept,) ascends from 0; `remarks` say what was changed.
    """

    order: IntArray
    time_s: FloatArray
    remarks: tuple[str, ...]


class Twins:
    """Marks frames that equal an earlier one of the same stamp."""

    def __init__(self) -> None:
        self._seen: set[tuple[float, bytes]] = set()

    def is_twin(self, stamp_s: float, frame: NDArray[Any]) -> bool:
        """Whether a frame has come before with this stamp, to the bit."""
        mark = stamp_s, hashlib.blake2b(np.ascontiguousarray(frame).data, digest_size=16).digest()
        known = mark in self._seen
        self._seen.add(mark)
        return known


def ascends(stamps_s: FloatArray) -> bool:
    """Whether each frame is later than the one before; also without any frames."""
    return bool(np.isfinite(stamps_s).all() and (np.diff(stamps_s) > 0).all())


def settled(stamps_s: FloatArray, same_as_before: BoolArray) -> Settled:
    """Settle the order and the times of frames.

    Frames of one clock that are out of order are sorted. A clock that goes back by more than `SET_BACK_S` is a new
    start: its frames follow one frame interval later. Of frames of the same stamp, one that equals an earlier one is
    left out, and others get a time between their neighbours'.

    Parameters
    ----------
    stamps_s : (frame,) float64
        Times of the frames as the source has them, s; NaN where one is missing.
    same_as_before : (frame,) bool
        Whether a frame equals an earlier one of the same stamp.
    """
    remarks: list[str] = []
    order = np.flatnonzero(~same_as_before)
    if twins := int(same_as_before.sum()):
        remarks.append(f"{_frames(twins)} equal to another of the same time left out")
    time_s = _filled(stamps_s[order], remarks)
    time_s = np.round(time_s - time_s.min(), _DIGITS)
    time_s = _restarted(time_s, order, remarks)
    sort = np.argsort(time_s, kind="stable")
    if moved := int(np.count_nonzero(sort != np.arange(sort.size))):
        remarks.append(f"{_frames(moved)} out of order sorted by time")
    order, time_s = order[sort], time_s[sort]
    time_s = _spread(time_s, remarks)
    return Settled(order, time_s - time_s[:1], tuple(remarks))


def _frames(count: int) -> str:
    return counted(count, "frame")


def _filled(time_s: FloatArray, remarks: list[str]) -> FloatArray:
    """Times with those that are missing between or beside their neighbours'."""
    known = np.isfinite(time_s)
    if known.all():
        return time_s
    if not known.any():
        remarks.append("no frame has a time; they are numbered, 1 s apart")
        return np.arange(time_s.size, dtype=np.float64)
    remarks.append(f"{_frames(int((~known).sum()))} without a time, which is put between the neighbours'")
    place = np.arange(time_s.size)
    filled = np.interp(place, place[known], time_s[known])
    step = _interval(time_s[known])
    first, last = place[known][0], place[known][-1]
    filled[:first] = filled[first] + (place[:first] - first) * step
    filled[last + 1 :] = filled[last] + (place[last + 1 :] - last) * step
    return filled


def _interval(time_s: FloatArray) -> float:
    """Median time from a frame to the next, of those that are later; 1 s without any."""
    steps = np.diff(time_s)
    later = steps[steps > 0]
    return float(np.median(later)) if later.size else 1.0


def _restarted(time_s: FloatArray, order: IntArray, remarks: list[str]) -> FloatArray:
    """Times in which a clock that was set back goes on."""
    backs = np.flatnonzero(np.diff(time_s) < -SET_BACK_S) + 1
    if not backs.size or _is_shuffled(time_s, backs):
        return time_s
    time_s, step = time_s.copy(), _interval(time_s)
    for start in backs:
        back = float(time_s[:start].max()) + step - time_s[start]
        time_s[start:] += back
        remarks.append(f"the clock is set back at frame {order[start]}; its frames follow one interval later")
    return time_s


def _is_shuffled(
    time_s: FloatArray, backs: IntArray, *, most_share: float = 0.1, gaps: tuple[float, float] = (0.3, 2.5)
) -> bool:
    """Whether frames of one clock are out of order, rather than a clock set back.

    They are if all times together, sorted, are those of one clock, without near twins and without gaps in units of
    their interval; or if the times go back at more than a share of the frames, for a clock is not set that often.
    """
    steps = np.diff(np.sort(time_s))
    interval = float(np.median(steps))
    if steps.min() >= gaps[0] * interval and steps.max() <= gaps[1] * interval:
        return True
    return backs.size > max(1.0, most_share * time_s.size)


def _spread(time_s: FloatArray, remarks: list[str]) -> FloatArray:
    """Ascending times in which those of the same stamp lie between this stamp and the next."""
    if not (np.diff(time_s) <= 0).any():
        return time_s
    starts = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > 0)
    sizes = np.diff(starts, append=time_s.size)
    stamps = time_s[starts]
    gaps = np.diff(stamps, append=stamps[-1] + _interval(stamps))
    within = np.arange(time_s.size) - np.repeat(starts, sizes)
    remarks.append(f"{_frames(int((sizes - 1).sum()))} of a time that another has; their times are put between")
    return np.repeat(stamps, sizes) + within * np.repeat(gaps / sizes, sizes)
