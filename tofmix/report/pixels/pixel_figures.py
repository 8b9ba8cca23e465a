"""Figures of single pixels, after the paper's Figs. 7 and 8: samples, density, fitted components.

`draw_density` and `style_axes` also draw the figures of docs/results/paper.md.

A pixel in the complex plane is drawn from the data of `tofmix.report.pixels.phasor_plane`.
"""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from tofmix.arrays import FloatArray
from tofmix.circle import cut_between
from tofmix.estimation.learnt.pixel_mixture import PixelMixture
from tofmix.estimation.peaks.modes import density
from tofmix.flags import Mixing
from tofmix.points import MM_A_METRE as _M
from tofmix.report.pixels.phasor_plane import REACH, PhasorEnd, PhasorPlane
from tofmix.report.pixels.pixels import GrowingDensity, PixelView
from tofmix.report.theme import Theme, new_figure
from tofmix.sensor import NoiseCurve
from tofmix.wording import counted

_SIDE_MARGIN, _MARGIN = 0.4, 0.1
"""Margins on each side of the drawing, as parts of its extent: for the labels of the ends."""


_LABEL_POINTS = (75.0, 27.0)
"""Width and height of a label in points."""

_WIDTHS, _HEIGHTS = (1.7, 1.0), (1.0, 1.15)
"""Plane beside legend and enlarged part; legend above enlarged part."""

_SAID = {
    Mixing.ONE_SURFACE: "one surface",
    Mixing.EVENTS: "samples of one surface each",
    Mixing.PHASOR: "phasor sums",
    Mixing.UNDECIDED: "undecided",
}


def draw_plane(
    figure: Figure | SubFigure, plane: PhasorPlane, *, theme: Theme, zoom_errors: float = 8.0, zoom_part: float = 0.25
) -> None:
    """Draw a pixel in the complex plane into an empty figure, with equal axes; a surface has the colour of its layer.

    The part around the mean is enlarged, `zoom_errors` standard errors to either side, if it is less than `zoom_part`
    of the whole extent.
    """
    grid = figure.add_gridspec(2, 2, width_ratios=_WIDTHS, height_ratios=_HEIGHTS)
    axes = figure.add_subplot(grid[:, 0])
    _draw_all(axes, plane, theme)
    axes.set_title(title(plane), loc="left", fontweight="bold")
    axes.set(xlabel="real part (amplitude)", ylabel="imaginary part (amplitude)")
    extent = _frame(axes)
    _label_ends(axes, plane, theme)
    key = figure.add_subplot(grid[0, 1])
    key.set_axis_off()
    handles, labels = axes.get_legend_handles_labels()
    key.legend(handles, labels, loc="upper left", borderpad=0.0, handlelength=1.4, labelspacing=0.8, fontsize=8.5)
    reach = 0.0 if plane.mean is None else zoom_errors * float(np.sqrt(max(0.0, *_principal(plane)[0])))
    if plane.mean is not None and 0 < reach < zoom_part * extent:
        near = figure.add_subplot(grid[1, 1])
        _draw_all(near, plane, theme)
        near.set_title("around the mean", loc="left")
        near.set(
            xlim=(plane.mean.real - reach, plane.mean.real + reach),
            ylim=(plane.mean.imag - reach, plane.mean.imag + reach),
        )
        near.locator_params(nbins=4)
        near.set_aspect("equal", adjustable="box", anchor="NW")


def _draw_all(axes: Axes, plane: PhasorPlane, theme: Theme) -> None:
    axes.grid(color=theme.grid, linewidth=0.6)
    axes.set_axisbelow(True)
    _draw_samples(axes, plane, theme)
    if plane.mean is not None:
        _draw_mean(axes, plane.mean, plane, theme)
    _draw_neighbours(axes, plane, theme)
    _draw_ends(axes, plane, theme)


def title(plane: PhasorPlane) -> str:
    """``row 20, column 31, complex plane: phasor sums``."""
    empty = plane.mixing == Mixing.ONE_SURFACE and plane.n_layers == 0
    said = "no surface" if empty else _SAID[plane.mixing]
    return f"row {plane.row}, column {plane.col}, complex plane: {said}"


