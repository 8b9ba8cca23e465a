"""Compile the kernels of learnt noise, or load them from the cache: each runs once on some made-up pixels."""

from dataclasses import replace

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.estimation.beam import all_steps, beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.background import background_counts, background_shares, pixel_widths
from tofmix.estimation.learnt.bootstrap import calibrate
from tofmix.estimation.learnt.clusters import cluster_likelihoods, find_clusters, fit_clusters
from tofmix.estimation.learnt.folds import flat_thresholds, held_out_scores
from tofmix.estimation.learnt.law import precision_of_t
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.population import LOG_WIDTHS, ONE_SURFACE, population_likelihoods
from tofmix.noise_shape import RangeStep
from tofmix.sensor import NoiseCurve, Sensor

_RANGE_MM, _SIGMA_MM = 1000.0, 10.0
_FRAMES, _PIXELS = 20, 3
"""Range, sigma and size of the made-up samples."""


def warm_up() -> None:
    """Run each kernel once."""
    warm_up_first()
    warm_up_later()


def warm_up_first() -> None:
    """Run the kernels that learn sigma, drift and shape."""
    samples, sensor, noise = _made_up()
    laws, beam = noise.laws(), beam_of(sensor)
    fit_clusters(samples, find_clusters(samples, beam), laws[0], beam, True)  # noqa: FBT003  a kernel's flag
    held_out_scores(samples, laws, beam, flat_thresholds(), 2)
    precision_of_t(0.0, 1.0)


def warm_up_later() -> None:
    """Run the kernels that count surfaces, draw the gains of noise alone, and weigh sigmas of samples on a step."""
    samples, sensor, noise = _made_up()
    laws, beam, thresholds = noise.laws(), beam_of(sensor), flat_thresholds()
    clusters = find_clusters(samples, beam)
    fits = fit_clusters(samples, clusters, laws[0], beam, True)  # noqa: FBT003  a kernel's flag
    stepped = beam._replace(steps=all_steps(RangeStep.common(1.0)))
    cluster_likelihoods(samples, clusters, fits.place, fits.support, np.ones(len(fits.place)), laws[1], stepped)
    background_shares(samples, laws, beam, thresholds, 2)
    background_counts(samples, laws, beam, thresholds, 2, np.array([0.0, 2.0 * _RANGE_MM]))
    pixel_widths(samples, laws, laws[0], beam, thresholds, 2)
    none = np.zeros(1)
    population_likelihoods(np.zeros((1, _FRAMES)), none, none + 0.1, none + 1.0, laws[0], ONE_SURFACE, LOG_WIDTHS)
    gains = calibrate(noise, beam, np.array([_RANGE_MM]), samples=(_FRAMES, _FRAMES), draws=_FRAMES)
    layer_pixels(samples.T, replace(sensor, learnt=noise.learnt_with(gains)))


def _made_up() -> tuple[Float32Array, Sensor, PixelNoise]:
    """Samples (pixel, frame), mm, their camera, and its noise."""
    samples = np.random.default_rng(1).normal(_RANGE_MM, _SIGMA_MM, (_PIXELS, _FRAMES)).astype(np.float32)
    curve = NoiseCurve(np.array([_RANGE_MM]), np.array([_SIGMA_MM]))
    sensor = Sensor(name="warm-up", range_min_mm=0.0, range_max_mm=2.0 * _RANGE_MM, noise=curve)
    return samples, sensor, PixelNoise.gaussian(curve, sensor.outlier_probability)
