"""Draw the figures of docs/results/paper.md and print its tables.

Run ``python docs/figures/paper_figures.py``: the paper's experiment on the built-in model
``three-boards``, all from one recording of 100 frames of 1.2 ms and one averaged
frame of 10 ms. The same versions of tofmix and Matplotlib give the same bytes.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.counters import Counter, Cpdf, Fourier, Kde
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.peaks.modes import density, find_modes
from tofmix.estimation.samples import sort_samples
from tofmix.estimation.settings import EstimateOptions
from tofmix.io.model_file import load_model
from tofmix.layers import Layers
from tofmix.optics.projection import beam_directions_of
from tofmix.report.pixels.pixel_figures import draw_density, draw_modes, style_axes
from tofmix.report.theme import LIGHT, drawing, new_figure
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensors import load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.render import recording_sensor, render_blocks

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from benchmarks.rivals import ForwardModel, fit_decaying_shares, fit_thin_beam

MODEL, SEED, FRAMES = "three-boards", 1, 100
ROW, COL = 72, 92
"""The paper's pixel: 92 of the middle row."""

NEIGHBOURS = (91, 92, 93, 94)
ROWS = slice(60, 85)
"""Rows of the views from above: few enough that the pitched boards stay thin."""

TAUS_MS = (0.2, 1.2, 5.0, 10.0, 50.0)
SHOWN = (5, 15, 30, 60, 100)
RATIOS = (0.25, 0.5, 0.75, 1.0)
FOUND_SIGMAS = 3.0
"""A surface is found where a mean lies within this many sigma of it, and lost where none does."""

