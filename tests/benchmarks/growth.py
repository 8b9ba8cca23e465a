"""How time and memory grow with a window's samples, with surfaces, with frames (hence windows) and with pixels.

Usage: python tests/benchmarks/growth.py [--folder docs/images] [--rounds 3] [--seed 75]

Prints Markdown tables and draws performance_growth.png; docs/results/performance.md has both. Time is processor time,
least of --rounds: a busy machine changes it by a few per cent only.

The kernels alone: samples in memory, noise of an SR-3000 at 1.2 ms, surfaces of equal shares 8 sigma apart. The whole
command, file to file and with two workers: windows of 100 frames of the built-in three boards, its first 100 frames
repeated, its image tiled.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.binning import CAMERA, NOISE
from benchmarks.scale import TALL, Case, measure, scene, write

from tofmix.arrays import Float32Array
from tofmix.estimation.layering import layer_pixels
from tofmix.report.theme import LIGHT, drawing

SAMPLES = (10, 30, 100, 300, 900, 1000, 3000, 10_000, 100_000)
SURFACES = (1, 2, 3, 4, 5, 6)
FRAMES = (1000, 3000, 10_000, 30_000)
IMAGES = ((36, 44), (72, 88), (144, 176), (288, 352))
APART = 8.0
WINDOW = 100
LEAST_SAMPLES = 300_000
"""Samples of a measurement, at least: that many over the window's samples, and at most 2000, are its pixels."""

Point = tuple[float, float]


