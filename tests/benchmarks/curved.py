"""Mixed pixels beside round things: how often both surfaces are found, how well, and what is invented.

    python tests/benchmarks/curved.py [scenes|noise|light|open|sweep|edges|cost ...] [--seeds 1 2] [--small]

Recordings of a lock-in camera (tests/support/round_things.py, which uses nothing of the package but its containers), 48
x 64 pixels, estimated with all defaults. Prints Markdown tables; docs/results/mixing.md holds a copy. Asserts nothing.

- scenes: each scene, 100 frames, noise of a sample on the wall 20 mm.
- noise: all scenes at noise 5 to 80 mm, with 30 and 100 frames.
- light: all scenes with light by cos^0.7 and cos^1.3, and 3 % of texture.
- open: things before open space; samples below three standard deviations of noise are without return.
- sweep: one sphere and one column of each radius and distance that are at least six pixels wide, 100 frames, 20 mm.
- edges: surfaces of each scene, the wrong area of their edges, and errors of edges; docs/results/surfaces.md has it.
- cost: CPU time of an estimate with and without surfaces that bend.

`--small` takes three scenes.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.costs import least_s

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.round_things import (
    COLS,
    FOCAL,
    OPEN_SCENES,
    PARTS,
    ROWS,
    SCENES,
    Scene,
    Score,
    Thing,
    cylinder,
    edge_distances,
    render,
    score,
    sphere,
    thing_at,
    wall,
)

import tofmix as tm
from tofmix.errors import DoubtWarning
from tofmix.surfaces.found import WindowSurfaces
from tofmix.surfaces.reconstruct import reconstruct
from tofmix.unmixing.image import mean_phasors
from tofmix.unmixing.settings import CurvedSettings, UnmixSettings
from tofmix.unmixing.unmix import unmix

FEW = ("sphere and cylinder", "person", "two columns")
PLANES = UnmixSettings(curved=CurvedSettings(rounds=0))
HEAD = (
    "| {} | mixed | both found | undecided | ranges within 2 errors | shares within 2 errors | share, rms |"
    " one surface split | flying layers |\n|---|---|---|---|---|---|---|---|---|"
)


def estimated(one: Scene) -> tm.Estimate:
    """Estimate a recording with all defaults."""
    return tm.estimate(one.recording)


def scored(
    names: Sequence[str],
    seeds: Sequence[int],
    scenes: dict[str, tuple[list[Thing], list[float]]] = SCENES,
    **choices: float,
) -> Score:
    """Estimate scenes and compare them with their truth."""
    total = Score()
    for name in names:
        things, reflectivity = scenes[name]
        for seed in seeds:
            one = render(things, reflectivity, seed=seed, **choices)  # type: ignore[arg-type]
            total += score(one, estimated(one).window(0))
    return total


def print_row(name: str, r: Score) -> None:
    """One row of a table."""
    found = max(r.both, 1)
    print(
        f"| {name} | {r.mixed} | {r.both / max(r.mixed, 1):.2f} | {r.undecided / max(r.mixed, 1):.2f} |"
        f" {r.ranges_within / max(r.ranges, 1):.2f} | {r.shares_within / found:.2f} |"
        f" {np.sqrt(r.share_square / found):.3f} | {r.split} of {r.single} | {r.flying} |",
        flush=True,
    )


def print_scenes(names: Sequence[str], seeds: Sequence[int]) -> None:
    """A row for each scene."""
    print(f"\n**Round things**\n\n{HEAD.format('scene')}")
    total = Score()
    for name in names:
        result = scored([name], seeds, noise_mm=20.0)
        print_row(name, result)
        total += result
    print_row("all", total)


def print_noise(names: Sequence[str], seeds: Sequence[int]) -> None:
    """A row for each noise and number of frames."""
    print(f"\n**By noise**\n\n{HEAD.format('noise, frames')}")
    for noise_mm in (5.0, 20.0, 40.0, 80.0):
        for frames in (30, 100):
            print_row(f"{noise_mm:g} mm, {frames}", scored(names, seeds, noise_mm=noise_mm, frames=frames))


def print_light(names: Sequence[str], seeds: Sequence[int]) -> None:
    """A row for each law of light."""
    print(f"\n**By light**\n\n{HEAD.format('light')}")
    for power in (0.7, 1.3):
        print_row(f"cos^{power:g}", scored(names, seeds, noise_mm=20.0, power=power))
    print_row("texture of 3 %", scored(names, seeds, noise_mm=20.0, texture=0.03))


def print_open(names: Sequence[str], seeds: Sequence[int]) -> None:
    """A row for each scene before open space."""
    print(f"\n**Before open space**\n\n{HEAD.format('scene')}")
    for name in OPEN_SCENES if len(names) > len(FEW) else list(OPEN_SCENES)[:1]:
        print_row(name, scored([name], seeds, OPEN_SCENES, noise_mm=20.0, threshold=3.0))


def print_sweep(names: Sequence[str], seeds: Sequence[int]) -> None:
    """A row for each radius and distance: a sphere beside an upright column, the wall 1.6 times as far."""
    print(f"\n**By radius and distance**\n\n{HEAD.format('radius, distance')}")
    total = Score()
    radii = RADII_MM if len(names) > len(FEW) else RADII_MM[::2]
    for radius_mm in radii:
        for distance_mm in DISTANCES_MM:
            wide = 2.0 * radius_mm / distance_mm * FOCAL  # pixels
            if not LEAST_WIDE <= wide <= COLS / 2 - LEAST_WIDE:
                continue
            aside_mm = COLS / 4 / FOCAL * distance_mm
            things = [
                wall(1.6 * distance_mm),
                sphere((-aside_mm, 0.02 * distance_mm, distance_mm), radius_mm),
                cylinder(aside_mm, distance_mm, radius_mm),
            ]
            name = f"{radius_mm:g} mm, {distance_mm / 1000.0:g} m"
            result = scored([name], seeds, {name: (things, [0.5, 0.8, 0.7])}, noise_mm=20.0)
            print_row(name, result)
            total += result
    print_row("all", total)


RADII_MM = (60.0, 100.0, 150.0, 220.0, 320.0, 500.0)
DISTANCES_MM = (1000.0, 2000.0, 4000.0)
LEAST_WIDE = 6.0
"""Least width of things, pixels."""


def print_edges(names: Sequence[str], seeds: Sequence[int]) -> None:
    """A row for each scene: surfaces of each thing, rms distances, wrong parts of mixed pixels, errors of edges.

    Upright limbs of the recordings lie at the border of two of 36 parts of a pixel, which adds 0.008 pixels to errors.
    """
    print(
        "\n**Surfaces and edges of round things**\n\n| scene | surfaces of each thing | smooth | rms, mm | mixed |"
        " wrong area | points of edges | off, rms, pixels | within 2 errors | above 0.5 off |"
        "\n|---|---|---|---|---|---|---|---|---|---|"
    )
    for name in names:
        things, reflectivity = SCENES[name]
        for seed in seeds:
            one = render(things, reflectivity, noise_mm=20.0, seed=seed)
            found = reconstruct(estimated(one).window(0), one.recording.sensor)
            thing = thing_of_surfaces(one, found)
            pieces = [int((thing == number).sum()) for number in range(len(things))]
            fine = one_each(things, found.factor)
            mixed = np.sort(one.share, axis=0)[-2] > LEAST_SHARE
            parts = (nearest_thing(one, found) != fine).reshape(ROWS, found.factor, COLS, found.factor)
            wrong = parts.mean(axis=(1, 3))[mixed].mean()
            row, col = found.edges.row.astype(float), found.edges.col.astype(float)
            off = edge_distances(things, row, col)
            near = off < MOST_OFF
            error = np.hypot(found.edges.stderr[near], 1.0 / PARTS / np.sqrt(12.0))
            within = (off[near] < 2.0 * error).mean()
            rms = ", ".join(f"{value:.1f}" for value in found.planes.rms_mm[:4])
            print(
                f"| {name} | {', '.join(map(str, pieces))} | {int(found.planes.is_smooth.sum())} | {rms} |"
                f" {int(mixed.sum())} | {wrong:.4f} | {len(off)} | {np.sqrt((off[near] ** 2).mean()):.4f} |"
                f" {within:.2f} | {int((~near).sum())} |",
                flush=True,
            )


LEAST_SHARE = 0.05
"""Least share of the second thing of a pixel whose edges are judged."""

MOST_OFF = 0.5
"""Distance from an edge, pixels, from which on a point is of none."""


def thing_of_surfaces(one: Scene, found: WindowSurfaces) -> NDArray[np.int64]:
    """Thing (surface,) that most layers of each surface are of, by range."""
    pixels = one.share.argmax(axis=0)
    first = found.surface[..., 0]
    sole = (one.share.max(axis=0) > 0.999) & (first >= 0)
    table = np.zeros((len(found.planes), len(one.share)), np.int64)
    np.add.at(table, (first[sole], pixels[sole]), 1)
    return np.where(table.sum(axis=1) > 0, table.argmax(axis=1), -1)


def nearest_thing(one: Scene, found: WindowSurfaces) -> NDArray[np.int64]:
    """Thing of each part's pixel whose range is nearest to that of `range_fine`; -1 without a range."""
    true = np.repeat(np.repeat(one.range_mm, found.factor, axis=1), found.factor, axis=2)
    off = np.abs(found.range_fine - true)
    return np.where(np.isnan(found.range_fine), -1, np.where(np.isnan(off), np.inf, off).argmin(axis=0))


