"""Draw samples from equation (1): one event a pixel a frame, then the sensor's noise.

Use `event_table` once a recording and `draw` once a frame. `tofmix.simulation.averaging` averages several such samples
as on board of a camera.

The parts of a camera's noise beyond sigma(r): the shape of the error, each pixel's own width, the amplitude's noise.

Effects act on Gaussian noise, which alone keeps its distribution under memory. The sample is the quantile of the shape
at the same probability (a Gaussian copula).

The samples are drawn from `Truth`, the surfaces of every pixel of a scene.
"""

import math
import zlib
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tofmix.arrays import ByteArray, Float32Array, FloatArray, IntArray
from tofmix.noise_shape import NoiseShape
from tofmix.sensor import NoiseCurve
from tofmix.sensors.camera import CompleteCamera

_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """Surfaces, ranges and shares of each pixel. The layers of a pixel run from near to far.

    Parameters
    ----------
    n_modes : (row, col) uint8
        Surfaces in the beam.
    range_true : (row, col, layer) float32
        Mean range of each surface's sub-beams, mm; NaN past `n_modes`.
    weight_true : (row, col, layer) float32
        p(c_i): area share times 1 - p(c_r), effects' outliers included; NaN past `n_modes`.
    weight_no_return : (row, col) float32
        p(c_0): share of the sub-beams that meet nothing, times 1 - p(c_r).
    surface : (row, col, layer) int16
        Number of the surface in the model, from 0; -1 past `n_modes`.
    amplitude : (row, col, layer) float32
        Amplitude of a sample of each surface; 0 past `n_modes`.
    width : (row, col, layer) float64 or None
        Factor on sigma(r) of each surface's samples, of a measured scene; None: sigma is the camera's.
    lost : (row, col) float64 or None
        Share of the samples of each pixel that are lost, of a measured scene; None: none is.
    """

    n_modes: ByteArray
    range_true: Float32Array
    weight_true: Float32Array
    weight_no_return: Float32Array
    surface: NDArray[np.int16]
    amplitude: Float32Array
    width: FloatArray | None = None
    lost: FloatArray | None = None

    def padded(self, layers: int) -> Self:
        """The same with room for `layers` surfaces a pixel, at least as many as it has."""
        more = layers - self.range_true.shape[2]

        def pad(values: NDArray[_T], padding: float) -> NDArray[_T]:
            return np.pad(values, ((0, 0), (0, 0), (0, more)), constant_values=padding)

        return replace(
            self,
            range_true=pad(self.range_true, np.nan),
            weight_true=pad(self.weight_true, np.nan),
            surface=pad(self.surface, -1),
            amplitude=pad(self.amplitude, 0.0),
            width=None if self.width is None else pad(self.width, 1.0),
        )


_STREAM = (zlib.crc32(b"noise width"), 0)
"""Where the widths' random stream is among those of a recording: no frame and no effect has it."""

_AMPLITUDE_STREAM = zlib.crc32(b"amplitude noise")
"""Before the frame's number, the key of its amplitudes' stream: ranges are drawn as if amplitudes had no noise."""


_LOSS_STREAM = zlib.crc32(b"lost samples")
"""Before the frame's number, the key of the stream of samples that are lost in a measured scene."""


def loss_draws(pixels: int, *, seed: int, frame: int) -> FloatArray:
    """Uniform draws (pixel,) of a frame's lost samples, from a random stream of its own."""
    key = (_LOSS_STREAM, frame)
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key))).random(pixels)


def amplitude_draws(pixels: int, *, seed: int, frame: int) -> FloatArray:
    """Standard normal noise (pixel,) of a frame's amplitudes, from a random stream of its own."""
    key = (_AMPLITUDE_STREAM, frame)
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key))).standard_normal(pixels)


def noisy_amplitude(amplitude: FloatArray, sigma_mm: FloatArray, draws: FloatArray, *, turn_mm: float) -> FloatArray:
    """Amplitudes as they are measured.

    The noise of a phasor z is the same in both directions. Across z it turns the phase, a range noise of sigma; along
    z it changes the amplitude A by A sigma 2 pi / d_u.

    Parameters
    ----------
    amplitude : (pixel,) float64
        Of the light, at least 0; 0 stays 0.
    sigma_mm : (pixel,) float64
        Each sample's range noise, mm.
    draws : (pixel,) float64
        Standard normal noise.
    turn_mm : float
        d_u, mm; NaN where the camera has no modulation frequency: then amplitudes have no noise.

    Returns
    -------
    (pixel,) float64
        At least 0: negative values become 0.
    """
    if math.isnan(turn_mm):
        return amplitude
    return np.maximum(amplitude * (1.0 + sigma_mm * (2 * math.pi / turn_mm) * draws), 0.0)


