import base64
import io

import numpy as np
import pytest
from matplotlib import image

from tofmix.report.figures.rasters import (
    ABOVE,
    BELOW,
    bar_labels,
    count_colours,
    count_label,
    count_uri,
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


def test_counts_have_their_colours() -> None:
    counts = np.array([[0, 1, 2, 9, 1]], dtype=np.uint8)
    found = pixels(count_uri(counts, fitted=np.array([[True, True, True, True, False]]), theme=DARK))
    colours = count_colours(9, DARK)
    assert found == [[DARK.no_surface, colours[1], colours[2], colours[6], "none"]]


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