def _draw_samples(axes: Axes, plane: PhasorPlane, theme: Theme) -> None:
    z = plane.samples
    axes.plot(
        z.real,
        z.imag,
        "o",
        color=theme.hatch,
        markersize=2.6,
        markeredgewidth=0,
        alpha=0.8,
        zorder=2.4,
        label=counted(len(z), "sample"),
    )


def _draw_neighbours(axes: Axes, plane: PhasorPlane, theme: Theme) -> None:
    single = plane.neighbour_is_single
    for mask, face, said in (
        (single, theme.ink, "neighbours of one surface"),
        (~single, theme.paper, "other neighbours"),
    ):
        if mask.any():
            axes.plot(
                plane.neighbours[mask].real,
                plane.neighbours[mask].imag,
                "o",
                markerfacecolor=face,
                markeredgecolor=theme.ink,
                markeredgewidth=0.8,
                markersize=3.6,
                alpha=0.75,
                zorder=2.2,
                label=f"{said}\nwithin {REACH} pixels, mean phasors",
            )


def _principal(plane: PhasorPlane) -> tuple[FloatArray, FloatArray]:
    """Variances (2,) of the mean along its principal axes, and these axes in columns (2, 2)."""
    values, vectors = np.linalg.eigh(plane.mean_covariance)
    return np.maximum(values, 0.0), vectors


def _draw_mean(axes: Axes, mean: complex, plane: PhasorPlane, theme: Theme) -> None:
    """Draw the mean as a cross, in the ellipse of its error."""
    values, vectors = _principal(plane)
    errors = 3.0  # half axes of the mean's ellipse, in standard errors
    width, height = (2.0 * errors * math.sqrt(float(value)) for value in values)
    turn = math.degrees(math.atan2(vectors[1, 0], vectors[0, 0]))
    axes.add_patch(
        Ellipse(
            (mean.real, mean.imag),
            width,
            height,
            angle=turn,
            facecolor="none",
            edgecolor=theme.accent,
            linewidth=1.4,
            zorder=3.6,
        )
    )
    axes.plot(
        [mean.real],
        [mean.imag],
        "+",
        color=theme.accent,
        markersize=9.0,
        markeredgewidth=1.4,
        zorder=3.7,
        label=f"mean of the samples, and\nan ellipse of {errors:.0f} standard errors",
    )


def _known(plane: PhasorPlane) -> list[tuple[PhasorEnd, complex]]:
    """The ends whose phasor is known."""
    return [(end, place) for end in plane.ends for place in (end.phasor,) if place is not None]


def _draw_ends(axes: Axes, plane: PhasorPlane, theme: Theme) -> None:
    """Draw the surfaces of an unmixed pixel, and the lines between them."""
    known = np.array([place for _, place in _known(plane)], np.complex128)
    if len(known) > 1:
        several = len(known) > 2  # noqa: PLR2004  a chord has two ends
        corners = np.append(known, known[0]) if several else known
        said = "triangle between its surfaces" if several else "chord between its surfaces"
        axes.plot(corners.real, corners.imag, "-", color=theme.ink, linewidth=1.0, zorder=3.0, label=said)
    for k, end in enumerate(plane.ends):
        place, colour = end.phasor, theme.layers[k % len(theme.layers)]
        if place is None:
            _draw_direction(axes, plane, end, colour)
        else:
            axes.plot(
                [place.real],
                [place.imag],
                "D",
                markerfacecolor="none",
                markersize=10.0,
                markeredgewidth=2.2,
                markeredgecolor=theme.ink if math.isinf(end.range_mm) else colour,
                zorder=3.4,
            )


def _draw_direction(axes: Axes, plane: PhasorPlane, end: PhasorEnd, colour: str) -> None:
    """Draw a surface that no neighbour shows alone: its phase is known, its amplitude is not."""
    shown: FloatArray = np.abs(np.concatenate([plane.samples, plane.neighbours]))
    far = float(shown.max(initial=0.0))
    axes.plot(
        [0.0, far * math.cos(end.phase)],
        [0.0, far * math.sin(end.phase)],
        ":",
        color=colour,
        linewidth=1.8,
        zorder=3.0,
        label=f"{_said(end).replace(chr(10), ', ')}:\nphase alone, no neighbour within\n{REACH} pixels shows it alone",
    )


