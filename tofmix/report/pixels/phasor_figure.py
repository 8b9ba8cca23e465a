"""Draws a pixel in the complex plane, from the data of `tofmix.report.pixels.phasor_plane`."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Ellipse

from tofmix.arrays import FloatArray
from tofmix.flags import Mixing
from tofmix.report.pixels.phasor_plane import REACH, PhasorEnd, PhasorPlane
from tofmix.report.theme import Theme
from tofmix.wording import counted

PLANE_INCH = 4.2
"""Height of the panel."""

_ERRORS = 3.0
"""Half axes of the mean's ellipse, in standard errors."""

_SIDE_MARGIN, _MARGIN = 0.4, 0.1
"""Margins on each side of the drawing, as parts of its extent: for the labels of the ends."""

_PLANE_POINTS = 250.0
"""Height of the plane in points of 1/72 inch, about: for the distance between labels."""

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
    width, height = (2.0 * _ERRORS * math.sqrt(float(value)) for value in values)
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
        label=f"mean of the samples, and\nan ellipse of {_ERRORS:.0f} standard errors",
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
    points = _PLANE_POINTS / float(np.ptp(axes.dataLim.get_points()[:, 1]) or 1.0)
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
