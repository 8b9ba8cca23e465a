"""Figures as files. Needs the extra ``report`` only when it is called."""

from importlib import import_module
from typing import TYPE_CHECKING

from tofmix.errors import UsageError
from tofmix.report.pixels.phasor_plane import PhasorPlane
from tofmix.report.pixels.pixels import GrowingDensity, PixelView
from tofmix.sensor import NoiseCurve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tofmix.report.theme import Format, Theme

FIGURE_SUFFIXES: dict[str, "Format"] = {".png": "png", ".svg": "svg"}

_MISSING_EXTRA = "a figure needs matplotlib: pip install 'tofmix[report]'"


def pixel_figure(
    views: list[PixelView],
    *,
    noise: NoiseCurve | None,
    growth: GrowingDensity | None,
    kind: "Format",
    unambiguous_range_mm: float | None = None,
    plane: PhasorPlane | None = None,
) -> bytes:
    """Draw neighbouring pixels, or how the density of the first one grew over its layers, as a file.

    The parameters are those of `tofmix.report.pixels.pixel_figures`; the same input gives the same bytes.
    """
    try:
        drawings = import_module("tofmix.report.pixels.pixel_figures")
        theme = import_module("tofmix.report.theme")
    except ImportError as error:
        raise UsageError(_MISSING_EXTRA) from error
    circle = {"unambiguous_range_mm": unambiguous_range_mm}

    def draw(t: "Theme") -> "Figure":
        if growth is None:
            figure: Figure = drawings.neighbours_figure(views, noise=noise, theme=t, plane=plane, **circle)
        else:
            figure = drawings.growth_figure(growth, views[0], theme=t, **circle)
        return figure

    content: bytes = theme.figure_bytes(draw, kind)
    return content