_NAMES = ("near", "middle", "far")
_BOARDS = LIGHT.layers
_CURVE, _MODE, _PALE = LIGHT.ink, LIGHT.accent, "#56b4e9"
_VIEW_M = (1.6, 6.2)
_WIDENED = 8.0
"""The beam of Fig. 3 is drawn this many times as wide as it is, as in the paper."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """The experiment: samples (frame, row, col) and the averaged frame (row, col), in mm."""

    model: Model
    truth: Truth
    sensor: Sensor
    samples: Float32Array
    averaged: Float32Array

    @property
    def noise(self) -> NoiseCurve:
        """sigma(r) of one sample."""
        return self.model.sensor.noise_at(self.model.sensor.integration_time_ms)

    def pixel(self, col: int = COL) -> FloatArray:
        """Samples of a pixel of the middle row, mm."""
        return self.samples[:, ROW, col].astype(np.float64)

    def boards(self, row: int = ROW, col: int = COL) -> tuple[FloatArray, FloatArray]:
        """Ranges, mm, and shares of the boards that a pixel sees."""
        k = int(self.truth.n_modes[row, col])
        return (
            self.truth.range_true[row, col, :k].astype(np.float64),
            self.truth.weight_true[row, col, :k].astype(np.float64),
        )


def make_scene() -> Scene:
    """Simulate the model at 1.2 ms and at the default integration time."""
    model = load_model(MODEL)
    truth = cast_scene(model)

    def frames(n_frames: int, *, averaged: bool) -> Float32Array:
        blocks = render_blocks(model, truth, n_frames=n_frames, seed=SEED, averaged=averaged)
        return np.concatenate([block.range_mm for block in blocks]).astype(np.float32)

    return Scene(
        model=model,
        truth=truth,
        sensor=recording_sensor(model),
        samples=frames(FRAMES, averaged=False),
        averaged=frames(1, averaged=True)[0],
    )


# Drawing


def _mark_boards(axes: Axes, ranges_mm: FloatArray, names: bool) -> None:
    """Draw dashed lines where boards are, in the colours of their distance."""
    for mm in ranges_mm:
        board = int(np.argmin(np.abs(mm - np.array([2400.0, 3600.0, 4800.0]))))
        axes.axvline(mm / 1000.0, color=_BOARDS[board], linestyle="--", linewidth=1.2, zorder=1.5)
        if names:
            axes.annotate(
                _NAMES[board], (mm / 1000.0, 1.0), (4, -2), xycoords=("data", "axes fraction"),
                textcoords="offset points", va="top", fontsize=9,
            )  # fmt: skip


def _counted(counter: Counter, scene: Scene) -> FloatArray:
    """Modes of the pixel by a counter, m."""
    block = scene.samples[:, ROW, COL][:, np.newaxis]
    peaks = counter.peaks(sort_samples(np.ascontiguousarray(block)), beam_of(scene.sensor))
    return np.asarray(peaks.place[0, : int(peaks.found[0])] / 1000.0)


def _modes_text(n: int) -> str:
    return f"{n} mode{'s' * (n != 1)}"


def forward_model(scene: Scene) -> Figure:
    """Fig. 1(b): three boards in the proportions 1:2:3."""
    figure = new_figure(3.4)
    axes = figure.subplots()
    style_axes(axes, "forward model of one beam, equation (1)", LIGHT)
    range_m = np.linspace(*_VIEW_M, 1200)
    total = np.zeros_like(range_m)
    for share, mean, name, colour in zip((1, 2, 3), (2.4, 3.6, 4.8), _NAMES, _BOARDS, strict=True):
        sigma = float(scene.noise.sigma(1000.0 * mean)) / 1000.0
        part = share / 6.0 * np.exp(-0.5 * ((range_m - mean) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
        total += part
        axes.fill_between(range_m, 0.0, part, color=colour, alpha=0.45, linewidth=0)
        label = f"{name} board\nshare {share}/6\nsigma {1000 * sigma:.0f} mm"
        axes.text(mean + 0.08 + 0.9 * sigma, part.max(), label, va="top", fontsize=9)
    axes.plot(range_m, total, color=_CURVE, linewidth=1.3)
    axes.set(xlim=_VIEW_M, ylim=(0.0, None), xlabel="range (m)", ylabel="p(r | surfaces)  (1/m)")
    return figure


def noise_curves(scene: Scene) -> Figure:
    """Fig. 2: sigma against range at several integration times."""
    figure = new_figure(3.8)
    axes = figure.subplots()
    profile = scene.model.sensor
    style_axes(axes, f"noise of one sample, {profile.name}", LIGHT)
    range_mm = np.linspace(profile.range_min_mm, profile.range_max_mm, 300)
    marked = {profile.integration_time_ms: "the samples", profile.default_integration_time_ms: "the camera's default"}
    for tau in TAUS_MS:
        sigma = profile.noise_at(tau).sigma(range_mm)
        axes.plot(range_mm / 1000.0, sigma, color=_MODE if tau in marked else _PALE, linewidth=1.8)
        text = f"{tau:g} ms" + (f", {marked[tau]}" if tau in marked else "")
        axes.annotate(
            text, (range_mm[-1] / 1000.0, sigma[-1]), (6, 0), textcoords="offset points", va="center", fontsize=9
        )
    axes.set(xlim=(0.5, 10.2), yscale="log", xlabel="range (m)", ylabel="sigma (mm)")
    axes.set_xticks(range(1, 8))
    axes.set_yticks([3, 10, 30, 100, 300, 1000], ["3", "10", "30", "100", "300", "1000"])
    axes.minorticks_off()
    return figure


def _from_above(range_mm: Float32Array, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Coordinates x and z, m, of an image (row, col) of the rows `ROWS`."""
    camera = scene.model.sensor
    directions = beam_directions_of(camera.optics, camera.shape)[ROWS]
    return range_mm * directions[..., 0] / 1000.0, range_mm * directions[..., 2] / 1000.0


def _nowhere(range_mm: Float32Array, scene: Scene) -> BoolArray:
    """Whether an averaged point (row, col) of a beam of several events is far from every board in it."""
    noise = scene.model.sensor.noise_at(scene.model.sensor.default_integration_time_ms)
    seen = scene.truth.range_true[ROWS].astype(np.float64)
    near = np.abs(range_mm[..., np.newaxis] - seen) <= FOUND_SIGMAS * noise.sigma(np.nan_to_num(seen))
    mixed = scene.truth.n_modes[ROWS] + (scene.truth.weight_no_return[ROWS] > 0) > 1
    return np.asarray(~near.any(axis=-1) & mixed, dtype=np.bool_)


def _board_ends(scene: Scene) -> list[tuple[FloatArray, FloatArray]]:
    """Coordinates x and z, m, of both ends of each board at the height of the camera."""
    ends = []
    for surface in scene.model.surfaces:
        along = surface.rotation()[:, 0] * surface.size_mm[0] / 2
        both = np.array([surface.center_mm - along, surface.center_mm + along]) / 1000.0
        ends.append((both[:, 0], both[:, 2]))
    return ends


