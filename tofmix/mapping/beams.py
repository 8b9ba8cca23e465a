"""Beams for a map: the ranges at which light stops, its amount, and the probability of each.

`beams_from_layers` takes every surface of a pixel with its share. `beams_from_ranges`
takes one range a pixel, as a camera's averaging gives it: for comparison.

Number of samples in the average of each pixel.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from tofmix.arrays import FloatArray, IntArray
from tofmix.circle import NO_RETURN_SIGMAS
from tofmix.layers import Layers
from tofmix.lost_samples import learn_losses
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import Projection, pixel_extent_rad
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.sensor import Sensor


def count_samples(recording: SampleSource, *, start: int, stop: int, block_samples: int = 1 << 21) -> IntArray:
    """Valid samples of each pixel in frames [start, stop), read a block at a time.

    Parameters
    ----------
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


MAX_INCIDENCE_DEG = 60.0
"""A surface may be inclined by this much: across a beam its range then varies, and it stops light over that depth."""

CLEAR_STDERRS = 2.0
"""A surface may be this many standard errors nearer than its range: space is free only up to there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beams:
    """The pixels of one image. A beam's samples belong to surfaces, to no return, or to outliers without information.

    Lost samples may have stopped anywhere.

    Parameters
    ----------
    near_mm, far_mm : (row, col, layer) float64
        Where each surface stops light: its range less and plus half its depth, mm. NaN where there is none.
    clear_to_mm : (row, col, layer) float64
        Range up to which the light of each surface certainly passed, mm; from there to `near_mm`, and behind, nothing
        is known.
    samples : (row, col, layer) float64
        Samples that stopped there: the surface's share of the pixel's samples; 0 where there is none.
    probability : (row, col, layer) float64
        How surely the surface exists, in [0, 1].
    samples_no_return : (row, col) float64
        Samples that met nothing.
    samples_lost : (row, col) float64
        Samples that were lost, beyond those that all pixels lose by chance (`tofmix.lost_samples`).
    free_to_mm : float
        Up to where a sample without a return says that space is free, mm; 0 where the camera knows no such samples.
    optics : Projection
        Where the pixels look.
    """

    near_mm: FloatArray
    far_mm: FloatArray
    clear_to_mm: FloatArray
    samples: FloatArray
    probability: FloatArray
    samples_no_return: FloatArray
    samples_lost: FloatArray
    free_to_mm: float
    optics: Projection

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        rows, cols = self.samples_no_return.shape
        return rows, cols

    @property
    def pixel_size_rad(self) -> tuple[float, float]:
        """Extent of a pixel in azimuth and elevation, rad.

        Raises
        ------
        TypeError
            If pixels have no equal angles.
        """
        if not isinstance(self.optics, Equiangular):
            raise TypeError(f"projection: {self.optics.name}: its pixels differ in size")
        return self.optics.pixel_size_rad(self.shape)

    @property
    def reach_mm(self) -> float:
        """The farthest range with information from the beams, mm: `free_to_mm`, or a surface behind it."""
        surfaces = self.far_mm[np.isfinite(self.far_mm)]
        return max(self.free_to_mm, float(surfaces.max()) if surfaces.size else 0.0)

    def probability_within(self, distance_mm: float) -> FloatArray:
        """Probability that each surface exists and lies within this distance of the place where it stops light.

        Parameters
        ----------
        distance_mm : float
            Distance, mm, above 0.

        Returns
        -------
        (row, col, layer) float64
            `probability` times that of a normal error of the range below the distance; 0 where there is no surface.
        """
        stderr = (self.near_mm - self.clear_to_mm) / CLEAR_STDERRS
        with np.errstate(divide="ignore"):
            placed = erf(distance_mm / (math.sqrt(2.0) * stderr))
        return np.asarray(np.nan_to_num(self.probability * placed))


def beams_from_layers(layers: Layers, sensor: Sensor, *, min_probability: float = 0.9999) -> Beams:
    """Every layer is a hit with its share of the samples; no return counts as such.

    A hit lies at its range, half as deep as ``r b tan(60 deg) / 2``, b being a pixel's larger extent in rad. In the two
    standard errors before it, nothing is known. Lost samples are those that `invalid_share` of the layers tells.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col). Suspect ones count neither as a hit nor as free space.
    sensor : Sensor
        The camera: field of view or projection, `range_max_mm`, noise curve.
    min_probability : float
        Layers less sure than this count neither as a hit nor as free space, in [0, 1]; at 0.9999, a few false
        ones of 25,000 pixels remain.

    Returns
    -------
    Beams
        Of the same image.

    Raises
    ------
    ValueError
        If the layers are not an image, it is not known where the pixels look, or `min_probability` is outside [0, 1].
    """
    if not 0 <= min_probability <= 1:
        raise ValueError(f"min_probability: {min_probability:g} is not in [0, 1]")
    range_mm = layers.range.astype(np.float64)
    # A layer without a probability or an error, as another program may write it, is taken at its word.
    probability = np.nan_to_num(layers.probability.astype(np.float64), nan=1.0)
    known = layers.unsuspected & (range_mm > 0) & (probability >= min_probability)
    n_samples = layers.n_samples.astype(np.float64)
    return _beams(
        np.where(known, range_mm, np.nan),
        stderr_mm=np.nan_to_num(layers.range_stderr.astype(np.float64)),
        samples=np.where(known, np.nan_to_num(layers.weight), 0.0) * n_samples[..., np.newaxis],
        probability=probability,
        samples_no_return=np.nan_to_num(layers.weight_no_return) * n_samples,
        samples_lost=_lost_samples(layers),
        sensor=sensor,
    )


def beams_from_ranges(range_mm: ArrayLike, n_samples: ArrayLike, sensor: Sensor) -> Beams:
    """One range a pixel, the mean of its samples: all samples stopped there, or none did.

    A mean that the estimator would take as no return, within 2 sigma of `range_max_mm`, is no return.

    Parameters
    ----------
    range_mm : (row, col) array_like
        Mean ranges, mm; NaN where a pixel has no sample.
    n_samples : (row, col) array_like
        Samples behind each mean.
    sensor : Sensor
        The camera: field of view or projection, `range_max_mm`, noise curve of one sample.

    Returns
    -------
    Beams
        Of the same image, one layer.

    Raises
    ------
    ValueError
        If the ranges are not an image of the same size as `n_samples`, or it is not known where the pixels look.
    """
    mean, count = np.asarray(range_mm, dtype=np.float64), np.asarray(n_samples, dtype=np.float64)
    if mean.shape != count.shape:
        raise ValueError(f"n_samples: shape {count.shape} does not match range {mean.shape}")
    known = np.isfinite(mean) & (mean > 0) & (count > 0)
    open_space = known & (mean >= _free_to_mm(sensor))
    surface = known & ~open_space
    noise = sensor.noise.sigma(np.nan_to_num(mean)) if sensor.noise is not None else np.zeros(mean.shape)
    return _beams(
        np.where(surface, mean, np.nan)[..., np.newaxis],
        stderr_mm=(noise / np.sqrt(np.maximum(count, 1.0)))[..., np.newaxis],
        samples=np.where(surface, count, 0.0)[..., np.newaxis],
        probability=np.ones((*mean.shape, 1)),
        samples_no_return=np.where(open_space, count, 0.0),
        samples_lost=np.zeros(mean.shape),
        sensor=sensor,
    )


def _lost_samples(layers: Layers) -> FloatArray:
    """Samples (row, col) that pixels lost, beyond the loss of all; none in layers that do not say."""
    if layers.invalid_share is None or layers.invalid_share.ndim != 2:  # noqa: PLR2004  rows and columns
        return np.zeros(layers.shape)
    lost = layers.invalid_share.astype(np.float64)
    seen = lost < 1.0  # false for NaN
    samples = layers.n_samples[seen] / (1.0 - lost[seen])
    if not samples.size:
        return np.zeros(layers.shape)
    of_window = max(1, round(float(samples.max())))
    return of_window * learn_losses(lost, of_window).lost_share(lost)


def _free_to_mm(sensor: Sensor) -> float:
    if sensor.range_max_mm is None:
        return math.inf
    sigma = 0.0 if sensor.noise is None else float(sensor.noise.sigma(sensor.range_max_mm))
    return max(sensor.range_max_mm - NO_RETURN_SIGMAS * sigma, 0.0)


def _beams(
    range_mm: FloatArray,
    *,
    stderr_mm: FloatArray,
    samples: FloatArray,
    probability: FloatArray,
    samples_no_return: FloatArray,
    samples_lost: FloatArray,
    sensor: Sensor,
) -> Beams:
    if samples_no_return.ndim != 2 or samples_no_return.size == 0:  # noqa: PLR2004  rows and columns
        raise ValueError(f"range: expected an image (row, col), got shape {samples_no_return.shape}")
    optics = sensor.optics
    if optics is None:
        raise ValueError(
            "the sensor has no field of view (fov_horizontal_deg, fov_vertical_deg) and no projection, so the"
            " directions of its pixels are not known"
        )
    rows, cols = samples_no_return.shape
    if isinstance(optics, Equiangular):
        half_width = range_mm * max(optics.pixel_size_rad((rows, cols))) / 2
    else:
        half_width = range_mm * pixel_extent_rad(optics, (rows, cols))[..., np.newaxis] / 2
    half_depth = half_width * math.tan(math.radians(MAX_INCIDENCE_DEG))
    has_limit = sensor.range_max_mm is not None
    return Beams(
        near_mm=range_mm - half_depth,
        far_mm=range_mm + half_depth,
        clear_to_mm=range_mm - half_depth - CLEAR_STDERRS * stderr_mm,
        samples=samples,
        probability=probability,
        samples_no_return=samples_no_return if has_limit else np.zeros_like(samples_no_return),
        samples_lost=samples_lost,
        free_to_mm=_free_to_mm(sensor) if has_limit else 0.0,
        optics=optics,
    )
