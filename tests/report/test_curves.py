import io
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from tofmix.layers import Layers
from tofmix.report.curves import Section, range_histogram, section_figure, sigma_figure, weight_histogram
from tofmix.report.theme import LIGHT, drawing
from tofmix.sensor import NoiseCurve

CURVE = NoiseCurve(np.array([500.0, 7500.0]), np.array([9.0, 430.0]))


def section(cols: int, *, fov: float | None = 47.0, layers: int = 3) -> Section:
    range_mm = np.full((cols, layers), np.nan)
    range_mm[:, 0] = 2000.0
    range_mm[cols // 2, : min(2, layers)] = [2000.0, 4000.0][: min(2, layers)]
    weight, averaged_mm = np.full((cols, layers), 0.5), np.full(cols, 2500.0)
    return Section(range_mm=range_mm, weight=weight, averaged_mm=averaged_mm, fov_horizontal_deg=fov)


def saved(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg")
    return buffer.getvalue()


def test_section_places_points_by_the_field_of_view() -> None:
    with drawing(LIGHT):
        figure = section_figure(section(5), theme=LIGHT)
        axes = figure.axes[0]
        points = np.asarray(axes.collections[1].get_offsets())
    azimuth = np.deg2rad((np.arange(5) - 2) * 47.0 / 5)
    np.testing.assert_allclose(points, np.stack([2.5 * np.sin(azimuth), 2.5 * np.cos(azimuth)], axis=-1))
    assert axes.get_aspect() == 1.0
    assert "(m)" in axes.get_xlabel()


def test_a_line_joins_the_layers_of_one_pixel() -> None:
    with drawing(LIGHT):
        segments = section_figure(section(5), theme=LIGHT).axes[0].collections[0].get_segments()  # type: ignore[attr-defined]
    assert len(segments) == 1
    np.testing.assert_allclose(segments[0], [[0, 2.0], [0, 2.5], [0, 4.0]], atol=1e-12)


def test_section_without_a_field_of_view_is_over_columns() -> None:
    with drawing(LIGHT):
        axes = section_figure(section(5, fov=None), theme=LIGHT).axes[0]
    assert axes.get_xlabel() == "column (pixels)"
    assert axes.get_ylabel() == "range (m)"


def test_averaged_points_out_of_view_are_counted() -> None:
    case = section(5)
    case.averaged_mm[:] = [90_000.0, 90_000.0, 2500.0, 2000.0, np.nan]
    with drawing(LIGHT):
        title = section_figure(case, theme=LIGHT).axes[0].get_title(loc="left")
    assert title.startswith("2 averaged points")


@pytest.mark.parametrize(("cols", "layers"), [(1, 1), (1, 4), (2, 1), (4000, 2)])
def test_sections_of_any_size_are_drawn(cols: int, layers: int) -> None:
    with drawing(LIGHT):
        assert saved(section_figure(section(cols, layers=layers), theme=LIGHT))


def test_long_sections_are_rasterised() -> None:
    with drawing(LIGHT):
        assert len(saved(section_figure(section(20_000), theme=LIGHT))) < 1_000_000


@pytest.mark.parametrize(("shape", "max_layers", "curve"), [((1, 1), 1, CURVE), ((1, 30), 5, None), ((9, 9), 5, CURVE)])
def test_histograms_are_drawn(
    shape: tuple[int, int], max_layers: int, curve: NoiseCurve | None, make_layers: Callable[..., Layers]
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


def test_sigmas_above_the_view_are_counted(make_layers: Callable[..., Layers]) -> None:
    layers = make_layers((50, 50))
    layers.sigma[0, 0, 0], layers.range[0, 0, 0] = 1e6, 2000.0
    with drawing(LIGHT):
        title = sigma_figure(layers, curve=CURVE, theme=LIGHT).axes[0].get_title(loc="left")
    assert "above this view" in title