def _said(end: PhasorEnd) -> str:
    what = "open space" if math.isinf(end.range_mm) else f"{end.range_mm / 1000.0:.3f} m"
    return f"{what}\nshare {end.share:.2f}"


def _frame(axes: Axes) -> float:
    """Make the axes equal, with room around all that is drawn; return its longer side."""
    limits = axes.dataLim.get_points()
    (left, bottom), (right, top) = limits if np.isfinite(limits).all() else ((0.0, 0.0), (1.0, 1.0))
    wide, high = right - left, top - bottom
    side, rest = _SIDE_MARGIN * wide, _MARGIN * high
    # Equal axes may be cut down to the data, but not below: so the room counts as data.
    axes.update_datalim([(left - side, bottom - rest), (right + side, top + rest)])
    axes.set_aspect("equal", adjustable="datalim")
    return float(max(wide, high))


def _label_ends(axes: Axes, plane: PhasorPlane, theme: Theme) -> None:
    """Write ranges and shares next to the ends, left or right, away from other ends and labels."""
    known = _known(plane)
    if not known:
        return
    middle = sum(place for _, place in known) / len(known)
    plane_points = 250.0  # height of the plane in points of 1/72 inch, about: for the distance between labels
    points = plane_points / float(np.ptp(axes.dataLim.get_points()[:, 1]) or 1.0)
    width, height = _LABEL_POINTS
    written: list[tuple[bool, float, float]] = []
    for end, place in sorted(known, key=lambda pair: pair[1].imag):
        x, y = points * place.real, points * place.imag
        close = [
            other.real
            for _, other in known
            if other != place
            and points * abs(other.real - place.real) < width
            and points * abs(other.imag - place.imag) < height
        ]
        right = place.real >= (min(close) if close else middle.real)
        below = [at + height for side, beside, at in written if side == right and abs(beside - x) < width]
        at = max([y, *below])
        written.append((right, x, at))
        axes.annotate(
            _said(end),
            (place.real, place.imag),
            xytext=(11.0 if right else -11.0, at - y),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            fontsize=9.0,
            zorder=5.0,
            bbox={"facecolor": theme.paper, "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
            arrowprops={"arrowstyle": "-", "color": theme.ink, "linewidth": 0.6} if at > y else None,
        )


_STRIP_INCH, _SCATTER_INCH = 1.15, 2.4
"""Heights of one number of samples, and of the modes over samples, inch."""


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
    panel_inch = 2.5  # height of a panel, inch, and panels side by side
    height = panel_inch * rows + 0.7
    plane_inch = 4.2  # height of the panel
    figure = new_figure(height + (0.0 if plane is None else plane_inch))
    part: Figure | SubFigure = figure
    if plane is not None:
        part, below_it = figure.subfigures(2, 1, height_ratios=(height, plane_inch), squeeze=False)[:, 0]
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
    margin_sigmas = 5.0  # margin of a view beyond the outermost surface, in its sigma
    for view in views:
        reach = margin_sigmas * view.sigma_mm
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
    least_margin_m = 0.05  # beyond the outermost sample, m
    margin = max(least_margin_m, 0.03 * (high - low))
    return low - margin, high + margin


def _near_layers(view: PixelView) -> FloatArray | None:
    """Samples that the view is to hold; under learnt noise without those that are background, far from every layer."""
    if view.samples_mm is None or view.mixture is None or not len(view.range_mm):
        return view.samples_mm
    # Under learnt noise, samples this many sigma from every layer are background, and may lie outside the view.
    background_sigmas = 12.0
    reach = background_sigmas * view.sigma_mm + view.mixture.drift_extent_mm()
    return view.samples_mm[(np.abs(view.samples_mm[:, np.newaxis] - view.range_mm) < reach).any(axis=1)]


def _bins(samples_mm: FloatArray, range_m: FloatArray) -> int:
    """Number of bins over the view, by Freedman and Diaconis' width, at most `_MOST_BINS`."""
    spread = float(np.subtract(*np.percentile(samples_mm, [75.0, 25.0]))) / _M
    width = 2.0 * spread / np.cbrt(samples_mm.size)
    length = float(range_m[-1] - range_m[0])
    return _MOST_BINS if width <= 0 else int(np.clip(length / width, _MOST_BINS // 2, _MOST_BINS))
