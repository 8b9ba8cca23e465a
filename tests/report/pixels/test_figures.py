"""Figures of a pixel: the complex plane, and its neighbours under learnt noise."""

import io
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.text import Text
from scipy.integrate import trapezoid
from support.learnt_noises import ALL, SIGMA_MM, Parts, camera
from support.lock_in import Scene, small

from tofmix.arrays import FloatArray
from tofmix.estimation.blocks.sequence import estimate_windows
from tofmix.flags import Mixing
from tofmix.layers import Layers, Provenance
from tofmix.recording import ArrayRecording
from tofmix.report.pixels.phasor_plane import PhasorEnd, PhasorPlane, SamplesAround, phasor_plane, read_around
from tofmix.report.pixels.pixel_figures import draw_plane, neighbours_figure
from tofmix.report.pixels.pixels import PixelView, learnt_sensor, view_pixels
from tofmix.report.theme import LIGHT, drawing, new_figure
from tofmix.sensor import Sensor

K_MM = 299_792_458_000.0 / (2.0 * 20.0e6) / (2.0 * math.pi)
"""d_u / 2 pi of 20 MHz, from the speed of light."""


@pytest.fixture(scope="module")
def sums() -> Scene:
    """Phasor sums of two boards before a wall."""
    return small(1)


@pytest.fixture(scope="module")
def layers(sums: Scene) -> Layers:
    """The layers that were found in them."""
    found = estimate_windows(sums.recording).layers
    return Layers(**{spec.name: getattr(found, spec.name)[0] for spec in found.fields})


def plane_of(scene: Scene, layers: Layers, row: int, col: int) -> PhasorPlane:
    """A pixel of a recording of one window."""
    source = scene.recording
    around = read_around(source, row=row, col=col, start=0, stop=source.shape[0])
    assert around is not None
    return phasor_plane(layers, around, source.sensor, row=row, col=col)


def pixel_of(layers: Layers, kind: Mixing, n_modes: int) -> tuple[int, int]:
    """The first pixel of a kind that is not at the edge of the image."""
    assert layers.mixing is not None
    chosen = np.argwhere((layers.mixing[5:-5, 5:-5] == int(kind)) & (layers.n_modes[5:-5, 5:-5] == n_modes))
    return int(chosen[0, 0]) + 5, int(chosen[0, 1]) + 5


@pytest.mark.parametrize(("pixel", "count"), [((20, 20), 48), ((0, 0), 15), ((47, 30), 27)])
def test_neighbours_within_three_pixels_are_shown_without_the_pixel_itself(
    sums: Scene, layers: Layers, pixel: tuple[int, int], count: int
) -> None:
    plane = plane_of(sums, layers, *pixel)
    assert plane.neighbours.shape == plane.neighbour_is_single.shape == (count,)
    assert plane.mean is not None
    assert np.abs(plane.neighbours - plane.mean).min() > 0


def test_ends_and_flags_of_mixing_are_those_of_the_layers(sums: Scene, layers: Layers) -> None:
    row, col = pixel_of(layers, Mixing.PHASOR, 2)
    plane = plane_of(sums, layers, row, col)
    assert layers.mixing is not None
    kinds = layers.mixing[row - 3 : row + 4, col - 3 : col + 4].ravel()
    kinds = np.delete(kinds, 24)  # the pixel itself
    np.testing.assert_array_equal(plane.neighbour_is_single, kinds == int(Mixing.ONE_SURFACE))
    assert 0 < plane.neighbour_is_single.sum() < 48
    assert layers.mixing is not None
    other = replace(layers, mixing=np.full(layers.shape, int(Mixing.UNDECIDED), np.uint8))
    row, col = pixel_of(layers, Mixing.PHASOR, 2)
    assert len(plane_of(sums, layers, row, col).ends) == 2
    assert plane_of(sums, other, row, col).ends == ()
    samples = read_around(sums.recording, row=1, col=1, start=0, stop=10)
    assert samples is not None
    with pytest.raises(ValueError, match="mixing"):
        phasor_plane(replace(layers, mixing=None), samples, sums.sensor, row=1, col=1)
    with pytest.raises(ValueError, match="frequency"):
        phasor_plane(layers, samples, replace(sums.sensor, modulation_frequency_hz=None), row=1, col=1)


