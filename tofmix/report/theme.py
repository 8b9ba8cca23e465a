"""How the pictures look: colours for light and dark pages, and their bytes.

Every picture comes in both themes. The colour maps and the categories
(Okabe and Ito) keep their order under every kind of colour blindness.
"""

import base64
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Literal

from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

RANGE_MAP = "cividis"
"""Ranges alone, so that one colour means one thing."""
COUNT_MAP = "viridis"
"""Numbers of surfaces."""
DENSITY_MAP = "cividis"
"""Counts of a histogram in two dimensions."""
GAP_MAP = "PuOr"
LAYER_LINES = ("-", "--", ":")


_HATCH = "////"
_SETTINGS = {
    "font.size": 10.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 10.0,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "hatch.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "tofmix",  # the same picture has the same ids, hence the same bytes
    "figure.dpi": 130.0,
    "savefig.dpi": "figure",
}

Format = Literal["png", "svg"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Theme:
    """Colours of a page: text, ground, grid, no data and its hatch, and one for each of the first three layers."""

    ink: str
    paper: str
    grid: str
    no_data: str
    hatch: str
    no_surface: str
    accent: str
    layers: tuple[str, str, str]


LIGHT = Theme(
    ink="#1f2328",
    paper="#ffffff",
    grid="#d8dee4",
    no_data="#e4e7eb",
    hatch="#8c959f",
    no_surface="#ffffff",
    accent="#d55e00",
    layers=("#0072b2", "#e69f00", "#009e73"),
)
DARK = Theme(
    ink="#e6edf3",
    paper="#161b22",
    grid="#343b44",
    no_data="#2b323b",
    hatch="#6e7681",
    no_surface="#05070a",
    accent="#ff8c42",
    layers=("#56b4e9", "#f0b429", "#1fc79a"),
)


@contextmanager
def drawing(theme: Theme) -> Iterator[None]:
    """Draw with these colours and Matplotlib's defaults, without the user's matplotlibrc."""
    colours = {
        "text.color": theme.ink,
        "axes.labelcolor": theme.ink,
        "axes.edgecolor": theme.ink,
        "xtick.color": theme.ink,
        "ytick.color": theme.ink,
        "axes.facecolor": theme.paper,
        "figure.facecolor": theme.paper,
        "savefig.facecolor": theme.paper,
        "grid.color": theme.grid,
    }
    with style.context(["default", _SETTINGS | colours]):
        yield


def drawn(draw: Callable[[Theme], Figure], kind: Format) -> tuple[str, str, tuple[int, int]]:
    """Draw a picture in both themes: PNG for images, SVG for curves.

    Returns
    -------
    light, dark : str
        ``data:`` URIs; the same figure gives the same text.
    size : (int, int)
        Width and height in CSS pixels, 96 an inch.
    """
    light, size = _saved(draw, kind, LIGHT)
    # An SVG names its colours, so it need not be drawn twice; laying out the text takes most of the time.
    dark = _recoloured(light) if kind == "svg" else _saved(draw, kind, DARK)[0]
    return _data_uri(light, kind), _data_uri(dark, kind), size


def figure_bytes(draw: Callable[[Theme], Figure], kind: Format) -> bytes:
    """Draw a figure on a light background as a file; the same figure gives the same bytes."""
    return _saved(draw, kind, LIGHT)[0]


def _saved(draw: Callable[[Theme], Figure], kind: Format, theme: Theme) -> tuple[bytes, tuple[int, int]]:
    nothing = {"Software": None} if kind == "png" else {"Date": None, "Creator": None}
    buffer = io.BytesIO()
    with drawing(theme):
        figure = draw(theme)
        figure.savefig(buffer, format=kind, metadata=nothing)
    width, height = figure.get_size_inches()
    return buffer.getvalue(), (round(96 * width), round(96 * height))


def _recoloured(svg: bytes) -> bytes:
    """Return the same SVG in the dark theme; an image inside it is base64, which has no ``#``."""
    light, dark = asdict(LIGHT), asdict(DARK)
    pairs = {light[key]: dark[key] for key in light if isinstance(light[key], str) and key != "no_surface"}
    pairs |= dict(zip(LIGHT.layers, DARK.layers, strict=True))
    return re.sub(rb"#[0-9a-f]{6}", lambda m: pairs.get(m[0].decode(), m[0].decode()).encode(), svg)


def _data_uri(content: bytes, kind: Format) -> str:
    mime = "image/png" if kind == "png" else "image/svg+xml"
    return f"data:{mime};base64,{base64.b64encode(content).decode('ascii')}"


def mark_no_data(axes: Axes, theme: Theme) -> None:
    """Hatch the background of an image, which is visible where the image has no value."""
    axes.patch.set(facecolor=theme.no_data, edgecolor=theme.hatch, hatch=_HATCH, linewidth=0)


def new_figure(height_inch: float) -> Figure:
    """Make a figure of the width of a page."""
    width_inch = 7.2  # width of a figure, inch: of a page of text
    return Figure(figsize=(width_inch, height_inch), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06))
