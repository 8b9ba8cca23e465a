"""Ranges of a camera that filters them over time, and ranges with a memory that is no filter."""

import numpy as np
from numpy.typing import NDArray

from support.cameras import camera_of
from tofmix.arrays import Float32Array, FloatArray

TOP_MM, BASE_MM, SLOPE = 7000.0, 5.0, 0.003
SENSOR = camera_of([0.0, TOP_MM], BASE_MM + SLOPE * np.array([0.0, TOP_MM]), reach_mm=(300.0, TOP_MM))
FIRST = 60
"""Frames before the first stored one: the filter has forgotten its start."""


class Scene:
    """A wall behind a tilted board, whose share is between 0.2 and 0.8 in every twelfth pixel of its edge.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    seed : int
        Of shares and samples.

    Attributes
    ----------
    near_mm, far_mm, share : (row, col) float64
        Ranges of board and wall, and the share of the board.
    """

    def __init__(self, shape: tuple[int, int], seed: int) -> None:
        self.rng = np.random.default_rng([20261128, seed])
        row, col = np.indices(shape)
        self.near_mm = 1500.0 + 9.0 * col + 4.0 * row
        self.far_mm = 3900.0 - 6.0 * col
        self.share = (col < shape[1] // 2).astype(float)
        mixed = (row + 5 * col) % 12 == 0
        self.share[mixed] = self.rng.uniform(0.2, 0.8, int(mixed.sum()))

    @property
    def mixed(self) -> NDArray[np.bool_]:
        """Pixels of two surfaces."""
        return (self.share > 0.0) & (self.share < 1.0)

    def draw(self, frames: int, *, memory: float = 0.0, pink: bool = False) -> FloatArray:
        """Samples (frame, row, col) before a filter; noise is AR(1) of a memory, or has a spectrum 1 / f."""
        shape = frames + FIRST, *self.share.shape
        place = np.where(self.rng.random(shape) < self.share, self.near_mm, self.far_mm)
        noise = self.rng.standard_normal(shape)
        for frame in range(1, shape[0] if memory else 0):
            noise[frame] = memory * noise[frame - 1] + np.sqrt(1.0 - memory**2) * noise[frame]
        if pink:
            frequency = np.maximum(np.abs(np.fft.fftfreq(shape[0])), 1.0 / shape[0])
            noise = np.fft.ifft(np.fft.fft(noise, axis=0) / np.sqrt(frequency)[:, None, None], axis=0).real
            noise /= noise.std()
        return np.asarray(place + (BASE_MM + SLOPE * place) * noise)


def averaged(samples: FloatArray, share: float) -> FloatArray:
    """Exponential average of samples (frame, ...), with a share of the new one."""
    out = samples.copy()
    for frame in range(1, len(out)):
        out[frame] = share * samples[frame] + (1.0 - share) * out[frame - 1]
    return out


def averaged_up_to(samples: FloatArray, share: float, jump_mm: float) -> FloatArray:
    """The same, but for samples (frame, ...) farther than a jump from the average before, which replace it."""
    out = samples.copy()
    for frame in range(1, len(out)):
        step = samples[frame] - out[frame - 1]
        out[frame] = np.where(np.abs(step) < jump_mm, out[frame - 1] + share * step, samples[frame])
    return out


def over_neighbours(samples: FloatArray, *, median: bool, jump_mm: float = np.inf) -> FloatArray:
    """Medians, or means of those within a jump of the middle, of 3 x 3 pixels of samples (frame, row, col)."""
    rows, cols = samples.shape[1:]
    padded = np.pad(samples, ((0, 0), (1, 1), (1, 1)), mode="edge")
    parts = np.stack([padded[:, i : i + rows, j : j + cols] for i in range(3) for j in range(3)])
    if median:
        return np.asarray(np.median(parts, axis=0))
    return np.asarray(np.mean(parts, axis=0, where=np.abs(parts - samples) < jump_mm))


def over_windows(samples: FloatArray, window: int, *, median: bool) -> FloatArray:
    """Running median or mean of samples (frame, ...); the first frames are left out."""
    parts = np.lib.stride_tricks.sliding_window_view(samples, window, axis=0)
    return np.asarray(np.median(parts, axis=-1) if median else parts.mean(axis=-1))


def stored(samples: FloatArray, frames: int) -> Float32Array:
    """The last frames in whole mm."""
    return np.rint(samples[-frames:]).astype(np.float32)
