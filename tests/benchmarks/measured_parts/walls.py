"""A wall at a stated distance, before a phase camera whose axis folds there: which effects are named.

The camera has an offset of 15 mm, and each pixel a bias of its own with a standard deviation of 10 mm. Half of the
recordings come from raw taps, drawn here, and half from `tofmix simulate`. Cases of an even number have one row of 24
to 48 pixels or 8 x 8 zones, the others one row of 8 to 16 pixels. The model states the distance of the wall and the
noise, and in a third of the cases also that the camera wraps.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from benchmarks.measured_parts.judging import far_pose, reconciled

from tofmix.arrays import Float32Array, FloatArray
from tofmix.circle import unambiguous_range_mm
from tofmix.sensor import NoiseCurve
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.effects.phase_wrapping import PhaseWrapping
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.render import render_blocks
from tofmix.simulation.surface import Surface

CASES = 120
OFFSET_MM, BIAS_MM, FRAMES, RATE_HZ = 15.0, 10.0, 30, 25.0
AMPLITUDES = (10.0, 2000.0)
ELECTRONS = 100.0
"""Electrons of each unit of amplitude: the noise is 27 mm at amplitude 10 and 1.9 mm at 2000, at 20 MHz."""

RANGE_MAX_MM = 30_000.0
FREQUENCIES_HZ = (20e6, 30e6, 60e6)
EXPECTED = frozenset({"phase_wrapping", "range_offset", "surface_pose", "fixed_pattern"})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A model, and the recording (frame, row, col), mm and amplitude, that disagrees with it."""

    model: Model
    range_mm: Float32Array
    amplitude: Float32Array
    small: bool
    raw: bool
    wraps: bool


def sigma_of(amplitude: float, turn_mm: float) -> float:
    """Range noise, mm, of four taps with Poisson noise and no background light, of one sample."""
    return turn_mm / (2 * math.pi) / math.sqrt(amplitude * ELECTRONS)


def _sensor(image: tuple[int, int], frequency_hz: float, sigma_mm: float) -> CompleteCamera:
    return CompleteCamera(
        name="taps",
        rows=image[0],
        cols=image[1],
        fov_horizontal_deg=min(1.0 * image[1], 40.0),
        fov_vertical_deg=min(1.0 * image[0], 40.0),
        range_min_mm=0.0,
        range_max_mm=RANGE_MAX_MM,
        integration_time_ms=1.0,
        default_integration_time_ms=1.0,
        reference_integration_time_ms=1.0,
        exponent=0.5,
        modulation_frequency_hz=frequency_hz,
        outlier_probability=1e-4,
        noise=NoiseCurve(np.array([100.0, RANGE_MAX_MM]), np.array([sigma_mm, sigma_mm])),
    )


