"""Draw the figures of docs/explanation/model.md and print its numbers.

Run ``python docs/figures/model_figures.py``. The same versions of tofmix and Matplotlib
give the same bytes.
"""

import argparse
import cmath
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.report.theme import LIGHT, drawing
from tofmix.sensor import NoiseCurve
from tofmix.sensors import load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import recording_sensor, render_blocks

BOARDS_MM = (2400.0, 3600.0, 4800.0)
"""The paper's Fig. 3."""
SHARES = (0.067577, 0.280792, 0.632203)
"""The paper's Table II; the rest, 0.019, is no return and random values, which have no light."""
TAU_MS = 1.2

WEIGHTS = {"area": 0, "area and 1 / r²": 2}
"""Powers of 1 / r in the light of a surface that fills the pixel."""

REFLECTIVITY = {"area": 1.0 / max(BOARDS_MM) ** 2, "area and 1 / r²": 0.0}
"""What makes boards as bright as the weight says: in proportion to r^2, which undoes 1 / r^2; or all the same, 0.8."""

PROBABILITIES = (0.0, 0.3, 1.0)
ROWS, FRAMES, SEED = 200, 100, 1
"""Pixels that all see the three boards, and samples of each."""

_SUMS = (LIGHT.accent, "#cc79a7")
_WIDTH_INCH = 7.2


@dataclass(frozen=True, slots=True, kw_only=True)
class PhasorSum:
    """Where the light of several surfaces at once is measured.

    range_mm is within one turn; left is what is left of the light's amplitude, between 0 (the surfaces cancel) and 1;
    arrows are the summands.
    """

    range_mm: float
    left: float
    arrows: tuple[complex, ...]


def phasor_sum(ranges_mm: tuple[float, ...], shares: tuple[float, ...], turn_mm: float, power: float) -> PhasorSum:
    """Add the phasors of surfaces, each of its share and 1 / r^power."""
    light = [share * (1000.0 / r) ** power for r, share in zip(ranges_mm, shares, strict=True)]
    arrows = tuple(a * cmath.exp(2j * math.pi * r / turn_mm) for a, r in zip(light, ranges_mm, strict=True))
    total = sum(arrows)
    return PhasorSum(
        range_mm=cmath.phase(total) % (2 * math.pi) * turn_mm / (2 * math.pi),
        left=abs(total) / sum(light),
        arrows=arrows,
    )


def camera() -> tuple[float, NoiseCurve]:
    """d_u, mm, and sigma(r) of the paper's camera at 1.2 ms."""
    profile = load_profile("sr3000")
    return profile.turn_mm("the phasor sum"), profile.noise_at(TAU_MS)


def bell(range_mm: FloatArray, mean_mm: float, sigma_mm: float) -> FloatArray:
    """Density of a Gaussian, 1/mm."""
    z = (range_mm - mean_mm) / sigma_mm
    return np.asarray(np.exp(-0.5 * z * z) / (sigma_mm * math.sqrt(2 * math.pi)))


# Drawing


def _figure(height_inch: float) -> Figure:
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06)
    return Figure(figsize=(_WIDTH_INCH, height_inch), layout=layout)


