"""The noise of a recording's pixels, as the estimator takes it and as a sensor and a layers file carry it."""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD, Law, law_of
from tofmix.estimation.learnt.thresholds import GainThresholds
from tofmix.learnt_noise import DRIFTS, LearntNoise
from tofmix.sensor import NoiseCurve, Sensor

SURE_SAMPLES = 1000.0
"""Pseudo-count, in samples, of the sensor's p(c_r), where pixels have no share of background each."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelNoise:
    """Noise of a recording's pixels, beyond a Gaussian of sigma(r).

    Parameters
    ----------
    curve : NoiseCurve
        sigma by range, and by amplitude where it has a law; the shape of the error, None for a Gaussian; and
        `width_spread`, the standard deviation of log width, 0 where all widths are equal; and the density of
        background, None where it is uniform. Log widths follow a Student t of the scale `law.SCALE_OF_SPREAD` times it.
    background : (float, float) or None
        Prior of each pixel's share of background, a Beta density: pseudo-counts, in samples, of background and
        of the rest. None: every pixel has about the sensor's p(c_r), `p_outlier`.
    p_outlier : float
        The sensor's p(c_r).
    drift_mm : (DRIFTS,) float64
        Scales, mm, of the drift of a pixel's ranges within a window: Legendre polynomials of time, degrees 1 to 3.
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
        """Gaussian noise of the curve's sigma(r), with the share `p_outlier` of background."""
        return cls(curve=curve, p_outlier=p_outlier, drift_mm=np.zeros(DRIFTS))

    @property
    def is_gaussian(self) -> bool:
        """Whether the noise is Gaussian, of sigma(r), and independent from frame to frame."""
        return (
            self.curve.shape is None
            and self.curve.width_spread == 0.0
            and self.background is None
            and self.curve.background_density is None
            and self.memory == 0.0
            and not self.drift_mm.any()
        )

    def laws(self) -> tuple[Law, Law]:
        """Tables for the kernels; the second without drift."""
        known = SURE_SAMPLES * self.p_outlier, SURE_SAMPLES * (1.0 - self.p_outlier)
        law = law_of(
            self.curve.shape,
            background=self.background or known,
            width_spread=SCALE_OF_SPREAD * self.curve.width_spread,
            drift_mm=self.drift_mm,
        )
        return law, law._replace(drift_mm=np.zeros(DRIFTS))

    @classmethod
    def of(cls, sensor: Sensor) -> "PixelNoise":
        """The noise that a sensor carries.

        Raises
        ------
        ValueError
            If it has no noise curve.
        """
        if sensor.noise is None:
            raise ValueError("the sensor has no noise curve")
        learnt = sensor.learnt
        if learnt is None:
            return cls.gaussian(sensor.noise, sensor.outlier_probability)
        return cls(
            curve=sensor.noise,
            p_outlier=sensor.outlier_probability,
            background=learnt.background,
            drift_mm=learnt.drift_mm,
            memory=learnt.memory,
        )

    def learnt_with(self, thresholds: GainThresholds) -> LearntNoise:
        """The noise as a sensor carries it, with the gains that it reaches alone."""
        return LearntNoise(
            background=self.background,
            drift_mm=self.drift_mm,
            memory=self.memory,
            gain_samples=np.exp(thresholds.log_n),
            gain_background=thresholds.background,
            gain_more=thresholds.more,
            gain_first=thresholds.first,
        )


def thresholds_of(learnt: LearntNoise) -> GainThresholds:
    """The gains that a sensor carries, as kernels read them."""
    return GainThresholds(
        log_n=np.log(learnt.gain_samples),
        background=np.array(learnt.gain_background),
        more=np.array(learnt.gain_more),
        first=np.array(learnt.gain_first),
    )