def test_the_mean_is_the_sum_of_the_ends_by_their_shares(sums: Scene, layers: Layers) -> None:
    assert layers.mixing is not None
    misses = []
    for row, col in np.argwhere((layers.mixing == int(Mixing.PHASOR)) & (layers.n_modes == 2)).tolist():
        plane = plane_of(sums, layers, row, col)
        near, far = plane.ends
        if near.phasor is None or far.phasor is None:
            continue
        assert plane.mean is not None
        misses.append(
            abs(plane.mean - near.share * near.phasor - far.share * far.phasor) / abs(near.phasor - far.phasor)
        )
    assert len(misses) > 100
    assert np.median(misses) < 0.01
    assert np.quantile(misses, 0.95) < 0.03


FLAT = (3, 3)


def around(range_mm: np.ndarray[tuple[int, int], np.dtype[np.float64]], amplitude: float = 10.0) -> SamplesAround:
    """Two equal samples of each pixel of 3 x 3."""
    ranges = np.tile(range_mm.astype(np.float32), (2, 1, 1))
    return SamplesAround(first_row=0, first_col=0, range_mm=ranges, amplitude=np.full_like(ranges, amplitude))


def made_layers(middle: list[float], beside: list[float], *, open_share: float = 0.0) -> Layers:
    """A mixed pixel of these ranges, beside pixels of one surface each."""
    layers = Layers.empty(FLAT, 3)
    layers = replace(layers, mixing=np.zeros(FLAT, np.uint8))
    layers.n_modes[...] = 1
    layers.range[..., 0].flat[[0, 1, 2, 3, 5, 6, 7, 8]] = np.resize(beside, 8)
    layers.n_modes[1, 1] = len(middle)
    layers.range[1, 1, : len(middle)] = middle
    layers.weight[1, 1, : len(middle)] = (1.0 - open_share) / len(middle)
    layers.weight_no_return[1, 1] = open_share
    assert layers.mixing is not None
    layers.mixing[1, 1] = int(Mixing.PHASOR)
    return layers


SENSOR = Sensor(name="lock-in", modulation_frequency_hz=20.0e6)


def ends_of(layers: Layers, circle_mm: float | None = None) -> tuple[PhasorEnd, ...]:
    """Ends of the middle pixel; its neighbours' amplitudes are 1, 2, ... row by row."""
    samples = around(np.full(FLAT, 2000.0))
    light = np.tile(np.arange(1.0, 10.0, dtype=np.float32).reshape(FLAT), (2, 1, 1))
    samples = replace(samples, amplitude=light)
    return phasor_plane(layers, samples, SENSOR, row=1, col=1, unambiguous_range_mm=circle_mm).ends


def test_ends_have_phases_of_layers_and_amplitudes_of_neighbours() -> None:
    near, far = ends_of(made_layers([2000.0, 3000.0], [2010.0, 2990.0]))
    assert near.amplitude == pytest.approx(np.median([1, 3, 6, 8]))  # every second neighbour; 5 is the pixel itself
    assert far.amplitude == pytest.approx(np.median([2, 4, 7, 9]))
    assert (near.phase, far.phase) == pytest.approx((2000.0 / K_MM, 3000.0 / K_MM))
    assert near.phasor == pytest.approx(4.5 * np.exp(2000j / K_MM))
    assert (near.share, far.share) == (0.5, 0.5)
    near, far = ends_of(made_layers([2000.0, 3000.0], [2010.0]))
    assert near.amplitude is not None
    assert far.amplitude is None
    assert far.phasor is None
    layers = made_layers([2000.0, 7480.0], [10.0, 2000.0])
    assert ends_of(layers)[1].amplitude is None
    assert ends_of(layers, circle_mm=7495.0)[1].amplitude == pytest.approx(np.median([1, 3, 6, 8]))
    near, empty = ends_of(made_layers([2000.0], [2000.0], open_share=0.25))
    assert near.share == pytest.approx(0.75)
    assert empty == PhasorEnd(share=0.25, range_mm=math.inf, phase=0.0, amplitude=0.0)
    assert empty.phasor == 0


