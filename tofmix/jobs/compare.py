"""Compare two layers files, and write the page of their differences."""

from contextlib import ExitStack
from pathlib import Path

from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.storage import locked, write_text
from tofmix.jobs.files import check_window
from tofmix.jobs.reporter import Reporter
from tofmix.report.comparison.comparison import Comparison, compare


def compare_layers(
    a: Path, b: Path, reporter: Reporter, *, tolerance: float, html: Path | None, window: int | None, overwrite: bool
) -> Comparison:
    """Compare two layers files; write the page `html`, which shows one window, if it is wanted."""
    with ExitStack() as stack:
        files = [stack.enter_context(open_layers(path)) for path in (a, b)]
        if html is not None:
            stack.enter_context(locked(html, overwrite=overwrite, inputs=(a, b)))
        check_window(files[0], window, reporter)
        try:
            comparison = compare(*files, tolerance=tolerance)
        except BadInputError as error:
            raise BadInputError(f"{a} and {b}: {error}") from error
        if html is not None:
            from tofmix.report.comparison.page import render_comparison  # with Matplotlib, which only pages need

            page = render_comparison(*files, comparison=comparison, window=window, names=(a.name, b.name))
            write_text(html, page, overwrite=overwrite, inputs=(a, b))
        return comparison
