"""The smallest magnitude of an effect that is named in 95 % of the recordings: what to try next, and what is known.

Whether an effect is named is yes or no, and goes from never to always over an octave or two of its magnitude, as scenes
and devices differ. The share named is taken for a cumulative normal in the magnitude's logarithm, of unknown middle and
width; each recording tells of both, and the next one is made where it tells most. So a dozen recordings do what
would take hundreds on a grid.

References
----------
Watson and Pelli, Perception & Psychophysics 33 (1983) 113; King-Smith and Rose, Vision Research 37 (1997) 1595.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from blind.cases import Built, Case, build, strengths
from blind.geometry import Array

SHARE = 0.95
LAPSES = 0.02  # of the recordings in which something else goes wrong, however clear the effect
_MIDDLE = np.arange(-9.0, 1.01, 0.125)[:, None]
_WIDTH = np.array([0.15, 0.3, 0.5, 0.8, 1.2])[None, :]
_ABOVE = float(ndtri(SHARE / (1 - LAPSES)))  # widths by which SHARE lies above the middle
_SLOTS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One kind, at one number of frames and one image."""

    kind: str
    frames: int
    rows: int
    cols: int

    def strength(self, octaves: float) -> float:
        """The magnitude so many octaves above `clear`."""
        return float(strengths()[self.kind]["clear"] * 2.0**octaves)

    def built(self, octaves: float, seed: int, master: int) -> Built:
        """A recording of a magnitude: the same device and scene at every one."""
        case = Case(
            name=f"{self.kind}-smallest-{seed}",
            sort="single",
            kinds=(self.kind,),
            level="clear",
            slot=seed % _SLOTS,
            seed=seed // _SLOTS,
            half="open",
        )
        camera = {"frames": self.frames, "rows": self.rows, "cols": self.cols}
        return build(case, master, strength=self.strength(octaves), camera=camera)


@dataclass(slots=True)
class Search:
    """What the recordings so far say of the magnitude, in octaves above `clear`."""

    log_likelihood: Array
    """(middle, width) float64. Of all that was tried."""

    def __init__(self) -> None:
        self.log_likelihood = np.zeros((_MIDDLE.size, _WIDTH.size))

    def add(self, octaves: float, *, named: bool) -> None:
        """Take a recording into account."""
        share = (1 - LAPSES) * ndtr((octaves - _MIDDLE) / _WIDTH)
        self.log_likelihood += np.log(np.maximum(share if named else 1 - share, 1e-12))

    def next(self) -> float:
        """Where to try next: a width above the middle, and never above `clear`."""
        return min(0.0, self._mean(_MIDDLE + _WIDTH))

    def found(self) -> tuple[float, float]:
        """Octaves at which SHARE of the recordings are named, and their standard deviation."""
        at = _MIDDLE + _ABOVE * _WIDTH
        mean = self._mean(at)
        return mean, math.sqrt(self._mean((at - mean) ** 2))

    def _mean(self, values: Array) -> float:
        weight = np.exp(self.log_likelihood - self.log_likelihood.max())
        return float((weight * values).sum() / weight.sum())
