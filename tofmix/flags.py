"""What the codes of a result mean: the status of a pixel, its kind of mixing, and the law of a whole recording.

Codes have one definition for code, files and documentation. Samples of a recording show one surface each, as in
equation (1), or are phasor sums.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class MixingLaw:
    """The law, over one window or several.

    Parameters
    ----------
    phasor_share : float
        q, the share of the samples at edges that are phasor sums. Where no pixel determines it: 1 if sums are assumed,
        else NaN.
    pixels : int
        Pixels that determine it.
    """

    phasor_share: float
    pixels: int

    @classmethod
    def of_windows(cls, shares: NDArray[np.floating], pixels: NDArray[np.integer]) -> Self:
        """Mean over windows (window,), weighted by the pixels that determine each; without any, what is assumed."""
        told = int(pixels.sum())
        assumed = float(np.nanmax(shares)) if np.isfinite(shares).any() else math.nan
        mean = float(np.nansum(np.asarray(shares, np.float64) * pixels) / told) if told else assumed
        return cls(phasor_share=mean, pixels=told)

    def words(self) -> str:
        """Say it: ``100 % of the samples at edges are phasor sums (2,016 pixels)``."""
        if math.isnan(self.phasor_share):
            return "no edge shows whether samples are phasor sums; each sample counts as one surface"
        if not self.pixels:
            return (
                "no edge shows whether samples are phasor sums; a lock-in camera sums, and nothing contradicts it, so"
                " mixed pixels that no neighbours unmix are undecided (--mixing events: each sample is one surface)"
            )
        percent = round(100.0 * min(max(self.phasor_share, 0.0), 1.0))
        return f"{percent} % of the samples at edges are phasor sums ({self.pixels:,} pixels)"

    def as_dict(self) -> dict[str, Any]:
        """The same for JSON; None where nothing is known."""
        share = None if math.isnan(self.phasor_share) else self.phasor_share
        return {"phasor_share": share, "pixels": self.pixels}


def law_over_windows(shares: NDArray[np.floating] | None, pixels: NDArray[np.integer] | None) -> MixingLaw | None:
    """`MixingLaw.of_windows`; None where it was not measured."""
    return None if shares is None or pixels is None else MixingLaw.of_windows(shares, pixels)


class Status(IntEnum):
    """Outcome of the estimator for one pixel in one window (CF flag values).

    Compare arrays with ``int(member)``: NumPy takes a member for a number of 64 bits, and casts the whole array.
    """

    OK = 0
    TOO_FEW_SAMPLES = 1
    NOT_CONVERGED = 2
    NO_SURFACE = 3
    DEGENERATE = 4


STATUS_MEANINGS: dict[Status, str] = {
    Status.OK: "the layers, if any, are a converged fit",
    Status.TOO_FEW_SAMPLES: "fewer valid samples than --min-samples; nothing was fitted",
    Status.NOT_CONVERGED: "EM stopped at --max-iter; the layers are its last values",
    Status.NO_SURFACE: "the samples show no surface: no return, or outliers alone",
    Status.DEGENERATE: "the layers are valid, but the samples do not determine their errors (singular information)",
}


class Mixing(IntEnum):
    """Kind of mixing of a pixel's samples (CF flag values)."""

    ONE_SURFACE = 0
    EVENTS = 1
    PHASOR = 2
    UNDECIDED = 3


MOST_UNDECIDED = 0.5
"""Most probability of a layer in a pixel whose mixing is undecided."""

MIXING_MEANINGS: dict[Mixing, str] = {
    Mixing.ONE_SURFACE: "the pixel sees one surface, or none",
    Mixing.EVENTS: "each sample shows one of several surfaces",
    Mixing.PHASOR: "samples are phasor sums of several surfaces; the layers are unmixed with the help of neighbours",
    Mixing.UNDECIDED: "samples may be phasor sums, or filtered over pixels, of surfaces that cannot be determined; the"
    " layers are those of events",
}


def mixing_name(value: int) -> str:
    """``one_surface`` for 0 and so on, as in the files' ``flag_meanings``; ``mixing_9`` for a value without a name."""
    return Mixing(value).name.lower() if value in tuple(Mixing) else f"mixing_{value}"


def status_name(value: int) -> str:
    """``too_few_samples`` for 1 and so on, as in the files' ``flag_meanings``; ``status_9`` without a name."""
    return Status(value).name.lower() if value in tuple(Status) else f"status_{value}"