def _style(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.grid(color=LIGHT.grid, linewidth=0.6)
    axes.set_axisbelow(True)


def rivals() -> Figure:
    """Density of a sample of the paper's pixel under both models."""
    turn_mm, noise = camera()
    range_mm = np.linspace(1800.0, 6000.0, 2000)
    figure = _figure(3.3)
    axes = figure.subplots()
    _style(axes, "one pixel, two models")
    parts = zip(BOARDS_MM, SHARES, strict=True)
    mixture = sum(share * bell(range_mm, r, float(noise.sigma(r))) for r, share in parts)
    axes.fill_between(range_mm / 1000, 1000 * np.asarray(mixture), color=LIGHT.ink, alpha=0.12, linewidth=0)
    axes.plot(
        range_mm / 1000, 1000 * np.asarray(mixture), color=LIGHT.ink, label="equation (1): a sample is of one board"
    )
    for (name, power), color in zip(WEIGHTS.items(), _SUMS, strict=True):
        at = phasor_sum(BOARDS_MM, SHARES, turn_mm, power)
        # The noise that the same light would have from one surface there, over what is left of its amplitude.
        density = bell(range_mm, at.range_mm, float(noise.sigma(at.range_mm)) / at.left)
        label = f"phasor sum, weighted by {name}: {at.range_mm / 1000:.2f} m"
        axes.plot(range_mm / 1000, 1000 * density, color=color, label=label)
    for r, color in zip(BOARDS_MM, LIGHT.layers, strict=True):
        axes.axvline(r / 1000, color=color, linestyle="--", linewidth=1.2, zorder=1.5)
    axes.set(xlabel="range (m)", ylabel="density (1/m)", xlim=(1.8, 6.0), ylim=(0, 3.4))
    axes.legend(loc="upper left", fontsize=8.5, framealpha=1.0, frameon=True, edgecolor="none")
    return figure


def dials() -> Figure:
    """The phasors of the three boards head to tail, and their sum."""
    turn_mm, _ = camera()
    figure = _figure(4.2)
    panels = figure.subplots(1, 2)
    for axes, (name, power), color in zip(panels, WEIGHTS.items(), _SUMS, strict=True):
        axes.text(0.0, 1.42, f"weighted by {name}", fontweight="bold", ha="center")
        _dial(axes, phasor_sum(BOARDS_MM, SHARES, turn_mm, power), turn_mm, color)
    return figure


def _dial(axes: Axes, total: PhasorSum, turn_mm: float, color: str) -> None:
    """Draw arrows over a dial of ranges; the light of all together is the dial's radius."""
    whole = sum(abs(arrow) for arrow in total.arrows)
    axes.set_aspect("equal")
    axes.set(xlim=(-1.34, 1.34), ylim=(-1.34, 1.56))
    axes.axis("off")
    turn = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(turn), np.sin(turn), color=LIGHT.grid, linewidth=1.0)
    for metre in range(math.ceil(turn_mm / 1000)):
        direction = cmath.exp(2j * math.pi * 1000 * metre / turn_mm)
        axes.plot([0.97 * direction.real, direction.real], [0.97 * direction.imag, direction.imag], color=LIGHT.ink)
        axes.text(1.15 * direction.real, 1.15 * direction.imag, f"{metre} m", ha="center", va="center", fontsize=9)
    at = 0j
    for arrow, layer, r in zip(total.arrows, LIGHT.layers, BOARDS_MM, strict=True):
        _arrow(axes, at, arrow / whole, layer, f"{r / 1000:.1f} m")
        at += arrow / whole
    _arrow(axes, 0j, at, color, f"sum: {total.range_mm / 1000:.2f} m")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=2, fontsize=8.5)


