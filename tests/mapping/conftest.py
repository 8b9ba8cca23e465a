"""A small camera with narrow pixels, and layers for it."""

from collections.abc import Sequence

import pytest
from support.alike import MakeLayers
from support.cameras import camera_of

from tofmix.layers import Layers
from tofmix.sensor import Sensor


@pytest.fixture
def camera() -> Sensor:
    """8 degrees wide and high, 6 m far; sigma 10 mm, so that space without a return is free up to 5980 mm."""
    return camera_of([1000.0], [10.0], reach_mm=(100.0, 6000.0), fov_deg=(8.0, 8.0))


@pytest.fixture
def make_layers() -> MakeLayers:
    """Layers that are the same in every pixel of an image of `size` x `size`."""

    def make(
        ranges: Sequence[float],
        weights: Sequence[float],
        *,
        no_return: float = 0.0,
        samples: int = 100,
        stderr: float = 0.0,
        probability: float = 1.0,
        size: int = 8,
    ) -> Layers:
        layers = Layers.empty((size, size), max(len(ranges), 1) + 1)
        layers.n_modes[:] = len(ranges)
        for k, (range_mm, weight) in enumerate(zip(ranges, weights, strict=True)):
            layers.range[..., k], layers.weight[..., k] = range_mm, weight
            layers.range_stderr[..., k], layers.probability[..., k] = stderr, probability
        layers.weight_no_return[:] = no_return
        layers.n_samples[:] = samples
        return layers

    return make
