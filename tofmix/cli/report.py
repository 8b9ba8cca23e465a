"""``tofmix report``: the results of an estimate, for people and for scripts."""

import json
from pathlib import Path

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, say_written
from tofmix.cli.reporter import CommandReporter
from tofmix.errors import UsageError


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
    layers: Path,
    recording: Path | None,
    surfaces: Path | None,
    html: Path | None,
    window: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Summarise LAYERS, a file that tofmix estimate wrote.

    Prints pixels by number of surfaces, the layers' ranges, shares and sigmas, and pixels by status. The page (--html)
    shows the same in pictures, and any pixel that you choose; its samples need --recording.
    """
    from tofmix.jobs.report import report_layers
    from tofmix.report.summary.tables import format_table

    if surfaces is not None and html is None:
        raise UsageError("--surfaces needs --html: only the page shows surfaces")
    summary = report_layers(
        layers,
        CommandReporter(),
        recording=recording,
        surfaces=surfaces,
        html=html,
        window=window,
        overwrite=overwrite,
    )
    said = json.dumps(summary.as_dict(), indent=2, allow_nan=False) if as_json else format_table(summary)
    click.echo(said)
    if html is not None:
        say_written("page", html, beside_json=as_json)
