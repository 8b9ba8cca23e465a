"""Draw the figures of docs/explanation/mapping.md and print what its text says of them.

Run ``python docs/figures/mapping_figures.py``: the corridor of ``docs/figures/side_exit.toml``,
once with its exit open and once with a door in it, mapped from layers, from
averages and from thin beams with the defaults of ``tofmix map``. The same versions
of tofmix and Matplotlib give the same bytes.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from math import cos, radians, sin
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.io.model_file import load_model
from tofmix.mapping.beams import Beams, beams_from_layers, beams_from_ranges
from tofmix.mapping.grid import Pose, plan_grid
from tofmix.mapping.occupancy import FREE_THRESH, OCCUPIED_THRESH, FloorMap, VoxelMap, map_beams, project
from tofmix.recording import ArrayRecording
from tofmix.report.averaging import average_samples
from tofmix.report.theme import LIGHT, drawing
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.render import recording_sensor, render_blocks
from tofmix.simulation.surface import Surface

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from support.corridors import ROBOT_RADIUS_MM, Corridor, find_way

FOLDER = Path(__file__).parent
MODEL, SEED, FRAMES, CELL_MM = "side_exit.toml", 1, 100, 50.0
OPENING_MM, DOOR_MM = (3200.0, 4150.0), (950.0, 2000.0)
SOURCES = {"layers": "layers", "averaged": "averaged", "thin-beam": "thin beam"}

_MAP = ListedColormap(["#ffffff", "#d0d5da", "#1f2328"])  # free, unknown, occupied
_WAY, _TRUTH = "#0072b2", "#d55e00"
_VIEW_X_M, _VIEW_Y_M = (-0.35, 6.3), (2.6, -1.35)
_FLAT = ("floor", "ceiling")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A corridor, its truth, and its voxels and floor maps by source."""

    corridor: Corridor
    truth: Truth
    voxels: dict[str, VoxelMap]
    maps: dict[str, FloorMap]


def corridor(*, closed: bool) -> Corridor:
    """The corridor of the model file; with a door in its opening where `closed`."""
    model, pitch = load_model(str(FOLDER / MODEL)), 7.0
    if closed:
        c, s = cos(radians(pitch)), sin(radians(pitch))
        x, y, z = -1000.0, 700.0 - DOOR_MM[1] / 2, sum(OPENING_MM) / 2
        door = Surface(
            name="door", center_mm=(x, c * y - s * z, s * y + c * z), size_mm=DOOR_MM, yaw_deg=90.0, pitch_deg=pitch
        )
        model = replace(model, surfaces=(*model.surfaces, door))
    return Corridor(
        model=model, pitch_deg=pitch, camera_mm=700.0, width_mm=2000.0, side=-1, opening_mm=OPENING_MM, end_mm=6000.0,
        blocked_by="door" if closed else "",
    )  # fmt: skip


def make_scene(*, closed: bool) -> Scene:
    """Simulate the corridor and map it from every source."""
    place = corridor(closed=closed)
    truth = cast_scene(place.model)
    pose = Pose(pitch_deg=place.pitch_deg)
    voxels = {}
    for name, beams in _beams(place, truth).items():
        grid = plan_grid(beams, pose, cell_mm=CELL_MM, height_mm=place.height_mm)
        voxels[name] = map_beams(beams, pose, grid)
    maps = {name: project(each, place.height_mm) for name, each in voxels.items()}
    return Scene(corridor=place, truth=truth, voxels=voxels, maps=maps)


def _beams(place: Corridor, truth: Truth) -> dict[str, Beams]:
    blocks = list(render_blocks(place.model, truth, n_frames=FRAMES, seed=SEED))
    sensor = recording_sensor(place.model)
    samples = ArrayRecording(
        np.concatenate([block.range_mm for block in blocks]).astype(np.float64),
        sensor,
        np.concatenate([block.amplitude for block in blocks]),
    )
    mean = average_samples(samples, start=0, stop=FRAMES).range_mm
    layers = estimate_layers(samples)
    thin = estimate_layers(samples, EstimateOptions(max_layers=1, sigma=SigmaMode.TIED))
    return {
        "layers": beams_from_layers(layers.reshaped(mean.shape), sensor),
        "averaged": beams_from_ranges(mean, np.full(mean.shape, FRAMES), sensor),
        "thin-beam": beams_from_layers(thin.reshaped(mean.shape), sensor),
    }


def exit_maps(scenes: tuple[Scene, Scene]) -> Figure:
    """The maps of the open and of the closed exit, a row each, with the robot's way."""
    figure = Figure(figsize=(7.0, 7.4), layout=ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06))
    panels = figure.subplots(2, len(SOURCES), sharex=True, sharey=True)
    for row, scene, what in zip(panels, scenes, ("exit open", "exit closed by a door"), strict=True):
        for axes, (name, title) in zip(row, SOURCES.items(), strict=True):
            way = find_way(scene.maps[name], scene.corridor)
            _draw_map(axes, scene, name, way)
            axes.set_title(f"{title}: {'a way' if way else 'no way'}", loc="left", fontweight="bold")
        row[0].set_ylabel(f"{what}\nx, ahead (m)")
    for axes in panels[-1]:
        axes.set_xlabel("y, to the left (m)")
    figure.legend(handles=_legend(), loc="outside lower center", ncols=5)
    return figure


