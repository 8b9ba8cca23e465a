"""Whether samples without a return are a constant, told from a recording."""

import numpy as np
import pytest

from tofmix.arrays import FloatArray
from tofmix.estimation.noise.measurement import no_return_constant
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

CAMERA = Sensor(
    name="a camera", range_max_mm=6000.0, noise=NoiseCurve(np.array([500.0, 6000.0]), np.array([10.0, 200.0]))
)


def scene(rng: np.random.Generator, no_return: FloatArray | float) -> ArrayRecording:
    """A wall at 2 m; the left columns, of 4 x 5 pixels, see nothing."""
    samples = 2000.0 + 60.0 * rng.standard_normal((30, 4, 8))
    samples[:, :, :5] = no_return
    return ArrayRecording(samples, CAMERA)


@pytest.mark.parametrize("value", [6000.0, 5950.0, 6100.0])
def test_constant_of_pixels_without_a_return_is_found(rng: np.random.Generator, value: float) -> None:
    assert no_return_constant(scene(rng, value)) == value


def test_samples_that_scatter_around_r_max_are_no_constant(rng: np.random.Generator) -> None:
    assert no_return_constant(scene(rng, 6000.0 + 200.0 * rng.standard_normal((30, 4, 5)))) is None


def test_a_few_stuck_pixels_among_scattered_ones_are_no_constant(rng: np.random.Generator) -> None:
    scattered = 6000.0 + 200.0 * rng.standard_normal((30, 4, 5))
    scattered[:, 0, :4] = 5900.0
    assert no_return_constant(scene(rng, scattered)) is None


def test_walls_near_the_constant_do_not_hide_it(rng: np.random.Generator) -> None:
    mixed = 5800.0 + 190.0 * rng.standard_normal((30, 4, 5))
    mixed[:, 3] = 6000.0
    assert no_return_constant(scene(rng, mixed)) == 6000.0


def test_too_few_samples_or_an_unknown_range_max_give_no_constant(rng: np.random.Generator) -> None:
    few = scene(rng, 6000.0).read_range(slice(0, 9), slice(None))
    assert no_return_constant(ArrayRecording(few, CAMERA)) is None
    endless = Sensor(name="endless", noise=CAMERA.noise)
    assert no_return_constant(ArrayRecording(scene(rng, 6000.0).read_range(slice(None), slice(None)), endless)) is None
