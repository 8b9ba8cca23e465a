"""Cameras with learnt noise, and pixels that have it: for the tests of tests/estimation/learnt."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.model import GainThresholds, PixelNoise
from tofmix.estimation.mixture.counting import FALSE_ALARMS
from tofmix.noise_shape import DRIFTS, NoiseShape
from tofmix.sensor import NoiseCurve, Sensor

LOW_MM, TOP_MM = 300.0, 6000.0
SIGMA_MM = 20.0
CAMERA = Sensor(name="learner", range_min_mm=LOW_MM, range_max_mm=TOP_MM)
"""As a recording of an unknown camera has it: no curve."""

CENTRAL = stats.norm.cdf([-1.0, 0.0, 1.0])


class Known(NamedTuple):
    """A density that SciPy knows, standardised as shapes are: z = (x - middle) / half."""

    law: Any
    middle: float
    half: float

    def pdf(self, z: ArrayLike) -> FloatArray:
        """Density of z."""
        return np.asarray(self.half * self.law.pdf(self.middle + self.half * np.asarray(z)))

    def cdf(self, z: ArrayLike) -> FloatArray:
        """Chance of less than z."""
        return np.asarray(self.law.cdf(self.middle + self.half * np.asarray(z)))

    def draw(self, rng: np.random.Generator, size: tuple[int, ...]) -> FloatArray:
        """Random z."""
        return np.asarray((self.law.rvs(size=size, random_state=rng) - self.middle) / self.half)

    def shape(self) -> NoiseShape:
        """A table of it, 32 points a unit, out to 20."""
        z = np.linspace(-20.0, 20.0, 1281)
        return NoiseShape.standardised(z, self.pdf(z))


def _known(law: Any) -> Known:  # noqa: ANN401  a frozen distribution of SciPy
    low, middle, high = law.ppf(CENTRAL)
    return Known(law, float(middle), 0.5 * float(high - low))


KNOWN = {
    "gaussian": _known(stats.norm()),
    "skewed": _known(stats.gamma(4.0)),
    "student": _known(stats.t(5.0)),
    "laplace": _known(stats.laplace()),
}
"""Errors of skewness 1, of long tails, and with a sharp peak, beside the Gaussian."""


def pixel_noise(
    name: str = "gaussian",
    *,
    sigma_mm: float = SIGMA_MM,
    p_outlier: float = 1.0e-4,
    background: tuple[float, float] | None = None,
    width_spread: float = 0.0,
    drift_mm: tuple[float, ...] = (0.0,) * DRIFTS,
    memory: float = 0.0,
) -> PixelNoise:
    """Noise of one sigma at all ranges."""
    curve = NoiseCurve(
        np.array([1000.0]),
        np.array([sigma_mm]),
        shape=None if name == "gaussian" else KNOWN[name].shape(),
        width_spread=width_spread,
    )
    return PixelNoise(
        curve=curve, p_outlier=p_outlier, background=background, drift_mm=np.array(drift_mm), memory=memory
    )


def flat(more: float = 7.0, first: float = 5.0) -> GainThresholds:
    """The same gains for all numbers of samples and shares of background, in a narrow ladder of chances."""
    ladder = 0.01 * np.arange(len(FALSE_ALARMS), dtype=np.float64)
    return GainThresholds(
        log_n=np.zeros(1),
        background=np.zeros(1),
        more=np.asarray(more + ladder, dtype=np.float64)[np.newaxis, np.newaxis],
        first=np.asarray(first + ladder, dtype=np.float64)[np.newaxis],
    )


def camera_with(noise: PixelNoise, thresholds: GainThresholds | None = None, camera: Sensor = CAMERA) -> Sensor:
    """A camera that carries the noise."""
    return replace(
        camera,
        noise=noise.curve,
        outlier_probability=noise.p_outlier,
        learnt=noise.learnt_with(thresholds or flat()),
    )


Errors = Callable[[np.random.Generator, tuple[int, ...]], FloatArray]


def surfaces(
    rng: np.random.Generator,
    size: tuple[int, int],
    ranges_mm: tuple[float, ...],
    shares: tuple[float, ...] = (1.0,),
    *,
    errors: Errors = KNOWN["gaussian"].draw,
    width: FloatArray | float = 1.0,
    background: FloatArray | float = 0.0,
    drift_mm: FloatArray | float = 0.0,
    sigma_mm: float = SIGMA_MM,
) -> FloatArray:
    """Samples (frame, pixel), mm, of pixels that see surfaces with these shares."""
    which = rng.choice(len(ranges_mm), size=size, p=np.array(shares))
    out = np.array(ranges_mm)[which] + drift_mm + sigma_mm * width * errors(rng, size)
    random = rng.random(size) < background
    return np.asarray(np.where(random, rng.uniform(LOW_MM, TOP_MM, size), out), dtype=np.float64)
