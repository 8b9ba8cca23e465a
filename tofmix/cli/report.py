"""``tofmix report``: the results of an estimate; ``tofmix compare``: where those of two differ."""

import json
from pathlib import Path

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, say_written
from tofmix.cli.reporter import CommandReporter
from tofmix.errors import ExitCode, UsageError


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


@examples(
    """
tofmix compare boards.layers.h5 other.layers.h5
tofmix compare prior.layers.h5 free.layers.h5 --tolerance 0.5 --html differences.html
tofmix compare monday.layers.h5 tuesday.layers.h5 --allow 0.05 --json
"""
)
@click.command(short_help="Show where two layers files differ.")
@click.argument("a", type=PATH)
@click.argument("b", type=PATH)
@click.option(
    "--tolerance",
    type=click.FloatRange(0),
    default=3.0,
    show_default=True,
    help="Largest difference of equal ranges, in combined standard errors.",
)
@click.option(
    "--allow",
    type=click.FloatRange(0, 1),
    default=0.0,
    show_default=True,
    help="Largest share of differing pixels for exit code 0.",
)
@click.option("--html", type=PATH, help="Write a self-contained page with pictures.")
@click.option("--window", type=click.IntRange(0), help="The window that the page shows.  [default: the most different]")
@json_option
@overwrite_option
def compare(
    a: Path,
    b: Path,
    tolerance: float,
    allow: float,
    html: Path | None,
    window: int | None,
    as_json: bool,
    overwrite: bool,
) -> ExitCode:
    """Show where the layers files A and B differ.

    A pixel differs if its numbers of surfaces differ, or if a range differs by more than --tolerance combined standard
    errors. Exit code 0: equal; 6: different; 3: the files have different sizes.
    """
    from tofmix.jobs.report import compare_layers
    from tofmix.report.comparison import format_comparison

    if window is not None and html is None:
        raise UsageError("--window needs --html")
    comparison = compare_layers(
        a, b, CommandReporter(), tolerance=tolerance, html=html, window=window, overwrite=overwrite
    )
    equal = comparison.equal(allow)
    if as_json:
        click.echo(json.dumps(comparison.as_dict() | {"allow": allow, "equal": equal}, indent=2, allow_nan=False))
    else:
        click.echo(format_comparison(comparison, names=(a.name, b.name), allow=allow))
    if html is not None:
        say_written("page", html, beside_json=as_json)
    return ExitCode.DONE if equal else ExitCode.DIFFERENT
