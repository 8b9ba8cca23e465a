"""The camera's own sigma(r), measured on flat fields: what a user of the blind camera would put into a model file.

Use `calibrated` for the noise table of a device. Boards of one reflectivity are recorded at many ranges; the standard
deviations are smoothed by a curve in r^2 (constant, shot noise, ambient), because an error of 0.2 % at each point would
already show in a million samples.
"""

from functools import lru_cache

import numpy as np

from blind.camera import Device, Exposure, demodulate, integrate
from blind.geometry import Array, Beams
from blind.reference import NoiseTable

REFLECTIVITY = 0.5
POINTS = 64
SAMPLES = 120_000


def flat_field(device: Device, range_mm: float, samples: int, seed: int) -> Array:
    """Ranges (samples,) of a flat board at one range, before rounding."""
    shape = (1, samples)
    away = np.full(shape, range_mm, dtype=np.float32)
    gloss = np.full(shape, REFLECTIVITY, dtype=np.float32)
    nothing = Beams(share=np.zeros((1, 1)), range_mm=np.zeros((1, 1)), cosine=np.zeros((1, 1)),
                    surface=np.zeros((1, 1)), nothing=np.zeros(1))  # fmt: skip
    x = Exposure(
        device=device, surfaces=[], time_s=np.zeros(1), rng=np.random.default_rng(0), key_beams=[nothing],
        key=np.zeros(1, int), layer=np.zeros(shape, np.int8), surface=np.zeros(shape, np.int8), true_mm=away,
        z=(device.amplitude(away, gloss) * device.phasor(away)).astype(np.complex64),
        charge=device.charge(away, gloss).astype(np.float32), lost=np.zeros(shape, dtype=bool),
    )  # fmt: skip
    phasor, _ = integrate(x, (), np.random.default_rng([seed, 11]))
    return np.asarray(demodulate(x, phasor)[0])


def calibrated(device: Device, seed: int = 1) -> NoiseTable:
    """Measure sigma(r) of a device; the last ones are kept."""
    return _calibrated(device, seed, SAMPLES)


@lru_cache(maxsize=32)
def _calibrated(device: Device, seed: int, samples: int) -> NoiseTable:
    ranges = np.geomspace(0.8 * device.range_min_mm, device.range_max_mm, POINTS)
    measured = np.array([flat_field(device, float(r), samples, seed * 1000 + k).std() for k, r in enumerate(ranges)])
    basis = np.stack([np.ones(POINTS), (ranges / 1000) ** 2, (ranges / 1000) ** 4, (ranges / 1000) ** 6], axis=1)
    weight = 1.0 / measured**2  # the relative error is the same at all ranges
    curve, *_ = np.linalg.lstsq(basis * weight[:, None], measured**2 * weight, rcond=None)
    return NoiseTable(range_mm=ranges, sigma_mm=np.sqrt(basis @ curve))
