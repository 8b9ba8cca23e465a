"""Units as files and people write them, and checks on ranges: that they are in mm, plausible, and zeros are ranges.

A float dataset does not show this. Without the attribute `units`, values of a few units are metres more likely than mm;
where the fill value is not 0, exact zeros are ranges by the contract, and lost samples more likely; so are other fill
values that the file does not name, and negative ranges. All are checked in a few blocks, so that a long recording is
not read twice; a file always has the same blocks.

Units of length and time may stand at the ends of names.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array
from tofmix.errors import BadInputError
from tofmix.io.next_command import import_command
from tofmix.io.samples import no_sample, unnamed
from tofmix.recording import SampleSource, TypedSource
from tofmix.sensor import Sensor

_BLOCK_SAMPLES = 1 << 16  # samples at each place


class FloatRecording(SampleSource, TypedSource, Protocol):
    """Interface of a recording, as `tofmix.io.recording.recording_file.RecordingFile` has it."""

    path: Path
    units: str | None

    @property
    def fill(self) -> float | None:
        """Value of invalid samples in addition to NaN."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeCheck:
    """Statistics of the blocks."""

    # samples, zeros: Samples that were looked at, and those of them that are exactly 0; none where as many lie within
    # `NEAREST_MM` of 0, as the ranges of a surface at the fold do.
    samples: int
    zeros: int
    median: float | None  # of the valid samples other than 0, as they are stored; None without any
    # Numbers of other samples that `tofmix import` would drop, by reason: unnamed fill values and negative ranges.
    fills: tuple[tuple[str, int], ...] = ()
    outside: float = 0.0  # share of the valid samples outside of the camera's working range, 0 to 1


def look(recording: FloatRecording) -> RangeCheck:
    """Look at some samples."""
    values = np.concatenate([recording.read_range(*block).ravel() for block in _blocks(recording)])
    some = values[np.isfinite(values) & (values != 0)]
    zeros = int((values == 0).sum())
    is_at_fold = zeros <= np.count_nonzero(np.abs(some) <= NEAREST_MM)
    return RangeCheck(
        samples=values.size,
        zeros=0 if is_at_fold else zeros,
        median=float(np.median(some)) if some.size else None,
        fills=tuple(_fills(some, recording).items()),
        outside=float(is_outside(some, recording.sensor).mean()) if some.size else 0.0,
    )


def _fills(valid: Float32Array, recording: FloatRecording) -> dict[str, int]:
    """Numbers of valid samples (n,), other than 0, that import takes for none, by reason.

    A value is a range where as many samples lie within `NEAREST_MM` of it.
    """
    stored = np.dtype(recording.stored_type)
    fits = np.can_cast(stored, np.float32)  # so that float32 holds its numbers exactly; the ends of wider types do not
    numbers = valid.astype(stored) if fits else valid
    found = no_sample(numbers, unit_mm=1.0)
    dropped = unnamed(found.dropped)
    if not dropped:
        return {}
    values, counts = np.unique(valid[found.bad], return_counts=True)
    kept = np.sort(valid[~found.bad])
    beside = np.searchsorted(kept, values + NEAREST_MM, "right") - np.searchsorted(kept, values - NEAREST_MM)
    return dropped if np.any(counts > beside) else {}