def set_up(scene: Scene) -> Figure:
    """Fig. 3: the camera and the boards from above."""
    figure = new_figure(5.3)
    axes = figure.subplots()
    style_axes(axes, "the set-up from above", LIGHT)
    camera = scene.model.sensor
    view_deg = camera.fov_horizontal_deg or 0.0
    for side in (-1, 1):
        edge = np.deg2rad(side * view_deg / 2)
        axes.plot([0, 7 * np.cos(edge)], [0, 7 * np.sin(edge)], color=LIGHT.grid, linewidth=1.5, zorder=1)
    beam = view_deg / camera.cols
    middle = (COL - (camera.cols - 1) / 2) * beam
    sides = np.deg2rad([middle - _WIDENED * beam / 2, middle + _WIDENED * beam / 2])
    axes.fill([0, *(5.25 * np.cos(sides))], [0, *(5.25 * np.sin(sides))], color="#f0e442", alpha=0.55, linewidth=0)
    for (x, z), name, colour in zip(_board_ends(scene), _NAMES, _BOARDS, strict=True):
        axes.plot(z, x, color=colour, linewidth=3.5, solid_capstyle="butt")
        side = -1 if name == "far" else 1
        axes.annotate(
            f"{name} board\n{z.mean():.1f} m", (z[0], x[0] if x[0] < -0.5 else x[1]), (7 * side, 0),  # noqa: PLR2004
            textcoords="offset points", ha="left" if side > 0 else "right", va="center", fontsize=9,
        )  # fmt: skip
    x, z = _from_above(scene.averaged[ROWS], scene)
    axes.plot(z[:, COL], x[:, COL], "x", color=_MODE, markersize=6, markeredgewidth=1.2, zorder=4)
    axes.annotate(
        f"what averaging makes of pixel {COL}\nin {len(x)} rows around the middle", (z[:, COL].min(), x[0, COL]),
        (0.1, 1.45), color=_MODE, fontsize=9, arrowprops={"arrowstyle": "-", "color": _MODE, "linewidth": 0.8},
    )  # fmt: skip
    axes.plot(0, 0, "s", color=_CURVE, markersize=10)
    axes.annotate("camera", (0, 0), (-4, -28), textcoords="offset points", fontsize=9)
    axes.text(
        0.85, -0.28, f"beam of pixel {COL}, {_WIDENED:.0f} times\nas wide as it is ({beam:.2f}°)", fontsize=9, va="top"
    )
    axes.set(xlim=(-0.2, 5.4), ylim=(2.0, -2.0), xlabel="z, away from the camera (m)", ylabel="x, to the right (m)")
    axes.set_aspect("equal", adjustable="box")
    return figure


def comet_tail(scene: Scene) -> Figure:
    """Fig. 4(c) and (d): points at the default integration time and at 1.2 ms."""
    figure = new_figure(3.9)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    camera = scene.model.sensor
    style_axes(left, f"one frame of {camera.default_integration_time_ms:g} ms, averaged", LIGHT)
    style_axes(right, f"one frame of {camera.integration_time_ms:g} ms", LIGHT)
    nowhere = _nowhere(scene.averaged[ROWS], scene)
    x, z = _from_above(scene.averaged[ROWS], scene)
    left.plot(x[~nowhere], z[~nowhere], ".", color=_PALE, markersize=2.0, markeredgewidth=0)
    left.plot(x[nowhere], z[nowhere], ".", color=_MODE, markersize=4.5, markeredgewidth=0)
    left.annotate(
        "comet tail:\nno board here", xy=(0.08, 3.0), xytext=(0.35, 2.75), color=_MODE, va="center", fontsize=9,
        arrowprops={"arrowstyle": "-", "color": _MODE, "linewidth": 0.8, "relpos": (0.0, 0.5)},
    )  # fmt: skip
    x, z = _from_above(scene.samples[0, ROWS], scene)
    right.plot(x, z, ".", color=_PALE, markersize=2.0, markeredgewidth=0)
    for axes in (left, right):
        for (x_ends, z_ends), colour in zip(_board_ends(scene), _BOARDS, strict=True):
            axes.plot(x_ends, z_ends, color=colour, linewidth=1.4, zorder=3)
        axes.set(xlim=(-1.85, 1.85), ylim=(2.05, 5.6), xlabel="x, to the right (m)")
        axes.set_aspect("equal", adjustable="box")
    left.set_ylabel("z, away from the camera (m)")
    return figure


