"""``tofmix inspect``: one pixel and its neighbours."""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, say_written
from tofmix.cli.reporter import CommandReporter
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.layers import Layers, Provenance
    from tofmix.recording import SampleSource
    from tofmix.report.pixels.phasor_plane import PhasorPlane
    from tofmix.report.pixels.pixels import GrowingDensity, PixelView


@examples(
    """
tofmix inspect boards.layers.h5 --pixel 72,92
tofmix inspect boards.layers.h5 --pixel 72,92 --recording boards.h5 -o pixel.png
tofmix inspect boards.layers.h5 --pixel 72,92 --recording boards.h5 --over-frames -o frames.svg
"""
)
@click.command(short_help="Show one pixel: its layers, samples and density.")
@click.argument("layers", type=PATH)
@click.option("--pixel", metavar="ROW,COL", required=True, help="The pixel, from 0; row 0 is at the top.")
@click.option("--recording", type=PATH, help="The recording of these layers, for samples and density.")
@click.option(
    "--neighbours",
    type=click.IntRange(0, 15),
    default=3,
    show_default=True,
    help="Number of neighbours in the same row to show too, nearest first.",
)
@click.option("--window", type=click.IntRange(0), default=0, show_default=True, help="The window.")
@click.option(
    "--over-frames",
    is_flag=True,
    allow_from_autoenv=False,
    help="Draw the peaks of the density over the number of samples; needs --recording.",
)
@click.option("-o", "--output", type=PATH, help="Figure to write, .png or .svg.")
@json_option
@overwrite_option
def inspect(
    layers: Path,
    pixel: str,
    recording: Path | None,
    neighbours: int,
    window: int,
    over_frames: bool,
    output: Path | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Show one pixel of LAYERS, a layers file, and its neighbours.

    Prints each layer's range and share with their standard errors, sigma and probability. The figure (-o) shows the
    fitted components and, with --recording, the samples and their density: the paper's Fig. 8, or its Fig. 7 with
    --over-frames. With learnt noise the line over the samples is the fitted mixture, with the learnt shape and the
    pixel's width, background and drift. If mixing was measured, a second panel shows the pixel in the complex plane:
    the phasors of its samples and of its neighbours, and the chord or triangle of its unmixing.
    """
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.io.storage import locked
    from tofmix.jobs.files import check_window
    from tofmix.report.pixels.pixels import FIGURE_SUFFIXES

    inputs = tuple(path for path in (layers, recording) if path is not None)
    if output is not None and output.suffix.lower() not in FIGURE_SUFFIXES:
        raise UsageError(f"{output}: the name must end in one of {', '.join(FIGURE_SUFFIXES)}")
    with ExitStack() as stack:
        if output is not None:
            stack.enter_context(locked(output, overwrite=overwrite, inputs=inputs))
        file = stack.enter_context(open_layers(layers))
        row, col = _place(pixel, file)
        check_window(file, window, CommandReporter())
        samples = source = None
        if recording is not None:
            from tofmix.jobs.files import check_recording, opened_recording
            from tofmix.report.pixels.pixels import row_samples

            source = stack.enter_context(opened_recording(recording, CommandReporter()))
            check_recording(file, source)
            frames = int(file.window_start[window]), int(file.window_stop[window])
            samples = row_samples(source, row=row, start=frames[0], stop=frames[1])
        from tofmix.report.pixels.pixels import learnt_sensor, neighbour_columns, view_pixels

        cols = [col] if over_frames else neighbour_columns(col, cols=file.shape[2], neighbours=neighbours)
        try:
            found = file.read_window(window)
            views = view_pixels(
                found,
                row=row,
                cols=cols,
                samples=samples,
                noise=file.provenance.sensor.noise,
                unambiguous_range_mm=file.provenance.unambiguous_range_mm,
                learnt=learnt_sensor(file.provenance),
            )
            plane = None
            if output is not None and source is not None and not over_frames:
                plane = _plane(found, file, source, window, (row, col))
        except ValueError as error:  # a noise or a working range that no estimate could have had
            raise BadInputError(f"{file.path}: {error}") from error
        growth = _growth(views[0], file) if over_frames else None
        if output is not None:
            _write_figure(output, views, file, growth, plane, inputs, overwrite)
    _print(views, col, growth, file.provenance, as_json)
    if output is not None:
        say_written("figure", output, beside_json=as_json)


def _place(pixel: str, file: "LayersFile") -> tuple[int, int]:
    try:
        numbers = [int(part) for part in pixel.split(",")]
    except ValueError:
        numbers = []
    coordinates = 2  # of a pixel: row and column
    if len(numbers) != coordinates:
        raise UsageError(f"--pixel: {pixel!r} is not ROW,COL, such as 72,92")
    _, rows, cols = file.shape
    if not (0 <= numbers[0] < rows and 0 <= numbers[1] < cols):
        raise UsageError(f"--pixel {pixel}: {file.path} has rows 0 to {rows - 1} and columns 0 to {cols - 1}")
    return numbers[0], numbers[1]


def _growth(view: "PixelView", file: "LayersFile") -> "GrowingDensity":
    from tofmix.report.pixels.pixels import grow_density

    if view.samples_mm is None:
        raise UsageError("--over-frames needs --recording")
    try:
        sensor, circle_mm = file.provenance.sensor, file.provenance.unambiguous_range_mm
        return grow_density(view.samples_mm, sensor, unambiguous_range_mm=circle_mm)
    except ValueError as error:
        raise BadInputError(f"{file.path}: {view.name}: {error}") from error


def _plane(
    layers: "Layers", file: "LayersFile", source: "SampleSource", window: int, pixel: tuple[int, int]
) -> "PhasorPlane | None":
    """The pixel in the complex plane; None if the file has no mixing or no amplitudes."""
    from tofmix.report.pixels.phasor_plane import phasor_plane, read_around

    made, (row, col) = file.provenance, pixel
    if layers.mixing is None or made.sensor.modulation_frequency_hz is None:
        return None
    start, stop = int(file.window_start[window]), int(file.window_stop[window])
    around = read_around(source, row=row, col=col, start=start, stop=stop)
    if around is None:
        return None
    circle_mm = made.unambiguous_range_mm
    return phasor_plane(layers, around, made.sensor, row=row, col=col, unambiguous_range_mm=circle_mm)


def _write_figure(
    output: Path,
    views: "list[PixelView]",
    file: "LayersFile",
    growth: "GrowingDensity | None",
    plane: "PhasorPlane | None",
    inputs: tuple[Path, ...],
    overwrite: bool,
) -> None:
    from tofmix.io.storage import AtomicFile
    from tofmix.report.pixels.pixels import FIGURE_SUFFIXES, pixel_figure

    kind = FIGURE_SUFFIXES[output.suffix.lower()]
    made = file.provenance
    content = pixel_figure(
        views,
        noise=made.sensor.noise,
        growth=growth,
        kind=kind,
        unambiguous_range_mm=made.unambiguous_range_mm,
        plane=plane,
    )
    with AtomicFile(output, overwrite=overwrite, inputs=inputs) as target:
        target.sink.write(content)
        target.commit()


def _print(
    views: "list[PixelView]", col: int, growth: "GrowingDensity | None", made: "Provenance", as_json: bool
) -> None:
    from tofmix.report.pixels.pixels import format_growth, format_pixels, why_layers_stand

    targets = made.targets
    if as_json:
        found: dict[str, Any] = {"pixels": [view.as_dict() for view in views]}
        found |= {"targets": targets} if targets else {}
        click.echo(json.dumps(found | ({"over_frames": growth.as_dict()} if growth else {}), indent=2, allow_nan=False))
        return
    click.echo(format_pixels(views, col))
    if why := why_layers_stand(views, made.options):
        click.echo(f"\n{why}")
    if targets:
        click.echo(f"a share is the share of detections, up to {targets} a frame")
    if growth is not None:
        click.echo("\n" + format_growth(growth))
