"""The figure of neighbouring pixels under learnt noise: mixture, components, background, and what is said of them."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from scipy.integrate import trapezoid
from support.learnt_noises import ALL, SIGMA_MM, Parts, camera

from tofmix.arrays import FloatArray
from tofmix.layers import Layers, Provenance
from tofmix.report.pixels.pixel_figures import neighbours_figure
from tofmix.report.pixels.pixels import PixelView, format_pixels, learnt_sensor, view_pixels
from tofmix.report.theme import LIGHT, drawing
from tofmix.sensor import Sensor

FRAMES = 60


def one_pixel(ranges: tuple[float, ...], background: float, width: float) -> Layers:
    """Layers of a single pixel with surfaces of equal shares."""
    count = len(ranges)
    layers = replace(Layers.empty((1, 1), 3), noise_width=np.full((1, 1), width, np.float32))
    layers.n_modes[...], layers.n_samples[...], layers.weight_outlier[...] = count, FRAMES, background
    layers.weight_no_return[...] = 0.0
    layers.range[0, 0, :count], layers.sigma[0, 0, :count] = ranges, SIGMA_MM * width
    layers.weight[0, 0, :count], layers.range_stderr[0, 0, :count] = (1.0 - background) / max(1, count), 2.0
    return layers


def viewed(
    sensor: Sensor, layers: Layers, samples: FloatArray | None = None, circle_mm: float | None = None
) -> PixelView:
    (view,) = view_pixels(
        layers,
        row=0,
        cols=[0],
        samples=None if samples is None else samples[:, np.newaxis],
        noise=sensor.noise,
        unambiguous_range_mm=circle_mm,
        learnt=sensor,
    )
    return view


def panel(view: PixelView, sensor: Sensor, circle_mm: float | None = None) -> Axes:
    with drawing(LIGHT):
        figure = neighbours_figure([view], noise=sensor.noise, theme=LIGHT, unambiguous_range_mm=circle_mm)
        figure.draw_without_rendering()
    return figure.axes[0]


def texts(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def drawn_line(axes: Axes) -> tuple[FloatArray, FloatArray]:
    """The line over all others: ranges in mm, density in 1/m."""
    lines = [line for line in axes.lines if line.get_color() == LIGHT.ink and line.get_linestyle() == "-"]
    return 1000.0 * np.asarray(lines[0].get_xdata()), np.asarray(lines[0].get_ydata())


def test_the_line_is_the_learnt_shape_at_the_pixels_own_width_on_its_background() -> None:
    parts = Parts(shape=ALL.shape, width_spread=0.2, background=0.2)
    sensor = camera(parts, (1, 1))
    samples = 2000.0 + SIGMA_MM * np.random.default_rng(1).standard_normal(FRAMES)
    samples[:3] = [400.0, 4000.0, 5000.0]
    axes = panel(viewed(sensor, one_pixel((2000.0,), 0.2, 1.5), samples), sensor)
    range_mm, p = drawn_line(axes)
    assert parts.shape is not None
    wide = 1.5 * SIGMA_MM
    expected = 0.8 * parts.shape.pdf((range_mm - 2000.0) / wide) / wide + 0.2 / 5000.0
    np.testing.assert_allclose(p, 1000.0 * expected, atol=0.01 * p.max())
    assert texts(axes) == ["60 samples, 3 outside", "2000.0 ± 2.0 mm, share 0.80", "width 1.50, background 20.0 %"]
    assert range_mm[0] > 1000.0  # background does not stretch the view
    assert range_mm[-1] < 3000.0


def test_a_drifting_pixel_is_drawn_as_wide_as_its_samples_lie() -> None:
    sensor = camera(Parts(drift_mm=(100.0, 0.0, 0.0)), (1, 1))
    time = np.linspace(-1.0, 1.0, FRAMES)
    samples = 2000.0 + 100.0 * time + SIGMA_MM * np.random.default_rng(2).standard_normal(FRAMES)
    layers = one_pixel((2000.0,), 1e-4, 1.0)
    view = viewed(sensor, layers, samples)
    axes = panel(view, sensor)
    range_mm, p = drawn_line(axes)
    assert trapezoid(p, range_mm / 1000.0) == pytest.approx(1.0, abs=0.01)
    spread = np.sqrt(trapezoid(p * (range_mm - 2000.0) ** 2, range_mm / 1000.0))
    assert spread == pytest.approx(samples.std(), rel=0.1)
    assert any(line.endswith("mm in the window") for line in texts(axes)[-1].splitlines())
    still = viewed(sensor, layers)
    assert texts(panel(still, sensor))[-1].endswith("drift not known")
    assert still.as_dict()["learnt_noise"] == {"width": 1.0, "background": pytest.approx(1e-4), "drift_mm": None}
    assert "drift (mm): 20" in format_pixels([view], 0) or "drift (mm): 19" in format_pixels([view], 0)


def test_each_component_is_drawn_with_the_shape() -> None:
    sensor = camera(Parts(shape=ALL.shape), (1, 1))
    axes = panel(viewed(sensor, one_pixel((2000.0, 2300.0), 0.0, 1.0)), sensor)
    range_mm, total = drawn_line(axes)
    parts = [np.asarray(line.get_ydata()) for line in axes.lines if line.get_color() in LIGHT.layers[:2]]
    parts = [part for part in parts if part.size == range_mm.size]
    np.testing.assert_allclose(sum(parts), total, atol=1e-9)
    above = [
        float(trapezoid(np.where(range_mm > at, part, 0.0), range_mm))
        for at, part in zip((2000, 2300), parts, strict=True)
    ]
    assert above == pytest.approx([250.0, 250.0], rel=0.02)  # the median is at the layer, whatever the skewness
    assert range_mm[parts[0].argmax()] < 1998.0  # the mode is before it


def test_the_mixture_of_a_circle_is_drawn_across_the_fold() -> None:
    length = 5300.0
    sensor = camera(Parts(shape=ALL.shape), (1, 1))
    samples = np.mod(SIGMA_MM * np.random.default_rng(3).standard_normal(FRAMES), length)
    axes = panel(viewed(sensor, one_pixel((5.0,), 0.1, 1.0), samples, length), sensor, length)
    range_mm, p = drawn_line(axes)
    assert trapezoid(p, range_mm / 1000.0) == pytest.approx(0.9, abs=0.02)


def test_layers_with_impossible_numbers_have_no_component() -> None:
    sensor = camera(Parts(drift_mm=(40.0, 0.0, 0.0)), (1, 1))
    layers = one_pixel((1500.0, 2000.0), 0.1, 1.0)
    layers.sigma[0, 0, 0] = np.nan
    view = viewed(sensor, layers, 2000.0 + SIGMA_MM * np.random.default_rng(5).standard_normal(FRAMES))
    assert view.mixture is not None
    range_mm = np.linspace(1000.0, 3000.0, 2001)
    assert not view.mixture.component(0, range_mm).any()
    assert trapezoid(view.mixture.component(1, range_mm), range_mm) == pytest.approx(0.45, abs=0.01)


def test_a_pixel_without_a_layer_is_drawn() -> None:
    sensor = camera(ALL, (1, 1))
    samples = np.random.default_rng(4).uniform(400.0, 5200.0, FRAMES)
    axes = panel(viewed(sensor, one_pixel((), 1.0, 1.0), samples), sensor)
    _, p = drawn_line(axes)
    np.testing.assert_allclose(p, 1000.0 / 5000.0)


@pytest.mark.parametrize(
    ("options", "counted"),
    [
        ({}, True),
        ({"sigma": "prior", "refine": "likelihood"}, True),
        ({"sigma": "tied"}, True),
        ({"sigma": "free"}, False),
        ({"refine": "none"}, False),
        ({"paper": 1}, False),
    ],
)
def test_layers_of_free_sigmas_or_of_peaks_have_no_learnt_mixture(
    options: dict[str, str | int | float], counted: bool
) -> None:
    made_with = Provenance(source="a.h5", source_sha256="ab", version="1", sensor=camera(ALL, (1, 1)), options=options)
    assert (learnt_sensor(made_with) is not None) == counted
    assert learnt_sensor(replace(made_with, sensor=replace(made_with.sensor, learnt=None))) is None
