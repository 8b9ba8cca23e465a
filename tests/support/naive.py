"""Slow and obvious twins of the fast kernels, in plain NumPy, one pixel at a time."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from tofmix.arrays import FloatArray
from tofmix.mapping.beams import Beams
from tofmix.mapping.grid import Pose, VoxelGrid
from tofmix.optics.equiangular import check_view
from tofmix.sensor import NoiseCurve, Sensor

Array = NDArray[np.float64]


def density(samples: Array, at: Array, noise: NoiseCurve) -> Array:
    """Equation (4), every kernel in full."""
    return np.array([norm.pdf(r, samples, noise.sigma(r) / 2).mean() for r in at])


def peaks(samples: Array, noise: NoiseCurve, *, gamma: float, step: float) -> Array:
    """Test (5) with epsilon -> 0: strict maxima of the mean-shift field on a fine grid, above gamma."""
    grid = [samples.min() - noise.sigma(samples.min())]
    while grid[-1] < samples.max() + noise.sigma(samples.max()):
        grid.append(grid[-1] + step * noise.sigma(grid[-1]))
    r = np.array(grid)
    h = noise.sigma(r)[:, None] / 2
    z = (r[:, None] - samples) / h
    kernel = np.exp(-z * z / 2)
    slope = -(kernel * z).sum(1)
    height = kernel.sum(1)
    threshold = max(gamma * len(samples), 3.0) / np.sqrt(5.0)
    crossing = np.flatnonzero((slope[:-1] > 0) & (slope[1:] <= 0) & (height[1:] > 1e-4))
    crossing = crossing[np.maximum(height[crossing], height[crossing + 1]) > threshold]
    share = slope[crossing] / (slope[crossing] - slope[crossing + 1])
    return np.asarray(r[crossing] + share * (r[crossing + 1] - r[crossing]))


def mixture_density(at: Array, mean: Array, sigma: Array, weight: Array, no_return: float, sensor: Sensor) -> Array:
    """Equation (1)."""
    assert sensor.noise is not None
    top = sensor.noise.range_mm[-1] if sensor.range_max_mm is None else sensor.range_max_mm
    out = np.full(len(at), sensor.outlier_probability / (top - (sensor.range_min_mm or 0.0)))
    if sensor.range_max_mm is not None:
        out += no_return * norm.pdf(at, sensor.range_max_mm, sensor.noise.sigma(sensor.range_max_mm))
    return np.asarray(out + (weight * norm.pdf(at[:, None], mean, sigma)).sum(1))


def em(
    samples: Array, start: Array, sensor: Sensor, *, mode: str, iterations: int, prior_samples: float = 50.0
) -> tuple[Array, Array, Array, float]:
    """The paper's section V, line by line; returns means, sigmas, weights and p(c_0)."""
    assert sensor.noise is not None
    mean = np.array(start, dtype=float)
    sigma = sensor.noise.sigma(mean)
    p_r = sensor.outlier_probability
    has_max = sensor.range_max_mm is not None
    weight = np.full(len(mean), (1 - p_r) / (len(mean) + has_max))
    no_return = (1 - p_r) / (len(mean) + 1) if has_max else 0.0
    for _ in range(iterations):
        total = mixture_density(samples, mean, sigma, weight, no_return, sensor)
        share = weight * norm.pdf(samples[:, None], mean, sigma) / total[:, None]
        support = share.sum(0)
        support_0 = 0.0
        if has_max:
            assert sensor.range_max_mm is not None
            top = sensor.range_max_mm
            support_0 = float((no_return * norm.pdf(samples, top, sensor.noise.sigma(top)) / total).sum())
        mean = (share * samples[:, None]).sum(0) / support
        squares = (share * (samples[:, None] - mean) ** 2).sum(0)
        curve = sensor.noise.sigma(mean)
        if mode == "tied":
            sigma = curve
        elif mode == "prior":
            sigma = np.sqrt((prior_samples * curve**2 + squares) / (prior_samples + support))
        else:
            sigma = np.maximum(np.sqrt(squares / support), 0.1 * curve)
        scale = (1 - p_r) / (support.sum() + support_0)
        weight, no_return = scale * support, scale * support_0
    return mean, sigma, weight, no_return


