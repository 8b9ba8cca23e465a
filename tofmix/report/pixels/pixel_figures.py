"""Figures of single pixels, after the paper's Figs. 7 and 8: samples, density, fitted components.

`draw_density` and `style_axes` also draw the figures of docs/results/paper.md.
"""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from tofmix.arrays import FloatArray
from tofmix.circle import cut_between
from tofmix.estimation.learnt.pixel_mixture import PixelMixture
from tofmix.estimation.peaks.modes import density
from tofmix.points import MM_A_METRE as _M
from tofmix.report.pixels.phasor_figure import PLANE_INCH, draw_plane
from tofmix.report.pixels.phasor_plane import PhasorPlane
from tofmix.report.pixels.pixels import GrowingDensity, PixelView
from tofmix.report.theme import Theme, new_figure
from tofmix.sensor import NoiseCurve
from tofmix.wording import counted

_PANEL_INCH = 2.5
"""Height of a panel, inch, and panels side by side."""

_STRIP_INCH, _SCATTER_INCH = 1.15, 2.4
"""Heights of one number of samples, and of the modes over samples, inch."""

_MARGIN_SIGMAS = 5.0
"""Margin of a view beyond the outermost surface, in its sigma."""

_BACKGROUND_SIGMAS = 12.0
"""Under learnt noise, samples this many sigma from every layer are background, and may lie outside the view."""
_LEAST_MARGIN_M = 0.05  # beyond the outermost sample, m
_MOST_BINS = 80  # of a histogram


def style_axes(axes: Axes, title: str, theme: Theme) -> None:
    """Set title and grid."""
    axes.set_title(title, loc="left", fontweight="bold")
    axes.grid(color=theme.grid, linewidth=0.6)
    axes.set_axisbelow(True)


def draw_density(axes: Axes, range_m: FloatArray, p: FloatArray, modes_m: FloatArray, theme: Theme) -> None:
    """Draw p(r), 1/m, with a triangle above each peak."""
    axes.fill_between(range_m, 0.0, p, color=theme.ink, alpha=0.12, linewidth=0)
    axes.plot(range_m, p, color=theme.ink, linewidth=1.3)
    draw_modes(axes, range_m, p, modes_m, theme)


def draw_modes(axes: Axes, range_m: FloatArray, p: FloatArray, modes_m: FloatArray, theme: Theme) -> None:
    """Draw a triangle above p(r) at each peak."""
    if len(modes_m) == 0:
        return  # an empty line without clipping makes the layout collapse
    axes.plot(
        modes_m,
        np.interp(modes_m, range_m, p) + 0.05 * axes.get_ylim()[1],
        "v",
        color=theme.accent,
        markersize=6.5,
        zorder=4,
        clip_on=False,
    )


