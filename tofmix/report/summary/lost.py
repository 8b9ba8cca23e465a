"""Lost samples in words: pixels that show little or nothing, where they are, and why, where amplitudes tell."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, ByteArray, Float32Array
from tofmix.flags import Status
from tofmix.lost_samples import learn_losses
from tofmix.recording import SampleSource, amplitude_source
from tofmix.report.summary.findings import DEFAULT_THRESHOLDS, Finding, Thresholds
from tofmix.report.summary.quantiles import Quantiles, ValueCounts, spread_of
from tofmix.wording import counted

Cause = Callable[[BoolArray], str]
"""Tells the cause of the loss of some pixels (row, col), in words."""

UNKNOWN_CAUSE = "too dark, saturated, or out of range"
"""The cause, where amplitudes do not tell."""

_SPREAD = (0.05, 0.95)  # quantiles of the valid amplitudes, beyond which a lost one is dark or saturated


@dataclass(frozen=True, slots=True, kw_only=True)
class LostNumbers:
    """Lost samples of all windows; pixels are counted once a window."""

    share: Quantiles  # share of the frames without a valid sample, over pixels
    mean_share: float  # of all samples
    pixels_without_sample: int  # pixels without any valid sample
    # Other pixels that lose so much that their light is at the limit of the camera (`tofmix.lost_samples`).
    pixels_at_limit: int

    @property
    def line(self) -> str:
        """All of it in words."""
        said = f"{100 * self.mean_share:.1f} % of all samples"
        if self.pixels_without_sample:
            said += f"; {counted(self.pixels_without_sample, 'pixel', ',')} without a valid one"
        if self.pixels_at_limit:
            said += f"; {counted(self.pixels_at_limit, 'pixel', ',')} at the limit of the camera"
        return said


class LostTally:
    """Running counts of lost samples over windows."""

    def __init__(self) -> None:
        self._shares = ValueCounts()
        self._lost, self._pixels = 0.0, 0
        self._empty: BoolArray | None = None
        self._at_limit: BoolArray | None = None
        self._counts = [0, 0]
        self._left = ValueCounts()
        self.too_few = 0
        """Pixels of status too_few_samples whose light is not enough: more frames would not help."""

    def add(self, invalid_share: NDArray[np.float32] | None, status: ByteArray, frames: int) -> None:
        """Count a window (row, col) of so many frames; layers of old versions have no `invalid_share`."""
        if invalid_share is None:
            return
        self._shares.add(invalid_share)
        self._lost += float(np.nansum(invalid_share, dtype=np.float64))
        self._pixels += invalid_share.size
        if not (invalid_share > 0).any():
            return
        dark = learn_losses(invalid_share, frames).is_at_limit(invalid_share)
        empty = invalid_share >= 1.0
        partly = dark & ~empty
        self._empty = empty if self._empty is None else self._empty | empty
        self._at_limit = partly if self._at_limit is None else self._at_limit | partly
        self._counts = [self._counts[0] + int(empty.sum()), self._counts[1] + int(partly.sum())]
        self._left.add(invalid_share[partly])
        self.too_few += int((dark & (status == int(Status.TOO_FEW_SAMPLES))).sum())

    def numbers(self) -> LostNumbers | None:
        """The numbers of all windows; None where no sample was lost, or it is not known."""
        if not self._lost:
            return None
        return LostNumbers(
            share=spread_of(self._shares),
            mean_share=self._lost / max(1, self._pixels),
            pixels_without_sample=self._counts[0],
            pixels_at_limit=self._counts[1],
        )

    def findings(self, cause: Cause | None = None, *, thresholds: Thresholds = DEFAULT_THRESHOLDS) -> list[Finding]:
        """Say how many pixels show nothing, or little, and why, told by `cause`; a note where they are few."""
        found, most = [], thresholds.status_share * self._pixels
        if self._empty is not None and self._counts[0]:
            text = (
                f"No sample of {counted(self._counts[0], 'pixel', ',')} is valid ({_where(self._empty)}):"
                f" {UNKNOWN_CAUSE if cause is None else cause(self._empty)}. More frames will not help."
            )
            found.append(Finding(code="no_valid_sample", text=text, is_note=self._counts[0] <= most))
        if self._at_limit is not None and self._counts[1]:
            lost = self._left.quantiles(0.5)[0] or 0.0
            text = (
                f"{counted(self._counts[1], 'pixel', ',')} lose {100 * lost:.0f} % of the samples"
                f" (median; {_where(self._at_limit)}): {UNKNOWN_CAUSE if cause is None else cause(self._at_limit)}."
                " Their layers are less probable, and a map takes no free space from the lost light."
            )
            found.append(Finding(code="lost_samples", text=text, is_note=self._counts[1] <= most))
        return found


def _where(pixels: BoolArray) -> str:
    """The part of the image with some pixels, in words."""
    spans = []
    for name, axis in (("row", 1), ("column", 0)):
        places = np.flatnonzero(pixels.any(axis=axis))
        first, last = int(places[0]), int(places[-1])
        spans.append(f"{name} {first}" if first == last else f"{name}s {first} to {last}")
    return f"within {', '.join(spans)}" if pixels.sum() > 1 else ", ".join(spans)


def cause_of_loss(
    source: SampleSource,
    pixels: BoolArray,
    *,
    most_frames: int = 100,  # of which amplitudes are read
) -> str:
    """Why samples of some pixels were lost, as far as the recording's amplitudes tell.

    Parameters
    ----------
    source : SampleSource
        The recording. Amplitudes of the first 100 frames are read, of the rows with such pixels and as many around.
    pixels : (row, col) bool
        The pixels, at least one.

    Returns
    -------
    str
        Too dark, if half of the lost samples are darker than 95 % of the valid ones; saturated, if they are brighter;
        else `UNKNOWN_CAUSE`. Amplitudes that are all 0 or not known tell nothing.
    """
    light = amplitude_source(source)
    if light is None:
        return UNKNOWN_CAUSE
    rows = np.flatnonzero(pixels.any(axis=1))
    high = int(rows[-1] - rows[0] + 1)
    part = slice(max(0, int(rows[0]) - high), min(source.shape[1], int(rows[-1]) + 1 + high))
    frames = slice(0, min(most_frames, source.shape[0]))
    valid, amplitude = np.isfinite(source.read_range(frames, part)), light.read_amplitude(frames, part)
    chosen = np.broadcast_to(pixels[part], valid.shape)
    lost, seen = (_known(amplitude[where]) for where in (chosen & ~valid, ~chosen & valid))
    if not lost.size or not seen.size or not lost.any():
        return UNKNOWN_CAUSE
    low, high_light = np.quantile(seen, _SPREAD)
    middle = float(np.median(lost))
    said = f"amplitude {middle:.4g}, where valid samples around have {low:.4g} to {high_light:.4g}"
    if middle < low:
        return f"too dark ({said})"
    return f"saturated ({said})" if middle > high_light else UNKNOWN_CAUSE


def _known(amplitude: Float32Array) -> Float32Array:
    return np.asarray(amplitude[np.isfinite(amplitude)])
