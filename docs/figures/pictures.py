"""Draw the README's pictures: what a camera returns beside what tofmix recovers.

Run ``python docs/figures/pictures.py``. All panels show the built-in model ``three-boards``
from above. ``comet_tail.png``: 12 averaged frames of 10 ms beside 100 samples of
1.2 ms of one surface each, the same light. ``unmixed.png``: 100 samples of a lock-in
camera, each the phasor sum of all surfaces in the pixel, and the same samples unmixed.
The same versions of tofmix and Matplotlib give the same bytes.

``docs/images/report_page.png`` is not made here: it is a screenshot of the page
that ``tofmix report`` writes, see docs/developers.md.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from tofmix.arrays import BoolArray, FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.flags import Mixing
from tofmix.io.model_file import load_model
from tofmix.optics.projection import beam_directions_of
from tofmix.recording import ArrayRecording
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects.flying_pixels import FlyingPixels
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.render import recording_sensor, render_blocks

MODEL = "three-boards"
SEED = 1
AVERAGED_FRAMES = 12
SAMPLES = 100
ROWS = slice(60, 85)
"""Rows around the middle one: few enough that the pitched boards stay thin from above."""

FAR_SIGMAS = 3.0
"""A point farther than this from every surface of its pixel stands where there is none."""

_VIEW_X_M, _VIEW_Z_M = (-1.85, 1.85), (2.1, 5.35)
INK, GRID = "#1f2328", "#e3e7eb"
SKY, BLUE, VERMILLION = "#56b4e9", "#0072b2", "#d55e00"  # Okabe and Ito
SETTINGS = {
    "font.size": 10.0,
    "axes.titlesize": 11.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
}
_SIZE_INCH, _DPI = (8.4, 4.1), 190.0
_LARGEST_AREA, _ALPHA = 38.0, 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """What the panels show, of the rows `ROWS`.

    averaged_mm (row, col); layers_mm and weight (row, col, layer), NaN where there is no layer; mixed (row, col),
    whether a beam meets several surfaces, or a surface and open space; nowhere_averaged (row, col) and
    nowhere_layers (row, col, layer), whether a point of these pixels lies on none of their surfaces;
    undecided, pixels whose layers are left out because their surfaces cannot be told.
    """

    model: Model
    averaged_mm: FloatArray
    layers_mm: FloatArray
    weight: FloatArray
    mixed: BoolArray
    nowhere_averaged: BoolArray
    nowhere_layers: BoolArray
    undecided: int = 0


def make_scene() -> Scene:
    """Simulate the model in both ways and estimate its layers."""
    model = load_model(MODEL)
    truth = cast_scene(model)
    averaged = _frames(model, truth, AVERAGED_FRAMES, averaged=True)[:, ROWS].mean(axis=0)
    samples = _frames(model, truth, SAMPLES, averaged=False)[:, ROWS]
    layers = estimate_layers(ArrayRecording(samples, recording_sensor(model)))
    layers_mm = layers.range[0].astype(np.float64)
    mixed = truth.n_modes[ROWS] + (truth.weight_no_return[ROWS] > 0) > 1
    return Scene(
        model=model,
        averaged_mm=averaged,
        layers_mm=layers_mm,
        weight=layers.weight[0].astype(np.float64),
        mixed=mixed,
        nowhere_averaged=mixed & _nowhere(averaged[..., np.newaxis], model, truth)[..., 0],
        nowhere_layers=mixed[..., np.newaxis] & _nowhere(layers_mm, model, truth),
    )


def make_sums() -> Scene:
    """Simulate the model with phasor sums, and unmix them; `averaged_mm` is the median of a pixel's samples."""
    model = load_model(MODEL)
    truth = cast_scene(model)
    sums = replace(model, effects=(FlyingPixels(probability=1.0),))
    blocks = list(render_blocks(sums, truth, n_frames=SAMPLES, seed=SEED))
    recording = ArrayRecording(
        np.concatenate([block.range_mm for block in blocks]), recording_sensor(sums),
        np.concatenate([block.amplitude for block in blocks]),
    )  # fmt: skip
    layers = estimate_layers(recording, workers=2)
    middle = np.median(recording.read_range(slice(None), ROWS), axis=0).astype(np.float64)
    if layers.mixing is None:
        raise ValueError("the recording has no phasors")
    undecided = layers.mixing[0, ROWS] == int(Mixing.UNDECIDED)
    layers_mm = np.where(undecided[..., np.newaxis], np.nan, layers.range[0, ROWS].astype(np.float64))
    mixed = truth.n_modes[ROWS] + (truth.weight_no_return[ROWS] > 0) > 1
    return Scene(
        model=model, undecided=int(undecided.sum()), averaged_mm=middle, layers_mm=layers_mm,
        weight=layers.weight[0, ROWS].astype(np.float64), mixed=mixed,
        nowhere_averaged=mixed & _nowhere(middle[..., np.newaxis], model, truth)[..., 0],
        nowhere_layers=mixed[..., np.newaxis] & _nowhere(layers_mm, model, truth),
    )  # fmt: skip


def _frames(model: Model, truth: Truth, n_frames: int, *, averaged: bool) -> FloatArray:
    blocks = render_blocks(model, truth, n_frames=n_frames, seed=SEED, averaged=averaged)
    return np.concatenate([block.range_mm for block in blocks]).astype(np.float64)


