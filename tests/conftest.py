"""Fixtures and helpers that several folders of tests share."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from tofmix.sensor import NoiseCurve, Sensor

# The first call of a kernel compiles it: no deadline. One seed: CI sees what we saw.
settings.register_profile("tofmix", deadline=None, derandomize=True)
settings.load_profile("tofmix")

# `import naive`, `import scenes_in_memory`: helpers beside the tests, not a package.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20080922)


@pytest.fixture
def sensor() -> Sensor:
    """A camera whose noise grows with range, unlike any built-in one."""
    noise = NoiseCurve(np.array([400.0, 1500.0, 3000.0, 6000.0]), np.array([12.0, 25.0, 60.0, 200.0]))
    return Sensor(name="test camera", range_min_mm=300.0, range_max_mm=6000.0, noise=noise)