def neighbours_figure(
    views: list[PixelView],
    *,
    noise: NoiseCurve | None,
    theme: Theme,
    unambiguous_range_mm: float | None = None,
    plane: PhasorPlane | None = None,
    most_columns: int = 2,
    most_sigmas: float = 150.0,
    places: int = 1500,  # ranges at which a line is drawn: more than the pixels of a figure
) -> Figure:
    """Draw pixels side by side: histogram and density of the samples, fitted components with their means (Fig. 8).

    Of pixels under learnt noise the line is the fitted mixture, with its shape, the pixel's own width and background;
    where ranges drift within the window, it is the mean over the window.

    Parameters
    ----------
    views : list of PixelView
        The pixels, near ones side by side.
    noise : NoiseCurve, optional
        sigma(r), for the density; without it, or without samples, there is none.
    theme : Theme
        Colours.
    unambiguous_range_mm : float, optional
        Where ranges are on a circle: its length, mm. Surfaces across the fold are then drawn in one piece, beyond it.
    plane : PhasorPlane, optional
        One of the pixels in the complex plane, drawn below.
    most_columns : int
        Panels side by side.
    most_sigmas : float
        Width of a view in units of the smallest sigma, beyond which each pixel has a separate view.
    """
    cut = _cut(views, unambiguous_range_mm)
    named = [[_told(view, k) for k in range(len(view.range_mm))] for view in views]
    if unambiguous_range_mm is not None:
        views = [view.opened(cut, unambiguous_range_mm) for view in views]
    columns = min(most_columns, len(views))
    rows = math.ceil(len(views) / columns)
    height = _PANEL_INCH * rows + 0.7
    figure = new_figure(height + (0.0 if plane is None else PLANE_INCH))
    part: Figure | SubFigure = figure
    if plane is not None:
        part, below_it = figure.subfigures(2, 1, height_ratios=(height, PLANE_INCH), squeeze=False)[:, 0]
        draw_plane(below_it, plane, theme=theme)
    low, high = _view(views)
    known = np.concatenate([view.sigma_mm for view in views])
    # Side by side on one axis, as in the paper, unless the components would be needles.
    shared = known.size == 0 or high - low < most_sigmas * float(known.min()) / _M
    panels = part.subplots(rows, columns, sharex=shared, squeeze=False)
    for number, (axes, view, names) in enumerate(zip(panels.flat, views, named, strict=False)):
        limits = (low, high) if shared else _view([view])
        _draw_pixel(axes, view, names, np.linspace(*limits, places), noise, theme)
        below = number + columns >= len(views)
        axes.set(
            xlim=limits,
            ylabel="p(r)  (1/m)" if number % columns == 0 else "",
            xlabel=_axis(cut, unambiguous_range_mm) * below,
        )
        axes.tick_params(labelbottom=below or not shared)
    for axes in panels.flat[len(views) :]:
        axes.set_visible(False)
    _explain(part, theme, learnt=any(view.mixture is not None for view in views))
    return figure


def growth_figure(
    growth: GrowingDensity, view: PixelView, *, theme: Theme, unambiguous_range_mm: float | None = None
) -> Figure:
    """Draw the density at a few numbers of samples, and where its peaks are at each (Fig. 7); see the other figure."""
    cut = _cut([view], unambiguous_range_mm)
    if unambiguous_range_mm is not None:
        growth, view = growth.opened(cut, unambiguous_range_mm), view.opened(cut, unambiguous_range_mm)
    count = len(growth.snapshots)
    figure = new_figure(_STRIP_INCH * count + _SCATTER_INCH)
    axes = figure.subplots(count + 1, 1, sharex=True, height_ratios=[_STRIP_INCH] * count + [_SCATTER_INCH])
    range_m, (low, high) = growth.range_mm / _M, _view([view])
    top = 1.35 * _M * max(float(p.max()) for _, p in growth.snapshots)
    for panel, (number, p) in zip(axes, growth.snapshots, strict=False):
        modes_m = growth.modes_mm[number - 1] / _M
        named = f"{counted(number, 'sample')}: {counted(len(modes_m), 'peak')}"
        style_axes(panel, named, theme)
        panel.set(ylim=(0.0, top), ylabel="p(r)  (1/m)")
        draw_density(panel, range_m, _M * p, _within(modes_m, low, high), theme)
        _mark_layers(panel, view, theme)
    last = axes[-1]
    style_axes(last, f"peaks against samples, {view.name}", theme)
    places = np.concatenate(growth.modes_mm) / _M
    steps = np.repeat(growth.n_samples, [len(modes) for modes in growth.modes_mm])
    last.plot(places, steps, ".", color=theme.accent, markersize=3.5, markeredgewidth=0)
    _mark_layers(last, view, theme)
    last.set(
        xlim=(low, high),
        ylim=(0.0, 1.04 * growth.n_samples[-1]),
        xlabel=_axis(cut, unambiguous_range_mm),
        ylabel="samples",
    )
    figure.align_ylabels(axes)
    return figure