def cpdf(scene: Scene) -> Figure:
    """Fig. 5: the cumulative distribution P and the difference F, at 15 bins and more."""
    figure = new_figure(5.4)
    counters = (Cpdf(), Cpdf(bins=60), Cpdf(bins=100, ratio=1.02))
    samples = np.sort(scene.pixel())
    for column, (axes, counter) in enumerate(zip(figure.subplots(3, 2, sharex=True), counters, strict=True)):
        edges = counter.edges(beam_of(scene.sensor))
        below = np.searchsorted(samples, edges, side="right") / len(samples)
        rise = np.interp(counter.ratio * edges, edges, below) - below
        modes = _counted(counter, scene)
        style_axes(axes[0], f"P, {counter.bins} bins", LIGHT)
        style_axes(axes[1], f"F, k = {counter.ratio:g}: {_modes_text(len(modes))}", LIGHT)
        axes[0].step(edges / 1000.0, below, where="post", color=_CURVE, linewidth=1.3)
        axes[1].plot(edges / 1000.0, rise, "-", color=_CURVE, linewidth=1.2, marker=".", markersize=3.5)
        axes[1].set_ylim(0.0, 1.25 * rise.max())
        axes[1].plot(modes, np.full(len(modes), 1.16 * rise.max()), "v", color=_MODE, markersize=6)
        for one in axes:
            _mark_boards(one, scene.boards()[0], names=column == 0 and one is axes[0])
            one.set(xlim=(0.65, 7.5))
        axes[0].set(ylabel="share of samples", ylim=(0.0, 1.35), yticks=[0, 0.5, 1])
        if column == len(counters) - 1:
            axes[0].set_xlabel("range (m)")
            axes[1].set_xlabel("range (m)")
    return figure


def fourier(scene: Scene) -> Figure:
    """Fig. 6: the truncated series at a low order and at twice that."""
    figure = new_figure(4.8)
    low, high = beam_of(scene.sensor).range_min, beam_of(scene.sensor).range_top
    range_mm = np.linspace(low, high, 1500)
    period = high - low
    angles = -np.pi + 2.0 * np.pi * (scene.pixel() - low) / period
    at = -np.pi + 2.0 * np.pi * (range_mm - low) / period
    for axes, order in zip(figure.subplots(2, 1, sharex=True), (8, 16), strict=True):
        p = np.full_like(at, 0.5 / np.pi)
        for j in range(1, order + 1):
            p += np.cos(j * at) * np.cos(j * angles).mean() / np.pi + np.sin(j * at) * np.sin(j * angles).mean() / np.pi
        p *= 2.0 * np.pi / period * 1000.0  # of the angle -> 1/m
        modes = _counted(Fourier(order=order), scene)
        style_axes(axes, f"order {order}: {_modes_text(len(modes))}", LIGHT)
        axes.axhline(0.0, color=_CURVE, linewidth=0.8)
        axes.plot(range_mm / 1000.0, p, color=_CURVE, linewidth=1.3)
        axes.fill_between(range_mm / 1000.0, 0.0, np.minimum(p, 0.0), color=_MODE, alpha=0.55, linewidth=0)
        axes.set_ylim(1.25 * p.min(), 1.2 * p.max())
        draw_modes(axes, range_mm / 1000.0, p, modes, LIGHT)
        _mark_boards(axes, scene.boards()[0], names=order == 8)  # noqa: PLR2004 - the first of the two
        axes.set(xlim=(low / 1000.0, high / 1000.0), ylabel="p(r)  (1/m)")
    axes.set_xlabel("range (m)")
    axes.text(6.0, 0.72 * p.min(), "negative: no density", color=_MODE, fontsize=9, va="top")
    return figure


def incremental(scene: Scene) -> Figure:
    """Fig. 7: the density as samples come in."""
    figure = new_figure(6.0)
    live = IncrementalDensity(scene.sensor, 1)
    samples = scene.pixel()
    before = 0
    for axes, n in zip(figure.subplots(len(SHOWN), 1, sharex=True, sharey=True), SHOWN, strict=True):
        live.add(samples[before:n, np.newaxis])
        before = n
        modes = live.modes()
        k = int(modes.found[0])
        style_axes(axes, f"{n} samples: {_modes_text(k)}", LIGHT)
        axes.set(xlim=_VIEW_M, ylim=(0.0, 5.4), yticks=[0, 2, 4], ylabel="p(r)  (1/m)")
        draw_density(axes, live.range_mm / 1000.0, 1000.0 * live.density()[0], modes.place[0, :k] / 1000.0, LIGHT)
        _mark_boards(axes, scene.boards()[0], names=n == SHOWN[0])
    axes.set_xlabel("range (m)")
    return figure


