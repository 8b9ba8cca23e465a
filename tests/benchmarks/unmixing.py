"""Mixed pixels of a lock-in camera: how often both surfaces are found, and what is invented.

    python tests/benchmarks/unmixing.py [phasor|few|frames|texture|laws|open|wrapped|events|pickets|speed ...]
        [--seeds 1 2] [--small]

Raw-tap recordings (tests/blind, which knows nothing of the package) of ten kinds of scenes, 144 x 176 pixels, 50
frames unless said otherwise, estimated with all defaults. Prints Markdown tables; docs/results/mixing.md holds a copy.
Asserts nothing.

- phasor: all samples are phasor sums. few: 10 frames of that. texture: 10 % from pixel to pixel.
- frames: all scenes together, by number of frames.
- laws: the share q of phasor sums between 0 and 1, and what is measured of it.
- open: boards without the wall behind them: a surface beside open space, its share in every frame.
- wrapped: 30 MHz, the ranges folded at 5 m.
- events: samples of one surface each; how many layers files differ from those of `--mixing events`.
- pickets: slats of 1.5 to 4 pixels before a wall, 48 x 64 pixels, 40 frames, every slat at its own range; and the
  parts (8 x 8) of mixed pixels that get the wrong surface in `surfaces`, for slats that end in the image at their ends.
- speed: what unmixing adds to an estimate.
"""

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np
from support.costs import least_s

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind.geometry import View
from support import plates
from support.edges import camera, wrong_parts
from support.lock_in import FAMILIES, FULL, SLATS, SMALL, Direction, Judged, Scene, judge, made, slats

from tofmix.estimation.blocks.sequence import EstimatedWindows, estimate_windows
from tofmix.estimation.settings import EstimateOptions
from tofmix.layers import Layers
from tofmix.surfaces.reconstruct import reconstruct

FRAMES = (3, 5, 7, 10, 25)
SHARES = (0.0, 0.1, 0.35, 0.5, 0.7, 1.0)
HEADS = (
    "| scene | asked for | exactly both | false layers a mixed pixel | undecided of mixed | share, rms |"
    " split of single | sure and false |\n|---|---|---|---|---|---|---|---|"
)
LAW_SCENES = ("boards", "pickets", "random boards", "corner")


def scene(family: str, seed: int, small: bool, **choices: float | bool) -> Scene:
    """One recording of a family."""
    surfaces = FAMILIES[family](np.random.default_rng([seed, 77]))
    return made(surfaces, seed, view=SMALL if small else FULL, **choices)  # type: ignore[arg-type]


def first(found: EstimatedWindows) -> Layers:
    """Layers (row, col) of the first window."""
    return Layers(**{spec.name: getattr(found.layers, spec.name)[0] for spec in found.layers.fields})


def estimated(one: Scene, options: EstimateOptions | None = None) -> EstimatedWindows:
    """Estimate a recording with both cores."""
    return estimate_windows(one.recording, options, workers=2)


def print_judged(options: argparse.Namespace, title: str, **choices: float | bool) -> None:
    """A row for each family."""
    print(f"\n**{title}**\n")
    print(HEADS)
    total = Judged()
    for family in options.scenes or FAMILIES:
        result = Judged()
        for seed in options.seeds:
            one = scene(family, seed, options.small, **choices)
            circle_mm = one.device.unambiguous_mm if choices.get("wraps") else None
            chosen = EstimateOptions(unambiguous_range_mm=circle_mm)
            result += judge(one, first(estimated(one, chosen)), circle_mm=circle_mm or np.inf)
        total += result
        print_row(family, result)
    print_row("all", total)


def print_frames(options: argparse.Namespace) -> None:
    """All scenes together, by number of frames."""
    print(f"\n**Phasor sums, by number of frames**\n\n{HEADS.replace('scene', 'frames')}")
    for frames in FRAMES:
        scenes = ((family, seed) for family in options.scenes or FAMILIES for seed in options.seeds)
        judged = (
            judge(one, first(estimated(one))) for one in (scene(*of, options.small, frames=frames) for of in scenes)
        )
        print_row(str(frames), sum(judged, Judged()))


