"""Times of frames: their units, and an order that a recording can hold.

A recording's times ascend from 0. Sources have clocks that are set back, messages out of order, and frames that were
stored twice; `settled` gives the frames to keep, their order and their times.
"""

import hashlib
import re
from bisect import bisect_right, insort
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.wording import counted

_UNITS_S = {
    name: unit_s
    for unit_s, names in {
        1.0: "s sec secs second seconds",
        1e-3: "ms msec millis millisecond milliseconds",
        1e-6: "us µs μs usec micros microsecond microseconds",
        1e-9: "ns nsec nanos nanosecond nanoseconds",
        60.0: "min minute minutes",
        3600.0: "h hr hour hours",
        86400.0: "d day days",
    }.items()
    for name in names.split()
}


_EPOCH_S = 1.0e8, 1.0e10
"""Seconds since 1970 in the years 1973 to 2286."""

_MOST_S = 2**63 / 1e9
"""Clocks count nanoseconds in 64 bits with a sign; a larger stamp is damaged."""

_EXACT = 2.0**62
"""Whole numbers below this have a difference in 64 bits."""

_SLOWEST_S = 5.0
"""Frames farther apart than this are more likely in another unit than s."""

_REGULAR = 0.3, 2.5
"""Steps of one clock between its frames in order, in units of its interval: some frames are late, or lost."""


_SET, _COUNTED, _APART = "is set back", "starts again with the count of frames", "is apart from its neighbours'"
_NEW_STARTS = (_SET, _COUNTED)

_SHUFFLED = 1 / 3
"""Share of steps back. Frames in random order go back at half of the steps; a clock is not set that often."""


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


def unit_of_stamps(stamps: FloatArray, what: str) -> tuple[float, tuple[str, ...]]:
    """Unit of stamps for which no unit is stated, s, and a note where their size tells it.

    Stamps that count from 1970 show their unit; others are in s if frames follow one another within `_SLOWEST_S`.

    Parameters
    ----------
    stamps : (n,) float64
        Stamps of some frames, NaN where missing.
    what : str
        The source and the name of the stamps, for messages.
    """
    known = stamps[np.isfinite(stamps)]
    if not known.size:
        return 1.0, ()
    epoch_s = epoch_unit_s(float(np.median(known)))
    unit_s = epoch_s or 1.0
    steps = np.diff(np.unique(known))
    step_s = float(np.median(steps)) * unit_s if steps.size else 0.0
    if step_s > _SLOWEST_S:
        step = step_s / unit_s
        likely = next((text for text in ("ms", "us", "ns") if step * _UNITS_S[text] <= _SLOWEST_S), "s")
        others = ", ".join(text for text in ("s", "ms", "us", "ns") if text != likely)
        raise BadInputError(
            f"{what}: no unit, and frames would be {step:g} s apart; give --time-unit {likely} (or {others})"
        )
    if unit_s == 1.0:
        return 1.0, ()
    name = next(text for text in ("ms", "us", "ns") if _UNITS_S[text] == unit_s)
    return unit_s, (f"{what}: numbers of this size are taken as {name} since 1970",)


def times_of_array(
    stored: NDArray[Any], frames: int, what: str, unit_s: float | None = None
) -> tuple[FloatArray, tuple[str, ...]]:
    """Times of the frames, s, of an array of numbers, dates or durations, and notes.

    Parameters
    ----------
    stored : array of int, float, datetime64 or timedelta64
        One entry a frame.
    frames : int
        Number of frames.
    what : str
        The source and the name of the array, for messages.
    unit_s : float, optional
        Unit of the numbers, where it is given or stated; `unit_of_stamps` decides without it.
    """
    if stored.size != frames or stored.dtype.kind not in "iufMm":
        raise BadInputError(f"{what}: expected {frames} numbers, got {stored.dtype} of shape {stored.shape}")
    stamps = stored.reshape(-1)
    if stamps.dtype.kind in "Mm":
        known = stamps[~np.isnat(stamps)]
        since = stamps - known[0] if known.size else stamps - stamps
        return np.asarray(since / np.timedelta64(1, "s"), dtype=np.float64), ()
    notes: tuple[str, ...] = ()
    if unit_s is None:
        unit_s, notes = unit_of_stamps(stamps.astype(np.float64), what)
    if stamps.dtype.kind == "i" and np.abs(stamps.astype(np.float64)).max(initial=0.0) < _EXACT:
        stamps = stamps.astype(np.int64) - int(stamps[:1].sum())  # float64 has no nanoseconds since 1970
    return stamps.astype(np.float64) * unit_s, notes


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


