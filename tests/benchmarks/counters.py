"""The three counters of step 1 on the same recordings, and the density of a live sequence.

Usage: python tests/benchmarks/counters.py [--pixels 1000] [--output docs/images]

Prints the Markdown tables of docs/results/counters.md; with --output it also draws the figures. Asserts nothing.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.counters import Counter, Cpdf, Fourier, Kde, Peaks
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.samples import sort_samples
from tofmix.estimation.settings import EstimateOptions
from tofmix.io.model_file import load_model
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.render import recording_sensor, render_blocks

MODEL = load_model("three-boards")
CAMERA = recording_sensor(MODEL)
"""The paper's camera at its 1.2 ms."""

PAPER: dict[str, Counter] = {"density": Kde(), "CPDF, 15 bins": Cpdf(), "Fourier, order 16": Fourier()}
OTHERS: dict[str, Counter] = {
    "density, gamma 0.05": Kde(gamma=0.05),
    "density, gamma 0.1": Kde(gamma=0.1),
    "CPDF, 30 bins": Cpdf(bins=30),
    "CPDF, 60 bins": Cpdf(bins=60),
    "CPDF, 15 bins, k 1.2": Cpdf(ratio=1.2),
    "CPDF, 60 bins, k 1.02": Cpdf(bins=60, ratio=1.02),
    "CPDF, 100 bins, k 1.02": Cpdf(bins=100, ratio=1.02),
    "Fourier, order 8": Fourier(order=8),
    "Fourier, order 32": Fourier(order=32),
    "Fourier, level 0.05": Fourier(level=0.05),
    "Fourier, level 0.15": Fourier(level=0.15),
}
NUMBERS = (15, 30, 100, 300)
APART = (2, 3, 4, 5, 6, 8, 16)
SHARES = (0.5, 0.2, 0.1)
NEAR_MM = (1000.0, 3500.0)
"""Where the nearer surface stands: anywhere in its bin, and with the farther one inside the working range."""

SEED = 2008
PIXEL = (72, 92)
"""The paper's pixel: 92 of the middle row."""

SHOWN = (5, 15, 30, 60, 100)
PAIR, BOARDS = 2, 3

_COLOURS = {"density": "#0072b2", "CPDF": "#d55e00", "Fourier": "#009e73"}  # Okabe and Ito
_LINES = ("-", "--", ":", "-.")
_DRAWN = (
    "density",
    "density, gamma 0.1",
    "CPDF, 15 bins",
    "CPDF, 60 bins",
    "CPDF, 60 bins, k 1.02",
    "Fourier, order 8",
    "Fourier, order 16",
    "Fourier, order 32",
)
_INK, _GRID_COLOUR = "#1f2328", "#e3e7eb"
_SETTINGS = {
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "text.color": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "legend.frameon": False,
}
_SIZE_INCH, _DPI = (8.4, 3.7), 120.0


def sigma(range_mm: FloatArray) -> FloatArray:
    """The camera's noise, mm."""
    assert CAMERA.noise is not None
    return CAMERA.noise.sigma(range_mm)


def recording(n: int, pixels: int, *, apart: float = 0.0, share: float = 1.0) -> tuple[Float32Array, FloatArray]:
    """Samples (frame, pixel) of one surface, or of two `apart` sigma; and the nearer one's range (pixel,), mm."""
    rng = np.random.default_rng([SEED, n, int(10 * apart), int(100 * share)])
    near = rng.uniform(*NEAR_MM, pixels)
    mean = np.where(rng.random((n, pixels)) < share, near, near + apart * sigma(near))
    return (mean + rng.standard_normal(mean.shape) * sigma(mean)).astype(np.float32), near


def peaks(counter: Counter, block: Float32Array) -> Peaks:
    """What a counter finds in a block."""
    return counter.peaks(sort_samples(block), beam_of(CAMERA))


def right(counter: Counter, surfaces: int, block: Float32Array) -> float:
    """Share of the pixels in which a counter finds `surfaces` peaks."""
    return float((peaks(counter, block).found == surfaces).mean())


def header(*columns: str) -> None:
    """Print the head of a table."""
    print(f"\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")


