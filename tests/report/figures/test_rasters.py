import base64
import io

import numpy as np
import pytest
from matplotlib import image

from tofmix.report.figures.rasters import (
    ABOVE,
    BELOW,
    bar_labels,
    colour_scale,
    count_colours,
    count_label,
    difference_shades,
    difference_uri,
    kinds_uri,
    pixel_ticks,
    range_shades,
    range_uri,
)
from tofmix.report.theme import DARK, LIGHT


def pixels(uri: str) -> list[list[str]]:
    """Colours of a picture, ``none`` where it is transparent."""
    content = base64.b64decode(uri.removeprefix("data:image/png;base64,"))
    rgba = (255 * image.imread(io.BytesIO(content), format="png")).round().astype(int)
    return [["#{:02x}{:02x}{:02x}".format(*p[:3]) if p[3] else "none" for p in row] for row in rgba.tolist()]


def test_ranges_have_the_colours_of_the_scale() -> None:
    shades = range_shades()
    found = pixels(range_uri(np.array([[1000.0, 2000.0, 3000.0], [999.0, 3001.0, np.nan]]), scale=(1000, 3000)))
    assert found == [[shades[0], shades[len(shades) // 2], shades[-1]], [BELOW, ABOVE, "none"]]


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (144, 176)])
def test_images_keep_their_shape(shape: tuple[int, int]) -> None:
    found = pixels(range_uri(np.full(shape, np.nan), scale=(0, 1)))
    assert (len(found), len(found[0])) == shape
    assert {colour for row in found for colour in row} == {"none"}


def test_kinds_have_their_colours_and_others_are_transparent() -> None:
    colours = count_colours(9, DARK)
    kinds = np.array([[0, 1, 6, 7]], dtype=np.uint8)
    assert pixels(kinds_uri(kinds, colours)) == [[DARK.no_surface, colours[1], colours[6], "none"]]


def test_differences_have_zero_in_the_middle_of_the_colours() -> None:
    shades = difference_shades()
    found = pixels(difference_uri(np.array([[-9.0, -2.0, 0.0, 2.0, 9.0, np.nan]]), most=2.0))
    assert found == [[shades[0], shades[0], shades[len(shades) // 2], shades[-1], shades[-1], "none"]]


def test_colour_scale_holds_nearly_all() -> None:
    values = np.append(np.linspace(1000, 2000, 10_000), [9e9, np.nan])
    low, high = colour_scale(values, default=(0, 1))
    assert low < 1010
    assert 1990 < high < 2100
    assert colour_scale(np.array([np.nan]), default=(5, 6)) == (5, 6)
    assert colour_scale(np.array([7.0]), default=(5, 6)) == (6.0, 8.0)


def test_count_colours_differ_and_grow_lighter() -> None:
    channels = ((0.2126, 1), (0.7152, 3), (0.0722, 5))
    for most, length in ((0, 4), (3, 4), (6, 7), (32, 7)):
        colours = count_colours(most, LIGHT)
        assert len(set(colours)) == length
        lightness = [sum(w * int(c[i : i + 2], 16) for w, i in channels) for c in colours[1:]]
        assert lightness == sorted(lightness)


def test_labels_name_counts_and_ranges() -> None:
    assert [count_label(n) for n in (0, 1, 2, 6, 7)] == [
        "no surface",
        "1 surface",
        "2 surfaces",
        "6 or more",
        "6 or more",
    ]
    assert bar_labels((1000.0, 3000.0)) == ("1000", "1500", "2000", "2500", "3000")


@pytest.mark.parametrize("count", [1, 2, 3, 16, 144, 640])
def test_ticks_lie_in_the_middle_of_their_pixels(count: int) -> None:
    ticks = pixel_ticks(count)
    assert ticks[0] == (round(50 / count, 2), 0)
    assert all(place == round(100 * (n + 0.5) / count, 2) and n < count for place, n in ticks)
    assert len({n for _, n in ticks}) == len(ticks) <= 8
