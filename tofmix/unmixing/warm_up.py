"""Compile the kernels of unmixing, or load them from the cache: they run once on a made-up image."""

import numpy as np

from tofmix.flags import Status
from tofmix.image.smooth.patch import STATE, TangentFrame, meet
from tofmix.layers import Layers, layer_fields
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.unmixing.phasors import mean_phasors, phase_scale_mm
from tofmix.unmixing.unmix import unmix

_RANGE_MM, _SIGMA_MM, _FREQUENCY_HZ = 1000.0, 10.0, 20.0e6
_FRAMES, _SIDE = 20, 12
"""Range of the near surface, noise and frequency of the camera, and size of the image."""


def warm_up_curved() -> None:
    """Let rays meet a patch, as beside surfaces that bend."""
    frame = TangentFrame(*(np.eye(3)[[part]] for part in (2, 0, 1, 2)))
    meet(frame, np.zeros((1, 1, STATE)), np.eye(3)[np.newaxis, 2:])


def warm_up() -> None:
    """Unmix the pixels between two surfaces that share the middle column."""
    sensor = Sensor(
        name="warm-up",
        range_max_mm=2.0 * _RANGE_MM,
        fov_horizontal_deg=10.0,
        fov_vertical_deg=10.0,
        modulation_frequency_hz=_FREQUENCY_HZ,
        noise=NoiseCurve(np.array([_RANGE_MM]), np.array([_SIGMA_MM])),
    )
    share = np.repeat([1.0, 0.5, 0.0], [_SIDE // 2, 1, _SIDE // 2 - 1])
    scale = phase_scale_mm(_FREQUENCY_HZ)
    sums = share * np.exp(1j * _RANGE_MM / scale) + (1.0 - share) * np.exp(1.5j * _RANGE_MM / scale)
    shape = (_FRAMES, _SIDE, _SIDE)
    range_mm = np.random.default_rng(3).normal(scale * np.angle(sums), _SIGMA_MM, shape)
    light = np.random.default_rng(4).normal(np.abs(sums), 0.01, shape)
    layers = Layers.empty(shape[1:], 1, layer_fields(sensor))
    layers.n_modes[...], layers.status[...], layers.n_samples[...] = 1, int(Status.OK), _FRAMES
    layers.range[..., 0], layers.sigma[..., 0], layers.weight[..., 0] = np.median(range_mm, axis=0), _SIGMA_MM, 1.0
    layers.range_stderr[..., 0], layers.weight_stderr[..., 0] = _SIGMA_MM / np.sqrt(_FRAMES), 0.0
    unmix(layers, mean_phasors(range_mm, light, sensor), sensor, insist=True)
