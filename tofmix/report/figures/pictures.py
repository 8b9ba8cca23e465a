"""The pictures of one window and of a comparison of two, each with its words, and one figure of a whole window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tofmix.arrays import ByteArray, Float32Array, FloatArray
from tofmix.flags import MIXING_MEANINGS, Mixing, Status, mixing_name
from tofmix.layers import Layers
from tofmix.lost_samples import learn_losses
from tofmix.points import MM_A_METRE
from tofmix.report.averaging import AveragedImage
from tofmix.report.comparison import WindowDifference
from tofmix.report.figures.curves import SHOWN_LAYERS, gap_histogram, range_histogram, sigma_figure, weight_histogram
from tofmix.report.figures.picture import (
    ABOVE,
    BELOW,
    MANY,
    NO_DATA,
    NO_SURFACE,
    Legend,
    Picture,
    Words,
    colour_scale,
    count_colours,
    count_label,
    difference_picture,
    figure_picture,
    kinds_picture,
    most_of,
    range_picture,
)
from tofmix.report.summary.summary import MixingNumbers
from tofmix.report.summary.tables import ordinal
from tofmix.report.theme import COUNT_MAP, LIGHT, RANGE_MAP, Theme, mark_no_data, new_figure
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class Gallery:
    """The pictures of a page: over the image plane, and histograms."""

    images: tuple[Picture, ...]
    histograms: tuple[Picture, ...]


def draw_gallery(
    layers: Layers, averaged: AveragedImage, sensor: Sensor, *, scale: tuple[float, float], frames: int
) -> Gallery:
    """Draw every picture of a window (row, col) of so many frames.

    Every first to third layer that the file can hold has one, and lost samples if there are any. `scale` are the limits
    in mm of the colours of all range images; see `range_scale`.
    """
    lost = _lost_picture(layers.invalid_share, frames)
    return Gallery(
        images=(*_range_pictures(layers, averaged, scale), _count_picture(layers), *(() if lost is None else (lost,))),
        histograms=_histogram_pictures(layers, sensor.noise),
    )


def range_scale(layers: Layers, averaged: AveragedImage, sensor: Sensor) -> tuple[float, float]:
    """Limits in mm of the colours of all range images of a window, by its layers if there are any."""
    default = (sensor.range_min_mm or 0.0, sensor.range_max_mm or 10_000.0)
    ranges = layers.range.astype(np.float64)
    return colour_scale(ranges if np.isfinite(ranges).any() else averaged.range_mm, default=default)


def _range_pictures(layers: Layers, averaged: AveragedImage, scale: tuple[float, float]) -> list[Picture]:
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


def _layer_picture(layer: int, range_mm: FloatArray, scale: tuple[float, float]) -> Picture:
    name = ordinal(layer)
    title, alt = f"{name.capitalize()} layer", f"Range of the {name} layer over the image plane. {_extent(range_mm)}"
    words: Words = {**_LAYER_WORDS[layer], "title": title, "alt": alt}
    return _range_picture(range_mm, scale, no_data=f"no {name} layer", **words)


def _range_picture(
    range_mm: FloatArray, scale: tuple[float, float], *, no_data: str, **words: Unpack[Words]
) -> Picture:
    legend: Legend = (
        *(((BELOW, f"below {scale[0]:.0f} mm"),) if bool((range_mm < scale[0]).any()) else ()),
        *(((ABOVE, f"above {scale[1]:.0f} mm"),) if bool((range_mm > scale[1]).any()) else ()),
        *(((NO_DATA, no_data),) if bool(np.isnan(range_mm).any()) else ()),
    )
    return range_picture(range_mm, scale=scale, legend=legend, **words)


_LAYER_WORDS: dict[int, Words] = {
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


def _count_picture(layers: Layers) -> Picture:
    fitted = layers.status != int(Status.TOO_FEW_SAMPLES)
    counts = np.bincount(layers.n_modes[fitted], minlength=int(layers.n_modes.max(initial=0)) + 1).tolist()
    found = "; ".join(f"{n}: {counted(count, 'pixel')}" for n, count in enumerate(counts) if count)
    colours = [NO_SURFACE, *count_colours(len(counts) - 1, LIGHT)[1:]]
    return kinds_picture(
        np.where(fitted, np.minimum(layers.n_modes, MANY), len(colours)).astype(np.uint8),
        names=[count_label(n) for n in range(len(colours))],
        colours=colours,
        no_data="not fitted",
        title="Number of surfaces",
        alt=f"Number of surfaces in each pixel over the image plane. {found or 'nothing was fitted'}.",
        shows="Number of surfaces in each pixel.",
        good="One on surfaces, two along edges, more where edges meet.",
        bad="Pixels with two surfaces scattered over a flat surface, or edges with one surface only.",
    )


def _histogram_pictures(layers: Layers, curve: NoiseCurve | None) -> tuple[Picture, ...]:
    ranges = layers.range.astype(np.float64)
    known = layers.weight[np.isfinite(layers.weight)]
    sigma = layers.sigma[np.isfinite(layers.sigma)]
    weight_text = f"Median share {np.median(known):.2f}." if known.size else "No layer."
    sigma_text = f"Median sigma {np.median(sigma):.1f} mm." if sigma.size else "No component."
    return (
        figure_picture(
            lambda theme: range_histogram(layers, theme=theme),
            title="Ranges",
            alt=f"Histogram of the ranges of each layer. {_extent(ranges)}",
            shows="Number of pixels with a layer at each range.",
            good="A peak for each surface, none between them.",
            bad="Layers between the peaks, at ranges without a surface.",
        ),
        figure_picture(
            lambda theme: weight_histogram(layers, theme=theme),
            title="Shares",
            alt=f"Histogram of the shares of each layer and of no return. {weight_text}",
            shows="Share of the beam of each layer.",
            good="A first layer mostly at 1; the shares of mixed pixels spread evenly.",
            bad="Many layers at shares of a few per cent: outliers counted as surfaces.",
        ),
        figure_picture(
            lambda theme: sigma_figure(layers, curve=curve, theme=theme),
            title="Sigma",
            alt=f"Sigma of every component against its range{', with the noise curve' if curve else ''}. {sigma_text}",
            shows="The spread of each component against its range."
            + ("" if curve else " The file has no noise curve to compare with."),
            good="Components along the curve.",
            bad="Components off the curve: it does not fit this recording, or surfaces are merged (above the curve).",
        ),
    )


_LOSSES = ("most samples are valid", "at the limit of the camera", "no valid sample")


def _lost_picture(invalid_share: Float32Array | None, frames: int) -> Picture | None:
    """Pixels (row, col) that lose samples in a window of `frames`; None where none is lost, or it is not known."""
    if invalid_share is None or not (invalid_share > 0).any():
        return None
    kinds = learn_losses(invalid_share, frames).is_at_limit(invalid_share).astype(np.uint8)
    kinds[invalid_share >= 1.0] = 2
    return kinds_picture(
        kinds,
        names=_LOSSES,
        colours=("var(--no-data)", "var(--layer-3)", "var(--layer-2)"),
        title="Lost samples",
        alt=f"Pixels by their lost samples over the image plane. {_counted_kinds(kinds, _LOSSES)}.",
        shows="Where samples are lost: too dark, saturated, or out of range. At the limit of the camera, a sample is"
        " lost more often than valid, and layers are less probable.",
        good="Open space at most, or a thing that is known to be dark or bright.",
        bad="A closed shape in front of other surfaces: an obstacle that the camera does not see.",
    )


def _counted_kinds(kinds: ByteArray, names: Sequence[str]) -> str:
    counts = np.bincount(kinds.ravel(), minlength=len(names)).tolist()
    return "; ".join(f"{name}: {counted(count, 'pixel')}" for name, count in zip(names, counts, strict=False) if count)


_MIXING_COLOURS = {
    Mixing.ONE_SURFACE: "var(--no-data)",
    Mixing.EVENTS: "var(--layer-3)",
    Mixing.PHASOR: "var(--layer-1)",
    Mixing.UNDECIDED: "var(--layer-2)",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MixingPart:
    """The page's part about mixing."""

    law: str  # a sentence
    kinds: tuple[tuple[str, int, str], ...]  # of pixels: name, number, meaning
    image: Picture


