"""Suspicions: marks on layers that are not there, and false marks on layers that are.

The simulators below share no code with the package. Marks count in three ways: of the layers that are not there, those
that are marked or have a probability below one half; of all others, those that are marked; and the occupied cells of
the map where there is nothing.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.real_recordings import FOLDER, PROJECT, real_recordings
from numpy.typing import NDArray

import tofmix
from tofmix.api.recordings import Recording
from tofmix.mapping.beams import beams_from_layers
from tofmix.sensor import NoiseCurve, Sensor

TURN_MM = 299_792_458.0e3 / (2.0 * 20.0e6)
"""Unambiguous range at 20 MHz."""

NOISE = NoiseCurve(
    np.array([500.0, 1000.0, 2000.0, 3000.0, 5000.0, 7500.0]), np.array([2.0, 4.0, 8.0, 14.0, 30.0, 60.0])
)
"""Of the simulated cameras with many pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """A recording, and the layers of it that are not there."""

    name: str
    """For the table."""
    recording: Recording
    """The samples."""
    absent: Callable[[NDArray[np.floating]], NDArray[np.bool_]]
    """From ranges (window, row, col, layer), mm, to whether each is of a thing that is not there."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of `tofmix.estimate`."""


def beams(rows: int, cols: int, fov_deg: tuple[float, float]) -> NDArray[np.float64]:
    """Cosine (row, col) of the angle to the axis, times the direction's length along z."""
    azimuth = np.radians((np.arange(cols) - (cols - 1) / 2) * fov_deg[0] / cols)
    elevation = np.radians((np.arange(rows) - (rows - 1) / 2) * fov_deg[1] / rows)
    return np.asarray(np.cos(azimuth)[np.newaxis] * np.cos(elevation)[:, np.newaxis])


def _sensor(fov_deg: tuple[float, float], *, lock_in: bool, noise: NoiseCurve | None = None) -> Sensor:
    return Sensor(
        name="simulated",
        fov_horizontal_deg=fov_deg[0],
        fov_vertical_deg=fov_deg[1],
        noise=noise,
        modulation_frequency_hz=20.0e6 if lock_in else None,
        range_max_mm=7500.0 if lock_in else None,
    )


def ghost(seed: int, frames: int = 100, *, lock_in: bool = False, retro_mm: float = 1200.0) -> Situation:
    """A zone sensor, a retroreflector of amplitude 4000 in one zone, and amplitude 6 at its range in all others."""
    rng, fov = np.random.default_rng(seed), (45.0, 45.0)
    cosine = beams(8, 8, fov)
    shape = frames, 8, 8
    albedo = rng.uniform(0.3, 0.8)
    wall = rng.uniform(1.8, 3.0) * 1000.0 / cosine
    place = int(rng.integers(8)), int(rng.integers(8))
    range_mm = wall + rng.normal(0, 8, shape)
    amplitude = 1000.0 * albedo * cosine * (1000.0 / wall) ** 2 * np.exp(rng.normal(0, 0.05, shape))
    scattered = rng.random(shape) < 0.3
    scattered[:, place[0], place[1]] = True
    strength = np.full((8, 8), 6.0)
    strength[place] = 4000.0
    range_mm = np.where(scattered, retro_mm + rng.normal(0, 10, shape), range_mm)
    amplitude = np.where(scattered, strength * np.exp(rng.normal(0, 0.1, shape)), amplitude)
    bright = np.zeros((8, 8), bool)
    bright[place] = True

    def absent(found: NDArray[np.floating]) -> NDArray[np.bool_]:
        return np.asarray((np.abs(found - retro_mm) < 60.0) & ~bright[..., np.newaxis])

    sensor = _sensor(fov, lock_in=lock_in)
    recording = tofmix.from_array(range_mm, units="mm", amplitude=amplitude, sensor=sensor)
    return Situation(name=f"ghost, {'lock-in' if lock_in else 'direct'}", recording=recording, absent=absent)


def _boards(count: int, rng: np.random.Generator) -> Iterator[tuple[tuple[slice, slice], float, float]]:
    """Pixels, distance (mm) and albedo of boards."""
    for place in ((slice(6, 24), slice(6, 22)), (slice(20, 40), slice(38, 56)), (slice(4, 14), slice(44, 60)))[:count]:
        yield place, rng.uniform(1200.0, 3500.0), rng.uniform(0.2, 0.9)


