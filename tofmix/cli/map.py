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
    left_out_words,
    overwrite_option,
    suspect_option,
)
from tofmix.cli.progress import Progress
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.layers import Layers
    from tofmix.mapping.beams import Beams
    from tofmix.mapping.occupancy import FloorMap, VoxelMap
    from tofmix.sensor import Sensor

LAYERS, AVERAGED, THIN_BEAM = "layers", "averaged", "thin-beam"


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
    "--from", type=click.Choice([LAYERS, AVERAGED, THIN_BEAM]), default=LAYERS, show_default=True,
    help="Ranges to map. layers: all surfaces. For comparison: averaged (mean of the samples), thin-beam (one fitted"
    " surface).",
)  # fmt: skip
@click.option("--recording", type=PATH, help="The samples, for --from averaged and thin-beam.")
@click.option("--window", type=click.IntRange(0), default=0, show_default=True, help="Window to map.")
@click.option(
    "--cell", type=click.FloatRange(1.0, 10_000.0), default=50.0, show_default=True, help="Edge of a cell, mm."
)
@click.option(
    "--height", type=_Numbers("A,B"), metavar="A,B", default="-250,250", show_default=True,
    help="Heights in the 2-D map, mm above the camera; rounded outward to whole cells.",
)  # fmt: skip
@click.option(
    "--pose", type=_Numbers("X,Y,YAW"), metavar="X,Y,YAW", default="0,0,0", show_default=True,
    help="Pose of the camera in the map: mm, mm, and degrees anticlockwise from x.",
)  # fmt: skip
@click.option(
    "--pitch", type=click.FloatRange(-89.0, 89.0), default=0.0, show_default=True,
    help="Downward pitch of the camera, degrees.",
)  # fmt: skip
@click.option(
    "--min-share", type=click.FloatRange(0, 1, min_open=True, max_open=True), default=0.05, show_default=True,
    help="Smallest share of light that an obstacle blocks; a cell that blocks less is free.",
)  # fmt: skip
@click.option(
    "--min-probability", type=click.FloatRange(0, 1), default=0.9999, show_default=True,
    help="Layers with a smaller probability are ignored.",
)  # fmt: skip
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
    from tofmix.io.atomic.atomic_group import write_atomic_group
    from tofmix.io.atomic.storage import locked
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.io.map_file import encode_map
    from tofmix.io.voxel_file import encode_voxels
    from tofmix.mapping.grid import plan_grid
    from tofmix.mapping.occupancy import map_beams, project
    from tofmix.mapping.pose import Pose

    source = choices["from"]
    inputs = tuple(filter(None, (layers, recording)))
    outputs = _check_call(output, voxels, source, recording)
    threads = workers or default_workers()
    with locked(*outputs, overwrite=overwrite, inputs=inputs):
        with open_layers(layers) as file:
            if window >= file.shape[0]:
                raise UsageError(f"--window {window}: {layers} has windows 0 to {file.shape[0] - 1}")
            beams, left_out = _beams(file, window, source, recording, min_probability, threads, suspect=suspect)
            comment = _comment(file, source, recording)
            if file.provenance.sensor.range_max_mm is None:
                click.echo(
                    f"tofmix: {layers}: sensor: no range_max_mm: samples without a return mark no space as free",
                    err=True,
                )
        try:
            camera = Pose(x_mm=pose[0], y_mm=pose[1], yaw_deg=pose[2], pitch_deg=pitch)
            grid = plan_grid(beams, camera, cell_mm=cell, height_mm=None if voxels is not None else height)
            if output is not None:
                grid = grid.with_levels(height)
        except ValueError as error:
            raise UsageError(str(error)) from error
        with Progress(grid.size, "map", "cell") as bar:
            space = map_beams(beams, camera, grid, min_share=min_share, workers=threads, progress=bar.update)
            contents: dict[Path, bytes] = {}
            if voxels is not None:
                contents[voxels] = encode_voxels(space, voxels, comment=comment)
            floor = None if output is None else project(space, height)
            if output is not None and floor is not None:
                contents |= encode_map(floor, output, comment=comment)
            write_atomic_group(contents, overwrite=overwrite, inputs=inputs)
    _say(output, floor, voxels, space, left_out, as_json)


