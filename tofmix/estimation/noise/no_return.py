"""The value that a camera returns where there is no surface, if it is one value: from the samples of a recording.

Use `no_return_constant` before an estimate. Without a return, many cameras give r_max or another constant; others
scatter there as at a surface. c_0 of equation (1) has the spread that the recording shows.
"""

import numpy as np

from tofmix.circle import NO_RETURN_SIGMAS
from tofmix.recording import DECODED_SAMPLES, SampleSource


def no_return_constant(
    source: SampleSource,
    *,
    most_frames: int = 100,
    least_samples: int = 10,
    least_pixels: int = 3,
    near_errors: float = 3.0,
) -> float | None:
    """Find the constant of samples without a return.

    Parameters
    ----------
    source : SampleSource
        The recording, with a noise curve and `range_max_mm`.
    most_frames : int
        Frames that are looked at, from the first on.
    least_samples : int
        Samples that a pixel must have near r_max: 10 equal whole mm come from a spread of 1 mm once in 10^4 pixels.
    least_pixels : int
        Pixels that must agree. No more than agree may scatter around r_max: the few that agree are then stuck pixels.
    near_errors : float
        A pixel scatters around r_max if its mean is this near to it, in standard errors.

    Returns
    -------
    float or None
        The value, mm: at least `least_pixels` pixels have it as their only value within 2 sigma(r_max) of r_max, in at
        least `least_samples` of the first `most_frames` frames. None where there is none, or the sensor has no r_max or
        no noise curve.
    """
    sensor = source.sensor
    if sensor.noise is None or sensor.range_max_mm is None:
        return None
    top, sigma = np.float32(sensor.range_max_mm), float(sensor.noise.sigma(sensor.range_max_mm))
    frames, rows, cols = source.shape
    frames = min(frames, most_frames)
    high = max(source.row_step, DECODED_SAMPLES // (frames * cols) // source.row_step * source.row_step)
    constants, scattered = [np.zeros(0, dtype=np.float32)], 0
    for row in range(0, rows, high):
        samples = source.read_range(slice(0, frames), slice(row, min(row + high, rows)))
        with np.errstate(invalid="ignore"):
            near = np.abs(samples - top) <= NO_RETURN_SIGMAS * sigma
        count = near.sum(axis=0)
        low = np.where(near, samples, np.inf).min(axis=0)
        most = np.where(near, samples, -np.inf).max(axis=0)
        mean = np.where(near, samples - top, 0.0).sum(axis=0) / np.maximum(count, 1)
        told, one = count >= least_samples, low == most
        constants.append(most[told & one])
        as_scattered = np.abs(mean) <= near_errors * sigma / np.sqrt(np.maximum(count, 1))
        scattered += int((told & ~one & as_scattered).sum())
    values, pixels = np.unique(np.concatenate(constants), return_counts=True)
    if not len(values) or pixels.max() < max(least_pixels, scattered):
        return None
    return float(values[np.argmax(pixels)])