def neighbours(scene: Scene) -> Figure:
    """Fig. 8: four neighbouring pixels of the middle row."""
    figure = new_figure(4.6)
    range_m = np.linspace(*_VIEW_M, 1500)
    for axes, col in zip(figure.subplots(2, 2, sharex=True).flat, NEIGHBOURS, strict=True):
        samples = scene.pixel(col)
        modes = find_modes(samples, scene.noise)
        p = 1000.0 * density(samples, 1000.0 * range_m, scene.noise)
        style_axes(axes, f"pixel {col}: {_modes_text(len(modes))}", LIGHT)
        axes.set(xlim=_VIEW_M, ylim=(0.0, 1.3 * p.max()))
        draw_density(axes, range_m, p, modes / 1000.0, LIGHT)
        _mark_boards(axes, scene.boards(ROW, col)[0], names=True)
        if col in NEIGHBOURS[::2]:
            axes.set_ylabel("p(r)  (1/m)")
        if col in NEIGHBOURS[2:]:
            axes.set_xlabel("range (m)")
    return figure


FIGURES: dict[str, Callable[[Scene], Figure]] = {
    "fig1_forward_model": forward_model,
    "fig2_noise": noise_curves,
    "fig3_set_up": set_up,
    "fig4_comet_tail": comet_tail,
    "fig5_cpdf": cpdf,
    "fig6_fourier": fourier,
    "fig7_incremental": incremental,
    "fig8_neighbours": neighbours,
}

# Tables

PAPER_MU = ("2481.2", "3112.6", "4556.8")
PAPER_SIGMA = ("1252.4", "738.1", "960.0")
PAPER_SHARE = ("0.068", "0.281", "0.632")
"""The paper's Table II; shares rounded."""

PAPER_WEIGHTS = np.array([0.067577, 0.280792, 0.632203, 0.019318])
"""p(c_1), p(c_2), p(c_3) and p(c_0) of the same table."""

PAPER_SIGMA_0_MM = 57.2
BOARDS_MM = np.array([2400.0, 3600.0, 4800.0])
"""The boards' ranges by the paper's Fig. 3."""

NOISE_FACTORS = (3, 4, 5)
FAIR_PIXELS = 400

PROCEDURES = {
    "--paper --gamma 0.02": EstimateOptions(paper=True),
    "--paper --gamma 0.1": EstimateOptions(paper=True, counter=Kde(gamma=0.1)),
    "tofmix's default": EstimateOptions(),
}


def table_2(scene: Scene) -> list[str]:
    """Write the paper's Table II with ours beside it."""
    block = scene.samples[:, ROW, COL][:, np.newaxis]
    fits = [layer_pixels(block, scene.sensor, options) for options in PROCEDURES.values()]
    ranges, shares = scene.boards()
    places = [_matched(fit.range[0, : int(fit.n_modes[0])], ranges) for fit in fits]
    lines = [
        _row("", "paper", "our truth", *PROCEDURES),
        "|---|---|---|---|---|---|",
    ]
    rows = (
        ("mu_{} (mm)", PAPER_MU, ranges, "range", "range_stderr", 1),
        ("sigma_{} (mm)", PAPER_SIGMA, scene.noise.sigma(ranges), "sigma", None, 1),
        ("p(c_{})", PAPER_SHARE, shares, "weight", "weight_stderr", 3),
    )
    for name, paper, true, field, error, digits in rows:
        for i, value in enumerate(true):
            cells = [paper[i], f"{value:.{digits}f}"]
            cells += [_cell(fit, field, place[i], digits) for fit, place in zip(fits, places, strict=True)]
            if error is not None:
                cells[-1] += f" ± {_cell(fits[-1], error, places[-1][i], digits)}"
            lines.append(_row(name.format(i + 1), *cells))
    lines.append(_row("a fourth", "", "", *(_spare(fit, place) for fit, place in zip(fits, places, strict=True))))
    sigma_0 = float(scene.noise.sigma(scene.model.sensor.range_max_mm))
    lines.append(_row("sigma_0 (mm)", "57.2", f"{sigma_0:.1f}", *["no sample"] * 2, "held"))
    none = float(scene.truth.weight_no_return[ROW, COL])
    found = (f"{float(fit.weight_no_return[0]):.3f}" for fit in fits)
    lines.append(_row("p(c_0)", "0.019", f"{none:.3f}", *found))
    lines.append(_row("p(c_r)", "0.0001, supplied", f"{scene.sensor.outlier_probability:g}", *["held"] * 3))
    return lines


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """Pixels whose shares are the paper's: how they are counted, and where their boards are found."""

    counts: tuple[int, ...]
    offset_mm: FloatArray
    sigma_mm: FloatArray


