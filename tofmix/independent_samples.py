"""A recording of a camera that filters ranges over time, read as its independent samples.

Use `independent_samples` before samples are fitted, or noise is learnt from them. Without a filter it is the recording.
"""

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.recording import SampleSource, TargetSource, TypedSource, amplitude_source
from tofmix.sensor import Sensor
from tofmix.temporal_filter import TemporalFilter


class IndependentSamples:
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
        self._source, self._filter, self._marks = source, filter_, marks

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

    @property
    def has_amplitude(self) -> bool:
        """Whether the recording has amplitudes."""
        return amplitude_source(self._source) is not None

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes (frame, row, col) float32, as they are stored.

        Raises
        ------
        ValueError
            If there are none.
        """
        light = amplitude_source(self._source)
        if light is None:
            raise ValueError("the recording has no amplitudes")
        return light.read_amplitude(frames, rows)


def independent_samples(source: SampleSource, *, for_noise: bool = False) -> SampleSource:
    """The recording as its independent samples; the recording itself if its sensor has no filter.

    With `for_noise`, those that noise is learnt from (`TemporalFilter.for_noise`).
    """
    found = source.sensor.temporal_filter
    if found is None or isinstance(source, IndependentSamples):
        return source
    return IndependentSamples(source, found.for_noise() if for_noise else found, marks=not for_noise)
