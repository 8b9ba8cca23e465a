"""Curves, pictures, rasters and the theme."""

import base64
import io
import re
from dataclasses import asdict

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import image
from matplotlib.figure import Figure
from support.alike import MakeLayers

from tofmix.layers import Layers
from tofmix.report.figures.curves import range_histogram, sigma_figure, weight_histogram
from tofmix.report.figures.picture import (
    ABOVE,
    BELOW,
    NO_DATA,
    NO_SURFACE,
    bar_labels,
    colour_scale,
    count_colours,
    count_label,
    difference_picture,
    difference_shades,
    difference_uri,
    kinds_picture,
    kinds_uri,
    most_of,
    pixel_ticks,
    range_shades,
    range_uri,
)
from tofmix.report.figures.surface_pictures import edge_parts
from tofmix.report.theme import DARK, LIGHT, Theme, drawing, drawn, mark_no_data
from tofmix.sensor import NoiseCurve
from tofmix.surfaces.found import Edges, no_edges

CURVE = NoiseCurve(np.array([500.0, 7500.0]), np.array([9.0, 430.0]))


def saved(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("shape", "max_layers", "curve"),
    [
        pytest.param((1, 1), 1, CURVE, marks=pytest.mark.slow),
        pytest.param((1, 30), 5, None, marks=pytest.mark.slow),
        ((9, 9), 5, CURVE),
    ],
)
def test_histograms_are_drawn(
    shape: tuple[int, int], max_layers: int, curve: NoiseCurve | None, make_layers: MakeLayers
) -> None:
    empty = Layers.empty(shape, max_layers)
    with drawing(LIGHT):
        for layers in (make_layers(shape, max_layers=max_layers), empty):
            for figure in (
                range_histogram(layers, theme=LIGHT),
                weight_histogram(layers, theme=LIGHT),
                sigma_figure(layers, curve=curve, theme=LIGHT),
            ):
                assert saved(figure)
                assert figure.axes[0].get_xlabel().endswith(("(mm)", "(1)"))
                assert figure.axes[0].get_ylabel() in ("pixels", "sigma (mm)")


def test_bars_ends_and_legends_of_pictures_follow_their_values() -> None:
    values = np.array([[1.0, np.nan]])
    picture = difference_picture(values, most=2.374, unit="mm", no_data="nothing here", title="", alt="")
    assert picture.bar == ("-2.4", "-1.2", "0.0", "1.2", "2.4")
    assert picture.legend == ((NO_DATA, "nothing here"),)
    small = difference_picture(values[:, :1], most=0.1, unit="mm", no_data="nothing here", title="", alt="")
    assert (small.bar[0], small.bar[1], small.legend) == ("-0.10", "-0.05", ())
    values = np.append(np.linspace(-1.0, 1.0, 10_000), [1e9, np.nan])
    assert 0.99 < most_of(values, least=0.1) < 1.1
    assert most_of(np.array([np.nan]), least=0.1) == 0.1
    kinds = np.array([[0, 2, 9]], np.uint8)
    colours = (NO_SURFACE, "#ff0000", "var(--layer-1)")
    picture = kinds_picture(kinds, names=("none", "b", "c"), colours=colours, no_data="rest", title="", alt="")
    assert picture.legend == ((NO_SURFACE, "none"), ("var(--layer-1)", "c"), (NO_DATA, "rest"))
    assert picture.light != picture.dark


def pixels(uri: str) -> list[list[str]]:
    """Colours of a picture, ``none`` where it is transparent."""
    content = base64.b64decode(uri.removeprefix("data:image/png;base64,"))
    rgba = (255 * image.imread(io.BytesIO(content), format="png")).round().astype(int)
    return [["#{:02x}{:02x}{:02x}".format(*p[:3]) if p[3] else "none" for p in row] for row in rgba.tolist()]


def test_ranges_kinds_and_differences_have_their_colours() -> None:
    shades = range_shades()
    found = pixels(range_uri(np.array([[1000.0, 2000.0, 3000.0], [999.0, 3001.0, np.nan]]), scale=(1000, 3000)))
    assert found == [[shades[0], shades[len(shades) // 2], shades[-1]], [BELOW, ABOVE, "none"]]
    colours = count_colours(9, DARK)
    kinds = np.array([[0, 1, 6, 7]], dtype=np.uint8)
    assert pixels(kinds_uri(kinds, colours)) == [[DARK.no_surface, colours[1], colours[6], "none"]]
    shades = difference_shades()
    found = pixels(difference_uri(np.array([[-9.0, -2.0, 0.0, 2.0, 9.0, np.nan]]), most=2.0))
    assert found == [[shades[0], shades[0], shades[len(shades) // 2], shades[-1], shades[-1], "none"]]


def test_colour_scales_hold_nearly_all_and_counts_grow_lighter() -> None:
    values = np.append(np.linspace(1000, 2000, 10_000), [9e9, np.nan])
    low, high = colour_scale(values, default=(0, 1))
    assert low < 1010
    assert 1990 < high < 2100
    assert colour_scale(np.array([np.nan]), default=(5, 6)) == (5, 6)
    assert colour_scale(np.array([7.0]), default=(5, 6)) == (6.0, 8.0)
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


def _line(*places: tuple[float, float]) -> Edges:
    row, col = np.array(places, dtype=np.float32).T
    number = np.zeros(len(places), dtype=np.int32)
    return Edges(row=row, col=col, stderr=np.full(len(places), 0.01, np.float32), near=number, far=number, line=number)


def test_edges_mark_the_parts_that_they_run_through_without_gaps() -> None:
    marked = edge_parts(_line((1.0, 0.0), (1.0, 3.0)), (16, 24), 4)
    assert np.flatnonzero(marked.any(axis=1)).tolist() == [
        6
    ]  # the centre of pixel row 1 is the border of parts 5 and 6
    assert np.flatnonzero(marked.any(axis=0)).tolist() == list(range(2, 15))
    marked = edge_parts(_line((0.0, 0.0), (5.0, 2.0)), (64, 64), 8)
    rows = np.flatnonzero(marked.any(axis=1))
    assert rows.tolist() == list(range(rows[0], rows[-1] + 1))
    assert edge_parts(_line((-0.7, 0.0)), (16, 16), 4)[0].sum() == 1
    assert not edge_parts(no_edges(), (16, 16), 4).any()


def sample_figure(theme: Theme) -> Figure:
    figure = Figure(figsize=(3, 2), layout="constrained")
    axes = figure.add_subplot(xlabel="x (m)")
    mark_no_data(axes, theme)
    axes.plot([0, 1], [1, 0], color=theme.accent)
    axes.scatter([0], [0], color=theme.layers[0])
    return figure


def test_dark_svg_is_recoloured_wholly_and_pictures_carry_no_date() -> None:
    _, dark, _ = drawn(sample_figure, "svg")
    text = base64.b64decode(dark.partition(",")[2]).decode()
    colours = set(re.findall(r"#[0-9a-f]{6}\b", text))
    assert {DARK.paper, DARK.accent, DARK.layers[0], DARK.ink} <= colours
    assert not colours & {LIGHT.paper, LIGHT.accent, LIGHT.layers[0], LIGHT.ink}
    light = asdict(LIGHT)
    names = [light[k] for k in ("ink", "paper", "grid", "no_data", "hatch", "accent")] + list(LIGHT.layers)
    assert len(set(names)) == len(names)
    for kind in ("png", "svg"):
        content = base64.b64decode(drawn(sample_figure, kind)[0].partition(",")[2])
        assert b"dc:date" not in content
        assert mpl.__version__.encode() not in content
