"""The pictures of one window, each with the words that go with it."""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.report.averaging import AveragedImage
from tofmix.report.curves import (
    SHOWN_LAYERS,
    Section,
    range_histogram,
    section_figure,
    sigma_figure,
    weight_histogram,
)
from tofmix.report.images import colour_scale, count_image, range_image
from tofmix.report.picture import Picture, make_picture
from tofmix.report.tables import ordinal
from tofmix.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Gallery:
    """The pictures of a page: over the image plane, through the middle row, and histograms."""

    images: tuple[Picture, ...]
    section: tuple[Picture, ...]
    histograms: tuple[Picture, ...]


def draw_gallery(layers: Layers, averaged: AveragedImage, sensor: Sensor) -> Gallery:
    """Draw every picture of a window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    averaged : AveragedImage
        The averaged image of the same window.
    sensor : Sensor
        For the field of view, the working range and the noise curve.

    Returns
    -------
    Gallery
        All pictures; every first to third layer that the file can hold has one.
    """
    return Gallery(
        images=(*_range_pictures(layers, averaged, sensor), _count_picture(layers)),
        section=(_section_picture(layers, averaged, sensor),),
        histograms=_histogram_pictures(layers, sensor),
    )


def _range_pictures(layers: Layers, averaged: AveragedImage, sensor: Sensor) -> list[Picture]:
    default = (sensor.range_min_mm or 0.0, sensor.range_max_mm or 10_000.0)
    ranges = layers.range.astype(np.float64)
    scale = colour_scale(ranges if np.isfinite(ranges).any() else averaged.range_mm, default=default)
    pictures = [
        make_picture(
            lambda theme: range_image(averaged.range_mm, scale=scale, no_data="no data to average", theme=theme),
            "png",
            title="Averaged image",
            alt=f"Averaged range over the image plane. {_extent(averaged.range_mm)}",
            shows=f"One range a pixel, the {averaged.averaging}. The colours are those of the layers beside it;"
            " open space shows as the end of the range.",
            good="Sharp edges between surfaces.",
            bad="Edges with colours in between: ranges at which nothing stands.",
        )
    ]
    shown = range(min(SHOWN_LAYERS, layers.max_layers))
    return pictures + [_layer_picture(k + 1, ranges[..., k], scale) for k in shown]


def _layer_picture(layer: int, range_mm: FloatArray, scale: tuple[float, float]) -> Picture:
    name = ordinal(layer)
    return make_picture(
        lambda theme: range_image(range_mm, scale=scale, no_data=f"no data: no {name} layer", theme=theme),
        "png",
        title=f"{name.capitalize()} layer",
        alt=f"Range of the {name} layer over the image plane. {_extent(range_mm)}",
        **_LAYER_WORDS[layer],
    )


_LAYER_WORDS: dict[int, dict[str, str]] = {
    1: {
        "shows": "The nearest surface that each pixel sees.",
        "good": "Every surface in one colour up to its edge; hatching only where there is open space.",
        "bad": "Specks of other ranges inside a surface, or hatching on it.",
    },
    2: {
        "shows": "The second surface of the pixels that see more than one.",
        "good": "Thin lines along edges, in the colour of the surface behind.",
        "bad": "Specks scattered over plain surfaces: components without a surface.",
    },
    3: {
        "shows": "The third surface of the pixels that see more than two.",
        "good": "Few pixels, where three surfaces meet; hatching elsewhere.",
        "bad": "Many pixels away from any edge.",
    },
}


def _extent(range_mm: FloatArray) -> str:
    """Say in a sentence what an image holds."""
    finite = range_mm[np.isfinite(range_mm)]
    if finite.size == 0:
        return "No pixel has data."
    empty = 100 * (1 - finite.size / range_mm.size)
    values = f"Median {np.median(finite):.0f} mm, from {finite.min():.0f} to {finite.max():.0f} mm"
    return f"{values}; no data in {empty:.1f} % of the pixels."


def _count_picture(layers: Layers) -> Picture:
    fitted = layers.status != Status.TOO_FEW_SAMPLES
    counts = np.bincount(layers.n_modes[fitted].ravel(), minlength=1)
    found = "; ".join(f"{n}: {count} pixels" for n, count in enumerate(counts.tolist()) if count)
    return make_picture(
        lambda theme: count_image(layers.n_modes, fitted=fitted, theme=theme),
        "png",
        title="Number of surfaces",
        alt=f"Number of surfaces in each pixel over the image plane. {found or 'nothing was fitted'}.",
        shows="How many surfaces each pixel sees.",
        good="One on surfaces, two along edges, more where edges meet.",
        bad="Twos scattered over a plain surface, or edges with one surface only.",
    )


def _section_picture(layers: Layers, averaged: AveragedImage, sensor: Sensor) -> Picture:
    row = layers.shape[0] // 2
    section = Section(
        range_mm=layers.range[row].astype(np.float64),
        weight=layers.weight[row].astype(np.float64),
        averaged_mm=averaged.range_mm[row],
        fov_horizontal_deg=sensor.fov_horizontal_deg,
    )
    view = "seen from above" if sensor.fov_horizontal_deg is not None else "range over columns (field of view unknown)"
    several = int((layers.n_modes[row] > 1).sum())
    return make_picture(
        lambda theme: section_figure(section, theme=theme),
        "svg",
        title=f"Section through row {row}",
        alt=f"Averaged points and layers of row {row}, {view}. {several} of its {layers.shape[1]} pixels see more than "
        f"one surface. {_extent(section.range_mm)}",
        shows=f"The averaged points (crosses) and the layers of row {row}, {view}. Larger markers are larger shares; "
        "a line joins what one pixel sees.",
        good="Layers lie on the surfaces. Crosses between surfaces, the comet tail, have no layer near them.",
        bad="Layers between surfaces, where the crosses are.",
    )


def _histogram_pictures(layers: Layers, sensor: Sensor) -> tuple[Picture, ...]:
    curve = sensor.noise
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
            shows="How many pixels have a layer at each range.",
            good="A peak for each surface, none between them.",
            bad="A floor between the peaks: layers where nothing stands.",
        ),
        make_picture(
            lambda theme: weight_histogram(layers, theme=theme),
            "svg",
            title="Shares",
            alt=f"Histogram of the shares of each layer and of no return. {weight_text}",
            shows="How large a share of the beam each layer holds.",
            good="A first layer mostly at 1; the shares of mixed pixels spread evenly.",
            bad="Many layers at shares of a few per cent: outliers taken for surfaces.",
        ),
        make_picture(
            lambda theme: sigma_figure(layers, curve=curve, theme=theme),
            "svg",
            title="Sigma",
            alt=f"Sigma of every component against its range{', with the noise curve' if curve else ''}. {sigma_text}",
            shows="The spread of each component against its range."
            + ("" if curve else " The file has no noise curve to compare with."),
            good="Components along the curve.",
            bad="Components beside the curve: it does not fit this recording, or surfaces are merged (above it).",
        ),
    )
