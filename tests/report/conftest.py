"""Layers and recordings in memory: random, but consistent with the format."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from support.alike import MakeLayers, MakeSource
from support.cameras import camera_of

from tofmix.arrays import Float32Array
from tofmix.flags import MixingLaw, Status
from tofmix.layers import Layers, LayersSource, Provenance
from tofmix.sensor import NoiseCurve, Sensor

CURVE = NoiseCurve(np.array([500.0, 3000.0, 7500.0]), np.array([9.0, 70.0, 430.0]))
SENSOR = camera_of(
    CURVE.range_mm,
    CURVE.sigma_mm,
    reach_mm=(650.0, 7500.0),
    fov_deg=(47.0, 39.0),
    name="test <camera>",
    modulation_frequency_hz=20.0e6,
)


@dataclass(frozen=True)
class MemoryLayers:
    """A `LayersSource` without a file."""

    windows: tuple[Layers, ...]
    provenance: Provenance
    frames: int = 50
    reads: list[int] = field(default_factory=list)
    law: MixingLaw | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        rows, cols = self.windows[0].shape
        return len(self.windows), rows, cols

    @property
    def max_layers(self) -> int:
        return self.windows[0].max_layers

    @property
    def window_start(self) -> NDArray[np.uint64]:
        return np.arange(len(self.windows), dtype=np.uint64) * np.uint64(self.frames)

    @property
    def window_stop(self) -> NDArray[np.uint64]:
        return self.window_start + np.uint64(self.frames)

    @property
    def mixing_law(self) -> MixingLaw | None:
        return self.law

    def read_window(self, window: int) -> Layers:
        self.reads.append(window)
        return self.windows[window]


@dataclass(frozen=True)
class MemoryRecording:
    """A `SampleSource` with amplitudes, that remembers the largest block read."""

    range_mm: Float32Array
    amplitude: Float32Array
    sensor: Sensor
    row_step: int = 1
    frame_step: int = 1
    has_amplitude: bool = True
    blocks: list[int] = field(default_factory=list)

    @property
    def shape(self) -> tuple[int, int, int]:
        frames, rows, cols = self.range_mm.shape
        return frames, rows, cols

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        block = self.range_mm[frames, rows]
        self.blocks.append(block.size)
        return block

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        return self.amplitude[frames, rows]


def random_layers(shape: tuple[int, int] = (9, 11), *, max_layers: int = 4, seed: int = 0) -> Layers:
    """Layers of which every status, and every number of surfaces up to `max_layers`, may occur."""
    rng = np.random.default_rng(seed)
    layers = Layers.empty(shape, max_layers)
    layers.n_modes[...] = rng.integers(0, max_layers + 1, shape)
    layers.status[...] = rng.choice([0, 0, 0, 2, 4], shape)
    layers.status[layers.n_modes == 0] = Status.NO_SURFACE
    layers.status[(layers.n_modes == 0) & (rng.random(shape) < 0.3)] = Status.TOO_FEW_SAMPLES
    layers.n_peaks[...] = rng.integers(0, max_layers + 3, shape)
    layers.n_samples[...] = rng.integers(0, 101, shape)
    absent = np.arange(max_layers) >= layers.n_modes[..., None]
    layers.range[...] = np.sort(rng.uniform(700, 7000, (*shape, max_layers)), axis=-1)
    layers.sigma[...] = CURVE.sigma(layers.range.astype(np.float64)) * rng.uniform(0.5, 2.5, layers.range.shape)
    layers.range_stderr[...] = layers.sigma / 10
    shares = rng.dirichlet(np.ones(max_layers + 1), shape)
    layers.weight[...] = shares[..., 1:]
    for name in ("range", "sigma", "weight", "range_stderr"):
        getattr(layers, name)[absent] = np.nan
    layers.weight_outlier[...] = 1e-4
    layers.weight_no_return[...] = 1 - np.nansum(layers.weight, axis=-1)
    layers.weight_no_return[layers.status == Status.TOO_FEW_SAMPLES] = np.nan
    return layers


@pytest.fixture
def make_layers() -> MakeLayers:
    """`random_layers` for tests."""
    return random_layers


@pytest.fixture
def make_source() -> MakeSource:
    """Make a `LayersSource` of windows, with any field of `Provenance`."""

    def make(*windows: Layers, **changes: object) -> LayersSource:
        known = {
            "source": "boards.h5",
            "source_sha256": "ab" * 32,
            "version": "0.1.0",
            "sensor": SENSOR,
            "options": {"sigma": "prior", "gamma": 0.02},
            "frames_left_out": 3,
        }
        return MemoryLayers(windows=windows, provenance=Provenance(**(known | changes)))  # type: ignore[arg-type]

    return make


@pytest.fixture
def make_recording() -> Callable[..., MemoryRecording]:
    """Make a recording of random samples, some invalid, one pixel without any."""

    def make(
        shape: tuple[int, int, int] = (50, 9, 11), *, seed: int = 0, sensor: Sensor = SENSOR, row_step: int = 1
    ) -> MemoryRecording:
        rng = np.random.default_rng(seed)
        samples = rng.normal(3000, 200, shape).astype(np.float32)
        samples[rng.random(shape) < 0.1] = np.nan
        samples[:, 0, 0] = np.nan
        amplitude = rng.uniform(0.1, 5, shape).astype(np.float32)
        return MemoryRecording(range_mm=samples, amplitude=amplitude, sensor=sensor, row_step=row_step)

    return make
