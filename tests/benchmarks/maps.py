"""Is the exit open in the map? Corridors mapped from layers, from averages, and from thin beams.

Usage: python tests/benchmarks/maps.py [--seeds 100 101 ...] [--corridors] [--mixing 0 0.1 0.5 1]

Prints Markdown tables; docs/results/mapping.md holds a copy. Asserts nothing.

The corridors are those of tests/support/corridors.py, one open and one truly blocked for each seed, seen by the
built-in camera sr3000. All maps have the defaults of `tofmix map` but for the camera's pitch and the robot's band of
heights.
The defaults were chosen on the seeds 0 to 19; the seeds here are others.

- layers: 100 frames of 1.2 ms, estimated.
- averaged: the mean of the same 100 frames.
- averaged on board: 12 frames of the camera's default 10 ms, the same light, and their mean.
- thin-beam: one surface fitted to the same 100 frames.

With `--mixing`, open corridors alone, for shares q of phasor sums among the samples of pixels that see several surfaces
(the effect flying_pixels): maps of layers, of layers that take each sample for one of one surface, and of averages.

A cell is falsely occupied if it is more than 150 mm (three cells) from every true surface within the band of heights.
A surface is lost if a pixel sees it with a share of 0.3 or more, nearer than the space that no return frees, and no
occupied cell lies within 100 mm of its place.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tofmix.arrays import FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.settings import EstimateOptions, MixingChoice, SigmaMode
from tofmix.mapping.beams import Beams, beams_from_layers, beams_from_ranges
from tofmix.mapping.grid import Pose, plan_grid
from tofmix.mapping.occupancy import FloorMap, State, map_beams, project
from tofmix.recording import ArrayRecording
from tofmix.report.averaging import average_samples
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects.flying_pixels import FlyingPixels
from tofmix.simulation.events import Truth
from tofmix.simulation.render import recording_sensor, render_blocks

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.corridors import Corridor, draw_corridor, find_way

SEED = 88
FRAMES, ON_BOARD_FRAMES = 100, 12
CELL_MM = 50.0
OPEN_SPACE_MM = 150.0
LOST_MM = 100.0
LEAST_SHARE = 0.3
_STEP_MM = 20.0


def record(corridor: Corridor, truth: Truth, seed: int, *, averaged: bool) -> ArrayRecording:
    """Record a corridor by single samples or on-board averages."""
    blocks = list(
        render_blocks(
            corridor.model,
            truth,
            n_frames=ON_BOARD_FRAMES if averaged else FRAMES,
            seed=1000 * SEED + seed,
            averaged=averaged,
            threads=2,
        )
    )
    return ArrayRecording(
        np.concatenate([block.range_mm for block in blocks]),
        recording_sensor(corridor.model, averaged=averaged),
        np.concatenate([block.amplitude for block in blocks]),
    )


def print_mixing(shares: list[float], seeds: list[int]) -> None:
    """A row for each share of phasor sums and each source."""
    print("| q | map | shown open | falsely occupied cells | surfaces lost |\n|---|---|---|---|---|")
    for share in shares:
        totals: dict[str, list[Scores]] = {}
        for seed in seeds:
            corridor = draw_corridor(seed, blocked=False)
            truth = cast_scene(corridor.model)
            effects = (FlyingPixels(probability=share),) if share > 0 else ()
            mixed = replace(corridor, model=replace(corridor.model, effects=effects))
            samples = record(mixed, truth, seed, averaged=False)
            beams = {"averaged": averaged_beams(samples)}
            for name, mixing in (("layers", MixingChoice.AUTO), ("layers, --mixing events", MixingChoice.EVENTS)):
                layers = estimate_layers(samples, EstimateOptions(mixing=mixing), workers=2)
                beams[name] = beams_from_layers(layers.reshaped(layers.shape[1:]), samples.sensor)
            true, seen = true_places(corridor), seen_places(corridor, truth, beams["layers"])
            for name in ("layers", "layers, --mixing events", "averaged"):
                totals.setdefault(name, []).append(score(map_of(beams[name], corridor), corridor, true, seen))
        for name, every in totals.items():
            summed = Scores(*(sum(values) for values in zip(*every, strict=True)))
            print(
                f"| {share:g} | {name} | {summed.is_open} of {len(every)} | {summed.false_cells}"
                f" | {summed.lost} of {summed.seen} |",
                flush=True,
            )


def averaged_beams(recording: ArrayRecording) -> Beams:
    """The mean of each pixel."""
    frames = recording.shape[0]
    mean = average_samples(recording, start=0, stop=frames).range_mm
    return beams_from_ranges(mean, np.full(mean.shape, frames), recording.sensor)


def all_beams(corridor: Corridor, truth: Truth, seed: int) -> dict[str, Beams]:
    """What each source says of the same corridor."""
    samples = record(corridor, truth, seed, averaged=False)
    layers = estimate_layers(samples, workers=2)
    image = layers.shape[1:]
    thin = estimate_layers(samples, EstimateOptions(max_layers=1, sigma=SigmaMode.TIED), workers=2)
    return {
        "layers": beams_from_layers(layers.reshaped(image), samples.sensor),
        "averaged": averaged_beams(samples),
        "averaged on board": averaged_beams(record(corridor, truth, seed, averaged=True)),
        "thin-beam": beams_from_layers(thin.reshaped(image), samples.sensor),
    }


def map_of(beams: Beams, corridor: Corridor) -> FloorMap:
    """The 2-D map, as ``tofmix map`` makes it."""
    pose = Pose(pitch_deg=corridor.pitch_deg)
    grid = plan_grid(beams, pose, cell_mm=CELL_MM, height_mm=corridor.height_mm)
    return project(map_beams(beams, pose, grid, workers=2), corridor.height_mm)


def true_places(corridor: Corridor) -> FloatArray:
    """Points (n, 2) of the map, mm, 20 mm apart on all surfaces within the robot's band of heights."""
    low, high = corridor.height_mm
    out = []
    for surface in corridor.model.surfaces:
        u, v = (np.linspace(-size / 2, size / 2, int(size / _STEP_MM) + 2) for size in surface.size_mm)
        across, along = np.meshgrid(u, v)
        axes = surface.rotation()
        points = np.array(surface.center_mm) + np.outer(across, axes[:, 0]) + np.outer(along, axes[:, 1])
        points = points @ Pose(pitch_deg=corridor.pitch_deg).rotation().T
        # The map's cells are rounded outward from the band.
        out.append(points[(points[:, 2] > low - CELL_MM) & (points[:, 2] < high + CELL_MM), :2])
    return np.concatenate(out)