def fold(seed: int, boards: int, frames: int = 100, *, dark: bool = False) -> Situation:
    """A wall at 9.8 m that one frequency folds to 2.3 m, behind boards; or `dark`, a black wall that is at 2.3 m."""
    rng, fov = np.random.default_rng(seed), (47.0, 39.0)
    cosine = beams(48, 64, fov)
    distance = (2300.0 if dark else rng.uniform(9500.0, 10500.0)) / cosine
    albedo = np.full(cosine.shape, 0.03 if dark else rng.uniform(0.4, 0.8))
    is_wall = np.ones(cosine.shape, bool)
    for place, away, white in _boards(boards, rng):
        distance[place], albedo[place], is_wall[place] = away / cosine[place], white, False
    folded = np.mod(distance, TURN_MM)
    noise = rng.normal(0, 1, (frames, 48, 64)) * NOISE.sigma(folded)
    amplitude = 1000.0 * albedo * cosine * (1000.0 / distance) ** 2 * (1 + rng.normal(0, 0.02, noise.shape))
    sensor = _sensor(fov, lock_in=True, noise=NOISE)
    recording = tofmix.from_array(np.mod(distance + noise, TURN_MM), units="mm", amplitude=amplitude, sensor=sensor)

    def absent(found: NDArray[np.floating]) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(found) & is_wall[..., np.newaxis] & (not dark))

    what = "black wall at 2.3 m" if dark else "folded wall"
    return Situation(name=f"{what}, {boards} boards", recording=recording, absent=absent)


def person(seed: int, frames: int = 100, *, staying: int = 15) -> Situation:
    """Someone walks through in 15 of 100 frames, before a wall at 4.2 m."""
    rng, fov = np.random.default_rng(seed), (47.0, 39.0)
    cosine = beams(48, 64, fov)
    wall, start = 4200.0 / cosine, int(rng.integers(0, frames - staying))
    step, depth = rng.uniform(0.5, 3.0), rng.uniform(1500.0, 3200.0)
    range_mm = np.empty((frames, 48, 64))
    for frame in range(frames):
        distance = wall.copy()
        if start <= frame < start + staying:
            left = 10 + int(step * (frame - start))
            place = slice(10, 44), slice(left, left + 7)
            distance[place] = (depth + 10.0 * (frame - start)) / cosine[place]
        range_mm[frame] = distance + rng.normal(0, 1, wall.shape) * NOISE.sigma(distance)
    recording = tofmix.from_array(range_mm, units="mm", sensor=_sensor(fov, lock_in=False, noise=NOISE))

    def absent(found: NDArray[np.floating]) -> NDArray[np.bool_]:
        return found < 3900.0

    return Situation(name="person, 15 of 100 frames", recording=recording, absent=absent)


def glass(seed: int, frames: int = 100) -> Situation:
    """A cover glass: 6 % of the samples of a direct sensor at 25 +- 5 mm in every pixel."""
    rng, fov = np.random.default_rng(seed), (45.0, 45.0)
    cosine = beams(8, 8, fov)
    wall = 1500.0 / cosine
    wall[2:6, 3:6] = 900.0 / cosine[2:6, 3:6]
    near = rng.random((frames, 8, 8)) < 0.06
    range_mm = np.where(near, rng.normal(25, 5, near.shape), wall + rng.normal(0, 8, near.shape))
    recording = tofmix.from_array(np.maximum(range_mm, 1.0), units="mm", sensor=_sensor(fov, lock_in=False))

    def absent(found: NDArray[np.floating]) -> NDArray[np.bool_]:
        return found < 100.0

    return Situation(name="cover glass", recording=recording, absent=absent)


def net(seed: int, frames: int = 100, *, gusts: bool) -> Situation:
    """A net that wind moves, or one that each third frame shows: it is there."""
    rng = np.random.default_rng(seed)
    shape = frames, 24, 24
    seen = np.zeros(shape, bool)
    seen[::3] = True
    if gusts:
        state = rng.random(shape[1:]) < 0.2
        for frame in range(frames):
            state = np.where(state, rng.random(shape[1:]) < 0.6, rng.random(shape[1:]) < 0.1)
            seen[frame] = state
    cosine = beams(24, 24, (45.0, 45.0))
    distance = np.where(seen, 1500.0, 3000.0) / cosine
    range_mm = distance + rng.normal(0, 1, shape) * NOISE.sigma(distance)
    recording = tofmix.from_array(range_mm, units="mm", sensor=_sensor((45.0, 45.0), lock_in=False, noise=NOISE))
    name = "net in the wind" if gusts else "net in each third frame"
    return Situation(name=name, recording=recording, absent=lambda found: np.zeros(found.shape, bool))


def drifting(seed: int, frames: int = 100, *, by_mm: float = 60.0, sigma_mm: float = 5.0) -> Situation:
    """A wall that drifts within the window, under the file's noise curve, which makes several layers of it."""
    rng = np.random.default_rng(seed)
    wall = 2000.0 / beams(12, 16, (45.0, 45.0))
    range_mm = wall + rng.normal(0, sigma_mm, (frames, *wall.shape))
    range_mm += by_mm * np.linspace(0.0, 1.0, frames)[:, np.newaxis, np.newaxis]
    curve = NoiseCurve(np.array([500.0, 7000.0]), np.full(2, sigma_mm))
    recording = tofmix.from_array(range_mm, units="mm", sensor=_sensor((45.0, 45.0), lock_in=False, noise=curve))
    return Situation(
        name=f"wall that drifts by {by_mm / sigma_mm:.0f} sigma, noise of the file",
        recording=recording,
        absent=lambda found: np.zeros(found.shape, bool),
        options={"noise": "file"},
    )