def print_row(name: str, r: Judged) -> None:
    """One row of a table."""
    print(
        f"| {name} | {r.asked} | {r.found / max(r.asked, 1):.3f} | {r.false / max(r.mixed, 1):.3f} |"
        f" {r.undecided / max(r.mixed, 1):.3f} | {r.share_rms:.4f} | {r.split} of {r.single} |"
        f" {r.sure_false} of {r.sure} |",
        flush=True,
    )


def print_laws(options: argparse.Namespace) -> None:
    """A row for each share of phasor sums."""
    print("\n**The law of mixing**\n")
    print(
        "| q | measured, least and most of the scenes | exactly both | false layers a mixed pixel | sure and false |"
        "\n|---|---|---|---|---|"
    )
    for q in SHARES:
        result, measured = Judged(), []
        for family in options.scenes or LAW_SCENES:
            for seed in options.seeds:
                one = scene(family, seed, options.small, q=q)
                found = estimated(one)
                measured.append(float(found.phasor_share[0]))  # type: ignore[index]  # measured
                result += judge(one, first(found))
        print(
            f"| {q:g} | {min(measured):.3f} to {max(measured):.3f} | {result.found / max(result.asked, 1):.3f} |"
            f" {result.false / max(result.mixed, 1):.3f} | {result.sure_false} of {result.sure} |",
            flush=True,
        )


def print_open(options: argparse.Namespace) -> None:
    """Shares of surfaces beside open space."""
    print("\n**Beside open space**\n")
    print("| scene | pixels | one surface and open space | share, rms | without unmixing |\n|---|---|---|---|---|")
    for family in ("boards", "random boards"):
        for seed in options.seeds:
            surfaces = FAMILIES[family](np.random.default_rng([seed, 77]))[:-1]  # without the wall
            one = made(surfaces, seed, view=SMALL if options.small else FULL)
            beams = one.beams
            some = ((beams.share > 0).sum(axis=0) == 1) & (beams.share[0] > 0.15) & (beams.share[0] < 0.85)
            some &= beams.nothing > 0
            cells = []
            for mixing in ("auto", "events"):
                layers = first(estimated(one, EstimateOptions(mixing=mixing)))  # type: ignore[arg-type]  # becomes one
                flat = layers.reshaped((beams.share.shape[1],))
                both = some & (flat.n_modes == 1) & (flat.weight_no_return > 0)
                off = flat.weight[both, 0] - beams.share[0, both]
                cells.append((both.sum() / max(some.sum(), 1), float(np.sqrt(np.mean(off**2))) if both.any() else 0.0))
            print(
                f"| {family} {seed} | {some.sum()} | {cells[0][0]:.3f} | {cells[0][1]:.4f} | {cells[1][0]:.3f} |",
                flush=True,
            )


def print_events(options: argparse.Namespace) -> None:
    """Recordings under equation (1): arrays with and without the law's measurement."""
    print("\n**Equation (1)**\n")
    differ, recordings = 0, 0
    for family in options.scenes or FAMILIES:
        for seed in options.seeds:
            one = scene(family, seed, options.small, q=0.0)
            auto = estimated(one).layers
            events = estimated(one, EstimateOptions(mixing="events")).layers  # type: ignore[arg-type]  # becomes one
            same = all(
                getattr(auto, spec.name).tobytes() == getattr(events, spec.name).tobytes() for spec in events.fields
            )
            recordings += 1
            differ += not same
    print(f"{recordings} recordings; layers that differ from those of --mixing events: {differ}")


WIDTHS = ((1.5, 1.5), (2.0, 2.0), (2.0, 3.0), (3.0, 3.0), (4.0, 4.0))
"""Widths of slats, pixels, least and most."""

DIRECTIONS: tuple[Direction, ...] = ("vertical", "horizontal", "tilted")

SLAT_FRAMES = 40


