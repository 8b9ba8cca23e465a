import io

import numpy as np
import pytest

from tofmix.report.figures.images import category_image, colour_scale, gap_image
from tofmix.report.theme import DARK, LIGHT, Theme, drawing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "theme"),
    [((144, 176), LIGHT), ((144, 176), DARK), *((shape, LIGHT) for shape in ((1, 176), (40, 1), (1, 1), (3, 500)))],
)
def test_images_of_any_shape_are_drawn(shape: tuple[int, int], theme: Theme) -> None:
    gap_mm = np.full(shape, 2.0)
    gap_mm.flat[0] = np.nan
    categories = np.zeros(shape, dtype=np.uint8)
    with drawing(theme):
        for figure in (
            gap_image(gap_mm, no_data="no data", theme=theme),
            category_image(categories, names=("same", "other"), theme=theme),
        ):
            figure.savefig(io.BytesIO(), format="png")
            axes = figure.axes[0]
            assert (axes.get_xlabel(), axes.get_ylabel()) == ("column (pixels)", "row (pixels)")


def test_no_data_has_a_hatch_and_a_legend_entry() -> None:
    with drawing(LIGHT):
        figure = gap_image(np.array([[1.0, np.nan]]), no_data="nothing here", theme=LIGHT)
    assert [text.get_text() for legend in figure.legends for text in legend.get_texts()] == ["nothing here"]
    assert figure.axes[0].patch.get_hatch() == "////"


def test_colour_scale_holds_nearly_all() -> None:
    values = np.append(np.linspace(1000, 2000, 10_000), [9e9, np.nan])
    low, high = colour_scale(values, default=(0, 1))
    assert low < 1010
    assert 1990 < high < 2100
    assert colour_scale(np.array([np.nan]), default=(5, 6)) == (5, 6)
    assert colour_scale(np.array([7.0]), default=(5, 6)) == (6.0, 8.0)
