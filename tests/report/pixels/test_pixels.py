"""Single pixels: their numbers, their neighbours, the growing density, and pixels of one layer beside the noise."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from scipy.integrate import trapezoid
from scipy.stats import norm
from support.learnt_noises import ALL, SIGMA_MM, Made, Parts, made
from support.made_up import LayersInMemory, made_up_layers
from support.noise_parts import skewed

from tofmix.arrays import FloatArray
from tofmix.estimation.peaks.modes import find_modes
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.report.pixels.pixel_figures import growth_figure, neighbours_figure
from tofmix.report.pixels.pixels import (
    PixelView,
    format_growth,
    format_pixels,
    grow_density,
    neighbour_columns,
    view_pixels,
)
from tofmix.report.pixels.single_pixels import SinglePixels, single_pixels
from tofmix.report.theme import LIGHT, drawing
from tofmix.sensor import NoiseCurve, Sensor

SHAPE, MAX_LAYERS = (1, 3, 6), 3
LAYERS = LayersInMemory(made_up_layers(SHAPE, MAX_LAYERS)).read_window(0)
SENSOR = Sensor(
    name="camera", range_min_mm=500.0, range_max_mm=6000.0, noise=NoiseCurve(np.array([500.0]), np.array([30.0]))
)


def two_boards(frames: int = 80) -> np.ndarray[Any, np.dtype[np.float64]]:
    rng = np.random.default_rng(2)
    return rng.normal(np.where(rng.random(frames) < 0.4, 1500.0, 2500.0), 30.0)


def views(samples: np.ndarray[Any, Any] | None = None) -> list[PixelView]:
    return view_pixels(LAYERS, row=1, cols=[1, 2, 3], samples=samples, noise=SENSOR.noise)


@given(cols=st.integers(1, 40), neighbours=st.integers(0, 15), data=st.data())
def test_neighbours_are_the_nearest_columns(cols: int, neighbours: int, data: st.DataObject) -> None:
    col = data.draw(st.integers(0, cols - 1))
    chosen = neighbour_columns(col, cols=cols, neighbours=neighbours)
    nearest = sorted(range(cols), key=lambda c: (abs(c - col), c < col))[: neighbours + 1]
    assert chosen == sorted(nearest)


def test_views_hold_the_layers_of_the_four_pixels_of_the_paper() -> None:
    assert neighbour_columns(92, cols=176, neighbours=3) == [91, 92, 93, 94]
    for view in views():
        count = int(LAYERS.n_modes[1, view.col])
        for name, field in (("range_mm", "range"), ("range_stderr_mm", "range_stderr"), ("weight", "weight")):
            np.testing.assert_array_equal(getattr(view, name), getattr(LAYERS, field)[1, view.col, :count])
        described = view.as_dict()
        assert len(described["layers"]) == count
        assert described["samples_mm"] is None


def test_samples_are_the_valid_ones_in_order() -> None:
    samples = np.stack([two_boards()] * 6, axis=1)
    samples[[3, 9], 2] = np.nan
    one, two, _ = views(samples)
    assert one.samples_mm is not None
    assert two.samples_mm is not None
    np.testing.assert_array_equal(one.samples_mm, two_boards())
    np.testing.assert_array_equal(two.samples_mm, np.delete(two_boards(), [3, 9]))
    assert two.modes_mm is not None
    np.testing.assert_allclose(two.modes_mm, [1500, 2500], atol=30)
    nothing = view_pixels(LAYERS, row=1, cols=[1], samples=np.full((4, 6), np.nan), noise=SENSOR.noise)[0]
    assert nothing.samples_mm is not None
    assert nothing.samples_mm.size == 0
    assert nothing.modes_mm is None


@pytest.mark.slow
def test_density_over_all_samples_equals_the_last_step_of_its_growth() -> None:
    samples = two_boards()
    growth = grow_density(samples, SENSOR)
    assert growth.n_samples == tuple(range(1, 81))
    assert SENSOR.noise is not None
    np.testing.assert_allclose(growth.modes_mm[-1], find_modes(samples, SENSOR.noise), atol=30 / 8)
    assert [number for number, _ in growth.snapshots] == [4, 12, 24, 48, 80]
    for _, p in growth.snapshots:
        assert trapezoid(p, growth.range_mm) == pytest.approx(1.0, abs=1e-3)
    counts = [len(modes) for modes in growth.modes_mm]
    changes = growth.changes()
    assert changes[0] == 0
    assert changes[-1] == 79
    for first, after in pairwise(changes):
        assert len(set(counts[first:after])) == 1
    with pytest.raises(ValueError, match="no valid sample"):
        grow_density(np.zeros(0), SENSOR)


def test_the_table_names_every_number() -> None:
    text = format_pixels(views(np.stack([two_boards()] * 6, axis=1)), 2)
    assert text.startswith("row 1, column 2: ")
    assert text.isascii()
    for view in views():
        assert view.name in text
        for mm in view.range_mm:
            assert f"{mm:.2f}" in text
    grown = format_growth(grow_density(two_boards(), SENSOR))
    assert grown.splitlines()[-1].split()[:2] == ["80", "2"]


def _lines(axes: Axes) -> list[tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]]:
    return [
        (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.lines
        if len(np.asarray(line.get_xdata())) > 100
    ]


def test_the_figure_draws_components_density_and_samples() -> None:
    shown = views(np.stack([two_boards()] * 6, axis=1))
    with drawing(LIGHT):
        panels = neighbours_figure(shown, noise=SENSOR.noise, theme=LIGHT).axes
    assert len(panels) == 4
    assert not panels[3].get_visible()
    for axes, view in zip(panels, shown, strict=False):
        *components, (range_m, density) = _lines(axes)
        assert len(components) == len(view.range_mm)
        for k, (at, p) in enumerate(components):
            expected = view.weight[k] * norm.pdf(at, view.range_mm[k] / 1000, view.sigma_mm[k] / 1000)
            np.testing.assert_allclose(p, expected, atol=1e-9)
        assert trapezoid(density, range_m) == pytest.approx(1.0, abs=0.02)
        stairs = next(patch for patch in axes.patches if hasattr(patch, "get_data"))
        heights, edges, _ = stairs.get_data()
        assert (heights * np.diff(edges)).sum() == pytest.approx(1.0)
        assert axes.get_title(loc="left").startswith(view.name)


def test_figures_of_empty_pixels_and_of_growth_are_drawn() -> None:
    empty = made_up_layers((3, 6), 2)
    empty.n_modes[...] = 0
    shown = view_pixels(empty, row=0, cols=[0], samples=np.full((4, 6), np.nan), noise=None)
    with drawing(LIGHT):
        (axes,) = neighbours_figure(shown, noise=None, theme=LIGHT).axes
    assert not _lines(axes)
    growth = grow_density(two_boards(), SENSOR)
    with drawing(LIGHT):
        panels = growth_figure(growth, views()[0], theme=LIGHT).axes
    assert len(panels) == len(growth.snapshots) + 1
    dots = next(line for line in panels[-1].lines if line.get_marker() == ".")
    assert len(np.asarray(dots.get_xdata())) == sum(len(modes) for modes in growth.modes_mm)


CIRCLE_MM = 5000.0


def at_the_fold(frames: int = 200) -> tuple[PixelView, np.ndarray[Any, np.dtype[np.float64]]]:
    """A surface at 4990 mm of a circle of 5000, read on both sides of the fold, and one at 2500."""
    rng = np.random.default_rng(4)
    samples = rng.normal(np.where(rng.random(frames) < 0.5, 4990.0, 2500.0), 30.0) % CIRCLE_MM
    layers = LayersInMemory(made_up_layers((1, 1, 1), 2)).read_window(0)
    layers.n_modes[...] = 2
    layers.range[...], layers.sigma[...], layers.weight[...] = (2500.0, 4990.0), 30.0, 0.5
    (view,) = view_pixels(
        layers, row=0, cols=[0], samples=samples[:, None], noise=SENSOR.noise, unambiguous_range_mm=CIRCLE_MM
    )
    return view, samples


@pytest.mark.slow
def test_a_surface_across_the_fold_has_one_mode_and_is_drawn_in_one_piece() -> None:
    view, samples = at_the_fold()
    assert view.modes_mm is not None
    apart = (view.modes_mm - np.array([2500.0, 4990.0]) + 2500) % CIRCLE_MM - 2500
    assert np.abs(apart).max() < 15  # half a sigma
    with drawing(LIGHT):
        (axes,) = neighbours_figure([view], noise=SENSOR.noise, theme=LIGHT, unambiguous_range_mm=CIRCLE_MM).axes
        low, high = axes.get_xlim()
        assert 1.25 < low < 2.4 and 5.1 < high < 6.25  # noqa: PT018  the limits of one view, in m
        assert axes.get_xlabel() == "range (m); 0 again at 5.000"
    growth = grow_density(
        samples,
        Sensor(name="camera", range_min_mm=0.0, range_max_mm=4800.0, noise=SENSOR.noise),
        unambiguous_range_mm=CIRCLE_MM,
    )
    assert len(growth.modes_mm[-1]) == 2
    opened = growth.opened(1250.0, CIRCLE_MM)
    assert np.all(np.diff(opened.range_mm) > 0)
    assert trapezoid(opened.snapshots[-1][1], opened.range_mm) == pytest.approx(1.0, abs=0.01)
    with drawing(LIGHT):
        assert growth_figure(growth, view, theme=LIGHT, unambiguous_range_mm=CIRCLE_MM).axes


def true_layers(case: Made, *, background: float = 0.0) -> Layers:
    """Layers of one surface in each pixel, as a perfect estimator would have them."""
    layers = Layers.empty(case.range_mm.shape, 2)
    layers.n_modes[...] = 1
    layers.range[..., 0], layers.sigma[..., 0] = case.range_mm, SIGMA_MM * case.width
    layers.weight[..., 0], layers.weight_outlier[...] = 1.0 - background, background
    return layers


def looked_at(case: Made, layers: Layers, samples: FloatArray | None = None) -> SinglePixels:
    samples = case.samples_mm if samples is None else samples
    source = ArrayRecording(samples.astype(np.float32), case.sensor)
    return single_pixels(layers, case.provenance(), recording=source, start=0, stop=len(samples))


@pytest.mark.parametrize(
    "parts",
    [
        Parts(),
        Parts(shape=skewed(1.0)),
        Parts(background=0.3),
        Parts(drift_mm=(60.0, 20.0, 10.0)),
        Parts(width_spread=0.2),
        ALL,
    ],
)
def test_half_the_central_width_is_sigma_for_any_other_parts(parts: Parts) -> None:
    case = made(parts, frames=60, image=(20, 30), seed=2)
    spread = looked_at(case, true_layers(case, background=parts.background)).spread()
    assert spread is not None
    assert spread.count == 600
    assert spread.q50 == pytest.approx(float(np.median(case.width)), rel=0.03)


def test_width_of_a_pixel_is_its_own_with_and_without_the_recording() -> None:
    case = made(Parts(width_spread=0.4), frames=900, image=(3, 4))
    found = looked_at(case, true_layers(case))
    np.testing.assert_allclose(found.over_curve, case.width.ravel(), rtol=0.15)
    np.testing.assert_allclose(found.range_mm, case.range_mm.ravel(), rtol=1e-6)
    case = made(Parts(width_spread=0.3), frames=2, image=(4, 5))
    found = single_pixels(true_layers(case), case.provenance(), recording=None, start=0, stop=2)
    assert not found.from_samples
    np.testing.assert_allclose(found.over_curve, case.width.ravel(), rtol=1e-6)
    assert found.errors.size == 0


def test_errors_have_the_shape_less_the_background() -> None:
    case = made(ALL, frames=60, image=(20, 30))
    found = looked_at(case, true_layers(case, background=0.15))
    edges = np.array([-1.0, 0.0, 1.0, 3.0])
    share = np.histogram(found.errors, edges)[0] / found.errors.size
    surface = (share - found.background * np.diff(edges)) / found.held
    assert ALL.shape is not None
    np.testing.assert_allclose(surface, np.diff(ALL.shape.cdf(edges)), atol=0.02)


def test_large_images_and_long_windows_are_thinned_out_evenly() -> None:
    case = made(Parts(), frames=20, image=(60, 50))
    found = looked_at(case, true_layers(case))
    assert found.pixels_of_one_layer == 3000
    assert found.range_mm.size == 1000
    assert found.range_mm[[0, -1]].tolist() == pytest.approx([1500.0, 3000.0])
    long = made(Parts(drift_mm=(60.0, 20.0, 10.0)), frames=3500, image=(1, 2))
    few = looked_at(long, true_layers(long))
    assert few.errors.size == 2 * 875
    np.testing.assert_allclose(few.over_curve, 1.0, atol=0.12)
