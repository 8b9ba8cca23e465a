"""Draw the picture of round things: a person and a pole before a wall, from above.

Run ``python docs/figures/round_figures.py``. It writes ``docs/images/person_and_pole.png``:
the averages of 100 samples of a lock-in camera, and the same samples unmixed. The scene,
its samples and its truth are of ``tests/support/round_things.py``, which computes them
without the package. The same versions of tofmix and Matplotlib give the same bytes.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import NDArray
from pictures import BLUE, GRID, INK, SETTINGS, SKY, VERMILLION

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from support.round_things import Scene, Thing, capsule, cylinder, joined, rays_of, render, sphere, wall

import tofmix as tm
from tofmix.flags import Mixing

WALL_MM = 3000.0
BODY_MM, BODY_RADIUS_MM = (-300.0, 1900.0), 190.0
POLE_MM, POLE_RADIUS_MM = (380.0, 1750.0), 90.0
ROLL_DEG = 4.0
"""The camera is rolled about its axis, so that edges cross the columns of pixels and every share occurs."""

HEIGHT_MM = (-100.0, 700.0)
"""Heights that are drawn, y down: every section of the person is one circle there."""

NOISE_MM, SAMPLES = 20.0, 100
WHOLE = 0.999
"""A pixel with a smaller largest share is mixed."""

NOWHERE_MM = 60.0
"""A point farther than this from every surface in its pixel stands where there is none."""

_VIEW_X_M, _VIEW_Z_M = (-1.1, 1.1), (1.35, 3.2)
_SIZE_INCH, _DPI, _LARGEST_AREA, _ALPHA = (8.4, 3.9), 190.0, 38.0, 0.5

Values = NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Points within `HEIGHT_MM`, from above.

    x and z, m; share of the beam; whether the pixel is mixed, and whether no surface is near the point: all (point,).
    """

    x: Values
    z: Values
    share: Values
    mixed: Values
    nowhere: Values


def scene() -> Scene:
    """Record the person and the pole."""
    x, z = BODY_MM
    person = joined(capsule(x, z, BODY_RADIUS_MM, -250.0, 900.0), sphere((x, -540.0, z), 120.0))
    things = [wall(WALL_MM), person, cylinder(*POLE_MM, POLE_RADIUS_MM)]
    return render([_rolled(thing) for thing in things], [0.5, 0.7, 0.8], noise_mm=NOISE_MM, frames=SAMPLES)


def _roll() -> Values:
    angle = np.radians(ROLL_DEG)
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def _rolled(thing: Thing) -> Thing:
    """A thing as a rolled camera sees it."""
    return lambda rays: thing(rays @ _roll())


def points(range_mm: Values, share: Values, truth: Scene) -> Points:
    """Place ranges (row, col, layer) along the beams, NaN where there is none."""
    place = (rays_of(1) @ _roll())[:, :, np.newaxis] * range_mm[..., np.newaxis] / 1000.0
    away = np.abs(range_mm[..., np.newaxis] - np.moveaxis(truth.range_mm, 0, -1)[:, :, np.newaxis])
    nowhere = np.nanmin(np.where(np.isnan(away), np.inf, away), axis=-1) > NOWHERE_MM
    mixed = np.broadcast_to(truth.share.max(axis=0)[..., np.newaxis] < WHOLE, range_mm.shape)
    low, high = np.array(HEIGHT_MM) / 1000.0
    shown = (place[..., 1] > low) & (place[..., 1] < high)
    return Points(x=place[shown, 0], z=place[shown, 2], share=share[shown], mixed=mixed[shown], nowhere=nowhere[shown])


