"""Interface of the counters."""

from typing import NamedTuple, Protocol

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.samples import SortedSamples

MAX_PEAKS = 64
"""Most peaks whose places are kept; more than that in one pixel is noise."""

SIGMAS_BEYOND = 4.0
"""Samples of surfaces at the ends of the working range, and of no return, extend this many sigma beyond it."""


class Peaks(NamedTuple):
    """Peaks of many pixels.

    `place` (pixel, MAX_PEAKS) in mm, near to far; `height` (pixel, MAX_PEAKS), about the share of the samples;
    `found` (pixel,) is their number. Where it is 0, place[0] is the best guess at one, as the start of a fit.
    """

    place: FloatArray
    height: FloatArray
    found: IntArray


def no_peaks(pixels: int) -> Peaks:
    """Room for the peaks of `pixels` pixels."""
    shape = (pixels, MAX_PEAKS)
    return Peaks(np.zeros(shape), np.zeros(shape), np.zeros(pixels, dtype=np.int64))


class Counter(Protocol):
    """A way to count surfaces: a frozen dataclass of parameters."""

    def peaks(self, samples: SortedSamples, beam: Beam) -> Peaks:
        """Find the peaks of each pixel; pixels without samples have none."""

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