def one_surface(pixels: int) -> None:
    """Print the share of pixels in which one surface is one peak, and how far the peak is from it."""
    header("counter", *(f"N = {n}" for n in NUMBERS), "error of the place at N = 100, sigma")
    for name, counter in (PAPER | OTHERS).items():
        row = [f"{right(counter, 1, recording(n, pixels)[0]):.3f}" for n in NUMBERS]
        block, near = recording(100, pixels)
        found = peaks(counter, block)
        highest = found.place[np.arange(pixels), found.height.argmax(axis=1)]
        row.append(f"{np.sqrt(np.mean(((highest - near) / sigma(near)) ** 2)):.2f}")
        print(f"| {name} | {' | '.join(row)} |")


def two_surfaces(pixels: int) -> None:
    """Print the share of pixels in which two surfaces are two peaks, in brackets that in which they are fewer."""
    header("counter", *(f"{apart} sigma" for apart in APART))
    for name, counter in (PAPER | OTHERS).items():
        row = []
        for apart in APART:
            found = peaks(counter, recording(100, pixels, apart=apart, share=0.5)[0]).found
            row.append(f"{(found == PAIR).mean():.2f} ({(found < PAIR).mean():.2f})")
        print(f"| {name} | {' | '.join(row)} |")


def every_cell(pixels: int) -> None:
    """Print the share of pixels with two peaks for each share, number of samples and separation."""
    header("share of the nearer", "N", *(f"{apart} sigma" for apart in APART))
    for share in SHARES:
        for n in NUMBERS:
            row = []
            for apart in APART:
                block, _ = recording(n, pixels, apart=apart, share=share)
                row.append(" / ".join(f"{right(c, 2, block):.2f}" for c in PAPER.values()))
            print(f"| {share} | {n} | {' | '.join(row)} |")


def whole_estimate(pixels: int) -> None:
    """Print the share of pixels in which two surfaces are found after step 2, started from each counter."""
    header("counter", "one surface", *(f"{apart} sigma" for apart in APART))
    for name, counter in PAPER.items():
        options = EstimateOptions(counter=counter)
        row = [f"{(layer_pixels(recording(100, pixels)[0], CAMERA, options).n_modes == 1).mean():.3f}"]
        for apart in APART:
            block, _ = recording(100, pixels, apart=apart, share=0.5)
            row.append(f"{(layer_pixels(block, CAMERA, options).n_modes == PAIR).mean():.2f}")
        print(f"| {name} | {' | '.join(row)} |")


def scene() -> tuple[Truth, Float32Array]:
    """Truth and samples (frame, row, col) of the three boards."""
    truth = cast_scene(MODEL)
    return truth, np.concatenate([block.range_mm for block in render_blocks(MODEL, truth, n_frames=100, seed=1)])


def three_boards() -> None:
    """Print the share of pixels with as many peaks as surfaces, in pixels of three and of one; and over N."""
    truth, samples = scene()
    least = np.nanmin(np.where(np.isnan(truth.weight_true), np.inf, truth.weight_true), axis=-1)
    no_open: BoolArray = truth.weight_no_return == 0
    three = (truth.n_modes == BOARDS) & (least >= min(SHARES)) & no_open
    one = (truth.n_modes == 1) & no_open
    header("counter", f"three peaks, of {three.sum()}", "fewer", f"one peak, of {one.sum()}")
    for name, counter in (PAPER | OTHERS).items():
        found, alone = (peaks(counter, np.ascontiguousarray(samples[:, where])).found for where in (three, one))
        print(
            f"| {name} | {(found == BOARDS).mean():.2f} | {(found < BOARDS).mean():.2f} | {(alone == 1).mean():.3f} |"
        )
    header("samples so far", *(str(n) for n in SHOWN))
    live, before, row = IncrementalDensity(CAMERA, int(three.sum())), 0, []
    for n in SHOWN:
        live.add(samples[before:n, three])
        row.append(f"{(live.modes().found >= BOARDS).mean():.2f}")
        before = n
    print(f"| three modes or more | {' | '.join(row)} |")


def _axes(figure: Figure) -> list[Axes]:
    both = figure.subplots(1, 2)
    for axes in both:
        axes.grid(color=_GRID_COLOUR, linewidth=0.6)
        axes.set_axisbelow(True)
    return list(both)


def _figure() -> Figure:
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
    return Figure(figsize=_SIZE_INCH, dpi=_DPI, layout=layout, facecolor="white")