class Steps(ArrayRecording):
    """A recording that is stored in steps of seven frames, and remembers the blocks that were read."""

    frame_step = 7

    def read_range(self, frames: slice, rows: slice) -> np.ndarray[tuple[int, int, int], np.dtype[np.float32]]:
        self.blocks = [*getattr(self, "blocks", []), (frames.start, frames.stop)]
        return super().read_range(frames, rows)


def test_samples_around_a_pixel_are_read_in_whole_steps_each_once(rng: np.random.Generator) -> None:
    values = rng.uniform(500.0, 4000.0, (200, 9, 12)).astype(np.float32)
    light = rng.uniform(1.0, 9.0, values.shape).astype(np.float32)
    source = Steps(values, SENSOR, amplitude=light)
    found = read_around(source, row=1, col=10, start=10, stop=200)
    assert found is not None
    assert (found.first_row, found.first_col) == (0, 7)
    np.testing.assert_array_equal(found.range_mm, values[10:200, 0:5, 7:12])
    np.testing.assert_array_equal(found.amplitude, light[10:200, 0:5, 7:12])
    assert source.blocks == [(10, 70), (70, 140), (140, 200)]
    assert read_around(ArrayRecording(values, SENSOR), row=1, col=1, start=0, stop=9) is None


def drawn(plane: PhasorPlane) -> Figure:
    """The figure of a plane alone, laid out."""
    with drawing(LIGHT):
        figure = new_figure(4.2)
        draw_plane(figure, plane, theme=LIGHT)
        figure.savefig(io.BytesIO(), format="png")
    return figure


def made_plane(mixing: Mixing, ends: Sequence[tuple[float, complex | None]], *, spread: float = 1.0) -> PhasorPlane:
    """A plane of ends with ranges (infinite: open space) and phasors; the mean is their middle."""
    rng = np.random.default_rng(3)
    known = [place for _, place in ends if place is not None]
    mean = complex(np.mean(known)) if known else 50.0 + 20.0j
    noise = spread * (rng.standard_normal(40) + 1j * rng.standard_normal(40))
    beside = np.asarray(np.repeat(known, 6) + 0.5 * noise[: 6 * len(known)], np.complex128)
    return PhasorPlane(
        row=3,
        col=5,
        mixing=mixing,
        n_layers=len(ends),
        samples=np.asarray(mean + noise, np.complex128),
        mean=mean,
        mean_covariance=np.eye(2) * spread**2 / 40,
        neighbours=beside,
        neighbour_is_single=np.arange(len(beside)) % 3 > 0,
        ends=tuple(
            PhasorEnd(
                share=1.0 / len(ends),
                range_mm=range_mm,
                phase=1.0 if z is None else float(np.angle(z)),
                amplitude=None if z is None else abs(z),
            )
            for range_mm, z in ends
        ),
    )


def main_axes(figure: Figure) -> Axes:
    return figure.axes[0]


