import numpy as np

from tofmix.report.figures.picture import (
    NO_DATA,
    NO_SURFACE,
    difference_picture,
    kinds_picture,
    most_of,
)


def test_differences_have_a_bar_with_zero_in_the_middle_and_hatched_pixels_a_legend() -> None:
    values = np.array([[1.0, np.nan]])
    picture = difference_picture(values, most=2.374, unit="mm", no_data="nothing here", title="", alt="")
    assert picture.bar == ("-2.4", "-1.2", "0.0", "1.2", "2.4")
    assert picture.legend == ((NO_DATA, "nothing here"),)
    small = difference_picture(values[:, :1], most=0.1, unit="mm", no_data="nothing here", title="", alt="")
    assert (small.bar[0], small.bar[1], small.legend) == ("-0.10", "-0.05", ())


def test_ends_of_the_colours_hold_nearly_all_values() -> None:
    values = np.append(np.linspace(-1.0, 1.0, 10_000), [1e9, np.nan])
    assert 0.99 < most_of(values, least=0.1) < 1.1
    assert most_of(np.array([np.nan]), least=0.1) == 0.1


def test_legend_has_the_kinds_that_occur_and_themes_differ() -> None:
    kinds = np.array([[0, 2, 9]], np.uint8)
    colours = (NO_SURFACE, "#ff0000", "var(--layer-1)")
    picture = kinds_picture(kinds, names=("none", "b", "c"), colours=colours, no_data="rest", title="", alt="")
    assert picture.legend == ((NO_SURFACE, "none"), ("var(--layer-1)", "c"), (NO_DATA, "rest"))
    assert picture.light != picture.dark