def _draw_map(axes: Axes, scene: Scene, name: str, way: list[tuple[int, int]]) -> None:
    map_ = scene.maps[name]
    edges = [(map_.origin_mm[axis] + np.arange(n + 1) * map_.cell_mm) / 1000 for axis, n in enumerate(map_.cells.shape)]
    axes.set_facecolor(_MAP(1))
    axes.pcolormesh(edges[1], edges[0], map_.cells, cmap=_MAP, vmin=0, vmax=2, rasterized=True)
    turn = Pose(pitch_deg=scene.corridor.pitch_deg).rotation()
    for surface in scene.corridor.model.surfaces:
        if not surface.name.startswith(_FLAT):
            along = surface.rotation()[:, 0] * surface.size_mm[0] / 2
            x, y, _ = (turn @ (np.array(surface.center_mm) + np.outer([-1, 1], along)).T) / 1000
            axes.plot(y, x, color=_TRUTH, linewidth=0.9)
    if way:
        x, y = (map_.centres_mm(axis)[[cell[axis] for cell in way]] / 1000 for axis in (0, 1))
        axes.plot(y, x, color=_WAY, linewidth=2.0)
        angle = np.linspace(0, 2 * np.pi, 60)
        axes.plot(
            y[-1] + ROBOT_RADIUS_MM / 1000 * np.cos(angle), x[-1] + ROBOT_RADIUS_MM / 1000 * np.sin(angle), color=_WAY
        )
    goal_x, goal_y = scene.corridor.goal_mm
    axes.plot(goal_y / 1000, goal_x / 1000, "x", color=_WAY, markersize=8, markeredgewidth=2)
    axes.set(xlim=_VIEW_Y_M, ylim=_VIEW_X_M)
    axes.set_aspect("equal")


def _legend() -> list[Patch | Line2D]:
    grounds = [
        Patch(facecolor=_MAP(k), edgecolor="#8c959f", label=label)
        for k, label in enumerate(("free", "unknown", "occupied"))
    ]
    return [
        *grounds, Line2D([], [], color=_TRUTH, label="true walls"), Line2D([], [], color=_WAY, label="the robot's way"),
    ]  # fmt: skip


def edge_pixel(scene: Scene) -> tuple[int, int]:
    """The pixel of the camera's own height whose beam the corner and the passage's far side share most equally."""
    rows, cols, _ = scene.truth.weight_true.shape
    height = np.radians(39.0 / rows)
    row = round((rows - 1) / 2 - np.radians(scene.corridor.pitch_deg) / height)
    shares = np.nan_to_num(scene.truth.weight_true[row])
    ranges = np.nan_to_num(scene.truth.range_true[row])
    two = (scene.truth.n_modes[row] == 2) & (ranges[:, 0] > OPENING_MM[0]) & (np.arange(cols) < cols / 2)  # noqa: PLR2004
    return row, int(np.argmax(np.where(two, np.minimum(shares[:, 0], shares[:, 1]), -1)))


def along_a_beam(scene: Scene) -> Figure:
    """How probably the cells along one beam are occupied, by source."""
    row, col = edge_pixel(scene)
    rows, cols, _ = scene.truth.weight_true.shape
    az, el = np.radians((col - (cols - 1) / 2) * 47.0 / cols), np.radians((row - (rows - 1) / 2) * 39.0 / rows)
    ray = Pose(pitch_deg=scene.corridor.pitch_deg).rotation() @ [sin(az) * cos(el), sin(el), cos(az) * cos(el)]
    figure = Figure(figsize=(7.2, 3.4), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06))
    axes = figure.subplots()
    axes.set_title(f"along the beam of pixel ({row}, {col})", loc="left", fontweight="bold")
    range_mm = np.arange(700.0, 5600.0, 5.0)
    for name, colour, line in (("averaged", LIGHT.accent, "--"), ("layers", LIGHT.layers[0], "-")):
        voxels = scene.voxels[name]
        cell = np.floor((range_mm[:, None] * ray - voxels.grid.origin_mm) / CELL_MM).astype(int)
        inside = ((cell >= 0) & (cell < voxels.grid.shape)).all(axis=1)
        p = np.where(inside, voxels.probability()[tuple(np.clip(cell, 0, np.array(voxels.grid.shape) - 1).T)], 0.5)
        axes.plot(range_mm / 1000, p, line, color=colour, linewidth=1.8, label=SOURCES[name])
    truth = scene.truth
    for k in range(int(truth.n_modes[row, col])):
        place, share = truth.range_true[row, col, k] / 1000, truth.weight_true[row, col, k]
        axes.axvline(place, color=LIGHT.ink, linewidth=0.9, linestyle=":")
        axes.annotate(f"surface, share {share:.2f}", (place, 1.08), (4, 0), textcoords="offset points", fontsize=9)
    for threshold in (FREE_THRESH, OCCUPIED_THRESH):
        axes.axhline(threshold, color=LIGHT.grid, linewidth=1.2, zorder=0)
    axes.set(xlabel="range (m)", ylabel="probability of being occupied", ylim=(-0.03, 1.18), xlim=(0.7, 5.6))
    axes.legend(loc="center left")
    return figure


def main() -> None:
    """Draw into docs/images, or elsewhere with --output."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=FOLDER.parent / "images", help="folder for the pictures")
    folder = parser.parse_args().output
    scenes = make_scene(closed=False), make_scene(closed=True)
    with drawing(LIGHT):
        for name, figure in (("mapping_exit", exit_maps(scenes)), ("mapping_beam", along_a_beam(scenes[0]))):
            figure.savefig(folder / f"{name}.png", metadata={"Software": None})
            print(f"{folder / name}.png")  # noqa: T201  where the picture is
    for scene, what in zip(scenes, ("open", "closed"), strict=True):
        for name in SOURCES:
            found = "a way" if find_way(scene.maps[name], scene.corridor) else "no way"
            print(f"exit {what}, {name}: {found}")  # noqa: T201  what the page says


if __name__ == "__main__":
    main()
