"""A lens by brute force, independent of `tofmix.optics.pinhole`: OpenCV's formula, undone by its fixed-point iteration.

Use `distorted` for the formula and `undistorted` to look along a pixel. Nothing here is fast.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def distorted(x: Floats, y: Floats, k: tuple[float, ...]) -> tuple[Floats, Floats]:
    """X'' and y'' of OpenCV's calib3d page, with k = k1 k2 p1 p2 k3 k4 k5 k6 as far as given."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*k, *[0.0] * 8)[:8]
    r = np.sqrt(x**2 + y**2)
    radial = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
    return x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2), y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y


def undistorted(x: Floats, y: Floats, k: tuple[float, ...]) -> tuple[Floats, Floats]:
    """The place that is imaged at (x, y): OpenCV's fixed-point iteration, for lenses that do not distort much."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*k, *[0.0] * 8)[:8]
    u, v = x.copy(), y.copy()
    for _ in range(300):
        s = u**2 + v**2
        f = (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
        before = u
        u, v = (x - 2 * p1 * u * v - p2 * (s + 2 * u**2)) / f, (y - p1 * (s + 2 * v**2) - 2 * p2 * u * v) / f
        if np.abs(u - before).max() < 1e-15:
            break
    return u, v


def beams(
    row: Floats, col: Floats, *, fx: float, fy: float, cx: float, cy: float, distortion: tuple[float, ...] = ()
) -> tuple[Floats, Floats]:
    """Unit vectors (..., 3) at places of the image, and the solid angle (...) around each per pixel, sr."""
    x, y = undistorted((col - cx) / fx, (row - cy) / fy, distortion)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1)
    length = np.linalg.norm(ray, axis=-1)
    step = 1e-6
    by_x = [(b - a) / (2 * step) for a, b in _ends(x, y, step, 0.0, distortion)]
    by_y = [(b - a) / (2 * step) for a, b in _ends(x, y, 0.0, step, distortion)]
    stretch = np.abs(by_x[0] * by_y[1] - by_x[1] * by_y[0])
    return ray / length[..., np.newaxis], 1.0 / (stretch * fx * fy * length**3)


def _ends(x: Floats, y: Floats, dx: float, dy: float, k: tuple[float, ...]) -> Iterator[tuple[Floats, Floats]]:
    return zip(distorted(x - dx, y - dy, k), distorted(x + dx, y + dy, k), strict=True)
