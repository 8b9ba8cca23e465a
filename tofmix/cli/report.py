"""``tofmix report``: the results of an estimate, for people and for scripts."""

import json
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, say_written
from tofmix.cli.reporter import CommandReporter

if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.recording import SampleSource
    from tofmix.report.pixels.single_pixels import SinglePixels


@examples(
    """
tofmix report boards.layers.h5
tofmix report boards.layers.h5 --recording boards.h5 --html boards.html
tofmix report boards.layers.h5 --surfaces boards.surfaces.h5 --html boards.html
tofmix report boards.layers.h5 --json | python -m json.tool
"""
)
@click.command(short_help="Summarise a layers file.")
@click.argument("layers", type=PATH)
@click.option("--recording", type=PATH, help="Recording of these layers; adds its samples to the page.")
@click.option(
    "--surfaces", type=PATH, help="Surfaces file of these layers; adds surfaces, edges and finer ranges to the page."
)
@click.option("--html", type=PATH, help="Write a self-contained page with pictures.")
@click.option("--window", type=click.IntRange(0), default=0, show_default=True, help="The window that the page shows.")
@json_option
@overwrite_option
def report(
    layers: Path, recording: Path | None, surfaces: Path | None, html: Path | None, window: int, as_json: bool,
    overwrite: bool,
) -> None:  # fmt: skip
    """Summarise LAYERS, a file that tofmix estimate wrote.

    Prints pixels by number of surfaces, the layers' ranges, shares and sigmas, and pixels by status. The page (--html)
    shows the same in pictures, and any pixel that you choose; its samples need --recording.
    """
    from tofmix.errors import UsageError
    from tofmix.io.atomic.storage import locked, write_text
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.jobs.recordings import check_recording, findings_of_samples, opened_recording
    from tofmix.report.summary.lost import cause_of_loss
    from tofmix.report.summary.summary import find, remedy_for, summarise
    from tofmix.report.summary.tables import format_table

    if surfaces is not None and html is None:
        raise UsageError("--surfaces needs --html: only the page shows surfaces")
    inputs = tuple(path for path in (layers, recording, surfaces) if path is not None)
    with ExitStack() as stack:
        file = stack.enter_context(open_layers(layers))
        source = None if recording is None else stack.enter_context(opened_recording(recording, CommandReporter()))
        if source is not None:
            check_recording(file, source)
        if window >= file.shape[0]:
            raise UsageError(f"--window {window}: {layers} has windows 0 to {file.shape[0] - 1}")
        if html is not None:
            stack.enter_context(locked(html, overwrite=overwrite, inputs=inputs))
        summary = summarise(file)
        if source is not None:
            made = file.provenance
            remedy = remedy_for(made, file.shape[0], str(recording), has_amplitude=source.has_amplitude)
            of_samples = findings_of_samples(source, made.sensor, made.unambiguous_range_mm, remedy)
            summary = summary.with_findings((*of_samples, *find(file, remedy, cause=partial(cause_of_loss, source))))
        singles = None
        if source is not None and summary.noise is not None:
            singles = _singles(file, window, source)
            summary = replace(summary, noise=replace(summary.noise, scatter_over_sigma=singles.spread()))
        if html is not None:
            from tofmix.report.page.page import render_page

            shown: dict[str, Any] = {} if surfaces is None else _surfaces_of(surfaces, layers, window)
            page = render_page(file, recording=source, window=window, summary=summary, singles=singles, **shown)
            write_text(html, page, overwrite=overwrite, inputs=inputs)
        if as_json:
            click.echo(json.dumps(summary.as_dict(), indent=2, allow_nan=False))
        else:
            click.echo(format_table(summary))
        if html is not None:
            say_written("page", html, beside_json=as_json)


def _singles(file: "LayersFile", window: int, source: "SampleSource") -> "SinglePixels":
    """How far samples of single pixels scatter."""
    from tofmix.errors import BadInputError
    from tofmix.report.pixels.single_pixels import single_pixels

    start, stop = int(file.window_start[window]), int(file.window_stop[window])
    try:
        return single_pixels(file.read_window(window), file.provenance, recording=source, start=start, stop=stop)
    except ValueError as error:  # a noise or a working range that no estimate could have had
        raise BadInputError(f"{file.path}: {error}") from error


def _surfaces_of(path: Path, layers: Path, window: int) -> dict[str, Any]:
    """Surfaces of a window for the page."""
    from tofmix.errors import BadInputError
    from tofmix.io.recording.recording_file import file_sha256
    from tofmix.io.surfaces.surfaces_file import open_surfaces

    with open_surfaces(path) as file:
        if file.provenance.source_sha256 != file_sha256(layers):
            raise BadInputError(
                f"{path}: made from another layers file than {layers}; replace it: tofmix surfaces {layers} --overwrite"
            )
        found = file.read_window(window)
    numbers = found.surface[found.surface >= 0]
    return {"surfaces": found, "first_surface": int(numbers.min()) if len(numbers) else 0}
