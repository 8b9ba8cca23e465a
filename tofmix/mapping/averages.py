"""Number of samples in the average of each pixel."""

import numpy as np

from tofmix.arrays import IntArray
from tofmix.recording import SampleSource, samples_a_frame


def count_samples(recording: SampleSource, *, start: int, stop: int, block_samples: int = 1 << 21) -> IntArray:
    """Valid samples of each pixel in frames [start, stop), read a block at a time.

    Parameters
    ----------
    recording : SampleSource
        The recording.
    start, stop : int
        Frames, 0 <= start < stop <= its frames.
    block_samples : int
        Samples read at once, at 4 bytes each. It changes no value.

    Returns
    -------
    (row, col) int64
        Samples.

    Raises
    ------
    ValueError
        If the recording has no such frames.
    """
    samples, rows, cols = recording.shape
    each = samples_a_frame(recording)
    if not 0 <= start < stop <= samples // each:
        raise ValueError(f"frames {start} to {stop} asked for, the recording has {samples // each}")
    start, stop = start * each, stop * each
    out = np.zeros((rows, cols), dtype=np.int64)
    band = max(1, recording.row_step)
    depth = max(1, block_samples // (band * cols))
    for row in range(0, rows, band):
        part = slice(row, min(row + band, rows))
        for first in range(start, stop, depth):
            block = recording.read_range(slice(first, min(first + depth, stop)), part)
            out[part] += np.isfinite(block).sum(axis=0)
    return out