def _blocks(recording: FloatRecording) -> Iterator[tuple[slice, slice]]:
    """Frames and rows of blocks that are spread over recording and image; all of a small recording."""
    frames, rows, cols = recording.shape
    blocks = 4  # parts of the recording that are checked
    if frames * rows * cols <= blocks * _BLOCK_SAMPLES:
        yield slice(0, frames), slice(0, rows)
        return
    # Whole stored chunks where they are small; of larger ones a part, so that no block is larger than its limit.
    row_step, frame_step = min(recording.row_step, rows), min(recording.frame_step, frames)
    high = min(rows, row_step * max(1, _BLOCK_SAMPLES // (row_step * frame_step * cols)))
    high = min(high, max(1, _BLOCK_SAMPLES // cols))
    deep = min(frames, max(1, _BLOCK_SAMPLES // (high * cols)))
    for k, row in enumerate((0, 2, 1, 3)):  # the later frames of a scene that changes are not all of its lower rows
        first, top = (
            (size - part) * place // (blocks - 1) for size, part, place in ((frames, deep, k), (rows, high, row))
        )
        yield slice(first, first + deep), slice(top, top + high)


def is_too_small(median_mm: float, sensor: Sensor, *, least_mm: float = 50.0, least_share: float = 0.1) -> bool:
    """Whether a median range is in another unit than mm.

    Parameters
    ----------
    median_mm : float
        The median, if it is in mm.
    least_mm : float
        A median below this is no camera's; in m it is beyond every camera's.
    least_share : float
        A median below this share of `range_min_mm` is in another unit.
    """
    return median_mm < max(least_mm, least_share * (sensor.range_min_mm or 0.0))


FARTHEST_MM = 100_000.0
"""No camera measures a median range above 100 m."""

NEAREST_MM = 20.0
"""No camera measures a median range below 20 mm."""

_UNITS_MM = (("--units", "mm", 1.0), ("--units", "m", 1000.0), ("--units", "cm", 10.0), ("--scale", "0.001", 0.001))
"""Options of `tofmix import` that may set the unit right, and mm of one unit."""


def implausible(median_mm: float, sensor: Sensor, *, unit_mm: float, path: Path | None, far_share: float = 2.0) -> str:
    """Doubt about a median range that no camera measures, or not this one.

    Parameters
    ----------
    median_mm : float
        Median of the valid samples, mm.
    unit_mm : float
        mm of one unit of the source, by which the median was made.
    path : Path, optional
        The source, for the remedy.
    far_share : float
        A median above this many times the camera's range is doubtful.

    Returns
    -------
    str
        Reason and remedy; empty where the median is plausible.
    """
    least, most = sensor.range_min_mm or 0.0, sensor.range_max_mm or math.inf
    if median_mm > min(FARTHEST_MM, far_share * most):
        of_camera = f"the range of {sensor.name} ends at {most:g} mm"
        said = f"half of the ranges are above {median_mm / 1000:.4g} m; "
        said += "no camera sees so far" if median_mm > FARTHEST_MM else of_camera
    elif median_mm < max(NEAREST_MM, least):
        of_camera = f"the range of {sensor.name} begins at {least:g} mm"
        said = f"half of the ranges are below {median_mm:.4g} mm; "
        said += "no camera sees so near" if median_mm < NEAREST_MM else of_camera
    else:
        return ""
    value = median_mm / unit_mm
    fits = [
        (option, text)
        for option, text, mm in _UNITS_MM
        if mm != unit_mm and max(NEAREST_MM, least) <= value * mm <= min(FARTHEST_MM, most)
    ]
    if not fits:
        return f"{said}; check the units, and the camera"
    option, text = fits[0]
    remedy = f"units={text!r}" if path is None else import_command(path, option, text)
    return f"{said}; check the units; if the numbers are in {_NAMES[text]}: {remedy}"


def is_outside(range_mm: NDArray[Any], sensor: Sensor) -> BoolArray:
    """Which ranges, mm, lie outside of the camera's working range, as far as it is known; of their shape."""
    least, most = sensor.range_min_mm or 0.0, math.inf if sensor.range_max_mm is None else sensor.range_max_mm
    return np.asarray((range_mm < least) | (range_mm > most))


def outside_doubt(share: float, sensor: Sensor, option: str, *, mostly: float = 0.5) -> str:
    """Doubt about a share of the samples outside of the camera's working range; empty without one."""
    if share <= mostly:
        return ""
    least, most = sensor.range_min_mm or 0.0, math.inf if sensor.range_max_mm is None else sensor.range_max_mm
    return f"{100 * share:.0f} % of the samples lie outside the sensor's {least:g} to {most:g} mm; check {option}"


_NAMES = {"mm": "mm", "m": "m", "cm": "cm", "0.001": "micrometres"}


def unit_doubt(recording: FloatRecording, found: RangeCheck) -> str | None:
    """Reason to doubt that ranges are in mm, with the remedies; None without a doubt."""
    if found.median is None or recording.units is not None or "float" not in recording.stored_type:
        return None
    if not is_too_small(found.median, recording.sensor):
        return None
    least = recording.sensor.range_min_mm
    also = f" and range_min_mm of {least:g}" if is_too_small(found.median, recording.sensor, least_mm=0.0) else ""
    return (
        f"{recording.stored_type} without units, its median {found.median:.4g}, is too small for mm{also}; in metres:"
        f" {import_command(recording.path, '--units', 'm')}; in mm: set the dataset's attribute units to mm"
    )


def zeros_doubt(recording: FloatRecording, found: RangeCheck) -> str | None:
    """Number of samples that are exactly 0 and count as ranges, with the remedy; None without any."""
    if not found.zeros:
        return None
    other = ", or set the dataset's attribute _FillValue to 0" if recording.fill is None else ""
    return (
        f"{found.zeros:,} of {found.samples:,} checked samples are exactly 0 and count as ranges of 0 mm; if 0"
        f" means no sample: {import_command(recording.path, '--invalid', '0')}{other}"
    )


def fills_doubt(recording: FloatRecording, found: RangeCheck) -> str | None:
    """Number of samples that are fill values elsewhere and count as ranges, with the remedy; None without any."""
    if not found.fills:
        return None
    said = ", ".join(f"{number:,} {reason}" for reason, number in found.fills)
    return (
        f"of {found.samples:,} checked samples these count as ranges: {said}; if they mean no sample:"
        f" {import_command(recording.path)}"
    )


def distance_doubt(recording: FloatRecording, found: RangeCheck) -> str | None:
    """Doubt about ranges that no camera measures, or not this one, with the remedy; None without one."""
    if found.median is None or unit_doubt(recording, found) is not None:
        return None
    sensor = recording.sensor
    said = implausible(found.median, sensor, unit_mm=1.0, path=recording.path)
    # Samples without a return lie about range_max_mm, half of them beyond it: all of them are no doubt.
    return (
        said or outside_doubt(found.outside, sensor, "range_min_mm and range_max_mm of its sensor", mostly=0.6) or None
    )


def check_whole_numbers(recording: FloatRecording) -> tuple[str, ...]:
    """Notes on a recording of whole numbers: its distances, zeros and fill values, as `check_range` has them of floats.

    Apart from opening, since floats alone must be looked at before they are used.
    """
    if "float" in recording.stored_type:
        return ()
    return _notes(recording, look(recording))


def _notes(recording: FloatRecording, found: RangeCheck) -> tuple[str, ...]:
    doubts = (zeros_doubt(recording, found), fills_doubt(recording, found), distance_doubt(recording, found))
    return tuple(f"{recording.path}: range: {text}" for text in doubts if text)


def check_range(recording: FloatRecording) -> tuple[str, ...]:
    """Refuse floats that are probably not in mm; whole numbers are not read.

    Returns
    -------
    tuple of str
        Notes for the user, each a line that names the file.
    """
    if "float" not in recording.stored_type:
        return ()
    found = look(recording)
    doubt = unit_doubt(recording, found)
    if doubt is not None:
        raise BadInputError(f"{recording.path}: range: {doubt}")
    return _notes(recording, found)


UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm of one unit."""

_LENGTHS_MM = UNITS_MM | {
    name: mm
    for mm, names in {
        1e-6: "nm",
        1e-3: "um µm μm micron",
        100.0: "dm",
        1e6: "km",
        25.4: "inch",
        304.8: "foot ft",
    }.items()
    for name in names.split()
}
"""mm of each unit that a file may name."""

_PREFIXES_MM = {"": 1000.0, "nano": 1e-6, "micro": 1e-3, "milli": 1.0, "centi": 10.0, "deci": 100.0, "kilo": 1e6}
_SPELT = {
    f"{prefix}{metre}": mm for prefix, mm in _PREFIXES_MM.items() for metre in ("meter", "metre", "meters", "metres")
}
_SPELT |= {"microns": 1e-3, "inches": 25.4, "feet": 304.8}


def unit_mm_of(text: str) -> float | None:
    """Length of the unit that a text names, mm; None if it is not known."""
    name = text.strip()
    return _LENGTHS_MM.get(name, _SPELT.get(name.lower()))


TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""s of one unit of time."""

_IN_NAME = re.compile(r"\w.*?[_\s./([-](mm|cm|m)[)\]]?$", re.DOTALL)


def unit_in_name(name: str) -> float | None:
    """Length of the unit that the name of an array or channel ends in, mm, as in ``range_m`` or ``depth [mm]``."""
    found = _IN_NAME.match(name.strip())
    return None if found is None else UNITS_MM[found[1]]


def refuse_metres(range_mm: NDArray[Any], sensor: Sensor, what: object) -> None:
    """Refuse ranges without a unit, taken as mm and not all NaN, if half of them are too small for mm."""
    median = float(np.nanmedian(range_mm))
    if is_too_small(median, sensor):
        raise BadInputError(
            f"{what}: no unit is given, and half of the values are below {median:.3g}, too small for mm;"
            " give --units m, or --units mm if mm is right"
        )
