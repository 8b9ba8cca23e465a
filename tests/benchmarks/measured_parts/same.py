"""Real recordings against a model made from their own first half: nothing changed, so nothing is to be named.

The frames of a recording are permuted, so that halves differ by chance alone. The model is a wall with a map of each
pixel's mean over the first half, and the spread of that half as its noise; the second half is the measurement. A second
group does the same with running medians over 3 and over 5 frames, which a camera's filter gives: they are taken in time
order, the model is made from the first half, and frames are not permuted, because the memory is what is tried.
Recordings that are not on this machine are left out.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from benchmarks.measured_parts.judging import reconciled
from benchmarks.real_recordings import FOLDER, PROJECT
from scipy.ndimage import median_filter

from tofmix.arrays import FloatArray
from tofmix.sensor import NoiseCurve
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

CASES = 600
"""200 permuted, 200 medians over 3, 200 medians over 5."""

GROUPS = ("permuted", "median of 3", "median of 5")
WIDTH = {"median of 3": 3, "median of 5": 5}
MOST_FRAMES, SIDE = 120, 8
RATE_HZ = 15.0
LEAST_VALID = 0.9
"""Least share of valid samples of a pixel that is used."""


def _stored(path: Path) -> FloatArray:
    """Ranges (frame, row, col) of a recording file, mm, NaN where invalid."""
    with h5py.File(path) as file:
        values = file["range"][()].astype(np.float64)
    return np.where(values > 0, values, np.nan)


def _one_zone(path: Path, key: str, rng: np.random.Generator) -> FloatArray:
    """Windows of one zone's series as pixels, one after the other from a random start."""
    series = np.load(path)[key].astype(np.float64)
    count = SIDE * SIDE * MOST_FRAMES
    start = int(rng.integers(series.size - count))
    return np.asarray(series[start : start + count].reshape(SIDE, SIDE, MOST_FRAMES).transpose(2, 0, 1))


def _face(path: Path, rng: np.random.Generator) -> FloatArray:
    """The photons of pixels with at least 60 of them, as frames of 8 x 8 zones."""
    data = np.load(path)
    counts = data["samples_a_pixel"].astype(np.int64).ravel()
    pixels = np.split(data["samples"].astype(np.float64), np.cumsum(counts)[:-1])
    rich = rng.permutation(np.flatnonzero(counts >= 60))[: SIDE * SIDE]
    return np.stack([pixels[k][:60] for k in rich], axis=1).reshape(60, SIDE, SIDE)


RECORDINGS: dict[str, Callable[[np.random.Generator], FloatArray]] = {
    "TMF8829": lambda _: _stored(PROJECT / "sample_data" / "tmf8829_edge.h5"),
    "VL53L0X, 1 h": lambda rng: _one_zone(FOLDER / "vl53l0x" / "vl53l0x_static_1h.npz", "distance_mm", rng),
    "VL53L0X, 4 h": lambda rng: _one_zone(FOLDER / "vl53l0x" / "vl53l0x_static_4h.npz", "range_mm", rng),
    "VL53L8CX": lambda _: np.load(FOLDER / "vl53l8cx" / "vl53l8cx_48cm_27frames.npz")["distance_mm"].astype(np.float64),
    "face": lambda rng: _face(FOLDER / "mit_face" / "mit_face_4x4.npz", rng),
    "three boards": lambda _: _stored(PROJECT / "sample_data" / "three_boards.h5"),
}


def model_of(half: FloatArray) -> Model:
    """A wall at the median range, with the means of a half (frame, row, col) as a map, and its spread as noise."""
    _, rows, cols = half.shape
    mean = np.nanmean(half, axis=0)
    sigma = float(np.sqrt(np.nanmean(np.nanvar(half, axis=0, ddof=1))))
    distance = max(float(np.nanmedian(mean)), 1.0)
    sensor = CompleteCamera(
        name="measured",
        rows=rows,
        cols=cols,
        fov_horizontal_deg=40.0,
        fov_vertical_deg=40.0 * rows / cols,
        range_min_mm=0.0,
        range_max_mm=min(2 * float(np.nanmax(half)) + 1000.0, 65_000.0),
        integration_time_ms=1.0,
        default_integration_time_ms=1.0,
        reference_integration_time_ms=1.0,
        exponent=0.5,
        outlier_probability=1e-3,
        noise=NoiseCurve(np.array([1.0, 60_000.0]), np.array([sigma, sigma])),
    )
    wall = Surface(name="wall", center_mm=(0.0, 0.0, distance), size_mm=(1e5, 1e5), reflectivity=0.7)
    bare = Model(sensor=sensor, surfaces=(wall,), recording=RecordingSettings(frames=len(half), frame_rate_hz=RATE_HZ))
    plane = np.nan_to_num(mean - cast_scene(bare).range_true[..., 0]).astype(np.float32)
    return Model(
        sensor=sensor,
        surfaces=(wall,),
        recording=bare.recording,
        effects=(FixedPattern(map=PixelMap("means.npy", plane)),),
    )


def judged(number: int, seed: int) -> dict[str, Any] | None:
    """The result of one case; None where its recording is missing."""
    group, name = GROUPS[number % 3], list(RECORDINGS)[number // 3 % len(RECORDINGS)]
    rng = np.random.default_rng([seed, number])
    try:
        samples = RECORDINGS[name](rng)[:MOST_FRAMES]
    except FileNotFoundError:
        return None
    samples = in_group(part_of(samples, rng), group, rng)
    half = len(samples) // 2
    found = reconciled(model_of(samples[:half]), samples[half:].astype(np.float32))
    return {"number": number, "group": group, "name": name, "frames": half, **found}


def in_group(samples: FloatArray, group: str, rng: np.random.Generator) -> FloatArray:
    """The frames in another order, with the running median of the group."""
    samples = samples[rng.permutation(len(samples))]
    width = WIDTH.get(group)
    return samples if width is None else np.asarray(median_filter(samples, size=(width, 1, 1), mode="nearest"))


def part_of(samples: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A part of the image whose pixels have few invalid samples; invalid ones take another sample of their pixel."""
    _, rows, cols = samples.shape
    top, left = (int(rng.integers(max(n - 2 * SIDE, 0) + 1)) for n in (rows, cols))
    part = samples[:, top : top + 2 * SIDE, left : left + 2 * SIDE].copy()
    for row, col in np.ndindex(part.shape[1:]):
        pixel = part[:, row, col]
        lost = np.isnan(pixel)
        if lost.any() and not lost.all():
            pixel[lost] = rng.choice(pixel[~lost], lost.sum())
    return np.asarray(np.where(np.isnan(part), np.nanmedian(part), part), dtype=np.float64)


def order(count: int) -> Sequence[int]:
    """The first cases: groups take turns, then recordings."""
    return range(count)


def table(done: Sequence[Any]) -> Iterator[str]:
    """Names by group and recording."""
    yield "| | cases | named | aim | names |"
    yield "|---|---|---|---|---|"
    for group in GROUPS:
        own = [line for line in done if line["group"] == group]
        yield f"| {group} | {len(own)} | {_named(own)} | 2 % | |"
        for name in RECORDINGS:
            one = [line for line in own if line["name"] == name]
            if one:
                names = sorted({kind for line in one for kind in line["named"]})
                yield f"| {group}, {name} | {len(one)} | {_named(one)} | | {', '.join(names)} |"
    yield f"| longest run, s | {len(done)} | {max((line['seconds'] for line in done), default=0)} | 120 | |"


def _named(of: Sequence[Any]) -> int:
    return sum(bool(line["named"]) for line in of)
