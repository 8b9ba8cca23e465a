"""The noise of a sensor in words: sigma, shape, background, widths, drift, memory."""

import numpy as np

from tofmix.sensor import NoiseCurve, Sensor

SEEN_SKEWNESS = 0.2
"""Least absolute skewness of a shape that is called skewed."""


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
    if abs(skewness) >= SEEN_SKEWNESS:
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
