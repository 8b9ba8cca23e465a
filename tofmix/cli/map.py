"""``tofmix map``: layers in, occupancy grids out."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import (
    PATH,
    default_workers,
    examples,
    json_option,
    overwrite_option,
    suspect_option,
)
from tofmix.cli.reporter import CommandReporter
from tofmix.wording import left_out_words

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tofmix.mapping.occupancy import FloorMap, VoxelMap


class _Numbers(click.ParamType):  # type: ignore[type-arg]  # generic in new versions of click alone
    """Numbers with commas between them."""

    name = "numbers"

    def __init__(self, names: str) -> None:
        self.names = names

    def convert(
        self, value: str | tuple[float, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        parts = value.split(",")
        try:
            numbers = tuple(float(part) for part in parts)
        except ValueError:
            numbers = ()
        if len(numbers) != len(self.names.split(",")):
            self.fail(f"{value!r} is not {self.names}", param, ctx)
        return numbers


@examples(
    """
tofmix map boards.layers.h5 -o boards.yaml
tofmix map boards.layers.h5 -o boards.yaml --height -600,300 --pitch 7 --cell 40
tofmix map boards.layers.h5 --voxels boards.ply
tofmix map boards.layers.h5 -o averaged.yaml --from averaged --recording boards.h5
"""
)
@click.command("map", short_help="Write an occupancy map of the layers.")
@click.argument("layers", type=PATH)
@click.option("-o", "--output", type=PATH, help="2-D map to write, .yaml; its image gets the same name with .pgm.")
@click.option("--voxels", type=PATH, help="3-D map to write: occupied voxels as .ply, or the whole grid as .npz.")
@click.option(
    "--from",
    type=click.Choice(["layers", "averaged", "thin-beam"]),
    default="layers",
    show_default=True,
    help="Ranges to map. layers: all surfaces. For comparison: averaged (mean of the samples), thin-beam (one fitted"
    " surface).",
)
@click.option("--recording", type=PATH, help="The samples, for --from averaged and thin-beam.")
@click.option("--window", type=click.IntRange(0), default=0, show_default=True, help="Window to map.")
@click.option(
    "--cell", type=click.FloatRange(1.0, 10_000.0), default=50.0, show_default=True, help="Edge of a cell, mm."
)
@click.option(
    "--height",
    type=_Numbers("A,B"),
    metavar="A,B",
    default="-250,250",
    show_default=True,
    help="Heights in the 2-D map, mm above the camera; rounded outward to whole cells.",
)
@click.option(
    "--pose",
    type=_Numbers("X,Y,YAW"),
    metavar="X,Y,YAW",
    default="0,0,0",
    show_default=True,
    help="Pose of the camera in the map: mm, mm, and degrees anticlockwise from x.",
)
@click.option(
    "--pitch",
    type=click.FloatRange(-89.0, 89.0),
    default=0.0,
    show_default=True,
    help="Downward pitch of the camera, degrees.",
)
@click.option(
    "--min-share",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.05,
    show_default=True,
    help="Smallest share of light that an obstacle blocks; a cell that blocks less is free.",
)
@click.option(
    "--min-probability",
    type=click.FloatRange(0, 1),
    default=0.9999,
    show_default=True,
    help="Layers with a smaller probability are ignored.",
)
@suspect_option
@click.option(
    "--workers", type=click.IntRange(1), help="Threads; their number changes no result.  [default: all cores]"
)
@json_option
@overwrite_option
def map_(
    layers: Path,
    output: Path | None,
    voxels: Path | None,
    recording: Path | None,
    window: int,
    cell: float,
    height: tuple[float, float],
    pose: tuple[float, float, float],
    pitch: float,
    min_share: float,
    min_probability: float,
    suspect: bool,
    workers: int | None,
    as_json: bool,
    overwrite: bool,
    **choices: str,
) -> None:
    """Write an occupancy map of LAYERS, a file that tofmix estimate wrote.

    Every layer is a hit with its share of the light. Space in front of it is free; space behind it counts as free in
    proportion to the light that passes. The 2-D map is for ROS's map_server. A 2-D cell is occupied if any voxel of its
    column, within --height, is occupied. The camera is at height 0; with yaw 0, x is ahead of it and y to its left.
    """
    from tofmix.jobs.map import MapRequest, write_map

    asked = MapRequest(
        layers=layers,
        output=output,
        voxels=voxels,
        source=choices["from"],
        recording=recording,
        window=window,
        cell_mm=cell,
        height_mm=height,
        pose=pose,
        pitch_deg=pitch,
        min_share=min_share,
        min_probability=min_probability,
        suspect=suspect,
        workers=workers or default_workers(),
        overwrite=overwrite,
    )
    floor, space, left_out = write_map(asked, CommandReporter())
    _say(output, floor, voxels, space, left_out, as_json)


def _say(
    output: Path | None, floor: "FloorMap | None", voxels: Path | None, space: "VoxelMap", left_out: int, as_json: bool
) -> None:
    """Print the name of a written map and its number of cells in each state."""
    from tofmix.mapping.occupancy import State

    parts: dict[str, tuple[Path, NDArray[np.uint8]]] = {}
    if output is not None and floor is not None:
        parts["map"] = (output, floor.cells)
    if voxels is not None:
        parts["voxels"] = (voxels, space.states())
    said: dict[str, dict[str, Any]] = {}
    for name, (path, states) in parts.items():
        counts = {state.name.lower(): int((states == int(state)).sum()) for state in reversed(State)}
        said[name] = {"path": str(path), "cell_mm": space.grid.cell_mm, "shape": list(states.shape)} | counts
        if left_out:
            said[name]["suspect_left_out"] = left_out
        if not as_json:
            size = " x ".join(str(n) for n in states.shape)
            text = ", ".join(f"{state} {count:,}" for state, count in counts.items())
            click.echo(f"{path}: {size} cells of {space.grid.cell_mm:g} mm; {text}{left_out_words(left_out)}")
    if as_json:
        click.echo(json.dumps(said, indent=2))
