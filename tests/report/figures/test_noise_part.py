"""The page's part about learnt noise: which panels there are, what they draw, and what stands in the summary."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.alike import MakeLayers, MakeSource
from support.learnt_noises import ALL, SIGMA_MM, Parts, made
from support.noise_parts import skewed

from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.report.figures.noise_pictures import curve_figure, shape_figure, width_figure
from tofmix.report.page import render_page
from tofmix.report.pixels.single_pixels import single_pixels
from tofmix.report.summary.quantiles import ValueCounts
from tofmix.report.summary.summary import has_more_than_a_curve, noise_numbers, summarise
from tofmix.report.summary.tables import COLUMNS, format_table
from tofmix.report.theme import LIGHT, drawing
from tofmix.sensor import NoiseCurve, Sensor

IMAGE, FRAMES = (6, 8), 50
PANELS = ("Sigma of single pixels", "Shape of the error", "Widths of the pixels", "Background")


def layers_of(parts: Parts) -> Layers:
    """Layers of one surface in most pixels, with widths where the parts have them."""
    layers = Layers.empty(IMAGE, 3)
    case = made(parts, frames=FRAMES, image=IMAGE)
    layers.n_modes[...], layers.n_peaks[...], layers.n_samples[...] = 1, 1, FRAMES
    layers.n_modes[0, 0] = 0
    layers.range[..., 0], layers.sigma[..., 0] = case.range_mm, SIGMA_MM * case.width
    layers.weight[..., 0], layers.weight_outlier[...] = 1.0 - parts.background, parts.background
    layers.weight_no_return[...] = 0.0
    if parts.width_spread:
        layers = replace(layers, noise_width=case.width.astype(np.float32))
    return layers


def text_of(page: str) -> str:
    """The part of the page, without its pictures."""
    part = page.partition("<h2>Noise</h2>")[2]
    return re.sub(r"data:[^\"]*", "", part)


def page_of(parts: Parts, make_source: MakeSource, *, recorded: bool = True) -> str:
    case = made(parts, frames=FRAMES, image=IMAGE)
    source = make_source(layers_of(parts), sensor=case.sensor)
    recording = ArrayRecording(case.samples_mm.astype(np.float32), case.sensor) if recorded else None
    return render_page(source, recording=recording)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "panels", "recorded"),
    [
        (ALL, {0, 1, 2, 3}, True),
        (Parts(shape=skewed(1.0)), {0, 1}, True),
        (Parts(width_spread=0.2), {0, 2}, True),
        (Parts(background=0.2), {0, 3}, True),
        (Parts(drift_mm=(40.0, 0.0, 0.0)), {0}, False),
        (Parts(memory=0.3), {0}, True),
    ],
)
def test_each_learnt_part_has_its_panel_and_no_other(
    parts: Parts, panels: set[int], recorded: bool, make_source: MakeSource
) -> None:
    said = text_of(page_of(parts, make_source, recorded=recorded))
    for number, title in enumerate(PANELS):
        assert (f"<h3>{title}</h3>" in said) == (number in panels), title
    assert ("times the curve (median)" in said) == recorded
    assert ("With --recording the points" in said) != recorded
    assert ("drift" in said.partition("<figure")[0]) == any(parts.drift_mm)
    assert ("memory 0.3" in said) == (parts.memory == 0.3)


def test_gaussian_curves_and_files_without_learning_have_no_numbers(
    make_layers: MakeLayers, make_source: MakeSource
) -> None:
    curve = NoiseCurve(np.array([500.0]), np.array([30.0]))
    for sensor in (Sensor(name="bare"), Sensor(name="curve", noise=curve)):
        assert noise_numbers(sensor) is None
        assert not has_more_than_a_curve(sensor)
        summary = summarise(make_source(make_layers(), sensor=sensor))
        assert summary.as_dict()["noise"] is None
        assert "\nnoise" not in format_table(summary)
    sensor = Sensor(name="camera", noise=NoiseCurve(np.array([500.0]), np.array([30.0]), background=np.array(0.05)))
    numbers = noise_numbers(sensor, ValueCounts())
    assert numbers is not None
    assert numbers.line == "sigma 30 mm, Gaussian, background 5 to 5 % by pixel, widths alike"
    assert numbers.background is not None
    assert numbers.background.q50 == pytest.approx(0.05)
    assert (numbers.drift_mm, numbers.memory, numbers.widths, numbers.skewness) == (None, None, None, None)
    page = render_page(make_source(make_layers()))
    assert "<h2>Noise</h2>" not in page
    assert not any(title in page for title in PANELS)
    assert page.endswith(
        "</div>\n</main>\n<footer>Made by tofmix report. Ranges are radial, along each pixel's beam."
        "</footer>\n</body>\n</html>"
    )


def drawn(figure: Figure) -> Figure:
    """The figure, after it was written: nothing fails, or is off the paper."""
    figure.savefig(io.BytesIO(), format="svg")
    return figure


def test_the_curve_has_a_point_for_each_pixel_in_view() -> None:
    case = made(Parts(width_spread=0.2), frames=FRAMES, image=IMAGE)
    layers = layers_of(Parts(width_spread=0.2))
    layers.sigma[1, :2, 0] = 1.0e4
    singles = single_pixels(layers, case.provenance(), recording=None, start=0, stop=FRAMES)
    assert case.sensor.noise is not None
    with drawing(LIGHT):
        (axes,) = drawn(curve_figure(case.sensor.noise, singles, theme=LIGHT)).axes
    points, curve = axes.lines
    assert len(np.asarray(points.get_xdata())) == singles.range_mm.size - 2 == 45
    np.testing.assert_allclose(np.asarray(curve.get_ydata()), SIGMA_MM)
    assert axes.get_title(loc="left") == "2 pixels above this view"


def test_shape_is_drawn_with_the_gaussian_and_the_samples() -> None:
    case = made(Parts(shape=skewed(1.0)), frames=400, image=IMAGE)
    source = ArrayRecording(case.samples_mm.astype(np.float32), case.sensor)
    layers = layers_of(Parts())
    singles = single_pixels(layers, case.provenance(), recording=source, start=0, stop=400)
    assert case.sensor.noise is not None
    shape = case.sensor.noise.shape
    assert shape is not None
    with drawing(LIGHT):
        (axes,) = drawn(shape_figure(shape, singles, theme=LIGHT)).axes
    gaussian, learnt = axes.lines
    z = np.asarray(gaussian.get_xdata())
    np.testing.assert_allclose(np.asarray(gaussian.get_ydata()), np.exp(-z * z / 2) / np.sqrt(2 * np.pi))
    np.testing.assert_allclose(np.nan_to_num(np.asarray(learnt.get_ydata())), shape.pdf(z))
    assert axes.get_yscale() == "log"
    assert axes.get_title(loc="left").startswith("skewness 0.99, excess kurtosis 1.")
    bars = axes.patches[0].get_data()  # type: ignore[attr-defined]  # a StepPatch
    number = singles.errors.size * np.diff(shape.cdf(bars.edges))
    seen = bars.values * singles.errors.size * np.diff(bars.edges)
    assert (np.abs(seen - number) < 4.5 * np.sqrt(number + 1.0)).all()


@pytest.mark.parametrize("spread", [0.02, 0.2, 1.0])
def test_histogram_of_widths_is_drawn_with_the_learnt_spread(spread: float) -> None:
    widths = np.exp(spread * np.random.default_rng(2).standard_normal(4000))
    with drawing(LIGHT):
        (axes,) = drawn(width_figure(widths, spread, theme=LIGHT)).axes
    bars = axes.patches[0].get_data()  # type: ignore[attr-defined]  # a StepPatch
    assert bars.values.sum() == 4000
    (line,) = axes.lines
    places, heights = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    expected = np.interp(np.sqrt(bars.edges[1:] * bars.edges[:-1]), places, heights)
    assert np.abs(bars.values - expected).max() < 6.0 * np.sqrt(bars.values.max())
    assert expected.sum() == pytest.approx(4000, rel=0.05)
    assert len(axes.get_xticks()) >= 3


def test_the_summary_has_the_numbers_of_each_part(make_source: MakeSource) -> None:
    case = made(ALL, frames=FRAMES, image=IMAGE)
    summary = summarise(make_source(layers_of(ALL), sensor=case.sensor))
    noise = json.loads(json.dumps(summary.as_dict(), allow_nan=False))["noise"]
    assert noise["line"] == (
        "sigma 20 mm, skewed (1.0), background 15 to 15 % by pixel, widths differ by 20 %,"
        " pixels drift by 80 mm in a window, memory 0.1"
    )
    assert (noise["sigma_least_mm"], noise["sigma_most_mm"], noise["shape"]) == (20.0, 20.0, "skewed (1.0)")
    assert noise["skewness"] == pytest.approx(1.0, abs=0.02)
    assert (noise["width_spread"], noise["memory"], noise["drift_mm"]) == (0.2, 0.1, [40.0, 10.0, 5.0])
    assert noise["background"] == {"count": 48, "q05": 0.15, "q50": 0.15, "q95": 0.15}
    assert noise["widths"]["count"] == 47  # one pixel has no surface
    assert noise["widths"]["q50"] == pytest.approx(np.median(case.width.ravel()[1:]), rel=1e-6)
    assert noise["scatter_over_sigma"] is None
    table = format_table(summary)
    assert "\nnoise      sigma 20 mm, skewed (1.0), background" in table
    assert max(map(len, table.splitlines()[:8])) <= COLUMNS