def draw_recovery(pixels: int) -> Figure:
    """Draw how often each counter is right, over the separation and over N."""
    figure = _figure()
    first, second = _axes(figure)
    every = PAPER | OTHERS
    seen: dict[str, int] = {}
    for name in _DRAWN:
        kind = name.split(",")[0]
        line = _LINES[seen.setdefault(kind, 0)]
        seen[kind] += 1
        two = [right(every[name], 2, recording(100, pixels, apart=apart, share=0.5)[0]) for apart in APART]
        one = [right(every[name], 1, recording(n, pixels)[0]) for n in NUMBERS]
        for axes, x, y in ((first, APART, two), (second, NUMBERS, one)):
            axes.plot(x, y, line, color=_COLOURS[kind], marker="o", markersize=3.5, label=name)
    first.set_title("two surfaces, 100 samples", loc="left", fontweight="bold")
    first.set(xlabel="distance of the two (sigma)", ylabel="pixels with the right number of peaks", xscale="log")
    first.set_xticks(APART, [f"{s}" for s in APART])
    second.set_title("one surface", loc="left", fontweight="bold")
    second.set(xlabel="samples", xscale="log")
    second.set_xticks(NUMBERS, [f"{n}" for n in NUMBERS])
    for axes in (first, second):
        axes.set_ylim(-0.03, 1.03)
        axes.minorticks_off()
    figure.legend(*first.get_legend_handles_labels(), loc="outside right center", fontsize=8.5, handlelength=2.8)
    return figure


def draw_incremental() -> Figure:
    """Draw the paper's Fig. 7: the density as samples come in, and its modes against their number."""
    truth, samples = scene()
    live = IncrementalDensity(CAMERA, 1)
    figure = _figure()
    first, second = _axes(figure)
    range_m = live.range_mm / 1000.0
    for n, frame in enumerate(samples[:, PIXEL[0], PIXEL[1]], start=1):
        live.add([[frame]])
        found = live.modes()
        k = int(found.found[0])
        place, height = found.place[0, :k] / 1000.0, found.height[0, :k]
        second.scatter(np.full(k, n), place, s=60 * height, color=_COLOURS["density"], linewidths=0, alpha=0.8)
        if n in SHOWN:
            base = -SHOWN.index(n)
            curve = base + 620.0 * live.density()[0]
            first.fill_between(range_m, base, curve, color=_COLOURS["density"], alpha=0.25, linewidth=0)
            first.plot(range_m, curve, color=_COLOURS["density"], linewidth=1.0)
            first.text(6.35, base + 0.12, f"{n} samples", ha="right", fontsize=9.0)
    for true, share in zip(truth.range_true[PIXEL], truth.weight_true[PIXEL], strict=True):
        if np.isfinite(true):
            first.axvline(true / 1000.0, color=_COLOURS["CPDF"], linewidth=0.9, linestyle="--")
            second.axhline(true / 1000.0, color=_COLOURS["CPDF"], linewidth=0.9, linestyle="--", zorder=0.5)
            label = f"a board, share {share:.2f}"
            second.text(99, true / 1000.0 + 0.16, label, fontsize=8.5, ha="right", color=_COLOURS["CPDF"])
    first.set(xlim=(1.5, 6.4), xlabel="range (m)", yticks=[], ylabel="p(r), one scale")
    first.set_title("density as samples come in", loc="left", fontweight="bold")
    second.set(xlim=(0, 101), ylim=(2.0, 5.4), xlabel="samples so far", ylabel="range of the modes (m)")
    second.set_title("modes; area: height", loc="left", fontweight="bold")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=1000, help="pixels a cell")
    parser.add_argument("--output", type=Path, help="folder to draw into")
    chosen = parser.parse_args()
    for table in (one_surface, two_surfaces, every_cell, whole_estimate):
        table(chosen.pixels)
    three_boards()
    if chosen.output is not None:
        chosen.output.mkdir(parents=True, exist_ok=True)
        with style.context(["default", _SETTINGS]):
            drawn = {"recovery": draw_recovery(chosen.pixels), "incremental": draw_incremental()}
            for name, figure in drawn.items():
                figure.savefig(chosen.output / f"counters_{name}.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
