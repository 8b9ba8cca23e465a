"""Which law of mixing holds in a recording: samples of one surface each, as in equation (1), or phasor sums."""

import math
from dataclasses import dataclass
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
