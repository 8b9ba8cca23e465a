"""A lock-in camera's pixel, the slow and obvious way: four charges a sample, read out by an arctangent.

Plain NumPy; nothing here is shared with the package, neither its laws nor its geometry. What a frame is made of:

1. An event a pixel: a surface, with its share of the beam, or nothing at all.
2. The light that reaches the pixel: the phasor ``a exp(i phi)`` of that surface, a its amplitude and phi the phase
   ``4 pi f r / c``, and all other light that gets there: over a second path, through the lens, from a neighbour.
3. Four charges. The light's modulation is correlated with a reference at 0, 90, 180 and 270 degrees. A harmonic of the
   modulation is seen at three times the phase. Each charge has Gaussian noise of its own: the shot noise of a
   background much brighter than the signal, the same whatever the signal.
4. The arctangent of their differences is the phase, thus a range within one turn.

Its noise is set by what equation (1) says of the surface alone: a phase noise of ``s / (sqrt(2) a)`` is a sigma(r) of
``d_u / (2 pi)`` times that. The relation is one of small phase noise; at 0.1 rad the arctangent's distribution is
still a Gaussian to less than 1 % in sigma. Use it below 0.2 rad.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Phasors = NDArray[np.complex128]
Number = TypeVar("Number", np.float64, np.complex128)

LIGHT_MM_S = 299_792_458_000.0
QUARTERS = 1j ** np.arange(4)  # the reference's four phases


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera of rows x cols pixels; `sigma` is sigma(r) in mm at its integration time `tau_ms`."""

    rows: int
    cols: int
    fov_horizontal_deg: float
    fov_vertical_deg: float
    frequency_hz: float
    tau_ms: float
    sigma: Callable[[Floats], Floats]

    @property
    def turn_mm(self) -> float:
        """The range at which the phase has gone round once."""
        return LIGHT_MM_S / self.frequency_hz / 2.0


@dataclass(frozen=True, kw_only=True)
class Board:
    """A board that faces the camera at z_mm, from x = left_mm to right_mm, and over the image from top to bottom."""

    left_mm: float
    right_mm: float
    z_mm: float
    reflectivity: float


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the pixels see: arrays (board, row, col) of share, range (mm) and amplitude; 0 where a board is not seen."""

    share: Floats
    range_mm: Floats
    amplitude: Floats


def look(camera: Camera, boards: tuple[Board, ...], *, beams: int = 2000) -> Seen:
    """Cast `beams` rays across and 3 down each pixel; of two boards the nearer is seen."""
    across = ((np.arange(beams) + 0.5) / beams - 0.5)[np.newaxis, :]
    down = ((np.arange(3) + 0.5) / 3 - 0.5)[:, np.newaxis]
    shape = (len(boards), camera.rows, camera.cols)
    share, range_mm, amplitude = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for row in range(camera.rows):
        el = np.radians((row - (camera.rows - 1) / 2 + down) * camera.fov_vertical_deg / camera.rows)
        for col in range(camera.cols):
            az = np.radians((col - (camera.cols - 1) / 2 + across) * camera.fov_horizontal_deg / camera.cols)
            forward = np.cos(az) * np.cos(el)
            nearest = np.full(forward.shape, np.inf)
            seen = np.full(forward.shape, -1)
            for k, board in enumerate(boards):
                x = board.z_mm * np.tan(az) + 0.0 * el
                hit = (x >= board.left_mm) & (x <= board.right_mm) & (board.z_mm < nearest)
                nearest[hit], seen[hit] = board.z_mm, k
            for k, board in enumerate(boards):
                mine = seen == k
                if mine.any():
                    share[k, row, col] = mine.mean()
                    range_mm[k, row, col] = (board.z_mm / forward[mine]).mean()
                    light = 1000.0 * board.reflectivity * forward[mine].mean() * camera.tau_ms / 1.2
                    amplitude[k, row, col] = light * (1000.0 / range_mm[k, row, col]) ** 2
    return Seen(share=share, range_mm=range_mm, amplitude=amplitude)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """What is wrong with the camera or in its way; the defaults are nothing."""

    second_path: dict[int, tuple[float, float]] = field(default_factory=dict)
    """dict of board to (share, longer by mm). Light of a board that takes a longer way: its amplitude over the direct
    light's, and how much longer it is."""
    lens: float = 0.0
    """Share of the whole image's mean light that the lens scatters into every pixel."""
    window: tuple[float, float] = (0.0, 0.0)
    """(amplitude, range in mm). Light that the camera's own window reflects into every pixel."""
    neighbours: float = 0.0
    """Share of a pixel's charge that diffuses to each of its four neighbours."""
    all_at_once: float = 0.0
    """Probability that a sample is of all the light at once, each board's by its area, whatever it was to be of."""
    falloff: Floats | float = 1.0
    """(row, col) or 1. The illumination."""
    harmonic: float = 0.0
    """Third harmonic of the modulation, as a share of the fundamental."""
    harmonic_phase: float = 0.0
    """Its phase, rad."""
    unequal: tuple[float, float] = (0.0, 0.0)
    """(gain, common). Gain of the charges at 0 and 180 degrees over that of the others, less 1; and the part of the
    light's amplitude by which the charge at 0 degrees is larger than that at 180."""
    memory: float = 0.0
    """Correlation of a charge's noise from frame to frame."""
    stranger: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """(share of frames, mean frames of a burst, amplitude). A second camera, in bursts: light in no relation to ours,
    which leaves noise in each charge."""
    full_well: float = np.inf
    """Charge of modulated light over which a pixel saturates."""


