"""``tofmix compare``: where two layers files differ."""

import json
from contextlib import ExitStack
from pathlib import Path

import click

from tofmix.cli.options import PATH, examples, json_option, overwrite_option, say_written
from tofmix.errors import ExitCode


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
    "--tolerance", type=click.FloatRange(0), default=3.0, show_default=True,
    help="Largest difference of equal ranges, in combined standard errors.",
)  # fmt: skip
@click.option(
    "--allow", type=click.FloatRange(0, 1), default=0.0, show_default=True,
    help="Largest share of differing pixels for exit code 0.",
)  # fmt: skip
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
    from tofmix.errors import BadInputError, UsageError
    from tofmix.io.atomic.storage import locked, write_text
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.report.comparison.comparison import compare as compare_files
    from tofmix.report.comparison.table import format_comparison

    if window is not None and html is None:
        raise UsageError("--window needs --html")
    with ExitStack() as stack:
        files = [stack.enter_context(open_layers(path)) for path in (a, b)]
        if html is not None:
            stack.enter_context(locked(html, overwrite=overwrite, inputs=(a, b)))
        if window is not None and window >= files[0].shape[0]:
            raise UsageError(f"--window {window}: {a} has windows 0 to {files[0].shape[0] - 1}")
        try:
            comparison = compare_files(*files, tolerance=tolerance)
        except BadInputError as error:
            raise BadInputError(f"{a} and {b}: {error}") from error
        equal = comparison.equal(allow)
        if html is not None:
            from tofmix.report.comparison.page import render_comparison

            page = render_comparison(*files, comparison=comparison, window=window, names=(a.name, b.name))
            write_text(html, page, overwrite=overwrite, inputs=(a, b))
        if as_json:
            click.echo(json.dumps(comparison.as_dict() | {"allow": allow, "equal": equal}, indent=2, allow_nan=False))
        else:
            click.echo(format_comparison(comparison, names=(a.name, b.name), allow=allow))
        if html is not None:
            say_written("page", html, beside_json=as_json)
    return ExitCode.DONE if equal else ExitCode.DIFFERENT