def settled(stamps_s: FloatArray, same_as_before: BoolArray, starts: IntArray | None = None) -> Settled:
    """Settle the order and the times of frames.

    Frames of one clock that are out of order are sorted. A clock that goes back by more than a second is a new
    start: its frames follow one frame interval later. Of frames of the same stamp, one that equals an earlier one is
    left out, and others get a time between their neighbours'.

    Parameters
    ----------
    stamps_s : (frame,) float64
        Times of the frames as the source has them, s; NaN where one is missing.
    same_as_before : (frame,) bool
        Whether a frame equals an earlier one of the same stamp.
    starts : (n,) int64, optional
        Frames at which the source is known to start again, in ascending order; there the clock may go back by less.
    """
    remarks: list[str] = []
    order = np.flatnonzero(~same_as_before)
    if twins := int(same_as_before.sum()):
        remarks.append(f"{_frames(twins)} equal to another of the same time left out")
    time_s = _possible(stamps_s[order], remarks)
    begins = np.unique(np.searchsorted(order, [] if starts is None else starts))
    time_s = _restarted(time_s, order, begins[begins < order.size].tolist(), remarks)
    time_s = _filled(time_s, remarks)
    digits = 9  # stamps are whole nanoseconds: those of ROS are, and floats that differ by less are equal
    time_s = np.round(time_s - time_s.min(), digits)
    sort = np.argsort(time_s, kind="stable")
    if moved := int(np.count_nonzero(sort != np.arange(sort.size))):
        remarks.append(f"{_frames(moved)} out of order sorted by time")
    order, time_s = order[sort], time_s[sort]
    time_s = _spread(time_s, remarks)
    return Settled(order, _resolved(time_s - time_s[:1], remarks), tuple(remarks))


def _frames(count: int) -> str:
    return counted(count, "frame")


def _possible(time_s: FloatArray, remarks: list[str]) -> FloatArray:
    """Times without those that no clock shows."""
    with np.errstate(invalid="ignore"):
        damaged = ~np.isnan(time_s) & ~(np.abs(time_s) < _MOST_S)
    if number := int(damaged.sum()):
        remarks.append(f"{_frames(number)} of a time that no clock shows ({time_s[damaged][0]:g} s), taken as missing")
    return np.where(damaged, np.nan, time_s)


def _listed(frames: list[int], *, most: int = 3) -> str:
    """Some frames, as in "frame 7" or "frames 7, 9, 12 and 4 more"."""
    more = f" and {len(frames) - most} more" if len(frames) > most else ""
    return f"{'frame' if len(frames) == 1 else 'frames'} {', '.join(map(str, frames[:most]))}{more}"


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


def _restarted(time_s: FloatArray, order: IntArray, begins: list[int], remarks: list[str]) -> FloatArray:
    """Times in which a clock that was set back goes on, and a stamp apart from the clock is missing.

    Parameters
    ----------
    time_s : (kept,) float64
        Times in the order of the source; NaN where missing.
    order : (kept,) int64
        Their frames in the source, for remarks.
    begins : list of int
        Places in `time_s` at which the source is known to start again.
    remarks : list of str
        Extended.
    """
    known = np.flatnonzero(np.isfinite(time_s))
    anew = np.searchsorted(known, begins)
    backs = _set_back(time_s[known], anew)
    sure = set(known[anew[anew < known.size]].tolist())
    stops = sorted({*known[backs].tolist(), *sure})
    if not stops:
        return time_s
    clock = _Restarts(time_s[known], order[known])
    places = np.searchsorted(known, stops)
    for place, stop, end in zip(places, stops, [*places[1:], known.size], strict=True):
        clock.go_on(int(place), int(end), sure=stop in sure)
    remarks += clock.remarks
    time_s = time_s.copy()
    time_s[known] = clock.time_s
    return time_s


