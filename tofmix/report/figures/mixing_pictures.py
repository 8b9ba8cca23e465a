"""The mixing part of the page: the share of phasor sums in words, and a map of the kind of mixing in each pixel."""

from dataclasses import dataclass

from tofmix.arrays import ByteArray
from tofmix.flags import MIXING_MEANINGS, Mixing, mixing_name
from tofmix.report.figures.rasters import ImagePicture, kinds_uri
from tofmix.report.summary.summary import MixingNumbers
from tofmix.report.theme import DARK, LIGHT, Theme
from tofmix.wording import counted

_COLOURS = {
    Mixing.ONE_SURFACE: "var(--no-data)",
    Mixing.EVENTS: "var(--layer-3)",
    Mixing.PHASOR: "var(--layer-1)",
    Mixing.UNDECIDED: "var(--layer-2)",
}
"""Colours of the legend, which the page's style has in both themes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MixingPart:
    """The part of the page: the law in a sentence, kinds of pixels with name, number and meaning, and the map."""

    law: str
    kinds: tuple[tuple[str, int, str], ...]
    image: ImagePicture


def draw_mixing(mixing: ByteArray, numbers: MixingNumbers) -> MixingPart:
    """Draw the kind of mixing of each pixel of a window.

    Parameters
    ----------
    mixing : (row, col) uint8
        `tofmix.flags.Mixing` of one window.
    numbers : MixingNumbers
        Of the file: the law, and pixels of all windows.
    """
    return MixingPart(
        law=f"{numbers.line[:1].upper()}{numbers.line[1:]}.",
        kinds=tuple((_words(kind), numbers.pixels[mixing_name(kind)], MIXING_MEANINGS[kind]) for kind in Mixing),
        image=_map(mixing),
    )


def _words(kind: Mixing) -> str:
    return mixing_name(kind).replace("_", " ")


def _map(mixing: ByteArray) -> ImagePicture:
    present = [(kind, int((mixing == int(kind)).sum())) for kind in Mixing]
    said = "; ".join(f"{_words(kind)}: {counted(count, 'pixel')}" for kind, count in present if count)
    rows, cols = mixing.shape
    light, dark = (kinds_uri(mixing, _palette(theme)) for theme in (LIGHT, DARK))
    return ImagePicture(
        title="Kind of mixing",
        alt=f"Kind of mixing in each pixel over the image plane. {said or 'No pixel has a kind'}.",
        shows="Whether a pixel sees one surface; several, one in each sample (events) or all in their sum (phasor); or"
        " sums of surfaces that cannot be determined (undecided).",
        good="Thin lines of one colour along edges, one surface elsewhere.",
        bad="Mixed pixels scattered over plain surfaces; long lines or areas that are undecided.",
        rows=rows,
        cols=cols,
        light=light,
        dark=dark,
        bar=(),
        legend=tuple((_COLOURS[kind], _words(kind)) for kind, count in present if count),
    )


def _palette(theme: Theme) -> list[str]:
    """Colours of the kinds in the order of their values, as in `_COLOURS`."""
    colours = {"no-data": theme.no_data} | {f"layer-{k}": colour for k, colour in enumerate(theme.layers, 1)}
    return [colours[_COLOURS[kind].removeprefix("var(--").removesuffix(")")] for kind in Mixing]
