"""What samples say against a file's curve: each kind of contradiction by its name, and nothing where it is right."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import CAMERA, KNOWN, SIGMA_MM, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.noise.curve_check import doubts
from tofmix.estimation.noise.training_pixels import Pixels
from tofmix.sensor import NoiseCurve

FRAMES, PIXELS = 80, 200


def _doubts(samples: FloatArray, sigma_mm: float = SIGMA_MM, outliers: float = 1e-4) -> list[str]:
    sensor = replace(CAMERA, noise=NoiseCurve(np.array([2000.0]), np.array([sigma_mm])), outlier_probability=outliers)
    return doubts(Pixels(samples=np.ascontiguousarray(samples.T, dtype=np.float32)), sensor)


def test_right_curve_is_not_doubted() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        assert _doubts(surfaces(rng, (FRAMES, PIXELS), (2000.0,))) == []
        assert _doubts(surfaces(rng, (FRAMES, PIXELS), (1500.0, 3000.0), (0.5, 0.5))) == []


@pytest.mark.parametrize("factor", [0.7, 1.4, 3.0])
def test_wrong_sigma_is_doubted(factor: float, rng: np.random.Generator) -> None:
    assert "width" in _doubts(surfaces(rng, (FRAMES, PIXELS), (2000.0,)), factor * SIGMA_MM)


def test_widths_shape_drift_and_background_are_each_doubted_by_name(rng: np.random.Generator) -> None:
    size = FRAMES, PIXELS
    width = np.exp(0.3 * rng.standard_normal(PIXELS))
    assert _doubts(surfaces(rng, size, (2000.0,), width=width)) == ["widths"]
    assert "shape" in _doubts(surfaces(rng, size, (2000.0,), errors=KNOWN["skewed"].draw))
    assert "shape" in _doubts(surfaces(rng, size, (2000.0,), errors=KNOWN["laplace"].draw))
    drift = 1.5 * SIGMA_MM * np.linspace(-1.0, 1.0, FRAMES)[:, np.newaxis]
    assert "drift" in _doubts(surfaces(rng, size, (2000.0,), drift_mm=drift))
    assert _doubts(surfaces(rng, size, (2000.0,), background=0.1)) == ["background"]
    assert _doubts(surfaces(rng, size, (2000.0,), background=0.1), outliers=0.1) == []


def test_without_clear_clusters_differences_test_the_curve(rng: np.random.Generator) -> None:
    close = surfaces(rng, (FRAMES, PIXELS), (2000.0, 2000.0 + 6.0 * SIGMA_MM), (0.5, 0.5))
    assert _doubts(close, 0.1 * SIGMA_MM) == ["width"]


def test_few_pixels_raise_no_doubt(rng: np.random.Generator) -> None:
    assert _doubts(surfaces(rng, (30, 5), (2000.0,))) == []
    assert _doubts(np.full((30, 5), np.nan)) == []


def test_a_camera_without_a_curve_is_refused() -> None:
    with pytest.raises(ValueError, match="no noise curve"):
        doubts(Pixels(samples=np.zeros((5, 5), dtype=np.float32)), CAMERA)
