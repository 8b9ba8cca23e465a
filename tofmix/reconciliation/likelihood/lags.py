"""Products of samples at a distance of some frames, which show a memory."""

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray


def lag_product(
    values: Float32Array | FloatArray, valid: BoolArray, lag: int, frames: IntArray | None = None
) -> tuple[int, float]:
    """Number of pairs of valid samples of a pixel that are `lag` frames apart, and the sum of their products.

    Parameters
    ----------
    values : (frame, pixel) float32 or float64
        Samples; 0 where invalid.
    valid : (frame, pixel) bool
        Which are valid.
    lag : int
        Frames, at least 1.
    frames : (frame,) int64, optional
        Numbers of the frames, ascending; without them, no frame is missing.
    """
    if frames is None:
        pairs = int((valid[lag:] & valid[:-lag]).sum())
        return pairs, float((values[lag:] * values[:-lag]).sum(dtype=np.float64))
    now = np.flatnonzero(frames[lag:] - frames[:-lag] == lag)
    pairs = int((valid[now] & valid[now + lag]).sum())
    return pairs, float((values[now] * values[now + lag]).sum(dtype=np.float64))
