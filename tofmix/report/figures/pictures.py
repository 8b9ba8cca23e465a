"""The pictures of one window, each with its text."""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.report.averaging import AveragedImage
from tofmix.report.figures.curves import SHOWN_LAYERS, range_histogram, sigma_figure, weight_histogram
from tofmix.report.figures.images import colour_scale
from tofmix.report.figures.lost_pictures import lost_picture
from tofmix.report.figures.picture import Picture, make_picture
from tofmix.report.figures.rasters import (
    ABOVE,
    BELOW,
    MANY,
    ImagePicture,
    bar_labels,
    count_colours,
    count_label,
    count_uri,
    range_uri,
)
from tofmix.report.summary.tables import ordinal
from tofmix.report.theme import DARK, LIGHT
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.wording import counted

NO_DATA, NO_SURFACE = "var(--hatching)", "var(--no-surface)"
"""Backgrounds of the legend, which the page's style has in both themes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gallery:
    """The pictures of a page: over the image plane, and histograms."""

    images: tuple[ImagePicture, ...]
    histograms: tuple[Picture, ...]


def draw_gallery(
    layers: Layers, averaged: AveragedImage, sensor: Sensor, *, scale: tuple[float, float], frames: int
) -> Gallery:
    """Draw every picture of a window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    averaged : AveragedImage
        The averaged image of the same window.
    sensor : Sensor
        For the noise curve.
    scale : (float, float)
        Limits of the colours of all range images, mm; see `range_scale`.
    frames : int
        Frames of the window.

    Returns
    -------
    Gallery
        All pictures; every first to third layer that the file can hold has one, and lost samples have one if there
        are any.
    """
    lost = lost_picture(layers.invalid_share, frames)
    return Gallery(
        images=(*_range_pictures(layers, averaged, scale), _count_picture(layers), *(() if lost is None else (lost,))),
        histograms=_histogram_pictures(layers, sensor.noise),
    )


def range_scale(layers: Layers, averaged: AveragedImage, sensor: Sensor) -> tuple[float, float]:
    """Limits in mm of the colours of all range images of a window, by its layers if there are any."""
    default = (sensor.range_min_mm or 0.0, sensor.range_max_mm or 10_000.0)
    ranges = layers.range.astype(np.float64)
    return colour_scale(ranges if np.isfinite(ranges).any() else averaged.range_mm, default=default)


def _range_pictures(layers: Layers, averaged: AveragedImage, scale: tuple[float, float]) -> list[ImagePicture]:
    pictures = [
        _range_picture(
            averaged.range_mm,
            scale,
            no_data="no data to average",
            title="Averaged image",
            alt=f"Averaged range over the image plane. {_extent(averaged.range_mm)}",
            shows=f"One range a pixel, the {averaged.averaging}. The colours are those of the layers; open space has"
            " the largest range.",
            good="Sharp edges between surfaces.",
            bad="Edges with colours in between: ranges without a surface.",
        )
    ]
    shown = range(min(SHOWN_LAYERS, layers.max_layers))
    return pictures + [_layer_picture(k + 1, layers.range[..., k].astype(np.float64), scale) for k in shown]


def _layer_picture(layer: int, range_mm: FloatArray, scale: tuple[float, float]) -> ImagePicture:
    name = ordinal(layer)
    return _range_picture(
        range_mm,
        scale,
        no_data=f"no {name} layer",
        title=f"{name.capitalize()} layer",
        alt=f"Range of the {name} layer over the image plane. {_extent(range_mm)}",
        **_LAYER_WORDS[layer],
    )


def _range_picture(range_mm: FloatArray, scale: tuple[float, float], *, no_data: str, **words: str) -> ImagePicture:
    uri = range_uri(range_mm, scale=scale)
    rows, cols = range_mm.shape
    legend = [
        (BELOW, f"below {scale[0]:.0f} mm") if bool((range_mm < scale[0]).any()) else None,
        (ABOVE, f"above {scale[1]:.0f} mm") if bool((range_mm > scale[1]).any()) else None,
        (NO_DATA, no_data) if bool(np.isnan(range_mm).any()) else None,
    ]
    entries = tuple(entry for entry in legend if entry is not None)
    return ImagePicture(light=uri, dark=uri, rows=rows, cols=cols, bar=bar_labels(scale), legend=entries, **words)


_LAYER_WORDS: dict[int, dict[str, str]] = {
    1: {
        "shows": "The nearest surface of each pixel.",
        "good": "Every surface in one colour up to its edge; hatching only where there is open space.",
        "bad": "Specks of other ranges inside a surface, or hatching on it.",
    },
    2: {
        "shows": "The second surface of pixels with two or more.",
        "good": "Thin lines along edges, in the colour of the surface behind.",
        "bad": "Specks scattered over plain surfaces: components without a surface.",
    },
    3: {
        "shows": "The third surface of pixels with three or more.",
        "good": "Few pixels, where three surfaces meet; hatching elsewhere.",
        "bad": "Many pixels away from any edge.",
    },
}


def _extent(range_mm: FloatArray) -> str:
    """Describe the content of an image in one sentence."""
    finite = range_mm[np.isfinite(range_mm)]
    if finite.size == 0:
        return "No pixel has data."
    empty = 100 * (1 - finite.size / range_mm.size)
    values = f"Median {np.median(finite):.0f} mm, from {finite.min():.0f} to {finite.max():.0f} mm"
    return f"{values}; no data in {empty:.1f} % of the pixels."


def _count_picture(layers: Layers) -> ImagePicture:
    fitted = layers.status != int(Status.TOO_FEW_SAMPLES)
    counts = np.bincount(layers.n_modes[fitted], minlength=int(layers.n_modes.max(initial=0)) + 1)
    found = "; ".join(f"{n}: {counted(count, 'pixel')}" for n, count in enumerate(counts.tolist()) if count)
    light, dark = (count_uri(layers.n_modes, fitted=fitted, theme=theme) for theme in (LIGHT, DARK))
    present = sorted({min(n, MANY) for n, count in enumerate(counts.tolist()) if count})
    colours = [NO_SURFACE, *count_colours(len(counts) - 1, LIGHT)[1:]]
    legend = [(colours[n], count_label(n)) for n in present]
    rows, cols = layers.shape
    return ImagePicture(
        title="Number of surfaces",
        alt=f"Number of surfaces in each pixel over the image plane. {found or 'nothing was fitted'}.",
        shows="Number of surfaces in each pixel.",
        good="One on surfaces, two along edges, more where edges meet.",
        bad="Pixels with two surfaces scattered over a flat surface, or edges with one surface only.",
        light=light,
        dark=dark,
        rows=rows,
        cols=cols,
        bar=(),
        legend=(*legend, *(() if fitted.all() else ((NO_DATA, "not fitted"),))),
    )


def _histogram_pictures(layers: Layers, curve: NoiseCurve | None) -> tuple[Picture, ...]:
    ranges = layers.range.astype(np.float64)
    known = layers.weight[np.isfinite(layers.weight)]
    sigma = layers.sigma[np.isfinite(layers.sigma)]
    weight_text = f"Median share {np.median(known):.2f}." if known.size else "No layer."
    sigma_text = f"Median sigma {np.median(sigma):.1f} mm." if sigma.size else "No component."
    return (
        make_picture(
            lambda theme: range_histogram(layers, theme=theme),
            "svg",
            title="Ranges",
            alt=f"Histogram of the ranges of each layer. {_extent(ranges)}",
            shows="Number of pixels with a layer at each range.",
            good="A peak for each surface, none between them.",
            bad="Layers between the peaks, at ranges without a surface.",
        ),
        make_picture(
            lambda theme: weight_histogram(layers, theme=theme),
            "svg",
            title="Shares",
            alt=f"Histogram of the shares of each layer and of no return. {weight_text}",
            shows="Share of the beam of each layer.",
            good="A first layer mostly at 1; the shares of mixed pixels spread evenly.",
            bad="Many layers at shares of a few per cent: outliers counted as surfaces.",
        ),
        make_picture(
            lambda theme: sigma_figure(layers, curve=curve, theme=theme),
            "svg",
            title="Sigma",
            alt=f"Sigma of every component against its range{', with the noise curve' if curve else ''}. {sigma_text}",
            shows="The spread of each component against its range."
            + ("" if curve else " The file has no noise curve to compare with."),
            good="Components along the curve.",
            bad="Components off the curve: it does not fit this recording, or surfaces are merged (above the curve).",
        ),
    )