def draw(seed: int, number: int) -> Case:
    rng = np.random.default_rng([seed, number])
    small, raw, states = bool(number % 2), bool(number // 2 % 2), number % 3 == 0
    image = (1, int(rng.integers(8, 17))) if small else (1, int(rng.integers(24, 49)))
    if not small and number // 4 % 2:
        image = (8, 8)
    frequency = float(rng.choice(FREQUENCIES_HZ))
    turn = unambiguous_range_mm(frequency)
    amplitude = float(np.exp(rng.uniform(*np.log(AMPLITUDES))))
    distance = turn * float(rng.uniform(1.05, 1.6))
    sensor = _sensor(image, frequency, sigma_of(amplitude, turn))
    wall = Surface(name="wall", center_mm=(0.0, 0.0, distance), size_mm=(60_000.0, 60_000.0), reflectivity=0.7)
    model = Model(sensor=sensor, surfaces=(wall,), recording=RecordingSettings(frames=FRAMES, frame_rate_hz=RATE_HZ))
    bias = (OFFSET_MM * float(rng.choice([-1.0, 1.0])), BIAS_MM * rng.standard_normal(image))
    own = int(rng.integers(1, 2**31))
    seen = _from_taps(model, bias, amplitude, own) if raw else _simulated(model, bias, own)
    given = replace(model, effects=(PhaseWrapping(unambiguous_range_mm=turn),)) if states else model
    return Case(model=given, range_mm=seen, amplitude=np.full_like(seen, amplitude), small=small, raw=raw, wraps=states)


def _from_taps(model: Model, bias: tuple[float, FloatArray], amplitude: float, seed: int) -> Float32Array:
    """Ranges of the phases of four taps of Poisson noise, whole mm; no background light."""
    rng = np.random.default_rng(seed)
    turn = unambiguous_range_mm(float(model.sensor.modulation_frequency_hz or math.nan))
    true = cast_scene(model).range_true[..., 0] + bias[0] + bias[1]
    phase = 2 * math.pi * true / turn
    half = amplitude * ELECTRONS / 2  # of each tap: half of the light at the mean
    taps = [rng.poisson(half * (1 + np.cos(phase - k * math.pi / 2)), (FRAMES, *true.shape)) for k in range(4)]
    measured = np.arctan2(taps[1] - taps[3], taps[0] - taps[2])
    folded = np.rint(measured % (2 * math.pi) * turn / (2 * math.pi))
    return np.asarray(np.maximum(folded, 1), dtype=np.float32)


def _simulated(model: Model, bias: tuple[float, FloatArray], seed: int) -> Float32Array:
    """The same by the package's simulation, of Gaussian noise."""
    turn = unambiguous_range_mm(float(model.sensor.modulation_frequency_hz or math.nan))
    make: Any = EFFECTS
    effects: tuple[Effect, ...] = (
        make["range_offset"](offset_mm=bias[0]),
        make["fixed_pattern"](map=PixelMap("", bias[1].astype(np.float32))),
        PhaseWrapping(unambiguous_range_mm=turn),
    )
    there = replace(model, effects=effects)
    (block,) = render_blocks(there, cast_scene(there), n_frames=FRAMES, seed=seed, block_frames=FRAMES)
    return np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)


def judged(number: int, seed: int) -> dict[str, Any]:
    """The result of one case."""
    case = draw(seed, number)
    found = reconciled(case.model, case.range_mm, time_s=np.arange(FRAMES) / RATE_HZ, amplitude=case.amplitude)
    named = set(found["named"])
    wrapped = case.wraps or "phase_wrapping" in named
    rows, cols = case.model.sensor.shape
    return {
        "number": number,
        "small": case.small,
        "raw": case.raw,
        "wraps": case.wraps,
        "pixels": rows * cols,
        "sigma_mm": round(float(case.model.sensor.noise.sigma_mm[0]), 2),
        **found,
        "wrapped": wrapped,
        "all": wrapped and bool(named & {"range_offset", "surface_pose"}) and "fixed_pattern" in named,
        "bad": "multipath" in named or far_pose(found),
        "false": found["verdict"] == "explained" and bool(named - EXPECTED),
    }


def order(count: int) -> Sequence[int]:
    """The first cases."""
    return range(count)


def table(done: Sequence[Any]) -> Iterator[str]:
    """Counts beside their aims."""
    large, small = ([line for line in done if line["small"] == s] for s in (False, True))
    yield "| | cases | found | aim |"
    yield "|---|---|---|---|"
    yield f"| 24 to 64 pixels: wrapping, offset or pose, and biases | {len(large)} | {_sum(large, 'all')} | 90 % |"
    yield f"| 8 to 16 pixels: wrapping | {len(small)} | {_sum(small, 'wrapped')} | 90 % |"
    yield f"| a second path, or a pose of more than 200 mm | {len(done)} | {_sum(done, 'bad')} | 0 |"
    yield f"| `explained` with a false name | {len(done)} | {_sum(done, 'false')} | at most 1 |"
    yield f"| longest run, s | {len(done)} | {max((line['seconds'] for line in done), default=0)} | 120 |"


def _sum(of: Sequence[Any], key: str) -> int:
    return sum(bool(line[key]) for line in of)
