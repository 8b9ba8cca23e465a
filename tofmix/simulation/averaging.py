"""Range of a camera that integrates on board: the phasor mean of the samples within its integration time.

Use it for ``simulate --averaged``: if a pixel sees several surfaces, the mean lies between them, at a range without a
surface (the paper's comet tail). The samples themselves are those of `tofmix.simulation.events`.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.errors import BadInputError
from tofmix.noise_shape import NoiseShape
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.events import EventTable, draw


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exposure:
    """One sample within the on-board integration.

    Parameters
    ----------
    fraction : float
        Its integration time over that of the model's samples; 1, or less for the last one.
    sigma_mm : (event, pixel) float64
        Noise of each event at its integration time, mm.
    """

    fraction: float
    sigma_mm: FloatArray


def exposure_times(sensor: CompleteCamera) -> tuple[float, ...]:
    """Integration times in ms of the samples within the default one: whole samples, then the rest.

    Parameters
    ----------
    sensor : CompleteCamera
        The camera, at the integration time of one sample.

    Returns
    -------
    tuple of float
        Such as eight times 1.2 ms and once 0.4 ms for 10 ms.

    Raises
    ------
    BadInputError
        If one sample is not shorter than the default integration time, or over 1000 times shorter.
    """
    tau, total = sensor.integration_time_ms, sensor.default_integration_time_ms
    if tau >= total:
        raise BadInputError(
            f"[sensor]: integration_time_ms: {tau:g} ms is not below the {total:g} ms that the camera integrates on "
            "board, so there is nothing to average; lower it, or leave out --averaged"
        )
    max_exposures = 1000  # the SR-3000 sets its time in steps of 0.2 ms: 50 of them in its default time
    if total / tau > max_exposures:
        raise BadInputError(
            f"[sensor]: integration_time_ms: {tau:g} ms fits into {total:g} ms more than {max_exposures} times;"
            " raise it, or leave out --averaged"
        )
    negligible = 1.0e-6  # a last part of a sample shorter than this is a rounding error of the division
    whole = math.floor(total / tau + negligible)
    rest = total - whole * tau
    return (tau,) * whole + ((rest,) if rest > negligible * tau else ())


def exposures(table: EventTable, sensor: CompleteCamera, width: FloatArray | None = None) -> tuple[Exposure, ...]:
    """The samples within the on-board integration, each with its noise, times the pixels' own widths (pixel,).

    The shorter last one has the noise of its own time by the tau law. Its weight in the mean is its time, so that
    with the exponent 0.5 of shot noise the mean has exactly the noise of the whole time.

    Raises
    ------
    BadInputError
        If one sample is not shorter than the default integration time.
    """
    times = exposure_times(sensor)
    whole = sensor.integration_time_ms
    parts = {time: replace(table, amplitude=table.amplitude * np.float32(time / whole)) for time in set(times)}
    sigma = {time: part.sigma(sensor.noise_at(time), width) for time, part in parts.items()}
    return tuple(Exposure(fraction=time / sensor.integration_time_ms, sigma_mm=sigma[time]) for time in times)


def average_frame(
    table: EventTable,
    parts: tuple[Exposure, ...],
    *,
    turn_mm: float,
    rng: np.random.Generator,
    shape: NoiseShape | None = None,
    draws: FloatArray | None = None,
) -> tuple[FloatArray, Float32Array]:
    """Draw one frame as on-board integration returns it.

    Parameters
    ----------
    table : EventTable
        The events.
    parts : tuple of Exposure
        Result of `exposures`.
    turn_mm : float
        Unambiguous range d_u, mm, above 0.
    rng : numpy.random.Generator
        The frame's random stream; advanced.
    shape : NoiseShape, optional
        Of each sample's error; Gaussian without it.
    draws : (pixel,) float64, optional
        Standard normal noise of the mean's amplitude; without it the amplitude has none.

    Returns
    -------
    range_mm : (pixel,) float64
        ``d_u arg(z) / 2 pi`` of the sum z of ``amplitude * exp(2 pi i r / d_u)``, on the turn nearest the
        amplitude-weighted mean range, mm. Where no sample has an amplitude: the time-weighted mean range.
    amplitude : (pixel,) float32
        ``|z|``, with the noise of `draws`.
    """
    noise = MeanNoise(pixels=table.threshold.shape[1])

    def samples() -> Iterator[tuple[float, FloatArray, Float32Array]]:
        for part in parts:
            drawn = draw(table, sigma_mm=part.sigma_mm, rng=rng, shape=shape)
            noise.add(part.fraction, drawn.amplitude.astype(np.float64), drawn.sigma_mm)
            yield part.fraction, drawn.range_mm, drawn.amplitude

    range_mm, amplitude = phasor_mean(samples(), turn_mm=turn_mm)
    return range_mm, amplitude if draws is None else noise.on(amplitude, draws, turn_mm=turn_mm)


class MeanNoise:
    """Noise of a mean's amplitude: the noise of the samples' phasors adds in quadrature at any phase.

    Each sample's noise is the same in both directions, so along the mean it is A sigma 2 pi / d_u too. The range of
    the mean has the samples' range noise alone.
    """

    def __init__(self, *, pixels: int) -> None:
        self._square = np.zeros(pixels)  # of amplitude times mm

    def add(self, fraction: float, amplitude: FloatArray, sigma_mm: FloatArray) -> None:
        """Take in a sample: its time over that of a whole one, amplitude (pixel,) at the whole time, noise in mm."""
        self._square += (fraction * amplitude * sigma_mm) ** 2

    def on(self, amplitude: Float32Array, draws: FloatArray, *, turn_mm: float) -> Float32Array:
        """The mean's amplitude (pixel,) with its noise, at least 0; `draws` are standard normal, d_u is in mm.

        A mean without light stays at 0. Without a modulation frequency (NaN) there is no noise.
        """
        if math.isnan(turn_mm):
            return amplitude
        noise = np.sqrt(self._square) * (2 * math.pi / turn_mm) * draws
        noisy: Float32Array = np.maximum(amplitude + noise, 0.0).astype(np.float32)
        return noisy


def phasor_mean(
    samples: Iterable[tuple[float, FloatArray, Float32Array]], *, turn_mm: float
) -> tuple[FloatArray, Float32Array]:
    """The mean of samples as on-board integration forms it.

    Parameters
    ----------
    samples : iterable of (float, (pixel,) float64, (pixel,) float32)
        Of each its time over that of a whole sample, its ranges in mm and its amplitudes at the whole time.
    turn_mm : float
        d_u, mm.

    Returns
    -------
    range_mm, amplitude
        As for `average_frame`.
    """
    phasor: NDArray[np.complex128] = np.zeros(1, dtype=np.complex128)
    light = lit_range = plain_range = np.zeros(1)  # sums of amplitudes; of these times range; of times times range
    time = 0.0
    for fraction, range_mm, whole in samples:
        amplitude = whole * fraction
        phasor = phasor + amplitude * _unit_phasor(range_mm, turn_mm)
        light = light + amplitude
        lit_range = lit_range + amplitude * range_mm
        plain_range = plain_range + fraction * range_mm
        time += fraction
    dark = light == 0
    mean = np.where(dark, plain_range / time, lit_range / np.where(dark, 1.0, light))
    folded = np.angle(phasor) * (turn_mm / (2 * math.pi))
    range_mm = np.where(dark, mean, folded + turn_mm * np.rint((mean - folded) / turn_mm))
    return range_mm, np.abs(phasor).astype(np.float32)


def _unit_phasor(range_mm: FloatArray, turn_mm: float) -> NDArray[np.complex128]:
    phase = range_mm * (2 * math.pi / turn_mm)
    phasor = np.empty(phase.shape, dtype=np.complex128)
    phasor.real = np.cos(phase)
    phasor.imag = np.sin(phase)
    return phasor
