"""A comparison as a short plain text table for the terminal; for scripts use `Comparison.as_dict`."""

from tofmix.report.comparison.comparison import Comparison, PixelDifference
from tofmix.report.summary.tables import printable
from tofmix.wording import counted, number, percent_of


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