def draw_mixing(mixing: ByteArray, numbers: MixingNumbers) -> MixingPart:
    """Draw the kind of mixing (`tofmix.flags.Mixing`) of each pixel (row, col); `numbers` are those of the file."""
    names = [mixing_name(kind).replace("_", " ") for kind in Mixing]
    image = kinds_picture(
        mixing,
        names=names,
        colours=[_MIXING_COLOURS[kind] for kind in Mixing],
        title="Kind of mixing",
        alt="Kind of mixing in each pixel over the image plane."
        f" {_counted_kinds(mixing, names) or 'No pixel has a kind'}.",
        shows="Whether a pixel sees one surface; several, one in each sample (events) or all in their sum (phasor); or"
        " sums of surfaces that cannot be determined (undecided).",
        good="Thin lines of one colour along edges, one surface elsewhere.",
        bad="Mixed pixels scattered over plain surfaces; long lines or areas that are undecided.",
    )
    return MixingPart(
        law=f"{numbers.line[:1].upper()}{numbers.line[1:]}.",
        kinds=tuple(
            (name, numbers.pixels[mixing_name(kind)], MIXING_MEANINGS[kind])
            for kind, name in zip(Mixing, names, strict=True)
        ),
        image=image,
    )


def overview_figure(layers: Layers, *, name: str, theme: Theme, height_inch: float = 3.6) -> Figure:
    """Draw the nearest range and the number of surfaces of each pixel (row, col), side by side.

    It is hatched where a pixel has no surface, or too few samples.
    """
    figure = new_figure(height_inch)
    left, right = figure.subplots(1, 2)
    nearest = np.where(layers.n_modes > 0, layers.range[..., 0], np.nan).astype(np.float64)
    low, high = colour_scale(nearest, default=(0.0, MM_A_METRE))
    figure.suptitle(name, x=0.01, ha="left", fontweight="bold")
    _style(left, "nearest range", theme)
    shown = left.imshow(
        np.ma.masked_invalid(nearest) / MM_A_METRE,
        cmap=colormaps[RANGE_MAP],
        norm=Normalize(low / MM_A_METRE, high / MM_A_METRE),
        interpolation="nearest",
    )
    figure.colorbar(shown, ax=left, label="range (m)", shrink=0.8)
    _style(right, "number of surfaces", theme)
    most = max(1, int(layers.n_modes.max()))
    counts = np.ma.masked_where(layers.status == int(Status.TOO_FEW_SAMPLES), layers.n_modes)
    colours = [theme.no_surface, *colormaps[COUNT_MAP](np.linspace(0.15, 1.0, most))]
    counted = right.imshow(
        counts, cmap=ListedColormap(colours), norm=Normalize(-0.5, most + 0.5), interpolation="nearest"
    )
    figure.colorbar(counted, ax=right, ticks=range(most + 1), label="surfaces", shrink=0.8)
    return figure


