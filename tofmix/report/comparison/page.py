"""A comparison as one HTML page in the style of the report; for the terminal use `table`."""

from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from tofmix.report.comparison.comparison import Comparison, common_circle
from tofmix.report.comparison.window_difference import compare_windows
from tofmix.report.page.templates import load_template
from tofmix.report.sources import LayersSource
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.report.figures.picture import Picture


def render_comparison(
    a: LayersSource, b: LayersSource, *, comparison: Comparison, window: int | None, names: tuple[str, str]
) -> str:
    """Render the page of two layers files as HTML; the same input gives the same text.

    The pictures are of `window`, or of the window with most differences.
    """
    template = load_template("comparison/comparison.html")
    drawings = import_module("tofmix.report.comparison.pictures")
    shown = int(np.argmax(comparison.different_by_window)) if window is None else window
    of_a, of_b = a.read_window(shown), b.read_window(shown)
    circle_mm = common_circle(a, b)
    found = compare_windows(of_a, of_b, tolerance=comparison.tolerance, unambiguous_range_mm=circle_mm)
    pictures: tuple[Picture, ...] = drawings.draw_comparison(of_a, of_b, found, tolerance=comparison.tolerance)
    return template.render(
        comparison=comparison,
        names=names,
        headline=headline(comparison),
        window=shown,
        pictures=pictures,
        made=[
            (f"{letter}: {name}", source) for letter, name, source in zip("AB", names, comparison.sources, strict=True)
        ],
        options=[(name, f"{pair[0]} in A, {pair[1]} in B") for name, pair in comparison.options.items()],
    )


def headline(comparison: Comparison) -> str:
    """Describe the differences in one sentence."""
    c = comparison
    if c.different == 0:
        return f"All {counted(c.pixels, 'pixel', ',')} agree within {c.tolerance:g} standard errors."
    return (
        f"{c.different:,} of {counted(c.pixels, 'pixel', ',')} differ: {c.count_differs:,} in the number of surfaces,"
        f" {c.range_differs:,} in a range by more than {c.tolerance:g} standard errors."
    )
