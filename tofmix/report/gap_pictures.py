"""Pictures of a reconciliation: statistics against their axes before and after, and maps of what is left."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from tofmix.arrays import FloatArray
from tofmix.reconcile.panel import Curve
from tofmix.reconcile.workflow import Reconciliation
from tofmix.report.theme import Theme, drawn, mark_no_data

if TYPE_CHECKING:
    from tofmix.reconcile.compare import Compared

_MOST = 8
_MANY = 40  # bins: no marker for each
_DIVERGING = "PuOr"


class GapPicture(NamedTuple):
    """A picture in both themes, as ``data:`` URIs."""

    title: str
    alt: str
    light: str
    dark: str
    width: int
    height: int


def curve_pictures(result: Reconciliation) -> list[GapPicture]:
    """The statistics that disagree most before, each with what it is after."""
    v = result.verified
    after = {c.name: c for c in v.after.curves}
    drawable = [c for c in v.before.curves if c.dof > 1 and not c.statistic.endswith("pattern")]
    top = sorted(drawable, key=lambda c: -c.z)[:_MOST]
    several = len(result.models) > 1
    return [_picture(_words(c, several), _curve(c, after.get(c.name), named=bool(result.named))) for c in top]


def _words(curve: Curve, several: bool) -> str:
    words = f"{curve.statistic.replace('_', ' ')} against {curve.axis.replace('_', ' ')}"
    return f"{words}, recording {curve.recording + 1}" if several else words


def _picture(title: str, draw: Callable[[Theme], Figure], kind: str = "svg") -> GapPicture:
    light, dark, (width, height) = drawn(draw, kind)  # type: ignore[arg-type]
    return GapPicture(title, title, light, dark, width, height)


def _curve(before: Curve, after: Curve | None, *, named: bool) -> Callable[[Theme], Figure]:
    def draw(theme: Theme) -> Figure:
        figure = Figure(figsize=(5.0, 2.9), layout="constrained")
        axes = figure.add_subplot()
        error = 2 * np.sqrt(before.variance)
        at = (before.lower + before.upper) / 2
        many = before.dof > _MANY
        axes.fill_between(at, -error, error, color=theme.grid, label="chance, 2 standard errors", linewidth=0)
        shape: dict[str, Any] = {
            "linestyle": "-",
            "marker": "" if many else "o",
            "markersize": 4,
            "linewidth": 0.8 if many else 1.5,
        }
        axes.plot(at, before.value, color=theme.accent, label="before", **shape)
        if after is not None and named:
            middle = (after.lower + after.upper) / 2
            axes.plot(middle, after.value, color=theme.layers[0], label="after", **{**shape, "linestyle": "--"})
        axes.set_xlabel(before.axis.replace("_", " ") + (f" ({before.unit})" if before.unit != "1" else ""))
        in_sigma = before.statistic in ("bias", "trend", "common_mode")
        axes.set_ylabel("bias (sigma)" if in_sigma else before.statistic.replace("_", " "))
        axes.grid(visible=True)
        axes.legend(loc="best", fontsize=8)
        return figure

    return draw


def map_pictures(result: Reconciliation) -> list[GapPicture]:
    """Each pixel's mean score, before and after."""
    v = result.verified
    shape = (result.models[0].sensor.rows, result.models[0].sensor.cols)
    parts: list[tuple[str, Compared]] = [("mean score of each pixel, before", v.before)]
    if result.named:
        parts.append(("mean score of each pixel, after", v.after))
    finite = v.before.pattern[np.isfinite(v.before.pattern)]
    limit = max(float(np.quantile(np.abs(finite), 0.98)) if finite.size else 1.0, 0.2)
    several = len(result.models) > 1
    return [
        _picture(f"{title}, recording {k + 1}" if several else title, _map(pattern.reshape(shape), limit), "png")
        for title, part in parts for k, pattern in enumerate(part.pattern)
    ]  # fmt: skip


def _map(values: FloatArray, limit: float) -> Callable[[Theme], Figure]:
    def draw(theme: Theme) -> Figure:
        rows, cols = values.shape
        figure = Figure(figsize=(5.0, min(max(5.0 * rows / cols, 1.5), 6.0)), layout="constrained")
        axes = figure.add_subplot()
        mark_no_data(axes, theme)
        shown = axes.imshow(values, cmap=_DIVERGING, vmin=-limit, vmax=limit, interpolation="nearest")
        bar = figure.colorbar(shown, ax=axes, extend="both")
        bar.set_label("measured less predicted (sigma)")
        axes.set_xlabel("col")
        axes.set_ylabel("row")
        return figure

    return draw