def _style(axes: Axes, title: str, theme: Theme) -> None:
    mark_no_data(axes, theme)
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set(xlabel="column (pixels)", ylabel="row (pixels)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, nbins=6))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, nbins=6))


_CATEGORIES = ("the same", "another range", "fewer in B", "more in B")


def draw_comparison(a: Layers, b: Layers, found: WindowDifference, *, tolerance: float) -> tuple[Picture, ...]:
    """Draw where two windows differ, by how much the first layer does, and all differences in standard errors."""
    categories = np.zeros(a.n_modes.shape, dtype=np.uint8)
    categories[found.range_differs] = 1
    categories[b.n_modes < a.n_modes] = 2
    categories[b.n_modes > a.n_modes] = 3
    counts = np.bincount(categories.ravel(), minlength=len(_CATEGORIES)).tolist()
    told = "; ".join(f"{name}: {counted(count, 'pixel')}" for name, count in zip(_CATEGORIES, counts, strict=True))
    first = found.gap_mm[..., 0]
    known = np.abs(first[np.isfinite(first)])
    size = (
        f"Median size {np.median(known):.2f} mm, largest {known.max():.1f} mm." if known.size else "No pixel has one."
    )
    in_errors = np.abs(found.gap_errors[np.isfinite(found.gap_errors)])
    spread = f"{int((in_errors > tolerance).sum())} of {counted(in_errors.size, 'layer')} lie beyond the tolerance."
    return (
        kinds_picture(
            categories,
            names=_CATEGORIES,
            colours=(NO_SURFACE, "var(--layer-3)", "var(--layer-1)", "var(--accent)"),
            title="Where they differ",
            alt=f"Differences over the image plane. {told}.",
            shows="Pixels that have fewer or more surfaces, or a range beyond the tolerance.",
            good="Few pixels, and those along edges.",
            bad="Whole areas: the two differ in surfaces, or in the scene.",
        ),
        difference_picture(
            first,
            most=most_of(first, least=0.1),
            unit="mm",
            no_data="no such pair",
            title="First layer, B minus A",
            alt=f"Difference of the first layer's range over the image plane. {size}",
            shows="Range of the nearest surface in B minus that in A, where both have equally many surfaces.",
            good="Only random noise, or nothing at all.",
            bad="Areas of one colour: one of the two is biased.",
        ),
        figure_picture(
            lambda theme: gap_histogram(found.gap_errors, tolerance=tolerance, theme=theme),
            title="Differences in standard errors",
            alt=f"Histogram of the differences of all layers in combined standard errors. {spread}",
            shows="All pairs of layers. The curve is the distribution for two recordings of one scene.",
            good="Within the curve. Two estimates of one recording share its noise and lie far inside it.",
            bad="Wider than the curve or shifted: the standard errors do not explain the differences.",
        ),
    )
