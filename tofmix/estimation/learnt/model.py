"""The noise of a recording's pixels, as the estimator takes it and as a sensor and a layers file carry it.

`GainThresholds` are the gains in likelihood that a surface must have, by number of samples and share of background.
`bootstrap` draws them for the learnt noise of a recording: the likelihood ratio between mixtures of different numbers
of surfaces has no known distribution, so that no formula gives these gains.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD, Law, law_of
from tofmix.noise_shape import DRIFTS, LearntNoise
from tofmix.sensor import NoiseCurve, Sensor


class GainThresholds(NamedTuple):
    """Gains, nat, that noise alone exceeds with each probability of `mixture.false_alarms.FALSE_ALARMS`.

    `log_n` (samples,) are logarithms of numbers of samples, ascending, and `background` (background,) shares of
    background, ascending. `more` (samples, background, probability) are the gains of a further surface, and `first`
    (samples, probability) those of the first surface over background alone.
    """

    log_n: FloatArray
    background: FloatArray
    more: FloatArray
    first: FloatArray


@borrowing
def _place_in(x: float, known: FloatArray) -> tuple[int, float]:
    """Find the interval of ascending `known` that holds x, and the place in it, 0 to 1; beyond the ends, the end."""
    last = len(known) - 1
    if last == 0 or x <= known[0]:
        return 0, 0.0
    if x >= known[last]:
        return last - 1, 1.0
    at = 0
    while known[at + 1] < x:
        at += 1
    return at, (x - known[at]) / (known[at + 1] - known[at])


@borrowing
def read_gains(n: float, background: float, first: bool, thresholds: GainThresholds, out: FloatArray) -> None:
    """Interpolate the gains for `n` samples and a share of background, nat, into `out` (probability,).

    `first` asks for the gains of the first surface. Linear in log n and in the share; beyond the table, its ends hold.
    """
    a, s = _place_in(math.log(n), thresholds.log_n)
    above = min(a + 1, len(thresholds.log_n) - 1)
    if first:
        for c in range(len(out)):
            out[c] = (1.0 - s) * thresholds.first[a, c] + s * thresholds.first[above, c]
        return
    b, t = _place_in(background, thresholds.background)
    right = min(b + 1, len(thresholds.background) - 1)
    for c in range(len(out)):
        low = (1.0 - t) * thresholds.more[a, b, c] + t * thresholds.more[a, right, c]
        high = (1.0 - t) * thresholds.more[above, b, c] + t * thresholds.more[above, right, c]
        out[c] = (1.0 - s) * low + s * high


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


def noise_words(sensor: Sensor) -> list[str]:
    """One short text a part, for a user; the shape and the widths always have one.

    Raises
    ------
    ValueError
        If the sensor has no noise curve.
    """
    curve, learnt = sensor.noise, sensor.learnt
    if curve is None:
        raise ValueError("the sensor has no noise curve")
    low, high = float(curve.sigma_mm.min()), float(curve.sigma_mm.max())
    said = [f"sigma {low:.3g} mm" if f"{low:.3g}" == f"{high:.3g}" else f"sigma {low:.3g} to {high:.3g} mm"]
    said.append(shape_words(curve))
    if curve.background is not None or (learnt is not None and learnt.background is not None):
        said.append(_background_words(curve))
    said.append(f"widths differ by {100 * curve.width_spread:.0f} %" if curve.width_spread else "widths alike")
    if learnt is not None and learnt.drift_mm.any():
        said.append(f"pixels drift by {2.0 * learnt.drift_mm.max():.2g} mm in a window")
    if learnt is not None and learnt.memory:
        said.append(f"memory {learnt.memory:.2g}")
    return said


def shape_words(curve: NoiseCurve) -> str:
    """``Gaussian``, ``skewed (1.3)``, ``long-tailed`` or ``short-tailed``."""
    if curve.shape is None:
        return "Gaussian"
    _, _, skewness, kurtosis = curve.shape.moments()
    seen_skewness = 0.2  # least absolute skewness of a shape that is called skewed
    if abs(skewness) >= seen_skewness:
        return f"skewed ({skewness:.1f})"
    return "long-tailed" if kurtosis > 0 else "short-tailed"


def _background_words(curve: NoiseCurve) -> str:
    said = "background by pixel"
    if curve.background is not None:
        low, high = np.quantile(curve.background, (0.05, 0.95))
        said = f"background {100 * low:.0f} to {100 * high:.0f} % by pixel"
    if curve.background_density is not None:
        near, far = curve.background_density.quantile((0.05, 0.95)) / 1000.0
        said += f", most of it from {near:.2g} to {far:.2g} m"
    return said
