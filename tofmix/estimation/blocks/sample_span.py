"""The extreme samples of a recording whose camera has no known end of its working range.

Random values spread over the working range. Where its end is not known, they spread between the extreme valid samples:
use `sensor_with_span` before an estimate. The whole recording is read, so the result does not depend on the estimated
part or on the blocks.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tofmix.estimation.samples import FARTHEST_MM
from tofmix.recording import DECODED_SAMPLES, SampleSource
from tofmix.sensor import Sensor


def sample_span(source: SampleSource) -> tuple[float, float] | None:
    """Find the extreme valid samples of a recording.

    Parameters
    ----------
    source : SampleSource
        The recording. All of it is read once, about 2^20 samples at a time, or a stored chunk where that is larger.

    Returns
    -------
    tuple of float or None
        The least and the largest sample, mm; None where no sample is valid.
    """
    low, high = np.inf, -np.inf
    for frames, rows in _blocks(source):
        samples = source.read_range(frames, rows)
        with np.errstate(invalid="ignore"):
            valid = samples[np.abs(samples) <= FARTHEST_MM]  # false for NaN
        if valid.size:
            low, high = min(low, float(valid.min())), max(high, float(valid.max()))
    return (low, high) if low <= high else None


def sensor_with_span(source: SampleSource, unambiguous_range_mm: float | None = None) -> Sensor:
    """The recording's camera, with the extreme samples where random values need them.

    Parameters
    ----------
    source : SampleSource
        The recording. It is read where its camera has no `range_max_mm` and ranges are on a line.
    unambiguous_range_mm : float, optional
        Length of the circle that ranges are on, mm; a line without it.

    Returns
    -------
    Sensor
        With `sample_min_mm` and `sample_max_mm`, or without them if the working range, or the circle, is the interval
        of random values.
    """
    sensor, span = source.sensor, None
    if sensor.range_max_mm is None and unambiguous_range_mm is None:
        span = sample_span(source)
    low, high = span or (None, None)
    return replace(sensor, sample_min_mm=low, sample_max_mm=high)


def _blocks(source: SampleSource) -> Iterator[tuple[slice, slice]]:
    """Cut a recording into blocks (frames, rows) of whole stored chunks, which cover it once."""
    frames, rows, cols = source.shape
    high, deep = min(source.row_step, rows), min(source.frame_step, frames)
    more = max(1, DECODED_SAMPLES // (deep * high * cols))
    high = min(rows, high * more)
    deep *= max(1, DECODED_SAMPLES // (deep * high * cols))
    for first in range(0, frames, deep):
        for top in range(0, rows, high):
            yield slice(first, min(first + deep, frames)), slice(top, min(top + high, rows))
