import base64
import re
from dataclasses import asdict

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure

from tofmix.report.theme import DARK, LIGHT, Format, Theme, drawing, drawn, mark_no_data


def sample_figure(theme: Theme) -> Figure:
    figure = Figure(figsize=(3, 2), layout="constrained")
    axes = figure.add_subplot(xlabel="x (m)")
    mark_no_data(axes, theme)
    axes.plot([0, 1], [1, 0], color=theme.accent)
    axes.scatter([0], [0], color=theme.layers[0])
    return figure


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_the_same_figure_gives_the_same_bytes(kind: Format) -> None:
    first, second = drawn(sample_figure, kind), drawn(sample_figure, kind)
    assert first == second
    assert first[0] != first[1]
    assert first[2] == (288, 192)


def test_dark_svg_has_no_light_colour_left() -> None:
    _, dark, _ = drawn(sample_figure, "svg")
    text = base64.b64decode(dark.partition(",")[2]).decode()
    colours = set(re.findall(r"#[0-9a-f]{6}\b", text))
    assert {DARK.paper, DARK.accent, DARK.layers[0], DARK.ink} <= colours
    assert not colours & {LIGHT.paper, LIGHT.accent, LIGHT.layers[0], LIGHT.ink}


def test_pictures_carry_no_date_and_no_version() -> None:
    for kind in ("png", "svg"):
        content = base64.b64decode(drawn(sample_figure, kind)[0].partition(",")[2])
        assert b"dc:date" not in content
        assert mpl.__version__.encode() not in content


def test_global_settings_are_left_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(mpl.rcParams, "font.size", 31.0)
    with drawing(DARK):
        assert mpl.rcParams["font.size"] == 10.0
    assert mpl.rcParams["font.size"] == 31.0


def test_light_colours_differ_so_that_recolouring_is_unique() -> None:
    light = asdict(LIGHT)
    colours = [light[k] for k in ("ink", "paper", "grid", "no_data", "hatch", "accent")] + list(LIGHT.layers)
    assert len(set(colours)) == len(colours)
