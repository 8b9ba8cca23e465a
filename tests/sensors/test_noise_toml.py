"""A noise curve as a table of a model file is read as the same curve."""

import numpy as np
import pytest

from tofmix.noise_shape import NoiseShape
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensors.noise_toml import noise_toml
from tofmix.simulation.model_toml import parse_model

RANGE, SIGMA = np.array([500.0, 1234.5, 7500.0]), np.array([3.25, 7.0, 151.125])
LAW = AmplitudeLaw(
    reference=np.array([900.0, 300.0, 20.0]), amplitude=np.array([10.0, 100.0]), factor=np.array([3.0, 1.0])
)
WIDE = np.linspace(-6, 6, 121)
SHAPE = NoiseShape(z=WIDE, density=np.exp(-0.5 * WIDE**2) + 1e-4)
CURVES = (
    NoiseCurve(RANGE, SIGMA),
    NoiseCurve(RANGE, SIGMA, law=LAW),
    NoiseCurve(RANGE, SIGMA, shape=SHAPE, width_spread=0.125, background=np.array(0.03125)),
)


@pytest.mark.parametrize("curve", CURVES, ids=["sigma", "amplitude", "shape, widths, background"])
def test_table_is_read_as_the_same_curve(curve: NoiseCurve) -> None:
    table = noise_toml(curve, integration_time_ms=2.5, exponent=0.5)
    sensor = parse_model(f'[sensor]\nprofile = "sr3000"\n{table}', source="a.toml").sensor
    assert sensor.reference_integration_time_ms == 2.5
    assert sensor.noise.sigma_mm.tolist() == curve.sigma_mm.tolist()
    assert sensor.noise.range_mm.tolist() == curve.range_mm.tolist()
    assert sensor.noise.width_spread == curve.width_spread
    if curve.law is not None:
        assert sensor.noise.law is not None
        assert sensor.noise.law.factor.tolist() == curve.law.factor.tolist()
    if curve.shape is not None:
        assert sensor.noise.shape is not None
        assert sensor.noise.shape.density == pytest.approx(curve.shape.density, abs=1e-5)
    if curve.background is not None:
        assert sensor.noise.background == curve.background


def test_table_of_an_unknown_integration_time_leaves_it_to_the_model() -> None:
    assert "reference_integration_time_ms" not in noise_toml(CURVES[0], integration_time_ms=None)


def test_map_of_background_is_a_path_or_its_mean() -> None:
    curve = NoiseCurve(RANGE, SIGMA, background=np.array([[0.0, 0.25]]))
    assert "background = 0.125" in noise_toml(curve, integration_time_ms=1.0)
    assert 'background = "b.npy"' in noise_toml(curve, integration_time_ms=1.0, background="b.npy")
