"""Draw the picture of surfaces: a corner as averages, as layers of whole pixels, and with edges below a pixel.

Run ``python docs/figures/surfaces_figures.py``. It writes ``docs/images/surfaces.png``: the built-in model
``three-boards`` with two boards turned, 100 samples a pixel, layers and surfaces with all defaults.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from tofmix.arrays import FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.io.model_file import load_model
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.render import recording_sensor, render_blocks
from tofmix.surfaces.found import WindowSurfaces
from tofmix.surfaces.reconstruct import reconstruct

MODEL, SEED, SAMPLES = "three-boards", 1, 100
TURNS_DEG = ((42.0, 34.0), (-42.0, 28.0), (4.0, 0.0))
"""Yaw and pitch of the boards here, near to far: their edges cross the grid of pixels."""
ROWS, COLS = (94, 120), (72, 110)
"""The corners that are shown, pixels."""
_SIZE_INCH, _DPI = (9.8, 2.9), 180.0
_EDGE = "#d55e00"


def make() -> tuple[FloatArray, Layers, WindowSurfaces]:
    """Means of the samples (row, col), mm; the layers of the window; its surfaces."""
    model = tilted(load_model(MODEL))
    blocks = render_blocks(model, cast_scene(model), n_frames=SAMPLES, seed=SEED)
    samples = np.concatenate([block.range_mm for block in blocks])
    sensor = recording_sensor(model)
    found = estimate_layers(ArrayRecording(samples, sensor), workers=2)
    layers = Layers(**{spec.name: getattr(found, spec.name)[0] for spec in found.fields})
    return samples.mean(axis=0, dtype=np.float64), layers, reconstruct(layers, sensor)


def tilted(model: Model) -> Model:
    """The model with its boards turned."""
    boards = (replace(one, yaw_deg=yaw, pitch_deg=pitch)
              for one, (yaw, pitch) in zip(model.surfaces, TURNS_DEG, strict=True))  # fmt: skip
    return replace(model, surfaces=tuple(boards))


def draw(averaged: FloatArray, layers: Layers, found: WindowSurfaces) -> Figure:
    """Draw three panels."""
    figure = Figure(figsize=_SIZE_INCH, dpi=_DPI, layout=ConstrainedLayoutEngine(w_pad=0.06), facecolor="white")
    near, far = np.nanpercentile(layers.range[ROWS[0] : ROWS[1], COLS[0] : COLS[1], 0], (1, 99))
    options = {"cmap": "viridis", "vmin": near / 1000, "vmax": far / 1000, "interpolation": "nearest"}
    rows, cols = layers.shape
    whole = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    panels: tuple[tuple[str, FloatArray], ...] = (
        ("averaged by the camera", averaged),
        ("nearest layer of each pixel", layers.range[..., 0].astype(np.float64)),
        ("tofmix surfaces", found.range_fine.astype(np.float64)),
    )
    for axes, (title, image) in zip(figure.subplots(1, 3, sharex=True, sharey=True), panels, strict=True):
        drawn = axes.imshow(image / 1000.0, extent=whole, **options)
        axes.set_title(title, loc="left", fontweight="bold", fontsize=10.5)
        axes.set(xlim=(COLS[0] - 0.5, COLS[1] - 0.5), ylim=(ROWS[1] - 0.5, ROWS[0] - 0.5), xlabel="column")
    for line in found.edges.lines():
        axes.plot(found.edges.col[line], found.edges.row[line], color=_EDGE, linewidth=1.2)
    figure.axes[0].set_ylabel("row")
    figure.colorbar(drawn, ax=figure.axes, label="range (m)", shrink=0.85)
    return figure


def main() -> None:
    """Draw the picture into a folder."""
    parser = argparse.ArgumentParser(description="Draw the picture of docs/explanation/surfaces.md.")
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "images", help="folder to write to")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    with style.context("default"):
        draw(*make()).savefig(folder / "surfaces.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