def one_each(things: Sequence[Thing], factor: int) -> NDArray[np.int64]:
    """Thing of each part of a pixel."""
    places = [(np.arange(size * factor) + 0.5) / factor - 0.5 for size in (ROWS, COLS)]
    row, col = np.meshgrid(*places, indexing="ij")
    return thing_at(things, row.ravel(), col.ravel()).reshape(row.shape)


def print_cost(names: Sequence[str], seeds: Sequence[int]) -> None:
    """CPU time of estimates, and of unmixing by planes alone and with smooth surfaces; the best of three."""
    print("\n**Cost, s of CPU**\n\n| scene | estimate | unmixing | by planes alone |\n|---|---|---|---|")
    for name in names:
        things, reflectivity = SCENES[name]
        recording = render(things, reflectivity, noise_mm=20.0, seed=seeds[0]).recording
        light = recording.amplitude
        assert light is not None
        phasors = mean_phasors(recording.range_mm, light, recording.sensor)
        found = tm.estimate(recording, mixing="events")
        unmixing = partial(unmix, found.window(0), phasors, found.sensor)
        work = partial(tm.estimate, recording), unmixing, partial(unmixing, settings=PLANES)
        cells = (f"{seconds:.2f}" for seconds in least_s(*work, clock=time.process_time))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


PRINTERS = {
    "scenes": print_scenes,
    "noise": print_noise,
    "light": print_light,
    "open": print_open,
    "sweep": print_sweep,
    "edges": print_edges,
    "cost": print_cost,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], *PRINTERS], default=[])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--small", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", DoubtWarning)
    for name in options.tables or PRINTERS:
        PRINTERS[name](FEW if options.small else tuple(SCENES), options.seeds)


if __name__ == "__main__":
    main()