def drawn(samples: int, surfaces: int, rng: np.random.Generator) -> Float32Array:
    """Samples (frame, pixel), whole mm."""
    pixels = min(2000, max(20, LEAST_SAMPLES // samples))
    mean = [1000.0]
    while len(mean) < surfaces:
        mean.append(mean[-1] + APART * float(NOISE.sigma(mean[-1])))
    seen = np.array(mean)[rng.integers(0, surfaces, (samples, pixels))]
    return np.rint(seen + NOISE.sigma(seen) * rng.standard_normal(seen.shape)).astype(np.float32)


def microseconds(block: Float32Array, rounds: int) -> float:
    """Processor time of a pixel."""
    layer_pixels(block[:, :2], CAMERA)
    least = np.inf
    for _ in range(rounds):
        start = time.thread_time()
        layer_pixels(block, CAMERA)
        least = min(least, time.thread_time() - start)
    return float(1.0e6 * least / block.shape[1])


def command(frames: int, image: tuple[int, int], folder: Path, rounds: int) -> Point:
    """Processor seconds and peak MB of `tofmix estimate`."""
    samples, sensor = scene()
    tiles = -(-image[0] // samples.shape[1]), -(-image[1] // samples.shape[2])
    path = folder / "grown.h5"
    write(path, np.tile(samples, (1, *tiles)), sensor, frames, Case("", 1, *image, TALL))
    program = [sys.executable, "-m", "tofmix", "estimate", str(path), "--overwrite", "--window", str(WINDOW)]
    taken = [measure([*program, "--workers", "2"]) for _ in range(rounds)]
    return min(busy for _, busy, _ in taken), max(peak for *_, peak in taken)


def table(head: str, rows: list[tuple[str, ...]]) -> None:
    """Print a Markdown table."""
    print(f"\n{head}\n{'|---' * len(rows[0])}|")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def curve(axes: Axes, points: list[Point], label: str, color: str, marker: str) -> None:
    axes.plot(*zip(*points, strict=True), color=color, marker=marker, markersize=4, linewidth=1.2, label=label)


def finish(axes: Axes, title: str, x: str, y: str, *, log: str) -> None:
    """Name the axes, and write the numbers of logarithmic ones out; the others start at 0."""
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set(xlabel=x, ylabel=y)
    for letter, axis, set_scale in (("x", axes.xaxis, axes.set_xscale), ("y", axes.yaxis, axes.set_yscale)):
        if letter in log:
            set_scale("log")
            axis.set_major_formatter(lambda value, _: f"{value:,g}")
            axis.set_minor_formatter(NullFormatter())
        elif letter == "y":
            axes.set_ylim(bottom=0.0)
    axes.grid(color=LIGHT.grid, linewidth=0.6)
    axes.set_axisbelow(True)


def kernels(axes: tuple[Axes, Axes], rounds: int, rng: np.random.Generator) -> None:
    """Measure and draw what a pixel costs."""
    by_samples, by_surfaces = axes
    colours = dict(zip((1, 2, 3), LIGHT.layers, strict=True))
    found = {k: [(float(n), microseconds(drawn(n, k, rng), rounds)) for n in SAMPLES] for k in (1, 3)}
    for k, points in found.items():
        curve(by_samples, points, "1 surface" if k == 1 else f"{k} surfaces", colours[k], "os^"[k - 1])
    finish(by_samples, "a pixel, by the samples of its window", "samples", "processor time (µs)", log="xy")
    by_samples.legend(loc="upper left")
    table(
        "| samples | µs a pixel, 1 surface | 3 surfaces |",
        [(f"{n:,}", *(f"{dict(found[k])[float(n)]:.1f}" for k in (1, 3))) for n in SAMPLES],
    )
    more = {n: [(float(k), microseconds(drawn(n, k, rng), rounds)) for k in SURFACES] for n in (100, 1000)}
    for n, color, marker in ((100, LIGHT.layers[0], "o"), (1000, LIGHT.layers[1], "s")):
        curve(by_surfaces, more[n], f"{n} samples", color, marker)
    finish(by_surfaces, "a pixel, by its surfaces", "surfaces", "processor time (µs)", log="")
    by_surfaces.legend(loc="upper left")
    table(
        "| surfaces | µs a pixel, 100 samples | 1000 samples |",
        [(f"{k}", *(f"{dict(more[n])[float(k)]:.1f}" for n in (100, 1000))) for k in SURFACES],
    )


def commands(axes: tuple[Axes, Axes], rounds: int) -> None:
    """Measure and draw what the whole command takes."""
    of_time, of_memory = axes
    with tempfile.TemporaryDirectory() as name:
        longer = [(n * 72 * 88, *command(n, (72, 88), Path(name), rounds)) for n in FRAMES]
        larger = [(1000 * r * c, *command(1000, (r, c), Path(name), rounds)) for r, c in IMAGES]
    runs = ((longer, "more frames, 72 x 88", "o", 0), (larger, "more pixels, 1000 frames", "s", 1))
    for points, label, marker, k in runs:
        curve(of_time, [(n / 1e6, busy) for n, busy, _ in points], label, LIGHT.layers[k], marker)
        curve(of_memory, [(n / 1e6, peak) for n, _, peak in points], label, LIGHT.layers[k], marker)
    finish(of_time, "the command, by the recording's samples", "million samples", "processor time (s)", log="")
    finish(of_memory, "its memory", "million samples", "peak (MB)", log="")
    for each in axes:
        each.legend(loc="lower right")
    table(
        "| frames | image | windows | processor s | peak MB |",
        [
            (f"{frames:,}", f"{r} x {c}", f"{frames // WINDOW}", f"{busy:.2f}", f"{peak:.0f}")
            for (frames, (r, c)), (_, busy, peak) in zip(
                [*((n, (72, 88)) for n in FRAMES), *((1000, image) for image in IMAGES)],
                [*longer, *larger],
                strict=True,
            )
        ],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("docs/images"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seed", type=int, default=75)
    arguments = parser.parse_args()
    with drawing(LIGHT):
        figure = Figure(figsize=(9.0, 6.4), layout="constrained")
        (top_left, top_right), (low_left, low_right) = figure.subplots(2, 2)
        kernels((top_left, top_right), arguments.rounds, np.random.default_rng(arguments.seed))
        commands((low_left, low_right), arguments.rounds)
        figure.savefig(arguments.folder / "performance_growth.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
