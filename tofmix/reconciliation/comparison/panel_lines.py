"""Part of the panel: lines of the image with a common bias in a frame, as in a rolling read-out."""

from collections.abc import Iterator

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import Part

_FEW = 4  # samples of a line in a frame
_LEAST = 1e-9  # variance of a line that is not constant


def lines(z: Float32Array, evidence: Evidence, part: Part) -> Iterator[Curve]:
    """Variance of the mean of each row, and column, over that of independent samples, minus 1, over root 2.

    Means of pixels and of frames are removed first, and values are divided by the spread of the line. In an image of
    one row the mean of the row is that of the frame, which is removed, so there is no result. The same holds for one
    column.
    """
    rows, cols = evidence.image
    ok = np.isfinite(z)
    flat = np.where(ok, z - np.nansum(z, axis=0) / np.maximum(ok.sum(axis=0), 1), np.float32(0))
    flat -= np.where(ok, flat.sum(axis=1, keepdims=True) / np.maximum(ok.sum(axis=1, keepdims=True), 1), np.float32(0))
    cube: Float32Array = np.zeros((len(z), rows * cols), dtype=np.float32)
    cube[:, part[1]] = flat
    seen = np.zeros((len(z), rows * cols), dtype=bool)
    seen[:, part[1]] = ok
    image, valid = cube.reshape(-1, rows, cols), seen.reshape(-1, rows, cols)
    sigma = np.ones(1)
    for axis, name in ((2, "row"), (1, "col")):
        if image.shape[3 - axis] == 1:
            continue
        n = valid.sum(axis=axis)
        use = n >= _FEW
        frames = use.sum(axis=0)
        level = (image**2).sum(axis=(0, axis), dtype=np.float64) / np.maximum(n.sum(axis=0), 1)
        square = np.where(use, image.sum(axis=axis, dtype=np.float64) ** 2 / np.maximum(n, 1), 0.0).sum(axis=0)
        some = (frames >= _FEW) & (level > _LEAST)
        lost = 1.0 - 1.0 / image.shape[3 - axis]  # the part that the means of frames removed
        value = (square[some] / frames[some] / level[some] / lost - 1) / np.sqrt(2)
        at = np.flatnonzero(some).astype(np.float64)
        yield Curve(
            statistic="common_mode",
            axis=name,
            lower=at,
            upper=at + 1,
            value=value,
            variance=1.0 / frames[some],
            unit="1",
            scale_mm=np.broadcast_to(sigma, at.shape),
        )