def _nowhere(range_mm: FloatArray, model: Model, truth: Truth) -> BoolArray:
    """Whether ranges (row, col, point) are far from every true surface, in sigmas of one averaged frame."""
    noise = model.sensor.noise_at(model.sensor.default_integration_time_ms)
    surfaces = truth.range_true[ROWS].astype(np.float64)[..., np.newaxis, :]
    far = np.abs(range_mm[..., np.newaxis] - surfaces) > FAR_SIGMAS * noise.sigma(np.nan_to_num(surfaces))
    return np.asarray(np.all(far | np.isnan(surfaces), axis=-1) & np.isfinite(range_mm), dtype=np.bool_)


def comet_tail(scene: Scene) -> Figure:
    """Draw averages and layers."""
    sensor = scene.model.sensor
    frame_ms, sample_ms = sensor.default_integration_time_ms, sensor.integration_time_ms
    return _two_panels(
        scene, ("averaged by the camera", f"{AVERAGED_FRAMES} frames of {frame_ms:g} ms"),
        ("recovered by tofmix", f"{SAMPLES} samples of {sample_ms:g} ms"),
    )  # fmt: skip


def unmixed(scene: Scene) -> Figure:
    """Draw phasor sums, and the surfaces in them."""
    light = f"{SAMPLES} samples of {scene.model.sensor.integration_time_ms:g} ms"
    return _two_panels(scene, ("as the camera returns it", light), ("unmixed by tofmix", "the same samples"))


def _two_panels(scene: Scene, first: tuple[str, str], second: tuple[str, str]) -> Figure:
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
    figure = Figure(figsize=_SIZE_INCH, dpi=_DPI, layout=layout, facecolor="white")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    _panel(left, scene, *first)
    _panel(right, scene, *second)
    left.set_ylabel("z, away from the camera (m)")
    _draw_averaged(left, scene)
    _draw_layers(right, scene)
    return figure


def _panel(axes: Axes, scene: Scene, title: str, light: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_title(light, loc="right", fontsize=9.5)
    axes.set(xlim=_VIEW_X_M, ylim=_VIEW_Z_M, xlabel="x, to the right (m)")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for surface in scene.model.surfaces:
        along = surface.rotation()[:, 0] * surface.size_mm[0] / 2
        ends = np.array([surface.center_mm - along, surface.center_mm + along]) / 1000.0
        axes.plot(ends[:, 0], ends[:, 2], color=INK, linewidth=0.8, zorder=2.5)


def _draw_averaged(axes: Axes, scene: Scene) -> None:
    x, z = _from_above(scene.averaged_mm, scene)
    nowhere = scene.nowhere_averaged
    axes.scatter(x[~nowhere], z[~nowhere], s=2.5, color=SKY, linewidths=0, zorder=2)
    axes.scatter(x[nowhere], z[nowhere], s=11, color=VERMILLION, linewidths=0, zorder=3)
    shown = int((nowhere & _in_view(x, z)).sum())
    axes.annotate(
        f"comet tail:\n{shown} points where\nnothing stands", xy=(0.1, 3.28), xytext=(0.42, 2.8), color=VERMILLION,
        va="center", arrowprops={"arrowstyle": "-", "color": VERMILLION, "linewidth": 0.8, "relpos": (0.0, 1.0)},
    )  # fmt: skip
    axes.text(-0.1, 4.86, "the boards as they are", va="bottom", ha="center", fontsize=9.0)


def _draw_layers(axes: Axes, scene: Scene) -> None:
    x, z = _from_above(scene.layers_mm, scene)
    mixed = np.broadcast_to(scene.mixed[..., np.newaxis], x.shape) & np.isfinite(x)
    axes.scatter(x[~mixed], z[~mixed], s=2.5, color=SKY, linewidths=0, zorder=2)
    share = scene.weight[mixed]
    axes.scatter(x[mixed], z[mixed], s=_LARGEST_AREA * share, color=BLUE, alpha=_ALPHA, linewidths=0, zorder=3)
    shown = int((scene.nowhere_layers & _in_view(x, z)).sum())
    text = f"the same pixels:\n{shown} points where\nnothing stands"
    text += f",\n{scene.undecided} pixels undecided" if scene.undecided else ""
    axes.text(0.42, 2.8, text, color=BLUE, va="center")
    handles = [
        Line2D([], [], linestyle="", marker="o", color=BLUE, alpha=_ALPHA, markeredgewidth=0,
               markersize=(_LARGEST_AREA * value) ** 0.5, label=f"{value:g}")
        for value in (0.1, 0.5, 0.9)
    ]  # fmt: skip
    axes.legend(
        handles=handles, title="share of the beam", loc="center left", bbox_to_anchor=(0.02, 0.62), ncols=3,
        handletextpad=0.0, columnspacing=0.6, alignment="left",
    )  # fmt: skip


def _from_above(range_mm: FloatArray, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Coordinates x and z in m of ranges (row, col) or (row, col, layer) along the pixels' beams."""
    sensor = scene.model.sensor
    sideways, _, forward = np.moveaxis(beam_directions_of(sensor.optics, sensor.shape)[ROWS], -1, 0)
    more = (...,) + (np.newaxis,) * (range_mm.ndim - 2)
    return range_mm * sideways[more] / 1000.0, range_mm * forward[more] / 1000.0


def _in_view(x: FloatArray, z: FloatArray) -> BoolArray:
    inside = (x > _VIEW_X_M[0]) & (x < _VIEW_X_M[1]) & (z > _VIEW_Z_M[0]) & (z < _VIEW_Z_M[1])
    return np.asarray(inside, dtype=np.bool_)


def main() -> None:
    """Draw the picture into a folder."""
    parser = argparse.ArgumentParser(description="Draw the README's picture.")
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "images", help="folder to write to")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    with style.context(["default", SETTINGS]):
        comet_tail(make_scene()).savefig(folder / "comet_tail.png", metadata={"Software": None})
        unmixed(make_sums()).savefig(folder / "unmixed.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
