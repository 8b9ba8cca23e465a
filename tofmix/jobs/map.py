"""Map the layers of a window: beams from layers or samples, cells from beams, and the files of the map.

What only maps for comparison need is imported where it is used: it is slow to import.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.map_file import check_voxel_path, encode_map, encode_voxels, map_paths
from tofmix.io.recording.recording_file import RecordingFile, file_sha256
from tofmix.io.storage import locked, write_atomic_group
from tofmix.jobs.files import check_view, check_window, opened_recording
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.layers import Layers
from tofmix.mapping.beams import Beams, beams_from_layers, beams_from_ranges
from tofmix.mapping.grid import Pose, plan_grid
from tofmix.mapping.occupancy import FloorMap, VoxelMap, map_beams, project
from tofmix.recording import FrameSpan
from tofmix.sensor import Sensor
from tofmix.version import __version__

LAYERS, AVERAGED, THIN_BEAM = "layers", "averaged", "thin-beam"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRequest:
    """The options of a map."""

    layers: Path
    output: Path | None
    voxels: Path | None
    source: str  # layers, averaged or thin-beam
    recording: Path | None
    window: int
    cell_mm: float
    height_mm: tuple[float, float]
    pose: tuple[float, float, float]  # mm, mm and degrees
    pitch_deg: float
    min_share: float
    min_probability: float
    suspect: bool
    workers: int
    overwrite: bool


def write_map(asked: MapRequest, reporter: Reporter) -> tuple[FloorMap | None, VoxelMap, int]:
    """Write an occupancy map.

    Returns
    -------
    (FloorMap or None, VoxelMap, int)
        The 2-D map, if it is wanted, the cells, and how many suspect layers are left out.
    """
    output, voxels, height = asked.output, asked.voxels, asked.height_mm
    inputs = tuple(filter(None, (asked.layers, asked.recording)))
    with locked(*_checked_outputs(asked), overwrite=asked.overwrite, inputs=inputs):
        with open_layers(asked.layers) as file:
            check_window(file, asked.window, reporter)
            beams, left_out = _beams(file, asked, reporter)
            comment = _comment(file, asked)
            if file.provenance.sensor.range_max_mm is None:
                reporter.warn(
                    f"{asked.layers}: sensor: no range_max_mm: samples without a return mark no space as free"
                )
        try:
            (x_mm, y_mm, yaw_deg), pitch_deg = asked.pose, asked.pitch_deg
            camera = Pose(x_mm=x_mm, y_mm=y_mm, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
            grid = plan_grid(beams, camera, cell_mm=asked.cell_mm, height_mm=None if voxels is not None else height)
            if output is not None:
                grid = grid.with_levels(height)
        except ValueError as error:
            raise OptionError(str(error)) from error
        with reporter.steps(grid.size, "map", "cell"):
            space = map_beams(
                beams, camera, grid, min_share=asked.min_share, workers=asked.workers, progress=reporter.progress
            )
            contents = {} if voxels is None else {voxels: encode_voxels(space, voxels, comment=comment)}
            floor = None if output is None else project(space, height)
            if output is not None and floor is not None:
                contents |= encode_map(floor, output, comment=comment)
            write_atomic_group(contents, overwrite=asked.overwrite, inputs=inputs)
    return floor, space, left_out


def _checked_outputs(asked: MapRequest) -> tuple[Path, ...]:
    """Refuse impossible options before any work; return the files to write."""
    output, voxels, source, recording = asked.output, asked.voxels, asked.source, asked.recording
    if output is None and voxels is None:
        raise OptionError("nothing to write: pass -o MAP.yaml, --voxels OUT.ply or both")
    if source != LAYERS and recording is None:
        raise OptionError(f"--from {source} needs the samples: pass --recording RECORDING")
    if source == LAYERS and recording is not None:
        raise OptionError("--recording needs --from averaged or --from thin-beam")
    paths = () if output is None else map_paths(output)
    if voxels is not None:
        check_voxel_path(voxels)
        paths = (*paths, voxels)
    return paths


def _beams(file: LayersFile, asked: MapRequest, reporter: Reporter) -> tuple[Beams, int]:
    """The beams, and how many suspect layers are left out."""
    check_view(file)
    try:
        if asked.recording is None:
            return _from_layers(file.read_window(asked.window), file.provenance.sensor, asked)
        with opened_recording(asked.recording, reporter) as samples:
            frames = _frames(file, asked.window, samples, reporter)
            if asked.source == AVERAGED:
                return _averaged(file, samples, frames), 0
            return _thin_beam(file, samples, frames, asked)
    except ValueError as error:
        raise BadInputError(f"{file.path}: {error}") from error


def _from_layers(layers: Layers, sensor: Sensor, asked: MapRequest) -> tuple[Beams, int]:
    taken = layers.trusted() if asked.suspect else layers
    return beams_from_layers(taken, sensor, min_probability=asked.min_probability), taken.suspects()


def _frames(file: LayersFile, window: int, samples: RecordingFile, reporter: Reporter) -> tuple[int, int]:
    """The window's frames, or all frames of a recording that the layers were not made from."""
    if samples.shape[1:] != file.shape[1:]:
        raise BadInputError(
            f"{samples.path}: range: {samples.shape[1]} x {samples.shape[2]} pixels do not match {file.path},"
            f" which has {file.shape[1]} x {file.shape[2]}"
        )
    if file_sha256(samples.path) == file.provenance.source_sha256:
        return int(file.window_start[window]), int(file.window_stop[window])
    reporter.warn(f"{samples.path} is not the recording that {file.path} was made from; all its frames are used")
    return 0, samples.frames


def _averaged(file: LayersFile, samples: RecordingFile, frames: tuple[int, int]) -> Beams:

    from tofmix.mapping.beams import count_samples
    from tofmix.report.averaging import average_samples

    start, stop = frames
    circle_mm = file.provenance.unambiguous_range_mm
    mean = average_samples(samples, start=start, stop=stop, unambiguous_range_mm=circle_mm).range_mm
    noise = samples.sensor.noise or file.provenance.sensor.noise
    return beams_from_ranges(
        mean,
        count_samples(samples, start=start, stop=stop),
        replace(file.provenance.sensor, noise=noise, range_step_mm=None),
    )


def _thin_beam(
    file: LayersFile, samples: RecordingFile, frames: tuple[int, int], asked: MapRequest
) -> tuple[Beams, int]:
    from tofmix.estimation.blocks.sequence import estimate_layers
    from tofmix.estimation.settings import EstimateOptions, SigmaMode

    sensor, circle_mm = file.provenance.sensor, file.provenance.unambiguous_range_mm
    options = EstimateOptions(max_layers=1, sigma=SigmaMode.TIED, unambiguous_range_mm=circle_mm)
    found = estimate_layers(FrameSpan(samples.with_sensor(sensor), *frames), options, workers=asked.workers)
    return _from_layers(found.reshaped(file.shape[1:]), sensor, asked)


def _comment(file: LayersFile, asked: MapRequest) -> str:
    samples = "" if asked.recording is None else f" of {asked.recording.name}"
    return f"tofmix {__version__} map --from {asked.source}{samples}, {file.path.name}"
