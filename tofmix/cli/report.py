"""``tofmix report``: what came out of an estimate, for people and for scripts."""

import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option
from tofmix.cli.recording_check import check_recording, findings_of_samples, opened_recording


@examples(
    """
tofmix report boards.layers.h5
tofmix report boards.layers.h5 --recording boards.h5 --html boards.html
tofmix report boards.layers.h5 --json | python -m json.tool
"""
)
@click.command(short_help="Show what an estimate found.")
@click.argument("layers", type=PATH)
@click.option("--recording", type=PATH, help="The recording of these layers; the page then shows its samples too.")
@click.option("--html", type=PATH, help="Write a self-contained page with pictures.")
@click.option("--window", type=click.IntRange(0), default=0, show_default=True, help="The window that the page shows.")
@json_option
@overwrite_option
def report(
    layers: Path, recording: Path | None, html: Path | None, window: int, as_json: bool, overwrite: bool
) -> None:
    """Show what an estimate found: LAYERS is a file that tofmix estimate wrote.

    Prints pixels by number of surfaces, the layers' ranges, shares and sigmas, and
    pixels by status. A page (--html) shows the same in pictures, and lets you choose
    a pixel to look into; without --recording it has no samples.
    """
    from tofmix.errors import BadInputError, UsageError
    from tofmix.io.layers_file import open_layers
    from tofmix.io.storage import claimed, write_text
    from tofmix.report.summary import find, remedy_for, summarise
    from tofmix.report.tables import format_table

    inputs = tuple(path for path in (layers, recording) if path is not None)
    with ExitStack() as stack:
        file = stack.enter_context(open_layers(layers))
        source = None if recording is None else stack.enter_context(opened_recording(recording))
        if source is not None:
            check_recording(file, source)
        if window >= file.shape[0]:
            raise UsageError(f"--window {window}: {layers} has windows 0 to {file.shape[0] - 1}")
        if html is not None:
            stack.enter_context(claimed(html, overwrite=overwrite, inputs=inputs))
        summary = summarise(file)
        if source is not None:
            made = file.provenance
            remedy = remedy_for(made, file.shape[0], str(recording))
            of_samples = findings_of_samples(source, made.sensor, made.unambiguous_range_mm, remedy)
            summary = replace(summary, warnings=(*of_samples, *find(file, remedy)))
        singles = None
        if source is not None and summary.noise is not None:
            from tofmix.report.single_pixels import single_pixels

            start, stop = int(file.window_start[window]), int(file.window_stop[window])
            try:
                singles = single_pixels(file.read_window(window), made, recording=source, start=start, stop=stop)
            except ValueError as error:  # a noise or a working range that no estimate could have had
                raise BadInputError(f"{layers}: {error}") from error
            summary = replace(summary, noise=replace(summary.noise, scatter_over_sigma=singles.spread()))
        if html is not None:
            from tofmix.report.page import render_page

            page = render_page(file, recording=source, window=window, summary=summary, singles=singles)
            write_text(html, page, overwrite=overwrite, inputs=inputs)
        if as_json:
            click.echo(json.dumps(summary.as_dict(), indent=2, allow_nan=False))
        else:
            click.echo(format_table(summary))
        if html is not None:
            click.echo(f"page: {html}", err=as_json)
