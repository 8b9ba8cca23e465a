"""Lost samples over the image plane: pixels that show nothing, or little."""

import numpy as np
from numpy.typing import NDArray

from tofmix.lost_samples import learn_losses
from tofmix.report.figures.rasters import ImagePicture, kinds_uri
from tofmix.report.theme import DARK, LIGHT, Theme
from tofmix.wording import counted

_NAMES = ("most samples are valid", "at the limit of the camera", "no valid sample")
_COLOURS = ("var(--no-data)", "var(--layer-3)", "var(--layer-2)")
"""Colours of the legend, which the page's style has in both themes."""


def lost_picture(invalid_share: NDArray[np.float32] | None, frames: int) -> ImagePicture | None:
    """Draw the pixels of a window that lose samples; None where none is lost, or it is not known.

    Parameters
    ----------
    invalid_share : (row, col) float32 or None
        Share of the frames without a valid sample.
    frames : int
        Frames of the window.
    """
    if invalid_share is None or not (invalid_share > 0).any():
        return None
    kinds = learn_losses(invalid_share, frames).is_at_limit(invalid_share).astype(np.uint8)
    kinds[invalid_share >= 1.0] = 2
    counts = [int((kinds == kind).sum()) for kind in range(len(_NAMES))]
    said = "; ".join(f"{name}: {counted(count, 'pixel')}" for name, count in zip(_NAMES, counts, strict=True) if count)
    rows, cols = invalid_share.shape
    light, dark = (kinds_uri(kinds, _palette(theme)) for theme in (LIGHT, DARK))
    return ImagePicture(
        title="Lost samples",
        alt=f"Pixels by their lost samples over the image plane. {said}.",
        shows="Where samples are lost: too dark, saturated, or out of range. At the limit of the camera, a sample is"
        " lost more often than valid, and layers are less probable.",
        good="Open space at most, or a thing that is known to be dark or bright.",
        bad="A closed shape in front of other surfaces: an obstacle that the camera does not see.",
        rows=rows,
        cols=cols,
        light=light,
        dark=dark,
        bar=(),
        legend=tuple((colour, name) for colour, name, count in zip(_COLOURS, _NAMES, counts, strict=True) if count),
    )


def _palette(theme: Theme) -> list[str]:
    """Colours of the kinds, as in `_COLOURS`."""
    return [theme.no_data, theme.layers[2], theme.layers[1]]
