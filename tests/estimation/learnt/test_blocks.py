"""Which estimates count with learnt noise, and what options make of its parts."""

from typing import Any

import numpy as np
import pytest
from support.learnt_pixels import SIGMA_MM, camera_with, flat, pixel_noise, surfaces

from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.blocks import layers_with_learnt
from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode, counts_with_learnt
from tofmix.layers import Layers
from tofmix.sensor import NoiseCurve, Sensor

WIDE = camera_with(pixel_noise(width_spread=0.4))
PLAIN = Sensor(name="plain", range_max_mm=6000.0, noise=NoiseCurve(np.array([1000.0]), np.array([SIGMA_MM])))


@pytest.mark.parametrize(
    ("options", "counts"),
    [
        ({}, True),
        ({"sigma": SigmaMode.TIED}, True),
        ({"sigma": SigmaMode.FREE}, False),
        ({"refine": Refine.NONE}, False),
        ({"paper": True}, False),
    ],
)
def test_paper_options_use_a_gaussian_alone(options: dict[str, Any], counts: bool) -> None:
    assert counts_with_learnt(WIDE, EstimateOptions(**options)) is counts
    assert not counts_with_learnt(PLAIN, EstimateOptions(**options))


def test_tied_sigmas_give_no_pixel_a_width(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 20), (2000.0,), width=1.3)
    free = layer_pixels(samples, WIDE)
    tied = layer_pixels(samples, WIDE, EstimateOptions(sigma=SigmaMode.TIED))
    assert free.noise_width is not None
    assert tied.noise_width is not None
    assert float(np.median(free.noise_width)) == pytest.approx(1.3, rel=0.05)
    np.testing.assert_array_equal(tied.noise_width, 1.0)


def test_widths_are_kept_only_where_they_were_learnt(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (30, 5), (2000.0,))
    assert layer_pixels(samples, camera_with(pixel_noise("skewed"))).noise_width is None


@pytest.mark.parametrize("memory", [0.2, 0.5, 0.9])
def test_memory_widens_errors_of_range_by_that_of_a_mean_of_ar1_noise(memory: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 20), (2000.0,))
    without, with_it = (layer_pixels(samples, camera_with(pixel_noise("skewed", memory=m))) for m in (0.0, memory))
    # The variance of the mean of n samples of AR(1), over sigma^2 / n, for large n.
    lags = np.arange(1, 3000)
    inflation = 1.0 + 2.0 * float((memory**lags).sum())
    np.testing.assert_allclose(with_it.range_stderr[:, 0], np.sqrt(inflation) * without.range_stderr[:, 0], rtol=1e-5)
    np.testing.assert_array_equal(with_it.range, without.range)


def test_probability_is_the_chance_that_noise_gains_as_little(rng: np.random.Generator) -> None:
    # A ladder of gains, of which chance reaches the last once in 10^4.
    ladder = np.linspace(1.0, 12.0, len(FALSE_ALARMS))
    gains = flat()._replace(more=ladder[np.newaxis, np.newaxis], first=ladder[np.newaxis])
    samples = surfaces(rng, (60, 400), (2000.0, 2000.0 + 3.0 * SIGMA_MM), (0.9, 0.1))
    layers = layer_pixels(samples, camera_with(pixel_noise("skewed"), gains), EstimateOptions(false_alarm=0.02))
    found = np.isfinite(layers.range)
    assert (layers.probability[found] >= 1.0 - 0.02).all()
    assert (layers.probability[found] <= 1.0).all()
    strict = layer_pixels(samples, camera_with(pixel_noise("skewed"), gains), EstimateOptions(false_alarm=0.0001))
    assert (strict.n_modes <= layers.n_modes).all()
    assert (strict.n_modes < layers.n_modes).any()


def test_without_learnt_noise_the_kernel_is_not_called() -> None:
    with pytest.raises(ValueError, match="carries no learnt noise"):
        layers_with_learnt(
            np.zeros((1, 5), dtype=np.float32), beam_of(PLAIN), PLAIN, EstimateOptions(), Layers.empty((1,), 6)
        )
