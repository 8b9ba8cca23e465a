"""Where the further layers of pixels stand that visibly see one surface: at a surface that other pixels see, or not.

A pixel is a cone: beside an edge it sees a little of the surface next to it. The rule of `clusters.py` looks at one
pixel alone, so that a surface of few samples is none to it, and a second layer there counts as wrong. Other pixels
tell more: use `further_layers` to sort the further layers of single pixels by the clusters of the other pixels. It
does not call the package either.
"""

from dataclasses import dataclass

import numpy as np
from benchmarks.clusters import GAP, Judged, Kind

from tofmix.arrays import BoolArray, FloatArray

AROUND = 2
"""Pixels on each side that are taken for the surroundings of a pixel: 24 in all."""

SEEN_BY = 0.01
"""Share of the recording's pixels that have a cluster at a range which then counts as one of the scene's."""

STEPS = 4096
"""Places of the working range at which clusters are counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FurtherLayers:
    """Further layers of the single pixels of a recording: each is in one of four groups, the first that fits."""

    beside: int
    """Layers within `GAP` half-widths of the pixel's own cluster."""
    around: int
    """Layers within a cluster of one of the pixels around."""
    scene: int
    """Layers at a range at which `SEEN_BY` of the recording's pixels have a cluster."""
    elsewhere: int
    """All others."""
    around_by_chance: float
    scene_by_chance: float
    """`around_by_chance`, `scene_by_chance`: share of the working range that such clusters cover, at the pixels with a
    layer in the last three groups: so many layers would be in the group if they stood anywhere. NaN without such
    layers."""
    pixels_elsewhere: float
    """Share of the single pixels with a layer elsewhere."""


def further_layers(
    judged: Judged, shape: tuple[int, int], range_mm: FloatArray, weight: FloatArray, *, low_mm: float, high_mm: float
) -> FurtherLayers:
    """Sort the further layers of the single pixels.

    `judged`: clusters of all pixels.
    `shape` (int, int): rows and columns of the image.
    `range_mm`, `weight` (pixel, layer) float64: layers of all pixels, NaN past the last; the one of the largest share
      is the first, the others are further ones.
    `low_mm`, `high_mm`: ends of the working range, mm.
    """
    places = np.linspace(low_mm, high_mm, STEPS)
    seen = np.array([_covered(judged, [pixel], places) for pixel in range(len(judged.kind))])
    scene = np.asarray(seen.mean(axis=0) >= SEEN_BY)
    beside = around = at_scene = elsewhere = 0
    cover_around, cover_scene, strange = [], [], 0
    single = judged.pixels(Kind.SINGLE)
    for pixel in single:
        known = np.flatnonzero(np.isfinite(range_mm[pixel]))
        if known.size < 2:
            continue
        main = known[np.argmax(weight[pixel][known])]
        own, reach = judged.clusters[pixel][0], GAP * judged.half_width_mm
        near = np.asarray(seen[_around(pixel, shape)].any(axis=0))
        alone = False
        for layer in known[known != main]:
            at = range_mm[pixel, layer]
            if own.low_mm - reach <= at <= own.high_mm + reach:
                beside += 1
                continue
            cover_around.append(near.mean())
            cover_scene.append(scene.mean())
            place = int(np.argmin(np.abs(places - at)))
            if near[place]:
                around += 1
            elif scene[place]:
                at_scene += 1
            else:
                elsewhere += 1
                alone = True
        strange += alone
    return FurtherLayers(
        beside=beside,
        around=around,
        scene=at_scene,
        elsewhere=elsewhere,
        around_by_chance=float(np.mean(cover_around)) if cover_around else np.nan,
        scene_by_chance=float(np.mean(cover_scene)) if cover_scene else np.nan,
        pixels_elsewhere=strange / max(single.size, 1),
    )


def _covered(judged: Judged, pixels: list[int], places: FloatArray) -> BoolArray:
    """Which places lie within a cluster of one of these pixels."""
    covered = np.zeros(places.size, dtype=bool)
    for pixel in pixels:
        for cluster in judged.clusters[pixel]:
            covered |= (places >= cluster.low_mm) & (places <= cluster.high_mm)
    return covered


def _around(pixel: int, shape: tuple[int, int]) -> list[int]:
    """Numbers of the pixels around one."""
    row, col = divmod(int(pixel), shape[1])
    return [
        r * shape[1] + c
        for r in range(max(0, row - AROUND), min(shape[0], row + AROUND + 1))
        for c in range(max(0, col - AROUND), min(shape[1], col + AROUND + 1))
        if (r, c) != (row, col)
    ]