def seen_places(corridor: Corridor, truth: Truth, beams: Beams) -> FloatArray:
    """Places (n, 2) in the map, mm, of the surfaces that pixels see with a share of 0.3 or more."""
    rows, cols, _ = truth.range_true.shape
    width, height = beams.pixel_size_rad
    az, el = np.meshgrid((np.arange(cols) - (cols - 1) / 2) * width, (np.arange(rows) - (rows - 1) / 2) * height)
    direction = np.stack([np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)], axis=-1)
    range_mm = truth.range_true.astype(np.float64)
    sensor = corridor.model.sensor
    wanted = (truth.weight_true >= LEAST_SHARE) & (range_mm < beams.free_to_mm) & (range_mm > sensor.range_min_mm)
    row, col, layer = np.nonzero(wanted)
    points = direction[row, col] * range_mm[row, col, layer][:, None]
    points = points @ Pose(pitch_deg=corridor.pitch_deg).rotation().T
    low, high = corridor.height_mm
    return np.asarray(points[(points[:, 2] >= low) & (points[:, 2] <= high), :2])


class Scores(NamedTuple):
    """What one map shows."""

    is_open: int
    false_cells: int
    lost: int
    seen: int


def score(map_: FloorMap, corridor: Corridor, true: FloatArray, seen: FloatArray) -> Scores:
    """Count."""
    i, j = np.nonzero(map_.cells == State.OCCUPIED)
    occupied = np.column_stack([map_.centres_mm(0)[i], map_.centres_mm(1)[j]])
    away, _ = cKDTree(true).query(occupied)
    missed, _ = cKDTree(occupied).query(seen)
    way = find_way(map_, corridor)
    return Scores(
        int(bool(way)), int(np.count_nonzero(away > OPEN_SPACE_MM)), int(np.count_nonzero(missed > LOST_MM)), len(seen)
    )


def run(seed: int, *, blocked: bool) -> tuple[Corridor, dict[str, Scores]]:
    """Map one corridor from every source."""
    corridor = draw_corridor(seed, blocked=blocked)
    truth = cast_scene(corridor.model)
    beams = all_beams(corridor, truth, seed)
    true, seen = true_places(corridor), seen_places(corridor, truth, beams["layers"])
    return corridor, {name: score(map_of(each, corridor), corridor, true, seen) for name, each in beams.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(100, 120)))
    parser.add_argument("--corridors", action="store_true", help="print a line for each corridor too, on stderr")
    parser.add_argument("--mixing", type=float, nargs="+", help="shares of phasor sums, instead")
    chosen = parser.parse_args()
    if chosen.mixing:
        print_mixing(chosen.mixing, chosen.seeds)
        return
    totals: dict[tuple[bool, str], list[Scores]] = {}
    for seed in chosen.seeds:
        for blocked in (False, True):
            corridor, scores = run(seed, blocked=blocked)
            for name, each in scores.items():
                totals.setdefault((blocked, name), []).append(each)
            if chosen.corridors:
                text = "; ".join(f"{name} {tuple(each)}" for name, each in scores.items())
                print(seed, corridor.blocked_by or "open", text, file=sys.stderr, flush=True)
    print("| exit | map | shown open | falsely occupied cells | surfaces lost |\n|---|---|---|---|---|")
    for (blocked, name), every in totals.items():
        summed = Scores(*(sum(values) for values in zip(*every, strict=True)))
        kind = "truly blocked" if blocked else "open"
        print(
            f"| {kind} | {name} | {summed.is_open} of {len(every)} | {summed.false_cells}"
            f" | {summed.lost} of {summed.seen} |"
        )


if __name__ == "__main__":
    main()