def shaped(noise: FloatArray, shape: NoiseShape | None) -> FloatArray:
    """Standard normal noise, of any shape of array, as noise of a shape: the same chance of lying below."""
    return noise if shape is None else shape.quantile(ndtr(noise))


def drawn_widths(sensor: CompleteCamera, *, seed: int) -> FloatArray | None:
    """Each pixel's own width, a factor on sigma for a whole recording.

    Returns
    -------
    (pixel,) float64 or None
        Log-normal, with median 1; None if all pixels are equal.
    """
    spread = sensor.noise.width_spread
    if not spread:
        return None
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=_STREAM)))
    widths: FloatArray = np.exp(spread * rng.standard_normal(sensor.rows * sensor.cols))
    return widths


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
    width : (L, pixel) float64 or None
        Factor on sigma(r) of each surface's samples, of a measured scene.
    """

    threshold: FloatArray
    range_mm: FloatArray
    amplitude: Float32Array
    range_limits_mm: tuple[float, float]
    width: FloatArray | None = None

    @property
    def random_value(self) -> int:
        """Number of the event c_r."""
        return len(self.range_mm) - 1

    def sigma(self, noise: NoiseCurve, width: FloatArray | None = None) -> FloatArray:
        """Sigma (L + 2, pixel) in mm of each event: sigma(r) at its range and amplitude, 0 for a random value.

        With the pixels' own widths (pixel,): times these.
        """
        sigma = noise.sigma(self.range_mm, self.amplitude)
        if self.width is not None:
            sigma[: len(self.width)] *= self.width
        if width is not None:
            sigma *= width
        sigma[self.random_value] = 0.0  # equation (1): c_r has a flat density, without noise on top
        return sigma


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EventSamples:
    """One sample of each pixel, in row order.

    Parameters
    ----------
    range_mm : (pixel,) float64
        Ranges before rounding, mm.
    amplitude : (pixel,) float32
        Amplitudes of the light, without noise.
    event : (pixel,) int64
        Which event of the `EventTable` each one is.
    sigma_mm : (pixel,) float64
        Noise of each event, mm.
    """

    range_mm: FloatArray
    amplitude: Float32Array
    event: IntArray
    sigma_mm: FloatArray


def event_table(truth: Truth, sensor: CompleteCamera, *, outlier_share: float | FloatArray | None = None) -> EventTable:
    """Prepare the events of a scene for drawing.

    Parameters
    ----------
    truth : Truth
        Result of `tofmix.simulation.casting.cast.cast_scene`.
    sensor : CompleteCamera
        The camera it was cast for.
    outlier_share : float or (row, col), optional
        Difference between 1 and the sum of the true shares, if effects add random values to the camera's; the table is
        of equation (1), background included, all the same.

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
    returned = 1.0 - np.broadcast_to(sensor.random_share, sensor.shape).ravel()
    scale = 1.0 if outlier_share is None else returned / (1.0 - np.broadcast_to(outlier_share, sensor.shape).ravel())
    return EventTable(
        threshold=_thresholds(truth, returned, scale),
        range_mm=np.vstack([np.nan_to_num(surfaces), np.full((1, pixels), sensor.range_max_mm), np.zeros((1, pixels))]),
        amplitude=np.vstack([truth.amplitude.reshape(pixels, layers).T, np.zeros((2, pixels), dtype=np.float32)]),
        range_limits_mm=(sensor.range_min_mm, sensor.range_max_mm),
        width=None if truth.width is None else np.ascontiguousarray(truth.width.reshape(pixels, layers).T),
    )