def _set_back(time_s: FloatArray, begins: IntArray) -> IntArray:
    """Places at which a clock goes back by more than a second; none where frames are in random order."""
    steps = np.diff(time_s)
    down = np.setdiff1d(np.flatnonzero(steps < 0) + 1, begins)
    if down.size >= max(1.0, _SHUFFLED * steps.size):
        return np.zeros(0, dtype=np.int64)
    return down[steps[down - 1] < -1.0]  # s: a clock was set, or started again; by less, messages overtook one another


class _Restarts:
    """A clock over the frames, corrected from one step back to the next.

    `time_s` (frame,) are its times so far.
    """

    def __init__(self, time_s: FloatArray, order: IntArray) -> None:
        self._read, self._order, self._step = time_s, order, _interval(time_s)
        self.time_s = time_s.copy()
        self._set: dict[str, list[int]] = {}
        self._sorted = np.sort(time_s)
        steps = np.diff(self._sorted)
        irregular = (steps < _REGULAR[0] * self._step) | (steps > _REGULAR[1] * self._step)
        self._irregular = np.r_[0, np.cumsum(irregular)]
        self._seen, self._until = list[float](), 0

    def go_on(self, place: int, end: int, *, sure: bool) -> None:
        """Correct the frames from `place`, where the clock goes back, to the next such place, `end`."""
        read = self._read
        for time in read[self._until : place].tolist():
            insort(self._seen, time)
        self._until = place
        if sure:
            if self._seen and read[place] <= self._seen[-1]:
                self._start_again(place, end, _COUNTED)
            self._seen = []
        elif not self._are_late(read[place:end].tolist()) and not self._is_apart(place):
            self._start_again(place, end, _SET)
            self._seen = []

    @property
    def remarks(self) -> list[str]:
        """What was changed, with the first frames."""
        return [
            f"the clock {what} at {_listed(frames)}; its frames follow one interval later"
            if what in _NEW_STARTS
            else f"the time of {_listed(frames)} {what}, and is taken as missing"
            for what, frames in self._set.items()
        ]

    def _start_again(self, place: int, end: int, what: str) -> None:
        last = float(np.nanmax(self.time_s[:place]))
        self.time_s[place:] += last + self._step - self.time_s[place:end].min()
        self._set.setdefault(what, []).append(int(self._order[place]))

    def _are_late(self, times: list[float]) -> bool:
        """Whether frames fill holes that the frames before them left, so that both together are of one clock."""
        # Two frames farther apart than this, in intervals, have another between them that is missing, or comes later.
        hole = 1.5
        for time in times:
            if not self._seen or time >= self._seen[-1]:
                continue
            above = bisect_right(self._seen, time)
            if above == 0 or self._seen[above] - self._seen[above - 1] < hole * self._step:
                return False
            first, last = np.searchsorted(self._sorted, self._seen[above - 1 : above + 1])
            if self._irregular[last] > self._irregular[first]:
                return False
        return True

    def _is_apart(self, place: int) -> bool:
        """Whether one stamp is apart from the clock, which goes on beside it; the stamp is then missing."""
        read, most = self._read, 2 * _REGULAR[1] * self._step
        for k in (place - 1, place):
            inside = 0 < k < read.size - 1 and np.isfinite(self.time_s[k])
            if inside and 0 < read[k + 1] - read[k - 1] <= most:
                if k < place:
                    self._seen.remove(float(read[k]))
                else:
                    self._until = place + 1
                self.time_s[k] = np.nan
                self._set.setdefault(_APART, []).append(int(self._order[k]))
                return True
        return False


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


def _resolved(time_s: FloatArray, remarks: list[str]) -> FloatArray:
    """Times that ascend in float64 too; frames are numbered where the span of the times is too long for that."""
    if ascends(time_s):
        return time_s
    remarks.append("the times are too far apart to be told from one another; the frames are numbered, 1 s apart")
    return np.arange(time_s.size, dtype=np.float64)