CHORDS = {
    "upright": [(1500.0, 20 + 90j), (3000.0, 15 + 5j)],
    "level": [(1500.0, -80 + 30j), (3000.0, 60 + 31j)],
    "open space": [(1500.0, -60 + 90j), (math.inf, 0j)],
    "triangle": [(1500.0, 120 + 160j), (2300.0, -15 + 50j), (2900.0, -50 + 95j)],
    "two ends close by": [(1500.0, 75 + 220j), (3600.0, -14 + 1j), (math.inf, 0j)],
    "three ends close by": [(1500.0, 3 + 5j), (3600.0, -4 + 1j), (math.inf, 0j), (4000.0, 90 + 300j)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHORDS)
def test_labels_of_ends_lie_inside_the_axes_without_overlap(name: str) -> None:
    figure = drawn(made_plane(Mixing.PHASOR, CHORDS[name]))
    axes = main_axes(figure)
    assert axes.get_aspect() == 1.0
    boxes = [Text.get_window_extent(text) for text in axes.texts]  # without the line from the end to its label
    assert len(boxes) == len(CHORDS[name])
    for box in boxes:
        inside = axes.get_window_extent()
        assert inside.x0 <= box.x0
        assert box.x1 <= inside.x1
        assert inside.y0 <= box.y0
        assert box.y1 <= inside.y1
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


@pytest.mark.slow
def test_figure_names_the_kind_of_mixing_and_the_shares() -> None:
    axes = main_axes(drawn(made_plane(Mixing.PHASOR, CHORDS["open space"])))
    assert axes.get_title(loc="left") == "row 3, column 5, complex plane: phasor sums"
    assert sorted(text.get_text() for text in axes.texts) == ["1.500 m\nshare 0.50", "open space\nshare 0.50"]
    labels = [str(line.get_label()) for line in axes.lines]
    assert "chord between its surfaces" in labels
    for mixing, n_layers, said in (
        (Mixing.ONE_SURFACE, 1, "one surface"),
        (Mixing.ONE_SURFACE, 0, "no surface"),
        (Mixing.EVENTS, 2, "samples of one surface each"),
        (Mixing.UNDECIDED, 2, "undecided"),
    ):
        shown = main_axes(drawn(replace(made_plane(mixing, []), n_layers=n_layers)))
        assert shown.get_title(loc="left").endswith(f": {said}")
        assert not shown.texts


def test_chords_run_from_end_to_end_and_an_unknown_amplitude_is_a_direction() -> None:
    for name, corners in (("upright", 2), ("triangle", 4)):
        axes = main_axes(drawn(made_plane(Mixing.PHASOR, CHORDS[name])))
        (line,) = [line for line in axes.lines if "between its surfaces" in str(line.get_label())]
        points = [complex(x, y) for x, y in np.asarray(line.get_xydata()).tolist()]
        places = [z for _, z in CHORDS[name]]
        assert points == pytest.approx([*places, places[0]][:corners])
    axes = main_axes(drawn(made_plane(Mixing.PHASOR, [(1500.0, 20 + 90j), (3000.0, None)])))
    labels = [str(line.get_label()) for line in axes.lines]
    assert any("3.000 m, share 0.50:\nphase alone" in label for label in labels)
    assert not any("between its surfaces" in label for label in labels)


def test_ellipse_has_three_standard_errors_and_a_small_one_is_enlarged() -> None:
    plane = replace(made_plane(Mixing.ONE_SURFACE, []), mean_covariance=np.array([[2.5, 1.5], [1.5, 2.5]]))
    (ellipse,) = [patch for patch in main_axes(drawn(plane)).patches if isinstance(patch, Ellipse)]
    assert sorted((ellipse.width, ellipse.height)) == pytest.approx([6.0 * 1.0, 6.0 * 2.0])
    long_way = ellipse.angle + (0.0 if ellipse.width > ellipse.height else 90.0)
    assert long_way % 180.0 == pytest.approx(45.0)
    fine = drawn(made_plane(Mixing.PHASOR, CHORDS["upright"]))
    assert [axes.get_title(loc="left") for axes in fine.axes[2:]] == ["around the mean"]
    wide = replace(made_plane(Mixing.PHASOR, CHORDS["upright"]), mean_covariance=400.0 * np.eye(2))
    assert len(drawn(wide).axes) == 2


def test_a_pixel_without_samples_or_neighbours_is_drawn_empty() -> None:
    nothing = np.zeros(0, np.complex128)
    plane = replace(
        made_plane(Mixing.ONE_SURFACE, []),
        n_layers=0,
        samples=nothing,
        mean=None,
        mean_covariance=np.zeros((2, 2)),
        neighbours=nothing,
        neighbour_is_single=np.zeros(0, bool),
    )
    assert main_axes(drawn(plane)).get_title(loc="left").endswith("no surface")


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