def _check_call(output: Path | None, voxels: Path | None, source: str, recording: Path | None) -> tuple[Path, ...]:
    """Refuse impossible options before any work; return the files to write."""
    from tofmix.io.map_file import map_paths
    from tofmix.io.voxel_file import check_voxel_path

    if output is None and voxels is None:
        raise UsageError("nothing to write: pass -o MAP.yaml, --voxels OUT.ply or both")
    if source != LAYERS and recording is None:
        raise UsageError(f"--from {source} needs the samples: pass --recording RECORDING")
    if source == LAYERS and recording is not None:
        raise UsageError("--recording needs --from averaged or --from thin-beam")
    paths = () if output is None else map_paths(output)
    if voxels is not None:
        check_voxel_path(voxels)
        paths = (*paths, voxels)
    return paths


def _beams(
    file: "LayersFile", window: int, source: str, recording: Path | None, min_probability: float, workers: int, *,
    suspect: bool,
) -> "tuple[Beams, int]":  # fmt: skip
    """The beams, and how many suspect layers are left out."""
    from tofmix.cli.reporter import CommandReporter
    from tofmix.jobs.recordings import opened_recording
    from tofmix.jobs.view import check_view

    check_view(file)
    try:
        if recording is None:
            layers = file.read_window(window)
            return _from_layers(layers, file.provenance.sensor, min_probability, suspect=suspect)
        with opened_recording(recording, CommandReporter()) as samples:
            frames = _frames(file, window, samples)
            if source == AVERAGED:
                return _averaged(file, samples, frames), 0
            return _thin_beam(file, samples, frames, min_probability, workers, suspect=suspect)
    except ValueError as error:
        raise BadInputError(f"{file.path}: {error}") from error


def _from_layers(layers: "Layers", sensor: "Sensor", min_probability: float, *, suspect: bool) -> "tuple[Beams, int]":
    from tofmix.mapping.beams import beams_from_layers

    taken = layers.trusted() if suspect else layers
    return beams_from_layers(taken, sensor, min_probability=min_probability), taken.suspects()


def _frames(file: "LayersFile", window: int, samples: "RecordingFile") -> tuple[int, int]:
    """The window's frames, or all frames of a recording that the layers were not made from."""
    from tofmix.io.recording.recording_file import file_sha256

    if samples.shape[1:] != file.shape[1:]:
        raise BadInputError(
            f"{samples.path}: range: {samples.shape[1]} x {samples.shape[2]} pixels do not match {file.path},"
            f" which has {file.shape[1]} x {file.shape[2]}"
        )
    if file_sha256(samples.path) == file.provenance.source_sha256:
        return int(file.window_start[window]), int(file.window_stop[window])
    click.echo(
        f"tofmix: {samples.path} is not the recording that {file.path} was made from; all its frames are used", err=True
    )
    return 0, samples.frames


def _averaged(file: "LayersFile", samples: "RecordingFile", frames: tuple[int, int]) -> "Beams":
    from dataclasses import replace

    from tofmix.mapping.averages import count_samples
    from tofmix.mapping.beams import beams_from_ranges
    from tofmix.report.averaging import average_samples

    start, stop = frames
    circle_mm = file.provenance.unambiguous_range_mm
    mean = average_samples(samples, start=start, stop=stop, unambiguous_range_mm=circle_mm).range_mm
    noise = samples.sensor.noise or file.provenance.sensor.noise
    return beams_from_ranges(
        mean, count_samples(samples, start=start, stop=stop),
        replace(file.provenance.sensor, noise=noise, range_step_mm=None),
    )  # fmt: skip


def _thin_beam(
    file: "LayersFile", samples: "RecordingFile", frames: tuple[int, int], min_probability: float, workers: int, *,
    suspect: bool,
) -> "tuple[Beams, int]":  # fmt: skip
    from tofmix.estimation.blocks.sequence import estimate_layers
    from tofmix.estimation.settings import EstimateOptions, SigmaMode
    from tofmix.recording import FrameSpan

    sensor, circle_mm = file.provenance.sensor, file.provenance.unambiguous_range_mm
    options = EstimateOptions(max_layers=1, sigma=SigmaMode.TIED, unambiguous_range_mm=circle_mm)
    found = estimate_layers(FrameSpan(samples.with_sensor(sensor), *frames), options, workers=workers)
    return _from_layers(found.reshaped(file.shape[1:]), sensor, min_probability, suspect=suspect)


def _comment(file: "LayersFile", source: str, recording: Path | None) -> str:
    from tofmix.version import __version__

    samples = "" if recording is None else f" of {recording.name}"
    return f"tofmix {__version__} map --from {source}{samples}, {file.path.name}"


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