def fair_table() -> list[str]:
    """Write what each procedure makes of pixels with the paper's shares and more noise than the profile has."""
    lines = [
        _row("noise", "procedure", "1", "2", "3", "4 and more", "offsets of three (mm)", "their sigmas (mm)"),
        "|---|---|---|---|---|---|---|---|",
    ]
    for factor in NOISE_FACTORS:
        sensor, samples = _pixels_of_table_2(factor)
        true = sensor.noise.sigma(BOARDS_MM) if sensor.noise is not None else BOARDS_MM
        lines.append(_row(f"{factor} x", "truth", "", "", "100 %", "", "0, 0, 0", _three(true)))
        for name, options in PROCEDURES.items():
            spread = _spread(layer_pixels(samples, sensor, options))
            shares = [f"{100.0 * n / FAIR_PIXELS:.0f} %" for n in spread.counts]
            lines.append(_row("", name, *shares, _three(spread.offset_mm), _three(spread.sigma_mm)))
    return lines


def _pixels_of_table_2(factor: float) -> tuple[Sensor, Float32Array]:
    """Draw samples (frame, pixel), mm, by equation (1) with the shares of Table II, and `factor` times the noise.

    The spread of c_0 is the paper's sigma_0: the curve falls to it at r_max.
    """
    profile = load_profile("sr3000")
    curve, far = profile.noise_at(1.2).scaled(factor), profile.range_max_mm
    inside = curve.range_mm < far
    range_mm = np.append(curve.range_mm[inside], [far - 1.0, far])
    noise = NoiseCurve(range_mm, np.append(curve.sigma(range_mm[:-1]), PAPER_SIGMA_0_MM))
    sensor = Sensor(
        name="as in Table II", range_min_mm=profile.range_min_mm, range_max_mm=far, noise=noise,
        outlier_probability=1.0e-4,
    )  # fmt: skip
    rng = np.random.default_rng(SEED)
    means = np.append(BOARDS_MM, far)
    which = rng.choice(len(means), p=PAPER_WEIGHTS / PAPER_WEIGHTS.sum(), size=(FRAMES, FAIR_PIXELS))
    samples = means[which] + noise.sigma(means)[which] * rng.standard_normal(which.shape)
    random = rng.random(which.shape) < sensor.outlier_probability
    return sensor, np.where(random, rng.uniform(profile.range_min_mm, far, which.shape), samples).astype(np.float32)


def _spread(found: Layers) -> Spread:
    """Count pixels by their layers; of those with three, the median of offsets and sigmas."""
    n = found.n_modes
    three = n == len(BOARDS_MM)
    offset = np.abs(found.range[three, : len(BOARDS_MM)] - BOARDS_MM)
    sigma = found.sigma[three, : len(BOARDS_MM)].astype(np.float64)
    none = np.full(len(BOARDS_MM), np.nan)
    return Spread(
        counts=tuple(np.bincount(np.clip(n, 1, len(BOARDS_MM) + 1), minlength=len(BOARDS_MM) + 2)[1:].tolist()),
        offset_mm=np.median(offset, axis=0) if three.any() else none,
        sigma_mm=np.median(sigma, axis=0) if three.any() else none,
    )


def _three(values: FloatArray) -> str:
    return ", ".join("none" if np.isnan(v) else f"{v:.0f}" for v in values)


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _matched(found: Float32Array, ranges: FloatArray) -> list[int]:
    """Return the number of the mean next to each board."""
    return [int(np.argmin(np.abs(found - mm))) for mm in ranges]


def _cell(fit: Layers, field: str, layer: int, digits: int) -> str:
    return f"{float(getattr(fit, field)[0, layer]):.{digits}f}"


