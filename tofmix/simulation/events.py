"""Draw samples from equation (1): one event a pixel a frame, then the sensor's noise.

Use `event_table` once a recording and `draw` once a frame. What the camera makes
of several such samples on board is in `tofmix.simulation.averaging`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.sensor import NoiseCurve
from tofmix.sensors.profile import SensorProfile
from tofmix.simulation.truth import Truth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EventTable:
    """The events of each pixel: L surfaces from near to far, then no return (L), then a random value (L + 1).

    Parameters
    ----------
    threshold : (L + 1, pixel) float64
        Cumulative probabilities: the event of u, uniform in [0, 1), is the number of thresholds that u has reached.
    range_mm : (L + 2, pixel) float64
        Mean range of each event, mm; ``range_max_mm`` for no return, 0 for a random value, whose range is drawn.
    amplitude : (L + 2, pixel) float32
        Amplitude of each event; 0 without a surface.
    range_limits_mm : (float, float)
        A random value is uniform between these.
    """

    threshold: FloatArray
    range_mm: FloatArray
    amplitude: Float32Array
    range_limits_mm: tuple[float, float]

    @property
    def random_value(self) -> int:
        """Number of the event c_r."""
        return len(self.range_mm) - 1

    def sigma(self, noise: NoiseCurve) -> FloatArray:
        """Sigma (L + 2, pixel) in mm of each event: sigma(r) at its range, 0 for a random value."""
        sigma = noise.sigma(self.range_mm)
        sigma[self.random_value] = 0.0  # equation (1): c_r has a flat density, without noise on top
        return sigma


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """One sample of each pixel, in row order.

    Parameters
    ----------
    range_mm : (pixel,) float64
        Ranges before rounding, mm.
    amplitude : (pixel,) float32
        Amplitudes.
    event : (pixel,) int64
        Which event of the `EventTable` each one is.
    """

    range_mm: FloatArray
    amplitude: Float32Array
    event: IntArray


def event_table(truth: Truth, sensor: SensorProfile) -> EventTable:
    """Prepare the events of a scene for drawing.

    Parameters
    ----------
    truth : Truth
        What `tofmix.simulation.cast.cast_scene` returned.
    sensor : SensorProfile
        The camera it was cast for.

    Raises
    ------
    ValueError
        If the truth is of another image size than the camera's.

    References
    ----------
    Equation (1).
    """
    if truth.n_modes.shape != (sensor.rows, sensor.cols):
        raise ValueError(f"truth: expected an image of {(sensor.rows, sensor.cols)}, got {truth.n_modes.shape}")
    pixels, layers = truth.n_modes.size, truth.range_true.shape[2]
    surfaces = truth.range_true.reshape(pixels, layers).T
    return EventTable(
        threshold=_thresholds(truth, 1.0 - sensor.outlier_probability),
        range_mm=np.vstack([np.nan_to_num(surfaces), np.full((1, pixels), sensor.range_max_mm), np.zeros((1, pixels))]),
        amplitude=np.vstack([truth.amplitude.reshape(pixels, layers).T, np.zeros((2, pixels), dtype=np.float32)]),
        range_limits_mm=(sensor.range_min_mm, sensor.range_max_mm),
    )


def _thresholds(truth: Truth, returned: float) -> FloatArray:
    """Cumulative p(c_1) .. p(c_L), then 1 - p(c_r).

    The truth is in float32: where a pixel has no gap, its last surface gets what rounding left, so that it never
    draws a no-return. Padded layers have a share of 0, thus the threshold of the layer before: u skips them.
    """
    pixels, layers = truth.n_modes.size, truth.range_true.shape[2]
    share = np.nan_to_num(truth.weight_true.reshape(pixels, layers).T.astype(np.float64))
    threshold = np.vstack([np.cumsum(share, axis=0), np.full((1, pixels), returned)])
    number = np.arange(layers + 1)[:, np.newaxis]
    last = (truth.weight_no_return.ravel() == 0) & (number >= truth.n_modes.ravel().astype(np.int64) - 1)
    threshold[last] = returned
    limited: FloatArray = np.minimum(threshold, returned)
    return limited


def frame_generator(seed: int, frame: int) -> np.random.Generator:
    """The random stream of one frame.

    Each frame has its own, so that a frame does not depend on how many there are, on the blocks they are made in, or
    on the threads that make them.

    Parameters
    ----------
    seed : int
        The recording's seed, at least 0.
    frame : int
        The frame's number, from 0.
    """
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(frame,))))


def draw(table: EventTable, *, sigma_mm: FloatArray, rng: np.random.Generator) -> Samples:
    """Draw one sample of each pixel from equation (1).

    Parameters
    ----------
    table : EventTable
        The events.
    sigma_mm : (L + 2, pixel) float64
        Noise of each event, mm: `EventTable.sigma` at the sample's integration time.
    rng : numpy.random.Generator
        The frame's random stream; advanced.

    Returns
    -------
    Samples
        Ranges, amplitudes and events.
    """
    pixels = table.threshold.shape[1]
    u = rng.random(pixels)
    event = np.zeros(pixels, dtype=np.int64)
    for threshold in table.threshold:
        event += u >= threshold
    index = event * pixels + np.arange(pixels)
    range_mm = rng.standard_normal(pixels)
    range_mm *= sigma_mm.take(index)
    range_mm += table.range_mm.take(index)
    random_value = np.flatnonzero(event == table.random_value)
    range_mm[random_value] = rng.uniform(*table.range_limits_mm, size=random_value.size)
    return Samples(range_mm=range_mm, amplitude=table.amplitude.take(index), event=event)


def stored_range(range_mm: FloatArray) -> NDArray[np.uint16]:
    """Ranges as a recording stores them: the nearest whole mm, 1 to 65,534 (0 and 65,535 may mean "no sample")."""
    stored: NDArray[np.uint16] = np.clip(np.rint(range_mm), 1, 65_534).astype(np.uint16)
    return stored
