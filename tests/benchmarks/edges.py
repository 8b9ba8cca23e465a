"""Edges below a pixel: how many parts of mixed pixels get the wrong surface, and how far edges are from true ones.

    python tests/benchmarks/edges.py [wrong|three|disks|bars|half-planes|links|phasor|speed ...]
        [--seeds 1 2] [--frames 40 100 400] [--layers estimate|counts] [--worst 5] [--small]

Scenes of 144 x 176 pixels, and the estimator's own layers with all defaults. Boards, random boards and pickets are
raw-tap recordings (tests/blind, which knows nothing of the package); rolled rectangles, disks, bars and half-planes are
drawn from plates cast finely (tests/support/plates.py), as is all truth. Prints Markdown tables. Asserts nothing.

- wrong: parts (8 x 8) of a mixed pixel with the wrong surface, mean over all mixed pixels: a second surface with a
  share of 0.05 and more, all of them 5 standard errors and 3 % of the range apart. Beside it simple methods on the same
  layers, which get the true links. `no range`: wrong parts of tofmix that have none.
- three: pixels with three surfaces. disks: 4 to 15 pixels radius. bars: 0.5 and 0.8 pixels wide.
- half-planes: distance of the points of edges from the true edge, and their stated errors; 8 angles a seed.
- links: purity and completeness of surfaces.
- phasor: samples that are phasor sums, 50 frames.
- speed: of one core, best of 3.

With `--layers counts` layers are made from the truth with the scatter of counts alone: quick, without an estimator.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from support.costs import least_s

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind.geometry import View
from support import plates
from support.edge_rivals import RIVALS, youngs_points
from support.edges import (
    Links,
    Places,
    Wrong,
    between,
    camera,
    counted,
    drawn,
    estimated,
    first_frames,
    judge_links,
    judge_parts,
    judge_places,
    recorded,
    worst_pixels,
    wrong_parts,
)
from support.lock_in import FAMILIES

from tofmix.layers import Layers
from tofmix.surfaces.reconstruct import reconstruct

Maker = Callable[[np.random.Generator, View], list[plates.Plate]]

TILTED: dict[str, Maker] = {"rolled rectangles": plates.tilted_rectangles}
EDGES: tuple[str, ...] = ("boards", "random boards", "pickets", "rolled rectangles")
THREE: dict[str, Maker] = {"lattice": plates.lattice, "crossing boards": plates.crossing_boards}
DISKS: dict[str, Maker] = {"disks": plates.disks}
BARS: dict[str, Maker] = {f"bars of {width}": plates.bars(width) for width in (0.5, 0.8)}
MAKERS = TILTED | THREE | DISKS | BARS

AIMS = {
    "wrong": (0.04, 0.02, 0.012),
    "three": (0.08, 0.06, 0.06),
    "disks": (0.042, 0.026, 0.012),
    "bars of 0.8": (0.03, 0.015),
}
"""Most wrong parts at 40, 100 and 400 frames."""

HALF_PLANES = 8
"""Angles for each seed."""


def view(options: argparse.Namespace) -> View:
    """The image."""
    return plates.SMALL if options.small else plates.FULL


def found_layers(
    options: argparse.Namespace, family: str, seed: int, frame_counts: list[int], q: float = 0.0
) -> Iterator[tuple[int, plates.Scene, Layers]]:
    """Layers of one scene for each number of frames, the first ones of one recording."""
    most = max(frame_counts)
    if family in FAMILIES:
        surfaces = FAMILIES[family](np.random.default_rng([seed, 77]))
        if options.layers == "counts" and q == 0:
            one = plates.scene([plates.Plate.of(surface) for surface in surfaces], view(options))
        else:
            one, recording = recorded(surfaces, seed, view=view(options), frames=most, q=q)
    else:
        one = plates.scene(MAKERS[family](np.random.default_rng([seed, 77]), view(options)), view(options))
        if options.layers == "estimate" or q > 0:
            recording = drawn(one, most, seed, q=q)
    for frames in frame_counts:
        if options.layers == "counts" and q == 0:
            yield frames, one, counted(one, frames, seed)
        else:
            yield frames, one, estimated(first_frames(recording, frames))


def aim(name: str, frames: int) -> str:
    """Most wrong parts at a number of frames, where one is set."""
    most = dict(zip((40, 100, 400), AIMS.get(name, ()), strict=False)).get(frames)
    return "" if most is None else f"{most:g}"


def print_wrong(
    options: argparse.Namespace,
    title: str,
    families: tuple[str, ...],
    *,
    aims: str | None = None,
    surfaces: int = 2,
    frame_counts: list[int] | None = None,
    q: float = 0.0,
) -> None:
    """A row for each family and number of frames."""
    print(f"\n**{title}**\n")
    names = [*RIVALS, "tofmix"]
    print(f"| {'scene':17} | frames | pixels | {' | '.join(f'{name:>8}' for name in names)} | no range | at most |")
    print(f"|{'---|' * (len(names) + 5)}")
    counts = frame_counts or options.frames
    all_of: dict[int, dict[str, Wrong]] = {frames: {name: Wrong() for name in names} for frames in counts}
    for family in families:
        sums: dict[int, dict[str, Wrong]] = {frames: {name: Wrong() for name in names} for frames in counts}
        for seed in options.seeds:
            for frames, one, layers in found_layers(options, family, seed, counts, q):
                ways: dict[str, np.ndarray] = {name: way(one, layers) for name, way in RIVALS.items()}
                ways["tofmix"] = reconstruct(layers, camera(one.view)).range_fine
                if options.worst:
                    worst = wrong_parts(one, ways["tofmix"], frames, surfaces=surfaces)
                    for line in worst_pixels(one, layers, worst, options.worst):
                        print(f"{family}, seed {seed}, {frames} frames, {line}", file=sys.stderr)
                for name, image in ways.items():
                    wrong = judge_parts(one, image, frames, surfaces=surfaces)
                    sums[frames][name] += wrong
                    all_of[frames][name] += wrong
        for frames in counts:
            print_row(family, frames, sums[frames], aim(aims or family, frames))
    if len(families) > 1:
        for frames in counts:
            print_row("all", frames, all_of[frames], aim(aims, frames) if aims else "")


def print_row(name: str, frames: int, wrong: dict[str, Wrong], most: str) -> None:
    """One row of a table."""
    cells = " | ".join(f"{w.mean:{max(8, len(way))}.4f}" for way, w in wrong.items())
    print(
        f"| {name:17} | {frames:6} | {wrong['tofmix'].pixels:6} | {cells} | {wrong['tofmix'].none:8.4f} | {most:>7} |",
        flush=True,
    )


def print_half_planes(options: argparse.Namespace, *, frame_counts: list[int] | None = None, q: float = 0.0) -> None:
    """Distances from true edges of the points between the two surfaces; edges of anything else are counted."""
    print("\n**Half-planes" + (", phasor sums" if q else "") + ": points of edges, distances in pixels**\n")
    print(
        "| frames | points | rms | at most | in stated errors, rms | 0.8 to 1.2 | above 0.25 off | points of false"
        " edges | mixed pixels with a point | Youngs, rms |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    for frames in frame_counts or options.frames:
        ours, theirs = Places(), Places()
        for seed in options.seeds:
            for turn in range(HALF_PLANES):
                rng = np.random.default_rng([seed, turn, 78])
                one = plates.scene(plates.half_plane(rng, view(options)), view(options))
                if options.layers == "counts" and q == 0:
                    layers = counted(one, frames, seed * 100 + turn)
                else:
                    layers = estimated(drawn(one, frames, seed * 100 + turn, q=q))
                found = reconstruct(layers, camera(one.view))
                edges = found.edges
                own = between(one, layers, found.surface, edges.near, edges.far)
                ours += judge_places(
                    one, frames, edges.row[own], edges.col[own], edges.stderr[own], elsewhere=int((~own).sum())
                )
                theirs += judge_places(one, frames, *youngs_points(one, layers))
        print(
            f"| {frames} | {ours.points} | {ours.rms:.4f} | {'0.012' if frames == 100 else ''} | {ours.z_rms:.2f} |"
            f" {'yes' if 0.8 <= ours.z_rms <= 1.2 else 'no'} | {ours.far_off} | {ours.elsewhere} |"
            f" {ours.covered:.3f} | {theirs.rms:.4f} |",
            flush=True,
        )


def print_links(options: argparse.Namespace) -> None:
    """Purity and completeness."""
    print("\n**Links between layers** (purity at least 0.99, completeness at least 0.95)\n")
    print("| scene             | frames | purity | completeness | surfaces found | true |\n|---|---|---|---|---|---|")
    for family in (*EDGES, *THREE):
        sums = {frames: Links() for frames in options.frames}
        for seed in options.seeds:
            for frames, one, layers in found_layers(options, family, seed, options.frames):
                sums[frames] += judge_links(one, layers, reconstruct(layers, camera(one.view)).surface)
        for frames, links in sums.items():
            print(
                f"| {family:17} | {frames:6} | {links.purity:.4f} | {links.completeness:.4f} | {links.surfaces} |"
                f" {links.true_surfaces} |",
                flush=True,
            )


def print_phasor(options: argparse.Namespace) -> None:
    """The same for phasor sums."""
    print_wrong(
        options, "Phasor sums, 50 frames: wrong parts", (*EDGES, "disks", "bars of 0.8"), frame_counts=[50], q=1.0
    )
    print_half_planes(options, frame_counts=[50], q=1.0)


def print_speed(options: argparse.Namespace) -> None:
    """Time for a full image beside that of its estimate."""
    frames = 100
    print(f"\n**Speed**, one core, best of 3, {frames} frames (at most 1 s on two cores)\n")
    print("| scene | mixed pixels | estimate, s | surfaces and edges, s | ratio |\n|---|---|---|---|---|")
    for family in (*EDGES, "lattice", "disks"):
        seed = options.seeds[0]
        if family in FAMILIES:
            surfaces = FAMILIES[family](np.random.default_rng([seed, 77]))
            one, recording = recorded(surfaces, seed, view=view(options), frames=frames, q=0.0)
        else:
            one = plates.scene(MAKERS[family](np.random.default_rng([seed, 77]), view(options)), view(options))
            recording = drawn(one, frames, seed)
        layers = estimated(recording)
        sensor = camera(one.view)
        reconstruct(layers, sensor)  # compiles
        work = partial(estimated, recording), partial(reconstruct, layers, sensor)
        estimate_s, surfaces_s = least_s(*work)
        several = int((layers.n_modes > 1).sum())
        print(
            f"| {family} | {several} | {estimate_s:.2f} | {surfaces_s:.2f} | {surfaces_s / estimate_s:.2f} |",
            flush=True,
        )


TABLES: dict[str, Callable[[argparse.Namespace], None]] = {
    "wrong": lambda o: print_wrong(o, "Wrong parts of mixed pixels", EDGES, aims="wrong"),
    "three": lambda o: print_wrong(o, "Three surfaces in the pixel", tuple(THREE), aims="three", surfaces=3),
    "disks": lambda o: print_wrong(o, "Disks of 4 to 15 pixels radius", tuple(DISKS)),
    "bars": lambda o: print_wrong(o, "Bars of 0.5 and 0.8 pixels", tuple(BARS)),
    "half-planes": print_half_planes,
    "links": print_links,
    "phasor": print_phasor,
    "speed": print_speed,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=[])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--frames", type=int, nargs="+", default=[40, 100, 400])
    parser.add_argument("--layers", choices=("estimate", "counts"), default="estimate")
    parser.add_argument("--worst", type=int, default=0, help="say of so many pixels what is wrong, on stderr")
    parser.add_argument("--small", action="store_true", help="48 x 60 pixels")
    options = parser.parse_args()
    for name in options.tables or TABLES:
        TABLES[name](options)


if __name__ == "__main__":
    main()
