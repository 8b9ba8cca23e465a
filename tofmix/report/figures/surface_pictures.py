"""The page's part about surfaces: a map of them, their edges over the whole pixels, and the fine range image."""

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from tofmix.arrays import BoolArray
from tofmix.layers import Layers
from tofmix.report.figures.picture import MARK, Picture, kinds_picture, range_picture
from tofmix.surfaces.found import Edges, WindowSurfaces
from tofmix.wording import counted

_COLOURS = "tab20"
"""Colours of different surfaces; they repeat after the last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfacesPart:
    """The part of the page: a sentence, and the images."""

    line: str
    images: tuple[Picture, ...]


def draw_surfaces(
    found: WindowSurfaces, layers: Layers, *, first: int, scale: tuple[float, float], most_named: int = 8
) -> SurfacesPart:
    """Draw the surfaces of a window.

    `first` is the number of its first surface: numbers may be those of the file. `scale` are the limits of the colours
    of ranges, mm. The legend names the `most_named` largest surfaces.
    """
    rows, cols = found.surface.shape[:2]
    numbers, sizes = np.unique(found.surface[found.surface >= 0], return_counts=True)
    lines = found.edges.lines()
    known = found.edges.stderr[np.isfinite(found.edges.stderr)]
    error = f", median error {np.median(known):.3f} pixels" if len(known) else ""
    smooth = int(np.isin(numbers, np.flatnonzero(found.planes.is_smooth)).sum())
    bent = f", {smooth:,} of them smooth and no plane" if smooth else ""
    text = f"{counted(len(numbers), 'surface', ',')}{bent}; {counted(len(lines), 'line', ',')} of edges{error}."
    shades = [to_hex(colour) for colour in colormaps[_COLOURS].colors]  # type: ignore[attr-defined]  # a listed map
    kind = np.where(found.surface_fine >= 0, (found.surface_fine - first) % len(shades), len(shades)).astype(np.uint8)
    order = np.argsort(-sizes, kind="stable")[:most_named]
    legend = tuple(
        (shades[(numbers[k] - first) % len(shades)], f"surface {numbers[k]}: {counted(int(sizes[k]), 'layer', ',')}")
        for k in order
    )
    marked = edge_parts(found.edges, found.range_fine.shape, found.factor)
    # Half a pixel thick: the page shows an image smaller than its parts are many.
    marked = binary_dilation(marked, iterations=max(1, found.factor // 4))
    whole = np.repeat(np.repeat(layers.range[..., 0], found.factor, axis=0), found.factor, axis=1).astype(np.float64)
    image = (rows, cols)
    surfaces = kinds_picture(
        kind,
        names=(),
        colours=shades,
        legend=legend,
        image=image,
        title="Surfaces",
        alt=f"Surface of each part of a pixel over the image plane. {text}",
        shows="The nearest surface in each part of a pixel; colours repeat after twenty.",
        good="One colour on each object, and walls behind others in one colour.",
        bad="Speckles, or one object in many colours: noise above its standard errors, or creases.",
    )
    edges = range_picture(
        whole,
        scale=scale,
        marked=marked,
        legend=((MARK, "edge"),),
        image=image,
        title="Edges over the nearest layers",
        alt=f"Lines where surfaces end, over the nearest layer of each pixel. {text}",
        shows="Where surfaces end within the pixels, from the shares of the beam.",
        good="Straight or smooth lines along the objects.",
        bad="Lines that jump from pixel to pixel.",
    )
    fine = range_picture(
        found.range_fine.astype(np.float64),
        scale=scale,
        image=image,
        title="Range below a pixel",
        alt=f"Range of the nearest surface in {found.factor} x {found.factor} parts of each pixel.",
        shows="The range of the nearest surface in each part of a pixel, on its plane or its smooth fit.",
        good="Sharp edges without steps of pixels.",
        bad="Steps and gaps at edges.",
    )
    return SurfacesPart(line=text, images=(surfaces, edges, fine))


def edge_parts(edges: Edges, shape: tuple[int, ...], factor: int) -> BoolArray:
    """Parts of pixels (row, col) that lines of edges run through."""
    marked = np.zeros(shape, dtype=bool)
    for line in edges.lines():
        places = np.stack([edges.row[line], edges.col[line]], axis=1).astype(np.float64)
        marked[_parts(places, shape, factor)] = True
        steps = np.diff(places, axis=0)
        count = np.maximum(1, np.ceil(2 * factor * np.abs(steps).max(axis=1, initial=0.0)).astype(int))
        for begin, step, parts in zip(places, steps, count, strict=False):
            along = np.linspace(0.0, 1.0, parts + 1)[:, np.newaxis]
            marked[_parts(begin + along * step, shape, factor)] = True
    return marked


def _parts(places: NDArray[np.float64], shape: tuple[int, ...], factor: int) -> tuple[NDArray[np.int64], ...]:
    """Row and column of the parts that places (place, 2) lie in, the nearest within the image."""
    inside = np.clip(np.floor((places + 0.5) * factor).astype(np.int64), 0, np.array(shape) - 1)
    return inside[:, 0], inside[:, 1]
