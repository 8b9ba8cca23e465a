"""Laws that no effect is: what they do to a recording (frame, row, col) in mm, NaN where invalid."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import Float32Array

_RATE_HZ = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stranger:
    """A law by its name."""

    name: str
    change: Callable[[Float32Array, np.random.Generator], Float32Array]


def _whole(samples: np.ndarray) -> Float32Array:
    return np.asarray(np.maximum(np.rint(samples), 1.0), dtype=np.float32)


def split(samples: Float32Array, rng: np.random.Generator) -> Float32Array:
    """A step of the bias from one column to the next: two halves of the image with clocks of their own."""
    cols = samples.shape[2]
    step = int(cols * rng.uniform(0.4, 0.6))
    return _whole(samples + rng.uniform(6, 12) * np.where(np.arange(cols) < step, -1.0, 1.0))


def ripple(samples: Float32Array, rng: np.random.Generator) -> Float32Array:
    """All ranges swing in time: a supply that hums."""
    now = np.arange(len(samples)) / _RATE_HZ
    swing = rng.uniform(4, 9) * np.sin(2 * math.pi * rng.uniform(1.5, 4) * now + rng.uniform(0, 6))
    return _whole(samples + swing[:, None, None])


def noisy_columns(samples: Float32Array, rng: np.random.Generator) -> Float32Array:
    """More noise in every fourth column or so: converters of columns, some of which are worse."""
    worse = rng.random(samples.shape[2]) < 1 / 4
    return _whole(samples + worse * rng.normal(0, rng.uniform(8, 16), samples.shape))


def heavy_tails(samples: Float32Array, rng: np.random.Generator) -> Float32Array:
    """One sample in twelve is several sigma off, either way: a converter that slips."""
    hit = rng.random(samples.shape) < 1 / 12
    return _whole(samples + hit * rng.laplace(0, rng.uniform(20, 40), samples.shape))


def hopping(samples: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Every fifth pixel hops between two delays, each by itself: random telegraph noise."""
    frames, rows, cols = samples.shape
    state = np.cumsum(rng.random((frames, rows, cols)) < 0.1, axis=0) % 2
    some = rng.random((rows, cols)) < 0.2
    return _whole(samples + state * some * rng.uniform(25, 50))


def late_rows(samples: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Rows move together from frame to frame: a read-out line by line, with a clock that jitters."""
    frames, rows, _ = samples.shape
    return _whole(samples + rng.normal(0, rng.uniform(4, 8), (frames, rows, 1)))


STRANGERS = (
    Stranger(name="split", change=split),
    Stranger(name="ripple", change=ripple),
    Stranger(name="noisy columns", change=noisy_columns),
    Stranger(name="heavy tails", change=heavy_tails),
    Stranger(name="hopping pixels", change=hopping),
    Stranger(name="late rows", change=late_rows),
)
