"""Samples drawn from equation (1), for the tests of the estimator; shares no code with the simulator."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tofmix.sensor import Sensor


def draw(
    rng: np.random.Generator,
    sensor: Sensor,
    *,
    ranges_mm: Sequence[float],
    shares: Sequence[float],
    n: int,
    pixels: int,
    outliers: float = 0.0,
) -> NDArray[np.float32]:
    """Draw (n, pixels) float32 samples; what the shares leave to 1 are samples without a return."""
    assert sensor.noise is not None
    centres = [*ranges_mm, sensor.range_max_mm or 0.0]
    full = [*shares, max(0.0, 1 - sum(shares))]
    mean = np.array(centres)[rng.choice(len(centres), p=np.array(full) / sum(full), size=(n, pixels))]
    samples = mean + rng.standard_normal((n, pixels)) * sensor.noise.sigma(mean)
    wild = rng.random((n, pixels)) < outliers
    samples[wild] = rng.uniform(sensor.range_min_mm or 0.0, sensor.range_max_mm or 6000.0, int(wild.sum()))
    return np.asarray(samples, dtype=np.float32)