def _spare(fit: Layers, taken: list[int]) -> str:
    """Describe the surfaces that are no board's."""
    rest = [i for i in range(int(fit.n_modes[0])) if i not in taken]
    return "; ".join(f"{fit.range[0, i]:.1f} mm, share {fit.weight[0, i]:.3f}" for i in rest) or "none"


def rivals(scene: Scene) -> list[str]:
    """Write how equation (1) and its rivals explain samples that they were not fitted to."""
    pixels = [tuple(pixel) for pixel in np.argwhere(scene.truth.n_modes == len(_NAMES)).tolist()]
    names = [
        "truth",
        "equation (1)",
        "thin beam",
        "thin beam, p(c_r) fitted",
        *(f"decaying shares, {r:g}" for r in RATIOS),
    ]
    scores, lost, off = (np.zeros((len(pixels), len(names))) for _ in range(3))
    half = FRAMES // 2
    for number, (row, col) in enumerate(pixels):
        ranges, shares = scene.boards(row, col)
        samples = scene.samples[:, row, col].astype(np.float64)
        for m, model in enumerate(_models(samples[:half], ranges, shares, scene)):
            scores[number, m] = model.log_likelihood(samples[half:]) / (FRAMES - half)
            gap = np.abs(model.mean_mm[:, np.newaxis] - ranges)
            found = gap <= FOUND_SIGMAS * scene.noise.sigma(ranges)
            lost[number, m] = (~found.any(axis=0)).sum()
            off[number, m] = np.abs((found * model.weight[:, np.newaxis]).sum(axis=0) - shares).mean()
    lines = [
        f"{len(pixels)} pixels, {len(_NAMES) * len(pixels)} surfaces\n",
        "| model | log likelihood, nat a sample | less than equation (1) | surfaces lost | error of a share |",
        "|---|---|---|---|---|",
    ]
    for m, name in enumerate(names):
        less = scores[:, 1] - scores[:, m]
        error = less.std(ddof=1) / np.sqrt(len(pixels))
        against = "" if m == 1 else f"{less.mean():.3f} ± {error:.3f}"
        numbers = f"{scores[:, m].mean():.3f}", against, f"{lost[:, m].sum():.0f}", f"{off[:, m].mean():.3f}"
        lines.append(_row(name, *numbers))
    return lines


def _models(samples: FloatArray, ranges: FloatArray, shares: FloatArray, scene: Scene) -> list[ForwardModel]:
    """Fit every model to one pixel's samples, the truth first."""
    sensor = scene.sensor
    fit = layer_pixels(samples[:, np.newaxis], sensor)
    k = int(fit.n_modes[0])
    truth = ForwardModel(
        mean_mm=ranges, sigma_mm=scene.noise.sigma(ranges), weight=shares,
        weight_no_return=1.0 - sensor.outlier_probability - float(shares.sum()),
        weight_outlier=sensor.outlier_probability, sensor=sensor,
    )  # fmt: skip
    equation_1 = replace(
        truth, mean_mm=fit.range[0, :k].astype(np.float64), sigma_mm=fit.sigma[0, :k].astype(np.float64),
        weight=fit.weight[0, :k].astype(np.float64), weight_no_return=float(fit.weight_no_return[0]),
    )  # fmt: skip
    thin = fit_thin_beam(samples, sensor), fit_thin_beam(samples, sensor, free_outliers=True)
    # The kindest start: the true number of surfaces, at the truth or at any peaks.
    starts = [ranges, *map(np.array, combinations(find_modes(samples, scene.noise), len(ranges)))]
    decaying = []
    for ratio in RATIOS:
        tried = [fit_decaying_shares(samples, start, sensor, ratio=ratio) for start in starts]
        decaying.append(max(tried, key=lambda one: one.log_likelihood(samples)))
    return [truth, equation_1, *thin, *decaying]


def main() -> None:
    """Draw every figure into a folder and print the tables."""
    parser = argparse.ArgumentParser(description="Draw the figures of docs/results/paper.md and print its tables.")
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "images", help="folder to write to")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene()
    with drawing(LIGHT):
        for name, draw in FIGURES.items():
            draw(scene).savefig(folder / f"paper_{name}.png", metadata={"Software": None})
    sys.stdout.write("\n".join([*table_2(scene), "", *fair_table(), "", *rivals(scene), ""]))


if __name__ == "__main__":
    main()
