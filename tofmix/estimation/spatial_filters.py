"""Whether a camera filters its ranges over neighbouring pixels, by the noise that neighbours share.

Use `neighbour_correlation` before layers are estimated. A median or an average over neighbours mixes samples of several
surfaces at every edge, and cannot be undone. Noise that a row, a column or a frame shares is no filter: noise counts
that is shared with the next pixel along rows and along columns, but not with pixels farther away. Steps from frame to
frame are compared, so that drift and things that move slowly count little.
"""

import math

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.recording import SampleSource, samples_a_frame


def neighbour_correlation(
    source: SampleSource, *, least: float = 0.12, frames: int = 100, bands: int = 4, least_pixels: int = 64
) -> float | None:
    """Correlation of the noise of a pixel and the next one, beyond that of pixels farther away.

    Parameters
    ----------
    source : SampleSource
        The recording.
    least : float
        Least correlation of a filter.
    frames, bands : int
        Most frames, and most bands of rows, that are read.
    least_pixels : int
        Fewest pairs of pixels that may show a filter.

    Returns
    -------
    float or None
        The geometric mean of those along rows and along columns. None: below `least`, several targets a frame, or too
        few frames or pixels.
    """
    far, least_frames = 3, 20  # pixels apart: noise of a filter falls off by there, that of blocks of pixels hardly
    total, rows, cols = source.shape
    height = min(rows, 16)
    if samples_a_frame(source) > 1 or min(total, frames) < least_frames or min(height, cols) <= far:
        return None
    found: dict[tuple[int, int], list[FloatArray]] = {}
    for top in np.unique(np.linspace(0, rows - height, min(bands, -(-rows // height))).astype(int)).tolist():
        steps = _steps(source.read_range(slice(0, min(total, frames)), slice(top, top + height)))
        for apart in ((0, 1), (1, 0), (0, far), (far, 0)):
            found.setdefault(apart, []).append(_correlations(steps, *apart))
    near, away = (
        [np.concatenate(found[apart]) for apart in pairs] for pairs in (((0, 1), (1, 0)), ((0, far), (far, 0)))
    )
    if min(len(part) for part in (*near, *away)) < least_pixels:
        return None
    beyond = [max(float(np.median(one) - np.median(other)), 0.0) for one, other in zip(near, away, strict=True)]
    shared = math.sqrt(beyond[0] * beyond[1])
    return min(shared, 1.0) if shared >= least else None


def _steps(stored: Float32Array) -> FloatArray:
    """Signs (frame, row, col) of steps from frame to frame, of pixels that are valid throughout; else NaN."""
    with np.errstate(invalid="ignore"):
        valid = (np.abs(stored) <= FARTHEST_MM).all(axis=0)
    steps = np.diff(np.where(valid, stored, np.nan).astype(np.float64), axis=0)
    return np.sign(steps)


def _correlations(signs: FloatArray, down: int, across: int) -> FloatArray:
    """Correlation (pair,) of the steps of pixels some rows and columns apart, by how often their signs agree.

    Steps of 0 tell nothing; pairs of few others are left out.
    """
    rows, cols = signs.shape[1:]
    product = signs[:, : rows - down, : cols - across] * signs[:, down:, across:]
    told = (np.abs(product) > 0.0).sum(axis=0)
    enough = told >= 10  # noqa: PLR2004  steps
    return np.asarray(np.sin(0.5 * np.pi * (np.nansum(product, axis=0)[enough] / told[enough])))