def log_likelihood(
    samples: Array, parameters: Array, k: int, sigma: Array, with_no_return: bool, sensor: Sensor
) -> float:
    """Log likelihood of (mu_1..mu_k, all shares but the last), for numeric derivatives."""
    shares = k + 1 if with_no_return else k
    mean, some = parameters[:k], parameters[k:]
    assert len(some) == shares - 1
    all_shares = np.append(some, 1 - sensor.outlier_probability - some.sum())
    no_return = float(all_shares[k]) if with_no_return else 0.0
    return float(np.log(mixture_density(samples, mean, sigma, all_shares[:k], no_return, sensor)).sum())


def light(
    beams: Beams, pose: Pose, grid: VoxelGrid, *, rays: int, direction: Callable[[float, float], Array] | None = None
) -> tuple[Array, Array]:
    """Samples that stop in each voxel, and that pass: every pixel as rays x rays thin rays, every ray through all.

    `direction` gives the unit vector of a place (down, right) in the image, pixels; default: an equiangular camera.
    """
    rows, cols, layers = beams.samples.shape

    def equiangular(down: float, right: float) -> Array:
        width, height = beams.pixel_size_rad
        el, az = (down + 0.5 - rows / 2) * height, (right + 0.5 - cols / 2) * width
        return np.array([np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)])

    corners = (
        np.stack(
            np.meshgrid(
                *[np.array(f) + np.arange(n) for f, n in zip(grid.first, grid.shape, strict=True)], indexing="ij"
            ),
            axis=-1,
        )
        * grid.cell_mm
        - pose.position()
    )
    stopped, passed = np.zeros(grid.shape), np.zeros(grid.shape)
    for number in np.ndindex(rows * rays, cols * rays):
        row, col = number[0] // rays, number[1] // rays
        down, right = ((n + 0.5) / rays - 0.5 for n in number)
        ray = pose.rotation() @ (direction or equiangular)(down, right)
        with np.errstate(divide="ignore"):
            planes = corners / ray, (corners + grid.cell_mm) / ray
        enter = np.maximum(np.minimum(*planes).max(axis=-1), 0.0)
        leave = np.maximum(*planes).min(axis=-1)
        hit = leave > enter
        for layer in range(layers):
            part = beams.samples[row, col, layer] / rays**2
            inside = (beams.near_mm[row, col, layer] <= leave) & (beams.far_mm[row, col, layer] >= enter)
            passed[hit & (beams.clear_to_mm[row, col, layer] > leave)] += part
            stopped[hit & inside] += part
        passed[hit & (leave <= beams.free_to_mm)] += beams.samples_no_return[row, col] / rays**2
    return stopped, passed


def pixel_angles(pixels: int, fov_deg: float) -> FloatArray:
    """Angle from the axis of each of `pixels` in a row or column, (pixels,) rad: (i - (n - 1) / 2) fov / n."""
    return np.asarray(np.deg2rad((np.arange(pixels) - (pixels - 1) / 2) * fov_deg / pixels), dtype=np.float64)


def beam_directions(rows: int, cols: int, *, fov_horizontal_deg: float, fov_vertical_deg: float) -> FloatArray:
    """Unit vectors along the beams of an equiangular pixel grid.

    `rows`, `cols`: size of the image.
    `fov_horizontal_deg`, `fov_vertical_deg`: full field of view.
    Returns (row, col, 3) float64: (sin az cos el, sin el, cos az cos el) in the sensor's frame: x right, y down, z
      forward.
    Raises ValueError: If the field of view cannot be.
    """
    check_view(fov_horizontal_deg, fov_vertical_deg)
    azimuth, elevation = np.meshgrid(pixel_angles(cols, fov_horizontal_deg), pixel_angles(rows, fov_vertical_deg))
    level = np.cos(elevation)
    return np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)
