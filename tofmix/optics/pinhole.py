"""The pinhole camera with a lens: equal steps on the image plane, and OpenCV's distortion.

Use it for nearly all cameras that have a lens. Not for fisheye lenses: their
equidistant models have other polynomials, in the angle off the axis.

References
----------
OpenCV, Camera Calibration and 3D Reconstruction: the distortion with k1 k2 p1 p2 k3 k4 k5 k6.
D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37 (1971): k1 k2 k3 p1 p2.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import BoolArray, FloatArray

DISTORTION_LENGTHS = (0, 4, 5, 8)
"""Numbers of `distortion`: none, k1 k2 p1 p2, with k3, with k4 k5 k6."""

MOST_OFF_AXIS = 1000.0
"""Largest tangent of an angle off the axis that a pinhole images: 89.94 degrees."""


_EXACT = 1e-11
"""Largest error of an undistorted place, in focal lengths: 1e-7 of a pixel where the focal length is 10,000."""

_POINTS_AT_ONCE = 1 << 18
"""Places that are undistorted at once: bounds the memory."""


@dataclass(frozen=True, slots=True)
class Distortion:
    """OpenCV's lens distortion, between undistorted and distorted places on the plane z = 1.

    With s = x^2 + y^2 and f = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3), a place (x, y) is imaged at

        x f + 2 p1 x y + p2 (s + 2 x^2),  y f + p1 (s + 2 y^2) + 2 p2 x y

    Parameters
    ----------
    coefficients : tuple of float
        k1 k2 p1 p2 k3 k4 k5 k6, as many as `DISTORTION_LENGTHS` allows.
    """

    coefficients: tuple[float, ...]

    @property
    def _all(self) -> tuple[float, ...]:
        return (*self.coefficients, *(0.0,) * 8)[:8]

    def apply(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distorted places of undistorted ones."""
        p1, p2 = self._all[2:4]
        s = x * x + y * y
        numerator, denominator, _, _ = self._radial(s)
        f = numerator / denominator
        return x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * f + p1 * (s + 2 * y * y) + 2 * p2 * x * y

    def _radial(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Numerator and denominator of f, and their derivatives by s."""
        k1, k2, _, _, k3, k4, k5, k6 = self._all
        return (
            1 + s * (k1 + s * (k2 + s * k3)),
            1 + s * (k4 + s * (k5 + s * k6)),
            k1 + s * (2 * k2 + 3 * s * k3),
            k4 + s * (2 * k5 + 3 * s * k6),
        )

    def _derivatives(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of the distorted place: x' by x, x' by y (which is y' by x), y' by y."""
        p1, p2 = self._all[2:4]
        top, bottom, top_slope, bottom_slope = self._radial(x * x + y * y)
        f = top / bottom
        slope = (top_slope * bottom - top * bottom_slope) / bottom**2
        return (
            f + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
            2 * x * y * slope + 2 * p1 * x + 2 * p2 * y,
            f + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x,
        )

    def fold_radius(self) -> float:
        """Undistorted radius up to which the distorted one grows, at most `MOST_OFF_AXIS`."""
        return _fold_radius(self._all)

    def undo(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Undistorted places of distorted ones; NaN if none exists before the distortion folds.

        Newton's iteration on both coordinates. It starts from the radius of a lens without p1 and p2, which a table
        gives, so that it cannot end behind the fold.
        """
        if not any(self.coefficients):
            return x, y
        fold = self.fold_radius()
        starts = 4097  # radii in a table of starts for the undistortion
        radius = np.tan(np.linspace(0.0, math.atan(fold), starts, endpoint=False))  # the fold may be a pole
        top, bottom, _, _ = self._radial(radius**2)
        imaged = np.maximum.accumulate(np.nan_to_num(radius * top / bottom))
        flat_x, flat_y = np.ravel(x), np.ravel(y)
        out = np.empty((2, flat_x.size))
        for start in range(0, flat_x.size, _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            out[:, part] = self._newton(flat_x[part], flat_y[part], imaged, radius, fold)
        return out[0].reshape(np.shape(x)), out[1].reshape(np.shape(x))

    def _newton(
        self,
        to_x: FloatArray,
        to_y: FloatArray,
        imaged: FloatArray,
        radius: FloatArray,
        fold: float,
        *,
        most_steps: int = 50,  # of Newton's; a place that needs more has no undistorted one
    ) -> tuple[FloatArray, FloatArray]:
        far = np.hypot(to_x, to_y)
        start = np.interp(far, imaged, radius) / np.where(far > 0, far, 1.0)
        x, y = to_x * start, to_y * start
        with np.errstate(all="ignore"):  # what leaves the lens ends as NaN
            for _ in range(most_steps):
                at_x, at_y = self.apply(x, y)
                a, b, c = self._derivatives(x, y)
                off_x, off_y, size = at_x - to_x, at_y - to_y, a * c - b * b
                step_x, step_y = (c * off_x - b * off_y) / size, (a * off_y - b * off_x) / size
                x, y = x - step_x, y - step_y
                if not (np.abs(step_x) + np.abs(step_y) > _EXACT / 10 * (1 + far)).any():
                    break
            good = self._is_solution(x, y, to_x, to_y, fold)
        return np.where(good, x, np.nan), np.where(good, y, np.nan)

    def _is_solution(self, x: FloatArray, y: FloatArray, to_x: FloatArray, to_y: FloatArray, fold: float) -> BoolArray:
        at_x, at_y = self.apply(x, y)
        a, b, c = self._derivatives(x, y)
        off = np.hypot(at_x - to_x, at_y - to_y)
        near = off <= _EXACT * (1 + np.hypot(to_x, to_y))
        return np.asarray(near & (np.hypot(x, y) < fold) & (a * c - b * b > 0), dtype=np.bool_)


@cache
def _fold_radius(coefficients: tuple[float, ...]) -> float:
    """The distorted radius r N(s) / D(s), s = r^2, grows while (N + 2 s N') D - 2 s N D' and D are above 0."""
    negligible = 1e-30  # a coefficient below this adds less than 1e-12 at the largest radius, 1000 focal lengths
    k1, k2, _, _, k3, k4, k5, k6 = (0.0 if abs(k) < negligible else k for k in coefficients)
    s = np.polynomial.Polynomial([0.0, 1.0])
    top = np.polynomial.Polynomial([1.0, k1, k2, k3]).trim()
    bottom = np.polynomial.Polynomial([1.0, k4, k5, k6]).trim()
    growth = ((top + 2 * s * top.deriv()) * bottom - 2 * s * top * bottom.deriv()).trim(negligible)
    return math.sqrt(min(_least_positive_root(growth), _least_positive_root(bottom), MOST_OFF_AXIS**2))


def _least_positive_root(polynomial: "np.polynomial.Polynomial") -> float:
    if polynomial.degree() == 0:
        return math.inf
    roots = polynomial.roots()
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(real.min()) if real.size else math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Pinhole:
    """Pixel (row, col) looks along the undistorted ((col - cx) / fx, (row - cy) / fy, 1).

    Parameters
    ----------
    fx, fy : float
        Focal lengths in pixels, above 0.
    cx, cy : float
        Column and row of the axis, in pixels; the centre of pixel (0, 0) is at 0, 0.
    distortion : tuple of float
        OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]; empty for none.

    Raises
    ------
    ValueError
        If a number is not finite or out of its bounds, or `distortion` has another length. It begins with the key.
    """

    name: ClassVar[str] = "pinhole"

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for key in ("fx", "fy", "cx", "cy"):
            value = float(getattr(self, key))
            if not math.isfinite(value) or (key in {"fx", "fy"} and value <= 0):
                raise ValueError(f"{key}: {value:g} is not a finite number{' above 0' if key in {'fx', 'fy'} else ''}")
            object.__setattr__(self, key, value)
        distortion = tuple(float(k) for k in self.distortion)
        if len(distortion) not in DISTORTION_LENGTHS:
            raise ValueError(
                f"distortion: {len(distortion)} numbers; expected OpenCV's k1 k2 p1 p2, k1 k2 p1 p2 k3, or"
                " k1 k2 p1 p2 k3 k4 k5 k6"
            )
        if not all(math.isfinite(k) for k in distortion):
            raise ValueError(f"distortion: {' '.join(f'{k:g}' for k in distortion)}: not all are finite")
        object.__setattr__(self, "distortion", distortion)

    @property
    def _lens(self) -> Distortion:
        return Distortion(self.distortion)

    def rays(self, row: ArrayLike, col: ArrayLike, *, shape: tuple[int, int]) -> FloatArray:  # noqa: ARG002
        """Vectors (..., 3) along the beams at places (row, col), with z = 1.

        Raises
        ------
        ValueError
            If a place lies outside the image of the lens: where the distortion folds, or 90 degrees off the axis.
        """
        down, across = np.broadcast_arrays(np.asarray(row, dtype=np.float64), np.asarray(col, dtype=np.float64))
        with np.errstate(over="ignore"):
            x, y = (across - self.cx) / self.fx, (down - self.cy) / self.fy
            reach = np.hypot(x, y)
        inside = reach <= MOST_OFF_AXIS
        x, y = self._lens.undo(np.where(inside, x, np.nan), np.where(inside, y, np.nan))
        if np.isnan(x).any():
            at = int(np.isnan(x).argmax())
            raise ValueError(self._beyond(float(down.flat[at]), float(across.flat[at])))
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def _beyond(self, row: float, col: float) -> str:
        off_axis = math.degrees(math.atan(self._lens.fold_radius()))
        where = f"the image reaches row {row:g}, column {col:g}, which lies beyond"
        if any(self.distortion):
            return f"distortion: it folds, or cannot be undone, {off_axis:.1f} degrees off the axis at most; {where}"
        return f"fx, fy: a pinhole images up to {off_axis:.2f} degrees off the axis; {where}"

    def pixels(self, directions: FloatArray, *, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002
        """Place (row, col) of directions (..., 3), in the image or outside it; NaN where the lens images none."""
        x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
        with np.errstate(all="ignore"):
            x, y = x / z, y / z
            seen = (z > 0) & (np.hypot(x, y) < self._lens.fold_radius())
            x, y = self._lens.apply(x, y)
        return np.where(seen, y * self.fy + self.cy, np.nan), np.where(seen, x * self.fx + self.cx, np.nan)

    def check(self, shape: tuple[int, int]) -> None:
        """Refuse an image (rows, cols) that extends beyond the image of the lens.

        The distorted radius grows up to the fold, so that an image whose border has rays has rays everywhere.

        Raises
        ------
        ValueError
            Naming the key and the first place without a ray.
        """
        rows, cols = shape
        down, across = np.arange(rows + 1) - 0.5, np.arange(cols + 1) - 0.5
        for row in (-0.5, rows - 0.5):
            self.rays(row, across, shape=shape)
        for col in (-0.5, cols - 0.5):
            self.rays(down, col, shape=shape)

    def words(self, shape: tuple[int, int]) -> str:
        """The kind, and the field of view through the image's middle row and column, in words."""
        rows, cols = shape
        wide = self.rays((rows - 1) / 2, np.array([-0.5, cols - 0.5]), shape=shape)
        high = self.rays(np.array([-0.5, rows - 0.5]), (cols - 1) / 2, shape=shape)
        angles = np.rad2deg([np.ptp(np.arctan(wide[:, 0])), np.ptp(np.arctan(high[:, 1]))])
        lens = "a pinhole with distortion" if any(self.distortion) else "a pinhole"
        return f"{angles[0]:.1f} x {angles[1]:.1f} degrees of {lens}"