SITUATIONS: tuple[Callable[[int], Situation], ...] = (
    ghost,
    lambda seed: ghost(seed, lock_in=True),
    lambda seed: fold(seed, 1),
    lambda seed: fold(seed, 2),
    lambda seed: fold(seed, 3),
    lambda seed: fold(seed, 2, dark=True),
    person,
    glass,
    lambda seed: net(seed, gusts=True),
    lambda seed: net(seed, gusts=False),
    drifting,
)
"""By the table's rows; each takes a seed."""


def marks(layers: tofmix.Estimate) -> NDArray[np.uint8]:
    """Marks (window, row, col, layer), 0 where no layer has any."""
    return np.zeros(layers.range.shape, np.uint8) if layers.suspect is None else layers.suspect


def judged(situation: Situation) -> tuple[int, int, int, int, int]:
    """Layers that are not there; those marked or improbable; those in the map; others; others that are marked."""
    layers = tofmix.estimate(situation.recording, **situation.options)
    there = np.isfinite(layers.range)
    with np.errstate(invalid="ignore"):
        absent = there & situation.absent(layers.range)
        caught = absent & ((marks(layers) > 0) | (layers.probability < 0.5))
    beams_of_map = beams_from_layers(layers.window(0), layers.sensor)
    mapped = absent[0] & (beams_of_map.samples > 0)
    others = there & ~absent
    return (
        int(absent.sum()),
        int(caught.sum()),
        int(mapped.sum()),
        int(others.sum()),
        int((others & (marks(layers) > 0)).sum()),
    )


def print_situations(seeds: range, rows: list[int] | None = None) -> None:
    """The table of simulated situations, all or some rows."""
    print(
        "| situation | not there | marked or p < 0.5 | in the map | there | falsely marked |\n|---|---|---|---|---|---|"
    )
    for make in SITUATIONS if rows is None else [SITUATIONS[row] for row in rows]:
        numbers = np.zeros(5, int)
        for seed in seeds:
            situation = make(seed)
            numbers += judged(situation)
        absent, caught, mapped, others, false = numbers.tolist()
        share = f"{100 * caught / absent:.1f} %" if absent else "-"
        rate = f"{false} ({100 * false / others:.2f} %)" if others else "-"
        print(f"| {situation.name} | {absent:,} | {share} | {mapped:,} | {others:,} | {rate} |", flush=True)


def stands(folder: Path) -> Iterator[tuple[str, Recording]]:
    """The first and last frames of the flights, in which the drone stands."""
    for path in sorted((folder / "vl53l5cx_flights").glob("A*.npz")):
        data = np.load(path)
        range_mm = np.where(np.isin(data["status"], (5, 9)), data["range_mm"], np.nan).reshape(-1, 8, 8)
        for name, part in (("start", slice(0, 45)), ("end", slice(-45, None))):
            recording = tofmix.from_array(range_mm[part], units="mm", sensor=Sensor(name="VL53L5CX"))
            yield f"{path.stem}, {name}", recording


def print_false_marks(folder: Path) -> None:
    """The table of false marks: every surface of these recordings stands."""
    print("\n| recording | layers | marked |\n|---|---|---|")
    recordings: list[tuple[str, Recording]] = []
    for path in sorted((PROJECT / "sample_data").glob("*.h5")):
        sample = tofmix.open(path)
        assert isinstance(sample, Recording)
        recordings.append((path.stem, sample))
    recordings += [
        (real.name, real.recording) for real in real_recordings(folder, ("vl53l0x", "vl53l8cx", "mit_face"), print)
    ]
    recordings += list(stands(folder))
    for name, recording in recordings:
        layers = tofmix.estimate(recording)
        count, false = int(layers.n_modes.sum()), int(np.count_nonzero(marks(layers)))
        print(f"| {name} | {count:,} | {false} ({100 * false / max(1, count):.2f} %) |", flush=True)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="not_there.py suspects", description=__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="simulations of each situation (4)")
    parser.add_argument("--first-seed", type=int, default=0, help="seed of the first of them (0)")
    parser.add_argument("--rows", type=int, nargs="+", help="rows of the first table, from 0 on (all)")
    parser.add_argument("--simulated", action="store_true", help="simulations alone")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of the real recordings")
    parser.add_argument("--real", action="store_true", help="real recordings alone")
    options = parser.parse_args(arguments)
    if not options.real:
        print_situations(range(options.first_seed, options.first_seed + options.seeds), options.rows)
    if not options.simulated:
        print_false_marks(options.folder)
