"""A camera whose noise is skewed, differs from pixel to pixel and has a background: a model for several tests."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from tofmix.noise_shape import NoiseShape
from tofmix.simulation.model import Model


def skewed(skewness: float = 1.0, points: int = 121) -> NoiseShape:
    """A gamma distribution of a skewness, moved and scaled as a noise shape."""
    power = 4.0 / skewness**2
    z = np.linspace(0.0, stats.gamma.isf(1e-5, power), points)
    return NoiseShape.standardised(z, stats.gamma.pdf(z, power))


def long_tailed(points: int = 161) -> NoiseShape:
    """Student's t of 5 degrees of freedom, up to 12 sigma."""
    z = np.linspace(-12.0, 12.0, points)
    return NoiseShape.standardised(z, stats.t.pdf(z, 5))


def listed(values: object) -> str:
    """Numbers as a TOML list, a few a line."""
    numbers = [f"{float(v)!r}" for v in np.asarray(values)]
    lines = [", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
    return "[\n" + ",\n".join(lines) + "]"


def shape_keys(shape: NoiseShape) -> str:
    """Keys of ``[sensor.noise]`` for a shape."""
    return f"shape_z = {listed(shape.z)}\nshape_density = {listed(shape.density)}\n"


def sensor_text(parts: str, *, outliers: float) -> str:
    """The tables of a small camera, whose sigma is twice the curve's: ``[sensor.noise]`` has further keys `parts`."""
    return f"""
[sensor]
profile = "sr4000"
rows = 8
cols = 12
integration_time_ms = 2.0
outlier_probability = {outliers}
[sensor.noise]
range_mm = [500.0, 2000.0, 5000.0]
sigma_mm = [6.0, 15.0, 40.0]
reference_integration_time_ms = 8.0
exponent = 0.5
{parts}
"""


SCENE = """
[recording]
frames = 60
seed = 3
[[surface]]
name = "board"
center_mm = [-500.0, 0.0, 1800.0]
size_mm = [800.0, 3000.0]
reflectivity = 0.3
[[surface]]
name = "wall"
center_mm = [500.0, 0.0, 3000.0]
size_mm = [2500.0, 9000.0]
"""


def model_text(parts: str = "", effects: str = "") -> str:
    """The model with keys of ``[sensor.noise]`` and tables of effects."""
    return sensor_text(parts, outliers=0.01) + SCENE + effects


def with_noise(model: Model, **parts: Any) -> Model:  # noqa: ANN401  of NoiseCurve
    """The model with other parts of its noise."""
    return replace(model, sensor=replace(model.sensor, noise=replace(model.sensor.noise, **parts)))