def record(
    camera: Camera, seen: Seen, frames: int, rng: np.random.Generator, errors: Errors, *, fold: bool = False
) -> tuple[Floats, Floats]:
    """Record frames: ranges (frame, row, col) in mm, NaN where saturated or without a surface, and amplitudes.

    The range is on the turn nearest to the event's own, or, with `fold`, as the arctangent gives it.
    """
    board = _draw_boards(seen.share, frames, rng)
    together = _together(seen, board, rng, errors)
    brightest = np.broadcast_to(np.argmax(seen.share * seen.amplitude, axis=0), board.shape)
    board = np.where(together & (board == len(seen.share)), brightest, board)
    amplitude, range_mm = _of(seen.amplitude, board), _of(seen.range_mm, board)
    noise = np.sqrt(2.0) * amplitude * camera.sigma(range_mm) * (2 * np.pi / camera.turn_mm)
    light, third = _light(camera, seen, board, together, errors)
    charges = np.stack([(light * q).real + errors.harmonic * (third * q**3).real for q in QUARTERS])
    gain, common = errors.unequal
    charges[0] += 2.0 * common * np.abs(light)
    charges[::2] *= 1.0 + gain
    charges += noise * _remembered(charges.shape, errors.memory, rng)
    share, burst, strength = errors.stranger
    charges += strength * _bursts(frames, share, burst, rng)[:, np.newaxis, np.newaxis] * rng.normal(size=charges.shape)
    in_phase, quadrature = (charges[0] - charges[2]) / 2, (charges[3] - charges[1]) / 2
    measured = np.arctan2(quadrature, in_phase) % (2 * np.pi) * (camera.turn_mm / (2 * np.pi))
    if not fold:
        measured += camera.turn_mm * np.rint((range_mm - measured) / camera.turn_mm)
    measured[(np.abs(light) > errors.full_well) | (board == len(seen.share))] = np.nan
    return measured, np.hypot(quadrature, in_phase)


def _draw_boards(share: Floats, frames: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Which board each sample comes from, (frame, row, col); the number after the last for none."""
    u = rng.random((frames, *share.shape[1:]))
    edges = np.cumsum(share, axis=0) + 1e-9 * (np.cumsum(share, axis=0) > 1 - 1e-9)
    return np.asarray((u[np.newaxis] >= edges[:, np.newaxis]).sum(axis=0), dtype=np.int64)


def _of(values: NDArray[Number], board: NDArray[np.int64]) -> NDArray[Number]:
    """Values (board, row, col) of each sample's board; 0 without one."""
    row, col = np.indices(board.shape[1:])
    nothing = np.zeros_like(values[:1])
    each: NDArray[Number] = np.concatenate([values, nothing])[board, row, col]
    return each


def _together(seen: Seen, board: NDArray[np.int64], rng: np.random.Generator, errors: Errors) -> NDArray[np.bool_]:
    """Which samples are of all the light of their pixel; one that sees a single board alone has nothing to mix."""
    boards = (seen.share > 0).sum(axis=0)
    gap = seen.share.sum(axis=0) < 1 - 1e-9
    mixes = (boards > 1) | ((boards > 0) & gap)
    return np.asarray(mixes & (rng.random(board.shape) < errors.all_at_once))


def _light(
    camera: Camera, seen: Seen, board: NDArray[np.int64], together: NDArray[np.bool_], errors: Errors
) -> tuple[Phasors, Phasors]:
    """All the light of each sample, as its modulation is seen, and the same at three times the phase."""
    turn = 2 * np.pi / camera.turn_mm
    sums = []
    for order in (1, 3):
        wave = seen.amplitude * errors.falloff * np.exp(1j * order * turn * seen.range_mm)
        for number, (share, longer_mm) in errors.second_path.items():
            wave[number] *= 1 + share * np.exp(1j * order * turn * longer_mm / 2)  # out and back: half of it is range
        sums.append(wave)
    light, third = (np.where(together, (seen.share * wave).sum(axis=0), _of(wave, board)) for wave in sums)
    light, third = (
        light_of
        + errors.lens * (seen.share * wave).sum(axis=0).mean()
        + errors.window[0] * np.exp(1j * order * turn * errors.window[1])
        for order, light_of, wave in zip((1, 3), (light, third), sums, strict=True)
    )
    light, third = (_diffused(light_of, errors.neighbours) for light_of in (light, third))
    return light, third * np.exp(1j * errors.harmonic_phase)


def _diffused(light: Phasors, share: float) -> Phasors:
    """A share of each pixel's light goes to each of its neighbours; the image's edge is repeated."""
    wide = np.pad(light, ((0, 0), (1, 1), (1, 1)), mode="edge")
    around = wide[:, :-2, 1:-1] + wide[:, 2:, 1:-1] + wide[:, 1:-1, :-2] + wide[:, 1:-1, 2:]
    return np.asarray((1 - 4 * share) * light + share * around)


def _remembered(shape: tuple[int, ...], memory: float, rng: np.random.Generator) -> Floats:
    """Standard normal numbers (charge, frame, row, col), each charge's correlated from frame to frame."""
    noise = rng.normal(size=shape)
    for frame in range(1, shape[1]):
        noise[:, frame] = memory * noise[:, frame - 1] + np.sqrt(1 - memory**2) * noise[:, frame]
    return noise


def _bursts(frames: int, share: float, length: float, rng: np.random.Generator) -> Floats:
    """1 in the frames of a burst, 0 elsewhere; a burst ends with probability 1 / length a frame."""
    on = np.zeros(frames)
    if share > 0:
        state = rng.random() < share
        for frame in range(frames):
            on[frame] = state
            leave = 1 / length if state else share / (1 - share) / length
            state = state != (rng.random() < leave)
    return on
