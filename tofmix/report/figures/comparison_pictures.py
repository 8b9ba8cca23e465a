"""The pictures of a comparison of two windows, each with its text."""

import numpy as np

from tofmix.layers import Layers
from tofmix.report.comparison import WindowDifference
from tofmix.report.figures.curves import gap_histogram
from tofmix.report.figures.picture import (
    NO_SURFACE,
    Picture,
    difference_picture,
    figure_picture,
    kinds_picture,
    most_of,
)
from tofmix.wording import counted

_CATEGORIES = ("the same", "another range", "fewer in B", "more in B")


def draw_comparison(a: Layers, b: Layers, found: WindowDifference, *, tolerance: float) -> tuple[Picture, ...]:
    """Draw where two windows differ, by how much the first layer does, and all differences in standard errors."""
    categories = np.zeros(a.n_modes.shape, dtype=np.uint8)
    categories[found.range_differs] = 1
    categories[b.n_modes < a.n_modes] = 2
    categories[b.n_modes > a.n_modes] = 3
    counts = np.bincount(categories.ravel(), minlength=len(_CATEGORIES)).tolist()
    told = "; ".join(f"{name}: {counted(count, 'pixel')}" for name, count in zip(_CATEGORIES, counts, strict=True))
    first = found.gap_mm[..., 0]
    known = np.abs(first[np.isfinite(first)])
    size = (
        f"Median size {np.median(known):.2f} mm, largest {known.max():.1f} mm." if known.size else "No pixel has one."
    )
    in_errors = np.abs(found.gap_errors[np.isfinite(found.gap_errors)])
    spread = f"{int((in_errors > tolerance).sum())} of {counted(in_errors.size, 'layer')} lie beyond the tolerance."
    return (
        kinds_picture(
            categories,
            names=_CATEGORIES,
            colours=(NO_SURFACE, "var(--layer-3)", "var(--layer-1)", "var(--accent)"),
            title="Where they differ",
            alt=f"Differences over the image plane. {told}.",
            shows="Pixels that have fewer or more surfaces, or a range beyond the tolerance.",
            good="Few pixels, and those along edges.",
            bad="Whole areas: the two differ in surfaces, or in the scene.",
        ),
        difference_picture(
            first,
            most=most_of(first, least=0.1),
            unit="mm",
            no_data="no such pair",
            title="First layer, B minus A",
            alt=f"Difference of the first layer's range over the image plane. {size}",
            shows="Range of the nearest surface in B minus that in A, where both have equally many surfaces.",
            good="Only random noise, or nothing at all.",
            bad="Areas of one colour: one of the two is biased.",
        ),
        figure_picture(
            lambda theme: gap_histogram(found.gap_errors, tolerance=tolerance, theme=theme),
            title="Differences in standard errors",
            alt=f"Histogram of the differences of all layers in combined standard errors. {spread}",
            shows="All pairs of layers. The curve is the distribution for two recordings of one scene.",
            good="Within the curve. Two estimates of one recording share its noise and lie far inside it.",
            bad="Wider than the curve or shifted: the standard errors do not explain the differences.",
        ),
    )
