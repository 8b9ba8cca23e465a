"""Pictures of a reconciliation: statistics over their axes before and after, and maps of the residuals."""

import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tofmix.arrays import FloatArray
from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.workflow import Reconciliation
from tofmix.report.figures.picture import Picture, difference_picture, figure_picture
from tofmix.report.theme import Theme

if TYPE_CHECKING:
    from tofmix.reconciliation.comparison.compare import Compared

_IN_MM = ("bias", "trend", "common_mode")
_COUNTED = ("row", "col", "surface", "surfaces_in_pixel", "frame")
_MEANINGS = {
    "bias": "mean, measured minus predicted",
    "trend": "mean, measured minus predicted",
    "common_mode": "mean, measured minus predicted",
    "spread": "spread beyond the predicted one",
    "bursts": "spread beyond the predicted one",
    "skew": "skew (normalised)",
    "tails": "tails (normalised)",
    "invalid": "invalid samples beyond those predicted",
    "bridging": "mixed samples beyond those predicted",
    "memory": "correlation",
    "neighbour_correlation": "correlation",
}


def curve_pictures(result: Reconciliation) -> list[Picture]:
    """Curves that disagree most, in the order of `where`, and the most telling one of each other statistic."""
    v = result.verified
    after = {c.name: c for c in v.after.curves} if result.named else {}
    drawable = [c for c in v.before.curves if c.dof > 1 and not c.statistic.endswith("pattern")]
    named = {(p.statistic, p.axis, p.recording): number for number, p in reversed(list(enumerate(result.where)))}
    ranked = sorted(drawable, key=lambda c: (named.get(c.name, len(named)), -c.z))
    most = 6  # curves that have a picture; the rest are named
    top = ranked[:most]
    for curve in ranked[most:]:
        if curve.statistic not in {c.statistic for c in top} and (curve.value != 0).any():
            top.append(curve)
    several = len(result.models) > 1
    return [_curve_picture(c, after.get(c.name), result, several=several) for c in top]


def _curve_picture(before: Curve, after: Curve | None, result: Reconciliation, *, several: bool) -> Picture:
    words = f"{before.statistic} against {_axis(before)}".replace("_", " ")
    title = f"{words}, recording {before.recording + 1}" if several else words
    now = "" if after is None else f", {after.distance:.1f} after"
    alt = f"{title}: {before.distance:.1f} times noise alone before{now}"
    names = [s.name for s in result.models[before.recording].surfaces]
    return figure_picture(_curve(before, after, names), title=title, alt=alt)


def _axis(curve: Curve) -> str:
    """The axis of a curve; waves over whole mm have their periods."""
    return "period" if curve.axis == "all" else curve.axis.replace("_", " ")


def _curve(before: Curve, after: Curve | None, names: list[str]) -> Callable[[Theme], Figure]:
    def draw(theme: Theme) -> Figure:
        width = 5.0  # in
        figure = Figure(figsize=(width, 2.9), layout="constrained")
        axes = figure.add_subplot()
        axes.grid(visible=True)
        axes.set_axisbelow(True)
        scale = before.scale_mm if before.statistic in _IN_MM else np.ones(before.dof)
        error = 2 * np.sqrt(before.variance) * scale
        edges = np.stack([before.lower, before.upper], axis=1).ravel()
        axes.fill_between(
            edges,
            np.repeat(-error, 2),
            np.repeat(error, 2),
            color=theme.grid,
            label="noise alone, 2 standard errors",
            linewidth=0,
        )
        _steps(axes, before, scale, color=theme.accent, label="before")
        if after is not None:
            now = after.scale_mm if after.statistic in _IN_MM else np.ones(after.dof)
            _steps(axes, after, now, color=theme.layers[0], label="after")
        axes.set_xlabel(_axis(before) + (f" ({before.unit})" if before.unit != "1" else ""))
        meaning = _MEANINGS.get(before.statistic, before.statistic.replace("_", " "))
        label = f"{meaning} (mm)" if before.statistic in _IN_MM else meaning
        axes.set_ylabel(textwrap.fill(label, 28), fontsize=8)  # characters: a longer line reaches the legend
        if before.axis in _COUNTED:
            _count(axes, before, names)
        figure.legend(loc="outside upper left", ncols=3, fontsize=8)
        return figure

    return draw


def _steps(axes: Axes, curve: Curve, scale: FloatArray, *, color: str, label: str) -> None:
    """One level for each bin, with a dot in its middle; a line through the middles where there are many.

    Dots alone where bins have no width: waves of one period have two values.
    """
    middle, value = (curve.lower + curve.upper) / 2, curve.value * scale
    if (curve.lower == curve.upper).all():
        axes.plot(middle, value, color=color, label=label, linestyle="none", marker="o", markersize=2.5)
        return
    many = 40  # bins: no marker for each
    if curve.dof > many:
        axes.plot(middle, value, color=color, label=label, linewidth=0.8)
        return
    axes.hlines(value, curve.lower, curve.upper, color=color, linewidth=1.5)
    dots: dict[str, Any] = {"marker": "o", "markersize": 4, "linestyle": "-", "linewidth": 0.5}
    axes.plot(middle, value, color=color, label=label, **dots)


def _count(axes: Axes, curve: Curve, names: list[str]) -> None:
    """Whole numbers at the middles of their bins; the surfaces' own names where they are few."""
    middle = (curve.lower + curve.upper) / 2
    if curve.axis == "surface" and curve.dof <= len(names) + 1 <= 6:  # noqa: PLR2004
        named = [*names, "no surface"]  # layers of a measured scene may be of none
        words = [named[int(low)] if low >= 0 else "no return" for low in curve.lower]
        axes.set_xticks(middle, [w.replace(" ", "\n", 1) for w in words], fontsize=8)
    elif curve.axis in ("surface", "surfaces_in_pixel"):
        axes.set_xticks(middle, [f"{low:.0f}" for low in curve.lower])
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def map_pictures(result: Reconciliation) -> list[Picture]:
    """Each pixel's mean score, before and after."""
    v = result.verified
    shape = (result.models[0].sensor.rows, result.models[0].sensor.cols)
    parts: list[tuple[str, Compared]] = [("residual of each pixel, before", v.before)]
    if result.named:
        parts.append(("residual of each pixel, after", v.after))
    finite = v.before.pattern[np.isfinite(v.before.pattern)]
    most = max(float(np.quantile(np.abs(finite), 0.98)) if finite.size else 1.0, 0.2)
    several = len(result.models) > 1
    return [
        difference_picture(
            pattern.reshape(shape),
            most=most,
            unit="sigma",
            no_data="no sample",
            title=f"{title}, recording {k + 1}" if several else title,
            alt="map of the image: each pixel's mean score, 0 if the model is right",
            shows="Measured minus predicted.",
        )
        for title, part in parts
        for k, pattern in enumerate(part.pattern)
    ]