def _draw_pixel(
    axes: Axes, view: PixelView, names: list[str], range_m: FloatArray, noise: NoiseCurve | None, theme: Theme
) -> None:
    count = len(view.range_mm)
    status = "" if view.status == "ok" else f", {view.status.replace('_', ' ')}"
    style_axes(axes, f"{view.name}: {counted(count, 'layer')}{status}", theme)
    highest, samples, mixture = 0.0, view.samples_mm, view.mixture
    own = None if mixture is None else _own_noise(view, mixture)
    headroom = _headroom(count + (0 if own is None else 1 + own.count("\n")))
    if samples is not None and samples.size:
        bins = np.linspace(range_m[0], range_m[-1], _bins(samples, range_m) + 1)
        bars = np.histogram(samples / _M, bins)[0] / (samples.size * np.diff(bins))
        outside = int(((samples < _M * bins[0]) | (samples > _M * bins[-1])).sum())
        said = counted(samples.size, "sample") + (f", {outside} outside" if mixture is not None and outside else "")
        axes.stairs(bars, bins, fill=True, color=theme.grid, label=said)
        highest = float(bars.max())
    for k in range(count):
        part = _component(view, k, range_m) if mixture is None else _M * mixture.component(k, _M * range_m)
        highest = max(highest, float(part.max()))
        colour = theme.layers[k % len(theme.layers)]
        axes.fill_between(range_m, 0.0, part, color=colour, alpha=0.45, linewidth=0, label=names[k])
        axes.plot(range_m, part, color=colour, linewidth=1.2)
    if mixture is not None:
        p = _M * mixture.total(_M * range_m)
        highest = max(highest, float(p.max()))
        axes.plot(range_m, p, color=theme.ink, linewidth=1.3)
        axes.plot(range_m, _M * mixture.floor(_M * range_m), color=theme.ink, linestyle=":", linewidth=1.2)
        axes.plot([], [], " ", label=own)
    elif samples is not None and samples.size and noise is not None and view.modes_mm is not None:
        p = _M * density(samples, _M * range_m, noise)
        highest = max(highest, float(p.max()))
        axes.set_ylim(0.0, headroom * highest)
        draw_density(axes, range_m, p, _within(view.modes_mm / _M, range_m[0], range_m[-1]), theme)
    axes.set_ylim(0.0, headroom * highest if highest > 0 else 1.0)
    _mark_layers(axes, view, theme, top=1.05 / headroom)
    if count or (samples is not None and samples.size):
        axes.legend(loc="upper left", fontsize=8, handlelength=1.2, borderaxespad=0.2, labelspacing=0.25)


def _cut(views: list[PixelView], length_mm: float | None) -> float:
    """The cut of the circle for all panels; 0 without a circle."""
    if length_mm is None:
        return 0.0
    ranges, sigmas = (np.concatenate([getattr(view, name) for view in views]) for name in ("range_mm", "sigma_mm"))
    return cut_between(ranges, sigmas, length_mm)


def _axis(cut_mm: float, length_mm: float | None) -> str:
    """Label of the axis."""
    return "range (m)" if length_mm is None or cut_mm == 0.0 else f"range (m); 0 again at {length_mm / _M:.3f}"


def _own_noise(view: PixelView, mixture: PixelMixture) -> str:
    """The pixel's width, background and drift under learnt noise, for its legend."""
    said = f"width {mixture.width:.2f}, background {100 * mixture.background:.1f} %"
    if mixture.drift_mm.any():
        extent = ", ".join(f"{mm:.1f}" for mm in mixture.drift_extent_mm())
        return f"{said}\ndrift {extent} mm in the window"
    return f"{said}\ndrift not known" if mixture.drifts and view.samples_mm is None else said


