"""The camera's own sigma(r), measured on flat fields: what a user of the blind camera would put into a model file.

Use `calibrated` for the noise table of a device. Boards of one reflectivity are recorded at many ranges; the standard
deviations are smoothed by a curve in r^2 (constant, shot noise, ambient), because an error of 0.2 % at each point would
already show in a million samples.

Under room light boards of several reflectivities are recorded, and the noise by amplitude is measured with them. The
noise of that camera depends on the amplitude alone, which a model file can hold: a curve over range, which is that of
a board of reflectivity 0.5, times a factor by amplitude. A camera whose noise is no such product of range and amplitude
has no exact model file.
"""

from functools import lru_cache

import numpy as np

from blind.camera import STANDARD_GLOSS, Device, Exposure, demodulate, integrate
from blind.geometry import Array, Beams
from blind.reference import AmplitudeTable, NoiseTable

REFLECTIVITIES = (0.08, 0.2, 0.5, 0.9)  # under room light
POINTS = 64
FINE_POINTS = 256  # of the curve under room light, which is the steeper one: linear pieces are right to 0.02 %
MOST_PHASE_NOISE = 0.25  # rad; noisier boards are not measured
SAMPLES = 120_000


def flat_field(device: Device, range_mm: float, samples: int, seed: int, *, gloss: float = STANDARD_GLOSS) -> Array:
    """Ranges (samples,) of a flat board at one range that faces the camera, before rounding; `gloss`: reflectivity."""
    shape = (1, samples)
    away = np.full(shape, range_mm, dtype=np.float32)
    board = np.full(shape, gloss, dtype=np.float32)
    nothing = Beams(
        share=np.zeros((1, 1)),
        range_mm=np.zeros((1, 1)),
        cosine=np.zeros((1, 1)),
        surface=np.zeros((1, 1)),
        nothing=np.zeros(1),
    )
    x = Exposure(
        device=device,
        surfaces=[],
        time_s=np.zeros(1),
        rng=np.random.default_rng(0),
        key_beams=[nothing],
        key=np.zeros(1, int),
        layer=np.zeros(shape, np.int8),
        surface=np.zeros(shape, np.int8),
        true_mm=away,
        z=(device.amplitude(away, board) * device.phasor(away)).astype(np.complex64),
        charge=device.charge(away, board).astype(np.float32),
        lost=np.zeros(shape, dtype=bool),
    )
    phasor, _ = integrate(x, (), np.random.default_rng([seed, 11]))
    return np.asarray(demodulate(x, phasor)[0])


def calibrated(device: Device, seed: int = 1) -> NoiseTable:
    """Measure sigma(r) of a device; the last ones are kept."""
    return _calibrated(device, seed, SAMPLES)


@lru_cache(maxsize=32)
def _calibrated(device: Device, seed: int, samples: int) -> NoiseTable:
    return (_by_range if device.room_electrons is None else _by_amplitude)(device, seed, samples)


def _by_range(device: Device, seed: int, samples: int) -> NoiseTable:
    ranges = np.geomspace(0.8 * device.range_min_mm, device.range_max_mm, POINTS)
    measured = np.array([flat_field(device, float(r), samples, seed * 1000 + k).std() for k, r in enumerate(ranges)])
    basis = np.stack([np.ones(POINTS), (ranges / 1000) ** 2, (ranges / 1000) ** 4, (ranges / 1000) ** 6], axis=1)
    weight = 1.0 / measured**2  # the relative error is the same at all ranges
    curve, *_ = np.linalg.lstsq(basis * weight[:, None], measured**2 * weight, rcond=None)
    return NoiseTable(range_mm=ranges, sigma_mm=np.sqrt(basis @ curve))


def _by_amplitude(device: Device, seed: int, samples: int) -> NoiseTable:
    """Noise by amplitude: sigma^2 = c0 / A^2 (room light) + c1 / A (the signal's own) + c2 + c4 / A^4 (of the arc)."""
    ranges = np.geomspace(0.8 * device.range_min_mm, device.range_max_mm, POINTS // len(REFLECTIVITIES))
    boards = [(float(r), gloss) for r in ranges for gloss in REFLECTIVITIES]
    scale = MOST_PHASE_NOISE * device.unambiguous_mm / (2 * np.pi)
    boards = [(r, gloss) for r, gloss in boards if device.sigma(np.array(r), np.array(gloss)) < scale]
    amplitude = np.array([float(device.amplitude(np.array(r), np.array(gloss))) for r, gloss in boards])
    measured = np.array(
        [flat_field(device, r, samples, seed * 1000 + k, gloss=gloss).std() for k, (r, gloss) in enumerate(boards)]
    )
    unit = float(np.exp(np.log(amplitude).mean()))
    weight = 1.0 / measured**2
    basis = _powers(amplitude / unit) * weight[:, None]
    size = np.sqrt((basis**2).sum(axis=0))
    curve, *_ = np.linalg.lstsq(basis / size, measured**2 * weight, rcond=None)

    def sigma(electrons: Array) -> Array:
        return np.asarray(np.sqrt(_powers(electrons / unit) @ (curve / size)))

    fine = np.geomspace(ranges[0], ranges[-1], FINE_POINTS)
    standard = device.amplitude(fine, np.array(STANDARD_GLOSS))
    every = np.geomspace(amplitude.min(), amplitude.max(), POINTS)
    law = AmplitudeTable(
        reference=standard * device.amplitude_unit, amplitude=every * device.amplitude_unit, factor=sigma(every)
    )
    return NoiseTable(range_mm=fine, sigma_mm=sigma(standard), by_amplitude=law)


def _powers(amplitude: Array) -> Array:
    return np.stack([amplitude**-2, 1 / amplitude, np.ones_like(amplitude), amplitude**-4], axis=-1)
