"""A comparison of two layers files as a text table and as one HTML page.

The table is for the terminal, the page in the style of the report; for scripts use `Comparison.as_dict`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from tofmix.layers import LayersSource
from tofmix.report.comparison.comparison import Comparison, PixelDifference, common_circle, compare_windows
from tofmix.report.page.templates import load_template
from tofmix.report.summary.tables import printable
from tofmix.wording import counted, number, percent_of

if TYPE_CHECKING:
    from tofmix.report.figures.picture import Picture


def format_comparison(comparison: Comparison, *, names: tuple[str, str], allow: float, shown_pairs: int = 5) -> str:
    """Format a comparison of the files `names` for the terminal, without a newline at the end.

    The `shown_pairs` most frequent pairs of numbers of surfaces are in it.
    """
    c = comparison
    image = f"{counted(c.rows, 'row')} x {counted(c.cols, 'column')}"
    lines = [
        *(f"{'AB'[k]}          {printable(names[k])}, of {printable(c.sources[k])}" for k in (0, 1)),
        f"recording  {'the same' if c.same_recording else 'not the same'}",
        f"pixels     {c.pixels} ({counted(c.windows, 'window')} of {image})",
        "",
        *(
            f"{name:<40}{count:>8}{percent_of(count, c.pixels):>9}"
            for name, count in (
                ("pixels that differ", c.different),
                ("  in the number of surfaces", c.count_differs),
                (f"  in a range, by over {c.tolerance:g} errors", c.range_differs),
                ("another status (no difference by itself)", c.status_differs),
            )
        ),
        "",
        f"layers compared   {c.layers_compared}, beyond tolerance {c.layers_differ}",
        f"range differences median {number(c.gap_median_mm, '.3g')} mm, largest {number(c.gap_largest_mm, '.3g')} mm",
        f"                  largest {number(c.gap_largest_errors, '.3g')} combined standard errors",
    ]
    lines += [f"surfaces {a} in A, {b} in B: {counted(count, 'pixel')}" for a, b, count in c.surfaces[:shown_pairs]]
    lines += [f"option {name}: {pair[0]} in A, {pair[1]} in B" for name, pair in c.options.items()]
    if c.pixels_shown:
        lines += ["", f"{'window':>6}{'row':>6}{'col':>6}{'errors':>8}  ranges in A | in B (mm)"]
        lines += [_pixel_line(pixel) for pixel in c.pixels_shown]
        if len(c.pixels_shown) < c.different:
            lines.append(f"and {c.different - len(c.pixels_shown)} more pixels")
    lines += ["", "equal" if c.equal(allow) else "different"]
    return "\n".join(lines)


def _pixel_line(pixel: PixelDifference) -> str:
    sides = (" ".join(number(mm, ".1f") for mm in side) or "none" for side in (pixel.range_a_mm, pixel.range_b_mm))
    return f"{pixel.window:>6}{pixel.row:>6}{pixel.col:>6}{number(pixel.gap_errors, '.1f'):>8}  {' | '.join(sides)}"


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
