"""What is learnt of a recording's noise: what the estimator is given, and what a layers file keeps of it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.law import DRIFTS, Law, law_of
from tofmix.sensor import NoiseCurve

if TYPE_CHECKING:
    from tofmix.estimation.learnt.counting import Thresholds


SURE_SAMPLES = 1000.0
"""Where pixels have no background of their own, p(c_r) is as sure as if so many samples had told it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelNoise:
    """The noise of a recording's pixels, beyond a Gaussian of sigma(r).

    Parameters
    ----------
    curve : NoiseCurve
        sigma by range, and by amplitude where there is a law; with the shape of the error, None for a Gaussian, and
        `width_spread`, 0 where the widths of all pixels are alike.
    background : (float, float) or None
        Prior of each pixel's share of uniform background, a Beta density: pseudo-counts, in samples, of background and
        of the rest. None: every pixel has about the sensor's p(c_r), `p_outlier`.
    p_outlier : float
        The sensor's p(c_r).
    drift_mm : (DRIFTS,) float64
        Scale, mm, of what each pixel's ranges follow within a window: Legendre polynomials of the degrees 1 to 3.
    memory : float
        Correlation of the standardised error from one frame to the next, as of AR(1) noise, 0 to below 1.
    """

    curve: NoiseCurve
    p_outlier: float
    background: tuple[float, float] | None = None
    drift_mm: FloatArray
    memory: float = 0.0

    @classmethod
    def gaussian(cls, curve: NoiseCurve, p_outlier: float) -> "PixelNoise":
        """Nothing beyond the curve."""
        return cls(curve=curve, p_outlier=p_outlier, drift_mm=np.zeros(DRIFTS))

    @property
    def is_gaussian(self) -> bool:
        """Whether the noise is that of a Gaussian of sigma(r), pixel by pixel and frame by frame."""
        return (
            self.curve.shape is None
            and self.curve.width_spread == 0.0
            and self.background is None
            and self.memory == 0.0
            and not self.drift_mm.any()
        )

    def laws(self) -> tuple[Law, Law]:
        """Tables for the kernels; the second without drift."""
        known = SURE_SAMPLES * self.p_outlier, SURE_SAMPLES * (1.0 - self.p_outlier)
        law = law_of(
            self.curve.shape,
            background=self.background or known,
            width_spread=self.curve.width_spread,
            drift_mm=self.drift_mm,
        )
        return law, law._replace(drift_mm=np.zeros(DRIFTS))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibratedNoise:
    """A recording's noise with the gains that it reaches by chance (`tofmix.estimation.learnt.thresholds`)."""

    noise: PixelNoise
    thresholds: "Thresholds"