def _explain(figure: Figure | SubFigure, theme: Theme, *, learnt: bool) -> None:
    """Write the common legend below the panels."""
    means = Line2D([], [], color=theme.ink, linestyle="--", linewidth=1.0, label="fitted means, with standard errors")
    if learnt:
        handles = [
            Line2D([], [], color=theme.ink, linewidth=1.3, label="learnt mixture"),
            Line2D([], [], color=theme.ink, linestyle=":", linewidth=1.2, label="its background, no return"),
            means,
        ]
    else:
        handles = [
            Line2D([], [], color=theme.ink, linewidth=1.3, label="density of the samples"),
            Line2D([], [], color=theme.accent, linestyle="none", marker="v", markersize=6.5, label="its peaks"),
            means,
        ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _within(modes_m: FloatArray, low: float, high: float) -> FloatArray:
    """Modes inside the view: triangles are not clipped at the axes, and would lie outside."""
    return modes_m[(modes_m >= low) & (modes_m <= high)]


def _headroom(layers: int) -> float:
    """Height of the axes over the highest curve, with room for the legend."""
    return 1.35 + 0.16 * layers


def _component(view: PixelView, k: int, range_m: FloatArray) -> FloatArray:
    """p(c_i) N(r; mean, sigma) of a layer, 1/m."""
    sigma = view.sigma_mm[k] / _M
    z = (range_m - view.range_mm[k] / _M) / sigma
    return np.asarray(view.weight[k] * np.exp(-0.5 * z * z) / (sigma * math.sqrt(2.0 * math.pi)))


def _told(view: PixelView, k: int) -> str:
    error = view.range_stderr_mm[k]
    plus_minus = f" ± {error:.1f}" if np.isfinite(error) else ""
    return f"{view.range_mm[k]:.1f}{plus_minus} mm, share {view.weight[k]:.2f}"


def _mark_layers(axes: Axes, view: PixelView, theme: Theme, *, top: float = 1.0) -> None:
    """Draw a line at each layer's mean, with its standard error as a band, up to a share of the axes' height."""
    for k, (mean, error) in enumerate(zip(view.range_mm / _M, view.range_stderr_mm / _M, strict=True)):
        colour = theme.layers[k % len(theme.layers)]
        axes.axvline(mean, ymax=top, color=colour, linestyle="--", linewidth=1.0, zorder=1.5)
        if np.isfinite(error):
            axes.axvspan(mean - error, mean + error, ymax=top, color=colour, alpha=0.3, linewidth=0, zorder=1.4)


def _view(views: list[PixelView]) -> tuple[float, float]:
    """Limits in m that hold every component and most samples."""
    lows, highs = [], []
    for view in views:
        reach = _MARGIN_SIGMAS * view.sigma_mm
        lows += (view.range_mm - reach).tolist()
        highs += (view.range_mm + reach).tolist()
        samples = _near_layers(view)
        if samples is not None and samples.size:
            inner = np.percentile(samples, [5.0, 95.0]).tolist()
            lows.append(inner[0])
            highs.append(inner[1])
    if not lows:
        return 0.0, 1.0
    low, high = min(lows) / _M, max(highs) / _M
    margin = max(_LEAST_MARGIN_M, 0.03 * (high - low))
    return low - margin, high + margin


def _near_layers(view: PixelView) -> FloatArray | None:
    """Samples that the view is to hold; under learnt noise without those that are background, far from every layer."""
    if view.samples_mm is None or view.mixture is None or not len(view.range_mm):
        return view.samples_mm
    reach = _BACKGROUND_SIGMAS * view.sigma_mm + view.mixture.drift_extent_mm()
    return view.samples_mm[(np.abs(view.samples_mm[:, np.newaxis] - view.range_mm) < reach).any(axis=1)]


def _bins(samples_mm: FloatArray, range_m: FloatArray) -> int:
    """Number of bins over the view, by Freedman and Diaconis' width, at most `_MOST_BINS`."""
    spread = float(np.subtract(*np.percentile(samples_mm, [75.0, 25.0]))) / _M
    width = 2.0 * spread / np.cbrt(samples_mm.size)
    length = float(range_m[-1] - range_m[0])
    return _MOST_BINS if width <= 0 else int(np.clip(length / width, _MOST_BINS // 2, _MOST_BINS))