def draw(truth: Scene) -> Figure:
    """Draw the averages beside the layers."""
    recording = truth.recording
    light = np.asarray(recording.amplitude, dtype=np.float64)
    scale_mm = 299_792_458e3 / (4.0 * np.pi * float(recording.sensor.modulation_frequency_hz or 0.0))
    mean = (light * np.exp(1j * recording.range_mm.astype(np.float64) / scale_mm)).mean(axis=0)
    averaged_mm = (scale_mm * np.angle(mean) % (2.0 * np.pi * scale_mm))[..., np.newaxis]
    layers = tm.estimate(recording).window(0)
    mixing = layers.mixing
    if mixing is None:
        raise ValueError("the recording has no phasors")
    undecided = mixing == int(Mixing.UNDECIDED)
    layers_mm = np.where(undecided[..., np.newaxis], np.nan, layers.range.astype(np.float64))
    before = points(averaged_mm, np.ones_like(averaged_mm), truth)
    after = points(layers_mm, layers.weight.astype(np.float64), truth)

    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
    figure = Figure(figsize=_SIZE_INCH, dpi=_DPI, layout=layout, facecolor="white")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    _panel(left, "averaged", f"{SAMPLES} samples of a lock-in camera")
    _panel(right, "unmixed by tofmix", "the same samples")
    left.set_ylabel("z, away from the camera (m)")
    _draw_averages(left, before)
    _draw_layers(right, after, int(undecided.sum()))
    return figure


def _panel(axes: Axes, title: str, light: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_title(light, loc="right", fontsize=9.5)
    axes.set(xlim=_VIEW_X_M, ylim=_VIEW_Z_M, xlabel="x, to the right (m)")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for centre, radius in ((BODY_MM, BODY_RADIUS_MM), (POLE_MM, POLE_RADIUS_MM)):
        place = (centre[0] / 1000.0, centre[1] / 1000.0)
        axes.add_patch(Circle(place, radius / 1000.0, fill=False, edgecolor=INK, linewidth=0.8, zorder=2.5))
    axes.axhline(WALL_MM / 1000.0, color=INK, linewidth=0.8, zorder=2.5)


def _draw_averages(axes: Axes, seen: Points) -> None:
    at = ~seen.nowhere
    axes.scatter(seen.x[at], seen.z[at], s=2.5, color=SKY, linewidths=0, zorder=2)
    axes.scatter(seen.x[~at], seen.z[~at], s=11, color=VERMILLION, linewidths=0, zorder=3)
    text = f"{int(seen.nowhere.sum())} points\nwhere nothing\nstands"
    axes.text(0.14, 2.72, text, color=VERMILLION, va="center", ha="center", fontsize=9.0)
    for text, (x, z), radius in (("person", BODY_MM, BODY_RADIUS_MM), ("pole", POLE_MM, POLE_RADIUS_MM)):
        axes.text(x / 1000.0, (z - radius) / 1000.0 - 0.03, text, va="top", ha="center", fontsize=9.0)
    axes.text(0.0, WALL_MM / 1000.0 + 0.04, "wall", va="bottom", ha="center", fontsize=9.0)


def _draw_layers(axes: Axes, seen: Points, undecided: int) -> None:
    mixed = seen.mixed
    axes.scatter(seen.x[~mixed], seen.z[~mixed], s=2.5, color=SKY, linewidths=0, zorder=2)
    area = _LARGEST_AREA * seen.share[mixed]
    axes.scatter(seen.x[mixed], seen.z[mixed], s=area, color=BLUE, alpha=_ALPHA, linewidths=0, zorder=3)
    text = f"{int(seen.nowhere.sum())} points where\nnothing stands"
    text += f",\n{undecided} pixel{'s' * (undecided > 1)} of the image undecided" if undecided else ""
    axes.text(0.02, 2.5, text, color=BLUE, va="center", ha="center")
    handles = [
        Line2D([], [], linestyle="", marker="o", color=BLUE, alpha=_ALPHA, markeredgewidth=0,
               markersize=(_LARGEST_AREA * value) ** 0.5, label=f"{value:g}")
        for value in (0.1, 0.5, 0.9)
    ]  # fmt: skip
    axes.legend(
        handles=handles, title="share of the beam", loc="lower left", ncols=3, handletextpad=0.0, columnspacing=0.6,
        alignment="left", fontsize=9.0,
    )  # fmt: skip


def main() -> None:
    """Draw the picture into a folder."""
    parser = argparse.ArgumentParser(description="Draw the picture of a person and a pole.")
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "images", help="folder to write to")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    with style.context(["default", SETTINGS]):
        draw(scene()).savefig(folder / "person_and_pole.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
