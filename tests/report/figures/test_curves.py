import io
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from tofmix.layers import Layers
from tofmix.report.figures.curves import range_histogram, sigma_figure, weight_histogram
from tofmix.report.theme import LIGHT, drawing
from tofmix.sensor import NoiseCurve

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
