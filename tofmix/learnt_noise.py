"""Learnt noise of the pixels beyond the noise curve: background, drift, memory, and gains by chance.

`tofmix.estimation.learnt` learns it; a sensor carries it, so threads, shards, clusters and resumed runs all use the
same noise.
"""

from dataclasses import dataclass, fields

import numpy as np

from tofmix.arrays import FloatArray

DRIFTS = 3
"""Legendre polynomials of time, of the degrees 1 to 3, that a pixel's ranges may follow within a window."""

TAIL_DEGREES = 4.0
"""Degrees of freedom of the Student t priors of log width and drift: some pixels are far wider than others."""

MOST_LOG_WIDTH = 1.5
"""Largest absolute log width of a pixel."""

_SHAPES = {"drift_mm": 1, "gain_samples": 1, "gain_background": 1, "gain_more": 3, "gain_first": 2}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearntNoise:
    """Noise of pixels in addition to a curve, and the gains in likelihood that this noise alone reaches.

    Parameters
    ----------
    background : (float, float) or None
        Prior of each pixel's share of uniform background, a Beta density: pseudo-counts, in samples, of background and
        of the rest. None: every pixel has about the sensor's p(c_r).
    drift_mm : (DRIFTS,) float64
        Scale, mm, of what each pixel's ranges follow within a window.
    memory : float
        Correlation of the standardised error from one frame to the next, as of AR(1) noise, in [0, 1).
    gain_samples : (n,) float64
        Numbers of samples, ascending, that the gains are known for.
    gain_background : (b,) float64
        Shares of background, ascending, that they are known for.
    gain_more : (n, b, chance) float64
        Gain, nat, of one surface more that noise exceeds with each of
        `tofmix.estimation.mixture.false_alarms.FALSE_ALARMS`.
    gain_first : (n, chance) float64
        The same for the first surface beside background alone.

    Raises
    ------
    ValueError
        If an array has a wrong number of dimensions or a wrong length, a number is not finite, or one is out of its
        bounds.
    """

    background: tuple[float, float] | None
    drift_mm: FloatArray
    memory: float
    gain_samples: FloatArray
    gain_background: FloatArray
    gain_more: FloatArray
    gain_first: FloatArray

    def __post_init__(self) -> None:
        for name, dimensions in _SHAPES.items():
            values = np.array(getattr(self, name), dtype=np.float64, copy=True)
            if values.ndim != dimensions or values.size == 0 or not np.isfinite(values).all() or (values < 0).any():
                raise ValueError(
                    f"learnt noise: {name}: expected {dimensions} dimensions of finite numbers, none negative"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        sizes = len(self.gain_samples), len(self.gain_background)
        if self.gain_more.shape[:2] != sizes or self.gain_first.shape != (sizes[0], self.gain_more.shape[2]):
            raise ValueError("learnt noise: the tables of gains differ in size")
        if len(self.drift_mm) != DRIFTS:
            raise ValueError(f"learnt noise: drift_mm: {len(self.drift_mm)} numbers, not {DRIFTS}")
        if not 0 <= self.memory < 1:
            raise ValueError(f"learnt noise: memory {self.memory:g} is not in [0, 1)")
        if self.background is not None and not (min(self.background) > 0 and np.isfinite(self.background).all()):
            raise ValueError("learnt noise: background: two finite numbers above 0 are expected")

    def same_as(self, other: "LearntNoise | None") -> bool:
        """Whether all numbers are equal."""
        return other is not None and all(
            np.array_equal(np.array(getattr(self, f.name) or 0.0), np.array(getattr(other, f.name) or 0.0))
            if f.name == "background"
            else np.array_equal(getattr(self, f.name), getattr(other, f.name))
            for f in fields(self)
        )
