"""Layers of a block of pixels whose sensor carries learnt noise; `blocks` has the kernel."""

import math

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.blocks import fill_layers
from tofmix.estimation.learnt.model import PixelNoise, thresholds_of
from tofmix.estimation.settings import EstimateOptions, SigmaMode, kernel_options
from tofmix.layers import Layers
from tofmix.learnt_noise import DRIFTS
from tofmix.sensor import Sensor


def layers_with_learnt(block: Float32Array, beam: Beam, sensor: Sensor, options: EstimateOptions, out: Layers) -> None:
    """Fill `out` for samples (pixel, frame), mm, NaN where invalid.

    On a circle of ranges no pixel drifts, because unrolled samples are not in the order of frames.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or carries no learnt noise.
    """
    if sensor.learnt is None:
        raise ValueError("the sensor carries no learnt noise")
    law, plain = PixelNoise.of(sensor).laws()
    if options.sigma is SigmaMode.TIED:
        law, plain = law._replace(width_spread=0.0), plain._replace(width_spread=0.0)
    if options.unambiguous_range_mm is not None:
        law = law._replace(drift_mm=np.zeros(DRIFTS))
    width = np.ones(len(block))
    fill_layers(block, out.arrays(), width, beam, (law, plain), thresholds_of(sensor.learnt), kernel_options(options))
    if out.noise_width is not None:
        out.noise_width[...] = width
    inflation = math.sqrt((1.0 + sensor.learnt.memory) / (1.0 - sensor.learnt.memory))
    if inflation > 1.0:
        # The variance of the mean of AR(1) noise is larger by this factor.
        out.range_stderr[...] *= inflation
