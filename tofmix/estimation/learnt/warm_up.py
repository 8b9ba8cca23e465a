"""Compile the kernels of learnt noise, or load them from the cache: each runs once on some made-up pixels."""

from dataclasses import replace

import numpy as np

from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.bootstrap import calibrate
from tofmix.estimation.learnt.clusters import find_clusters, fit_clusters
from tofmix.estimation.learnt.held_out import flat_thresholds, held_out_scores
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.shares import background_shares, pixel_widths
from tofmix.estimation.noise.pair_differences import sigma_from_differences
from tofmix.sensor import NoiseCurve, Sensor

_RANGE_MM, _SIGMA_MM = 1000.0, 10.0
_FRAMES, _PIXELS = 20, 3
"""Range, sigma and size of the made-up samples."""


def warm_up() -> None:
    """Run each kernel once."""
    samples = np.random.default_rng(1).normal(_RANGE_MM, _SIGMA_MM, (_PIXELS, _FRAMES)).astype(np.float32)
    sensor = Sensor(
        name="warm-up",
        range_min_mm=0.0,
        range_max_mm=2.0 * _RANGE_MM,
        noise=NoiseCurve(np.array([_RANGE_MM]), np.array([_SIGMA_MM])),
    )
    assert sensor.noise is not None  # noqa: S101  it was given
    noise = PixelNoise.gaussian(sensor.noise, sensor.outlier_probability)
    laws, beam, thresholds = noise.laws(), beam_of(sensor), flat_thresholds()
    sigma_from_differences(samples)
    fit_clusters(samples, find_clusters(samples, beam), laws[0], beam, True)  # noqa: FBT003  a kernel's flag
    held_out_scores(samples, laws, beam, thresholds, 2)
    background_shares(samples, laws, beam, thresholds, 2)
    pixel_widths(samples, laws, laws[0], beam, thresholds, 2)
    gains = calibrate(noise, beam, np.array([_RANGE_MM]), samples=(_FRAMES, _FRAMES), draws=_FRAMES)
    layer_pixels(samples.T, replace(sensor, learnt=noise.learnt_with(gains)))