def _thresholds(truth: Truth, returned: FloatArray, scale: FloatArray | float) -> FloatArray:
    """Cumulative p(c_1) .. p(c_L), then 1 - p(c_r), which is `returned` (pixel,).

    The truth is in float32: if a pixel has no gap, its last surface gets the rounding error, so it never draws a
    no-return. Padded layers have a share of 0, thus the threshold of the layer before: u skips them.
    """
    pixels, layers = truth.n_modes.size, truth.range_true.shape[2]
    share = np.nan_to_num(truth.weight_true.reshape(pixels, layers).T.astype(np.float64)) * scale
    threshold = np.vstack([np.cumsum(share, axis=0), returned[np.newaxis]])
    number = np.arange(layers + 1)[:, np.newaxis]
    last = (truth.weight_no_return.ravel() == 0) & (number >= truth.n_modes.ravel().astype(np.int64) - 1)
    threshold = np.where(last, returned, threshold)
    limited: FloatArray = np.minimum(threshold, returned)
    return limited


def frame_generator(seed: int, frame: int) -> np.random.Generator:
    """The random stream of one frame.

    Each frame has its own stream, so a frame does not depend on the number of frames, blocks or threads.

    Parameters
    ----------
    seed : int
        The recording's seed, at least 0.
    frame : int
        The frame's number, from 0.
    """
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(frame,))))


def draw(
    table: EventTable, *, sigma_mm: FloatArray, rng: np.random.Generator, shape: NoiseShape | None = None
) -> EventSamples:
    """Draw one sample of each pixel from equation (1).

    Parameters
    ----------
    table : EventTable
        The events.
    sigma_mm : (L + 2, pixel) float64
        Noise of each event, mm: `EventTable.sigma` at the sample's integration time.
    rng : numpy.random.Generator
        The frame's random stream; advanced.
    shape : NoiseShape, optional
        Of the error; Gaussian without it.

    Returns
    -------
    Samples
        Ranges, amplitudes and events.
    """
    drawn = draw_events(table, rng=rng)
    index = drawn.event * drawn.event.size + np.arange(drawn.event.size)
    range_mm = shaped(drawn.noise, shape)
    sigma = sigma_mm.take(index)
    range_mm *= sigma
    range_mm += table.range_mm.take(index)
    range_mm[drawn.random] = drawn.random_mm
    return EventSamples(range_mm=range_mm, amplitude=table.amplitude.take(index), event=drawn.event, sigma_mm=sigma)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """Random draws of one frame of equation (1).

    Parameters
    ----------
    u : (pixel,) float64
        The uniform that decided the event.
    event : (pixel,) int64
        Which event of the `EventTable`.
    noise : (pixel,) float64
        Standard normal noise.
    random : (n,) int64
        Pixels whose event is a random value.
    random_mm : (n,) float64
        Those values, mm.
    """

    u: FloatArray
    event: IntArray
    noise: FloatArray
    random: IntArray
    random_mm: FloatArray


def draw_events(table: EventTable, *, rng: np.random.Generator) -> Drawn:
    """Draw events, noise and random values of one frame.

    Parameters
    ----------
    table : EventTable
        The events.
    rng : numpy.random.Generator
        The frame's random stream; advanced.
    """
    pixels: int = table.threshold.shape[1]
    u: FloatArray = rng.random(pixels)
    event = _event(table.threshold, u)
    noise: FloatArray = rng.standard_normal(pixels)
    random = np.flatnonzero(event == table.random_value)
    random_mm = rng.uniform(*table.range_limits_mm, size=random.size)
    return Drawn(u=u, event=event, noise=noise, random=random, random_mm=random_mm)


def _event(threshold: FloatArray, u: FloatArray) -> IntArray:
    event = np.zeros(u.size, dtype=np.int64)
    for one in threshold:
        event += u >= one
    return event


def events_behind(table: EventTable, drawn: Drawn) -> IntArray:
    """Events (pixel,) behind random values: the samples that they replace.

    Given a random value, its u is uniform above the last threshold, and serves once more.
    """
    event = drawn.event.copy()
    at = drawn.random
    last = table.threshold[-1, at]
    u = (drawn.u[at] - last) / (1.0 - last) * last
    event[at] = np.minimum(_event(table.threshold[:, at], u), table.random_value - 1)
    return event


def stored_range(range_mm: FloatArray) -> NDArray[np.uint16]:
    """Ranges as a recording stores them: the nearest whole mm, 1 to 65,534 (0 and 65,535 may mean "no sample")."""
    stored: NDArray[np.uint16] = np.clip(np.rint(range_mm), 1, 65_534).astype(np.uint16)
    return stored
