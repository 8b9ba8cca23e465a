"""The range image that averaging gives, for comparison with the layers.

A camera returns this mean at a long integration time: if a beam meets two surfaces, the mean lies between them, in the
comet tail. Use it to show that tail, never as a range to trust.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.circle import fold, unambiguous_range_mm
from tofmix.errors import UsageError
from tofmix.layers import Layers, LayersSource
from tofmix.recording import AmplitudeSource, SampleSource, amplitude_source, samples_a_frame


class Averaging(StrEnum):
    """How an averaged image was made."""

    PHASOR = "phasor mean of the samples, weighted by amplitude"
    PLAIN = "plain mean of the samples"
    CIRCULAR = "mean direction of the samples on the circle of the unambiguous range"
    LAYERS = "mean of the layers, weighted by their shares"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AveragedImage:
    """An averaged range image.

    range_mm (row, col) float64 mm, NaN where there is nothing to average; averaging, how it was made.
    """

    range_mm: FloatArray
    averaging: Averaging


def average_samples(
    recording: SampleSource,
    *,
    start: int,
    stop: int,
    unambiguous_range_mm: float | None = None,
    block_samples: int = 1 << 19,
) -> AveragedImage:
    """Average the samples of frames [start, stop), a block of frames and rows at a time.

    With amplitudes A and a modulation frequency, the mean is that of the phasors,
    ``d_u arg(sum A exp(2 pi i r / d_u)) / (2 pi)`` on the turn nearest the plain
    mean; without them it is the plain mean. On a circle of `unambiguous_range_mm` it
    is that of the phasors in any case, of equal amplitudes where there are none, and
    lies in [0, d_u).

    Parameters
    ----------
    recording : SampleSource
        Samples; amplitudes too if it is an `AmplitudeSource`.
    start, stop : int
        Frames, 0 <= start < stop.
    unambiguous_range_mm : float, optional
        Length of the circle that the layers are on, mm.
    block_samples : int
        Samples read at once, which bounds the memory: by default about 40 MB with the phasors. It changes no value
        beyond rounding.

    Returns
    -------
    AveragedImage
        (row, col), NaN where no sample is valid.
    """
    n_samples, rows, cols = recording.shape
    each = samples_a_frame(recording)
    if not 0 <= start < stop <= n_samples // each:
        raise UsageError(
            f"recording: frames {start} to {stop} asked for, it has {n_samples // each};"
            " pass the one the layers were made from"
        )
    start, stop = start * each, stop * each
    amplitudes = None if recording.sensor.modulation_frequency_hz is None else amplitude_source(recording)
    band, depth = _block(recording, stop - start, block_samples)
    range_mm = np.empty((rows, cols))
    for row in range(0, rows, band):
        rows_read = slice(row, min(row + band, rows))
        range_mm[rows_read] = _band_mean(recording, amplitudes, rows_read, (start, stop, depth), unambiguous_range_mm)
    plain = Averaging.PLAIN if unambiguous_range_mm is None else Averaging.CIRCULAR
    return AveragedImage(range_mm=range_mm, averaging=plain if amplitudes is None else Averaging.PHASOR)


def average_layers(layers: Layers, *, unambiguous_range_mm: float | None = None) -> AveragedImage:
    """Average the layers (row, col) of each pixel by their shares, sum(w r) / sum(w); on a circle, by their directions.

    Use it without the recording. It has the comet tail, but neither the samples without a return nor the weighting by
    amplitude. The image is NaN where there is no layer.
    """
    weight = np.where(np.isfinite(layers.range), layers.weight, 0.0).astype(np.float64)
    range_mm = np.where(np.isfinite(layers.range), layers.range, 0.0).astype(np.float64)
    weight = np.where(np.isfinite(weight), weight, 0.0)
    total = weight.sum(axis=-1)
    if unambiguous_range_mm is not None:
        phasor = (weight * np.exp(2j * np.pi / unambiguous_range_mm * range_mm)).sum(axis=-1)
        direction = fold(np.angle(phasor) * unambiguous_range_mm / (2 * np.pi), unambiguous_range_mm)
        return AveragedImage(range_mm=np.where(total > 0, direction, np.nan), averaging=Averaging.LAYERS)
    return AveragedImage(range_mm=_ratio((weight * range_mm).sum(axis=-1), total), averaging=Averaging.LAYERS)


def average_window(
    layers_file: LayersSource, window: int, layers: Layers, recording: SampleSource | None
) -> AveragedImage:
    """Average the samples of a window of a file, or its layers where there is no recording."""
    circle_mm = layers_file.provenance.unambiguous_range_mm
    if recording is None:
        return average_layers(layers, unambiguous_range_mm=circle_mm)
    start, stop = int(layers_file.window_start[window]), int(layers_file.window_stop[window])
    return average_samples(recording, start=start, stop=stop, unambiguous_range_mm=circle_mm)


def _block(recording: SampleSource, n_frames: int, block_samples: int) -> tuple[int, int]:
    """Rows and frames of one read: whole chunks of rows, and no more than `block_samples` where they allow it."""
    _, rows, cols = recording.shape
    step = min(max(1, recording.row_step), rows)
    band = step * max(1, block_samples // (step * cols * n_frames))
    return min(band, rows), max(1, min(n_frames, block_samples // (min(band, rows) * cols)))


def _band_mean(
    recording: SampleSource,
    amplitudes: AmplitudeSource | None,
    rows: slice,
    frames: tuple[int, int, int],
    circle_mm: float | None,
) -> FloatArray:
    start, stop, depth = frames
    shape = (rows.stop - rows.start, recording.shape[2])
    total, count, phasor = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.complex128)
    frequency = recording.sensor.modulation_frequency_hz
    period = circle_mm or (unambiguous_range_mm(frequency) if frequency else math.inf)
    for first in range(start, stop, depth):
        block = slice(first, min(first + depth, stop))
        samples = recording.read_range(block, rows).astype(np.float64)
        valid = np.isfinite(samples)
        samples = np.where(valid, samples, 0.0)
        total += samples.sum(axis=0)
        count += valid.sum(axis=0)
        if amplitudes is not None:
            amplitude = amplitudes.read_amplitude(block, rows).astype(np.float64)
            amplitude = np.where(valid & np.isfinite(amplitude), amplitude, 0.0)
            phasor += (amplitude * np.exp(2j * np.pi / period * samples)).sum(axis=0)
        elif circle_mm is not None:
            phasor += (valid * np.exp(2j * np.pi / period * samples)).sum(axis=0)
    mean = _ratio(total, count)
    if amplitudes is None and circle_mm is None:
        return mean
    turn = np.angle(phasor) * period / (2 * np.pi)
    if circle_mm is not None:
        return np.where(count > 0, fold(turn, circle_mm), np.nan)
    turn += period * np.rint((mean - turn) / period)
    # A sum of 0 has no phase: without any light the plain mean is all there is.
    return np.where((np.abs(phasor) > 0) & (count > 0), turn, mean)


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Quotient, NaN where the denominator is 0."""
    known = denominator > 0
    return np.where(known, numerator / np.where(known, denominator, 1.0), np.nan)