def _arrow(axes: Axes, start: complex, step: complex, color: str, label: str) -> None:
    axes.annotate(
        "", xy=((start + step).real, (start + step).imag), xytext=(start.real, start.imag),
        arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 2.2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    axes.plot([], [], color=color, linewidth=2.2, label=label)


def two_surfaces() -> Figure:
    """Range and noise of the phasor sum of two equally bright surfaces, against the nearer one's share."""
    turn_mm, _ = camera()
    share = np.linspace(0.0, 1.0, 401)
    figure = _figure(3.4)
    where, noise = figure.subplots(1, 2)
    _style(where, "where the sum lies")
    _style(noise, "how much noisier it is")
    for (near, far), color in zip(((2400.0, 3600.0), (2400.0, 4800.0), (1500.0, 6000.0)), LIGHT.layers, strict=True):
        sums = [phasor_sum((near, far), (w, 1 - w), turn_mm, 0) for w in share.tolist()]
        label = f"{near / 1000:.1f} and {far / 1000:.1f} m"
        where.plot(share, [s.range_mm / 1000 for s in sums], ".", markersize=1.6, color=color)
        where.plot([], [], color=color, label=label)
        noise.plot(share, [1 / s.left for s in sums], color=color)
    where.set(xlabel="share of the nearer surface", ylabel="range (m)", ylim=(0, turn_mm / 1000))
    noise.set(xlabel="share of the nearer surface", ylabel="sigma over that of one surface", yscale="log")
    noise.set_yticks([1, 2, 3, 4], labels=["1", "2", "3", "4"])
    noise.minorticks_off()
    where.legend(fontsize=8.5)
    return figure


def one_column(weight: str, probability: float) -> Model:
    """Pixels of the paper's camera, all with the three boards in Table II's proportions, as a model for `simulate`."""
    pixel = math.radians(47.0 / 176)
    near, middle, _ = (share / sum(SHARES) * pixel for share in SHARES)
    near_ends, middle_begins = BOARDS_MM[0] * math.tan(near - pixel / 2), BOARDS_MM[1] * math.tan(pixel / 2 - middle)
    spans = (-2000.0, near_ends), (middle_begins, 2000.0), (-2000.0, 2000.0)
    boards = []
    for (left, right), z in zip(spans, BOARDS_MM, strict=True):
        reflectivity = REFLECTIVITY[weight] * z**2 or 0.8
        boards.append(f"""[[surface]]
center_mm = [{(left + right) / 2}, 0.0, {z}]
size_mm = [{right - left}, 2000.0]
reflectivity = {reflectivity}
""")
    text = f"""[sensor]
profile = "sr3000"
rows = {ROWS}
cols = 1
fov_horizontal_deg = {47.0 / 176}
fov_vertical_deg = 0.01
integration_time_ms = {TAU_MS}
outlier_probability = 0.0
{"".join(boards)}
[[effect]]
kind = "flying_pixels"
probability = {probability}
"""
    return parse_model(text, source="model_figures")


def recorded(model: Model) -> Float32Array:
    """Samples (frame, row, col) in mm."""
    block = next(render_blocks(model, cast_scene(model), n_frames=FRAMES, seed=SEED, block_frames=FRAMES))
    return block.range_mm.astype(np.float32)


def between() -> Figure:
    """Histograms of simulated samples: equation (1), the phasor sum, and some of each."""
    figure = _figure(3.0)
    panels = figure.subplots(1, len(PROBABILITIES), sharex=True, sharey=True)
    for axes, probability in zip(panels, PROBABILITIES, strict=True):
        _style(axes, f"probability {probability:g}")
        samples = recorded(one_column("area and 1 / r²", probability)).ravel() / 1000
        axes.hist(samples, bins=np.arange(1.8, 6.0, 0.05), density=True, color=LIGHT.ink, alpha=0.35)
        for r, color in zip(BOARDS_MM, LIGHT.layers, strict=True):
            axes.axvline(r / 1000, color=color, linestyle="--", linewidth=1.2)
        axes.set(xlabel="range (m)", xlim=(1.8, 6.0))
    panels[0].set_ylabel("density (1/m)")
    return figure


FIGURES = {"between": between, "rivals": rivals, "dials": dials, "two_surfaces": two_surfaces}


def numbers() -> list[str]:
    """Write where the phasor sum of the paper's three boards lies."""
    turn_mm, noise = camera()
    lines = [
        f"boards at {', '.join(f'{r:g}' for r in BOARDS_MM)} mm, shares of Table II, d_u = {turn_mm:.0f} mm\n",
        "| weighted by | range of the sum (mm) | amplitude left | sigma of one surface there (mm) | of the sum (mm) |",
        "|---|---|---|---|---|",
    ]
    for name, power in WEIGHTS.items():
        at = phasor_sum(BOARDS_MM, SHARES, turn_mm, power)
        sigma = float(noise.sigma(at.range_mm))
        lines.append(f"| {name} | {at.range_mm:.0f} | {at.left:.2f} | {sigma:.0f} | {sigma / at.left:.0f} |")
    return lines


def simulated() -> list[str]:
    """Write where `simulate` puts the phasor sum, and what `estimate` makes of either model."""
    lines = [
        f"\nsimulated, {ROWS} pixels of {FRAMES} samples\n",
        "| weighted by | probability | mean (mm) | spread (mm) | pixels with 1, 2, 3 layers | median ranges (mm) |",
        "|---|---|---|---|---|---|",
    ]
    for weight in WEIGHTS:
        for probability in PROBABILITIES:
            model = one_column(weight, probability)
            samples = recorded(model)
            layers = estimate_layers(ArrayRecording(samples, recording_sensor(model)))
            counts = ", ".join(str(int((layers.n_modes == k).sum())) for k in (1, 2, 3))
            row = f"| {weight} | {probability:g} | {samples.mean():.0f} | {samples.std():.0f} | {counts} |"
            lines.append(f"{row} {_medians(layers)} |")
    return lines


def _medians(layers: Layers) -> str:
    """Median range of each layer, over the pixels with the most frequent count."""
    count = int(np.bincount(layers.n_modes.ravel()).argmax())
    ranges = layers.range[layers.n_modes == count][:, :count]
    return ", ".join(f"{value:.0f}" for value in np.median(ranges, axis=0))


def main() -> None:
    """Draw every figure into a folder and print the numbers."""
    parser = argparse.ArgumentParser(description="Draw the figures of docs/explanation/model.md and print its numbers.")
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "images", help="folder to write to")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    with drawing(LIGHT):
        for name, draw in FIGURES.items():
            draw().savefig(folder / f"model_{name}.png", metadata={"Software": None})
    sys.stdout.write("\n".join([*numbers(), *simulated(), ""]))


if __name__ == "__main__":
    main()
