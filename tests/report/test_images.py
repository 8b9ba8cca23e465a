import io

import numpy as np
import pytest
from matplotlib.figure import Figure

from tofmix.report.images import colour_scale, count_colours, count_image, range_image
from tofmix.report.theme import DARK, LIGHT, Theme, drawing


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("shape", [(144, 176), (1, 176), (40, 1), (1, 1), (3, 500)])
@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_images_of_any_shape_are_drawn(shape: tuple[int, int], theme: Theme) -> None:
    range_mm = np.full(shape, 2000.0)
    range_mm.flat[0] = np.nan
    counts = np.zeros(shape, dtype=np.uint8)
    with drawing(theme):
        for figure in (
            range_image(range_mm, scale=(1000, 3000), no_data="no data", theme=theme),
            count_image(counts, fitted=np.isfinite(range_mm), theme=theme),
        ):
            figure.savefig(io.BytesIO(), format="png")
            axes = figure.axes[0]
            assert (axes.get_xlabel(), axes.get_ylabel()) == ("column (pixels)", "row (pixels)")


def test_no_data_has_a_hatch_and_a_legend_entry() -> None:
    with drawing(LIGHT):
        figure = range_image(np.array([[1.0, np.nan]]), scale=(0, 2), no_data="nothing here", theme=LIGHT)
    assert labels(figure) == ["nothing here"]
    assert figure.axes[0].patch.get_hatch() == "////"
    assert figure.axes[1].get_ylabel() == "range (mm)"


def test_an_image_without_gaps_has_no_legend() -> None:
    with drawing(LIGHT):
        assert labels(range_image(np.ones((2, 2)), scale=(0, 2), no_data="x", theme=LIGHT)) == []


def test_counts_that_occur_are_in_the_legend() -> None:
    counts = np.array([[0, 1, 1, 2, 9]], dtype=np.uint8)
    with drawing(LIGHT):
        figure = count_image(counts, fitted=np.array([[True, True, True, True, True]]), theme=LIGHT)
        partly = count_image(counts, fitted=counts < 2, theme=LIGHT)
        nothing = count_image(counts, fitted=counts > 9, theme=LIGHT)
    assert labels(figure) == ["no surface", "1 surface", "2 surfaces", "6 or more"]
    assert labels(partly) == ["no surface", "1 surface", "not fitted"]
    assert labels(nothing) == ["not fitted"]


def test_count_colours_differ_and_grow_lighter() -> None:
    colours = count_colours(6, LIGHT)
    assert len(set(colours)) == 7
    channels = ((0.2126, 1), (0.7152, 3), (0.0722, 5))
    lightness = [sum(w * int(c[i : i + 2], 16) for w, i in channels) for c in colours[1:]]
    assert lightness == sorted(lightness)


def test_colour_scale_holds_nearly_all() -> None:
    values = np.append(np.linspace(1000, 2000, 10_000), [9e9, np.nan])
    low, high = colour_scale(values, default=(0, 1))
    assert low < 1010
    assert 1990 < high < 2100
    assert colour_scale(np.array([np.nan]), default=(5, 6)) == (5, 6)
    assert colour_scale(np.array([7.0]), default=(5, 6)) == (6.0, 8.0)