def print_pickets(options: argparse.Namespace) -> None:
    """A row for each direction and width of slats."""
    print(f"\n**Slats, {SLAT_FRAMES} frames**\n")
    print(
        "| slats | pixels wide | asked for | exactly both | false layers a mixed pixel | undecided of mixed |"
        " share, rms | split of single | sure and false | wrong parts | at the ends |\n" + "|---" * 11 + "|"
    )
    for direction in DIRECTIONS:
        for width in WIDTHS:
            total, wrong, at_ends = Judged(), [], []
            for seed in options.seeds:
                one, layers, parts = judged_slats(seed, width, direction, ends=False)
                total += judge(one, layers)
                wrong.append(parts)
                at_ends.append(judged_slats(seed, width, direction, ends=True)[2])
            r, span = total, f"{width[0]:g}" if width[0] == width[1] else f"{width[0]:g} to {width[1]:g}"
            print(
                f"| {direction} | {span} | {r.asked} | {r.found / max(r.asked, 1):.3f} |"
                f" {r.false / max(r.mixed, 1):.3f} | {r.undecided / max(r.mixed, 1):.3f} | {r.share_rms:.4f} |"
                f" {r.split} of {r.single} | {r.sure_false} of {r.sure} | {np.concatenate(wrong).mean():.3f} |"
                f" {np.concatenate(at_ends).mean():.3f} |",
                flush=True,
            )


def judged_slats(
    seed: int, width: tuple[float, float], direction: Direction, *, ends: bool
) -> tuple[Scene, Layers, np.ndarray]:
    """A recording of slats, its layers, and the shares of wrong parts of its mixed pixels, or of those at ends."""
    surfaces = slats(np.random.default_rng([seed, 5]), width, direction, ends=ends)
    one = made(surfaces, seed, view=SLATS, frames=SLAT_FRAMES)
    layers = first(estimated(one))
    view = View(
        rows=SLATS[0],
        cols=SLATS[1],
        fov_horizontal_deg=SLATS[2],
        fov_vertical_deg=SLATS[3],
        range_max_mm=one.device.range_max_mm,
    )
    cast = plates.scene([plates.Plate.of(surface) for surface in surfaces], view)
    wrong = wrong_parts(cast, reconstruct(layers, camera(view)).range_fine, SLAT_FRAMES)
    if ends:
        # At an end, the pixel beyond along the slat sees the wall alone.
        is_wall = cast.truth.share[-1] > 1.0 - 1.0e-6
        along = 1 if direction == "horizontal" else 0
        beyond = np.stack([np.roll(is_wall, step, axis=along) for step in (-1, 1)])
        wrong = np.where(beyond.any(axis=0), wrong, np.nan)
    return one, layers, wrong[np.isfinite(wrong)]


def print_speed(options: argparse.Namespace) -> None:
    """What unmixing adds to an estimate, best of three runs side by side."""
    print("\n**Speed**\n\n| scene | estimate, s | with unmixing, s |\n|---|---|---|")
    for family in options.scenes or ("boards", "pickets", "random boards"):
        one = scene(family, options.seeds[0], options.small)
        ways = (EstimateOptions(mixing=mixing) for mixing in ("events", "auto"))  # type: ignore[arg-type]  # becomes one
        events, auto = least_s(*(partial(estimated, one, way) for way in ways))
        print(f"| {family} | {events:.2f} | {auto:.2f} |", flush=True)


TABLES = {
    "phasor": lambda o: print_judged(o, "Phasor sums, 50 frames"),
    "few": lambda o: print_judged(o, "Phasor sums, 10 frames", frames=10),
    "frames": print_frames,
    "texture": lambda o: print_judged(o, "Phasor sums, 10 % texture", texture=0.1),
    "laws": print_laws,
    "open": print_open,
    "wrapped": lambda o: print_judged(o, "30 MHz, folded at 5 m", frequency_hz=30.0e6, wraps=True),
    "events": print_events,
    "pickets": print_pickets,
    "speed": print_speed,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=[])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--scenes", nargs="+", choices=FAMILIES)
    parser.add_argument("--small", action="store_true", help="48 x 60 pixels")
    options = parser.parse_args()
    for name in options.tables or TABLES:
        TABLES[name](options)


if __name__ == "__main__":
    main()
