"""Flat plates of any outline before a camera of equal angles, cast finely: what each part of each pixel sees.

Rectangles (rolled in their plane, too), disks, half-planes, and bars that are narrow rectangles. `truth` casts them:
the surface and range at the centre of each of 8 x 8 parts of a pixel, and each pixel's shares from 1597 beams in a
lattice whose projections on the pixel's sides are evenly spread, so that shares of edges along the grid are right to
1/1597.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from blind.geometry import Surface, View
from numpy.typing import ArrayLike

from tofmix.arrays import BoolArray, FloatArray, IntArray

PARTS = 8
"""Parts along a pixel's side."""

BEAMS = 1597
_TURN = 987  # both Fibonacci numbers: a lattice of beams with the least gaps in every direction

Outline = Literal["rectangle", "disk", "half-plane"]

FULL = View(rows=144, cols=176, fov_horizontal_deg=47.0, fov_vertical_deg=39.0, range_max_mm=7000.0)
"""The image of an SR-3000."""

SMALL = View(rows=48, cols=60, fov_horizontal_deg=16.0, fov_vertical_deg=13.0, range_max_mm=7000.0)
"""The middle of it: quick, with pixels of the same size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plate:
    """A flat plate in the sensor's frame: x right, y down, z forward, mm."""

    center_mm: tuple[float, float, float]
    """(x, y, z). Its centre; of a half-plane, a point of its edge."""
    half_mm: tuple[float, float] = (1.0, 1.0)
    """(float, float). Half its sides along its own axes u and v; of a disk, the radius first; of a half-plane (u <= 0),
    unused."""
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    """`yaw_deg`, `pitch_deg`, `roll_deg`: turned in its own plane first, about y next, about x last."""
    reflectivity: float = 0.6
    """Of its surface."""
    outline: Outline = "rectangle"
    """Its shape."""

    @classmethod
    def of(cls, surface: Surface) -> "Plate":
        """The same rectangle as one of tests/blind."""
        return cls(
            center_mm=surface.center_mm,
            half_mm=(surface.size_mm[0] / 2, surface.size_mm[1] / 2),
            yaw_deg=surface.yaw_deg,
            pitch_deg=surface.pitch_deg,
            reflectivity=surface.reflectivity,
        )

    def axes(self) -> FloatArray:
        """Axes u, v and normal (3, 3) as rows."""
        yaw, pitch, roll = (math.radians(a) for a in (self.yaw_deg, self.pitch_deg, self.roll_deg))
        normal = np.array([math.sin(yaw), -math.sin(pitch) * math.cos(yaw), math.cos(pitch) * math.cos(yaw)])
        u0 = np.array([math.cos(yaw), math.sin(pitch) * math.sin(yaw), -math.cos(pitch) * math.sin(yaw)])
        v0 = np.array([0.0, math.cos(pitch), math.sin(pitch)])
        return np.stack([math.cos(roll) * u0 + math.sin(roll) * v0, math.cos(roll) * v0 - math.sin(roll) * u0, normal])

    def met(self, beams: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Range along beams (..., 3) to the plate's plane (inf: none), and u and v there, each (...)."""
        axes, center = self.axes(), np.array(self.center_mm)
        along = beams @ axes.T
        with np.errstate(divide="ignore", invalid="ignore"):
            away = float(axes[2] @ center) / along[..., 2]
            away[~(away > 0)] = np.inf
            u, v = (along[..., k] * away - float(axes[k] @ center) for k in (0, 1))
        return away, u, v

    def hit(self, beams: FloatArray) -> FloatArray:
        """Range along beams (..., 3), inf where they miss it."""
        away, u, v = self.met(beams)
        if self.outline == "half-plane":
            inside = u <= 0
        elif self.outline == "disk":
            inside = np.hypot(u, v) <= self.half_mm[0]
        else:
            inside = (np.abs(u) <= self.half_mm[0]) & (np.abs(v) <= self.half_mm[1])
        return np.where(inside & np.isfinite(away), away, np.inf)

    def edge_distance(self, view: View, row: ArrayLike, col: ArrayLike) -> FloatArray:
        """Distance (...) of places in the image from the edge of a half-plane, or of a disk's outline, in pixels.

        Positive outside. To the first order in the distance.
        """
        step = 1.0e-3
        row, col = np.asarray(row, dtype=np.float64), np.asarray(col, dtype=np.float64)

        def level(down: FloatArray, across: FloatArray) -> FloatArray:
            _, u, v = self.met(rays(view, down, across))
            return u if self.outline == "half-plane" else np.hypot(u, v) - self.half_mm[0]

        slope_row = (level(row + step, col) - level(row - step, col)) / (2 * step)
        slope_col = (level(row, col + step) - level(row, col - step)) / (2 * step)
        return np.asarray(level(row, col) / np.hypot(slope_row, slope_col))


def rays(view: View, row: ArrayLike, col: ArrayLike) -> FloatArray:
    """Unit vectors (..., 3) along the beams at places of the image; the centre of pixel (0, 0) is at (0, 0)."""
    wide, high = view.cell_rad
    across = (np.asarray(col) - (view.cols - 1) / 2) * wide
    down = (np.asarray(row) - (view.rows - 1) / 2) * high
    level = np.cos(down)
    return np.stack(np.broadcast_arrays(np.sin(across) * level, np.sin(down), np.cos(across) * level), axis=-1)


def facing(
    view: View,
    row: float,
    col: float,
    range_mm: float,
    *,
    size_pixels: tuple[float, float],
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    roll_deg: float = 0.0,
    reflectivity: float = 0.6,
    outline: Outline = "rectangle",
) -> Plate:
    """A plate at a place of the image that faces the camera but for `tilt_deg`; sides (disk: diameters) in pixels."""
    toward = rays(view, np.array(row), np.array(col))
    pixel_mm = view.cell_rad[0] * range_mm
    return Plate(
        center_mm=(float(toward[0] * range_mm), float(toward[1] * range_mm), float(toward[2] * range_mm)),
        half_mm=(size_pixels[0] * pixel_mm / 2, size_pixels[1] * pixel_mm / 2),
        yaw_deg=math.degrees(math.asin(toward[0])) + tilt_deg[0],
        pitch_deg=math.degrees(math.atan2(-toward[1], toward[2])) + tilt_deg[1],
        roll_deg=roll_deg,
        reflectivity=reflectivity,
        outline=outline,
    )


def wall(range_mm: float, *, yaw_deg: float = 0.0, pitch_deg: float = 0.0, reflectivity: float = 0.6) -> Plate:
    """A wall that fills the image."""
    return Plate(
        center_mm=(0.0, 0.0, range_mm),
        half_mm=(20000.0, 20000.0),
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        reflectivity=reflectivity,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What a camera sees of plates."""

    part_surface: IntArray
    """(rows x 8, cols x 8) int64. Number of the plate at the centre of each part; -1: none."""
    part_range_mm: FloatArray
    """(rows x 8, cols x 8) float64. Its range; NaN: none."""
    share: FloatArray
    """(plate, row, col) float64. Share of each pixel's solid angle; the rest sees nothing."""
    range_mm: FloatArray
    """(plate, row, col) float64. Mean range of the part of the pixel that sees the plate; NaN: none does."""
    cosine: FloatArray
    """(plate, row, col) float64. Cosine of incidence at the pixel's centre."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Plates, the image, and the truth about it."""

    plates: list[Plate]
    view: View
    truth: Truth


def scene(plates: list[Plate], view: View) -> Scene:
    """Cast plates."""
    return Scene(plates=plates, view=view, truth=truth(plates, view))


def truth(plates: list[Plate], view: View) -> Truth:
    """Cast plates: parts of all pixels at their centres, and many beams in each pixel that sees several."""
    rows, cols = view.rows, view.cols
    edge = (np.arange(PARTS) - (PARTS - 1) / 2) / PARTS
    beams = rays(
        view, (np.arange(rows)[:, np.newaxis] + edge).reshape(-1, 1), (np.arange(cols)[:, np.newaxis] + edge).ravel()
    )
    nearest, label = _nearest(plates, beams)
    nearest[label < 0] = np.nan
    center_row, center_col = np.indices((rows, cols))
    centers = rays(view, center_row, center_col)
    share = np.zeros((len(plates), rows, cols))
    mean = np.full(share.shape, np.nan)
    cosine = np.stack([np.abs(centers @ plate.axes()[2]) for plate in plates])
    seen = _seen(label, len(plates), rows, cols)
    several = seen.sum(axis=0) > 1
    by_pixel = label.reshape(rows, PARTS, cols, PARTS)[:, 0, :, 0]
    parts_mm = nearest.reshape(rows, PARTS, cols, PARTS).mean(axis=(1, 3))
    for k in range(len(plates)):
        alone = ~several & (by_pixel == k)
        share[k][alone], mean[k][alone] = 1.0, parts_mm[alone]
    _fill_mixed(plates, view, seen, several, share, mean)
    return Truth(part_surface=label, part_range_mm=nearest, share=share, range_mm=mean, cosine=cosine)


def _nearest(plates: list[Plate], beams: FloatArray) -> tuple[FloatArray, IntArray]:
    """Range and number (row, col) of the nearest plate of each of a grid of beams (row, col, 3)."""
    nearest = np.full(beams.shape[:2], np.inf)
    label = np.full(beams.shape[:2], -1, dtype=np.int64)
    across, down = np.arctan2(beams[0, :, 0], beams[0, :, 2]), np.arcsin(beams[:, 0, 1])
    for k, plate in enumerate(plates):
        place = _window(plate, down, across)
        away = plate.hit(beams[place])
        nearer = away < nearest[place]
        nearest[place] = np.where(nearer, away, nearest[place])
        label[place] = np.where(nearer, k, label[place])
    return nearest, label


def _window(plate: Plate, down: FloatArray, across: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of beams that may meet a plate: those of a ball around it."""
    center = np.array(plate.center_mm)
    away = float(np.linalg.norm(center))
    radius = plate.half_mm[0] if plate.outline == "disk" else math.hypot(*plate.half_mm)
    reach = radius / away
    elevation = math.asin(center[1] / away)
    if plate.outline == "half-plane" or reach > 0.7 or abs(elevation) > 0.7:
        return slice(None), slice(None)
    high = math.asin(reach)
    sideways = min(1.0, reach / math.cos(elevation))
    azimuth, wide = math.atan2(center[0], center[2]), math.asin(sideways)
    return _between(down, elevation, high), _between(across, azimuth, wide)


def _between(angles: FloatArray, middle: float, reach: float) -> slice:
    first, past = np.searchsorted(angles, (middle - reach, middle + reach))
    return slice(max(0, int(first) - 1), int(past) + 1)


def _seen(label: IntArray, count: int, rows: int, cols: int) -> BoolArray:
    """Whether a pixel, or a part that touches it, sees each plate, and nothing as the last: (plate + 1, row, col)."""
    ring = np.pad(label, 1, mode="edge")
    blocks = np.lib.stride_tricks.sliding_window_view(ring, (PARTS + 2, PARTS + 2))[::PARTS, ::PARTS]
    first = blocks[:, :, :1, :1]
    uneven = (blocks != first).any(axis=(2, 3))
    seen = np.zeros((count + 1, rows, cols), dtype=bool)
    at = np.nonzero(np.ones((rows, cols), dtype=bool))
    seen[first[:, :, 0, 0].ravel(), *at] = True  # -1 is the last
    row, col = np.nonzero(uneven)
    values = blocks[row, col].reshape(len(row), blocks.shape[2] * blocks.shape[3])
    for k in range(-1, count):
        met = (values == k).any(axis=1)
        seen[k, row[met], col[met]] = True
    return seen


def _fill_mixed(
    plates: list[Plate], view: View, seen: BoolArray, several: BoolArray, share: FloatArray, mean: FloatArray
) -> None:
    """Shares and mean ranges of pixels that may see several plates, from a lattice of beams in each."""
    row, col = np.nonzero(several)
    index = np.arange(BEAMS)
    x, y = (index + 0.5) / BEAMS - 0.5, (index * _TURN % BEAMS + 0.5) / BEAMS - 0.5
    for start in range(0, len(row), 1000):
        some = slice(start, start + 1000)
        beams = rays(view, row[some, np.newaxis] + y, col[some, np.newaxis] + x)
        nearest = np.full(beams.shape[:2], np.inf)
        label = np.full(beams.shape[:2], -1)
        met = seen[:, row[some], col[some]]
        for k, plate in enumerate(plates):
            away = plate.hit(beams[met[k]])
            nearer = away < nearest[met[k]]
            nearest[met[k]] = np.where(nearer, away, nearest[met[k]])
            label[met[k]] = np.where(nearer, k, label[met[k]])
        for k in range(len(plates)):
            mine = label == k
            count = mine.sum(axis=1)
            share[k, row[some], col[some]] = count / BEAMS
            with np.errstate(invalid="ignore"):
                mean[k, row[some], col[some]] = np.where(mine, nearest, 0.0).sum(axis=1) / np.where(
                    count, count, np.nan
                )


def tilted_rectangles(rng: np.random.Generator, view: View) -> list[Plate]:
    """Rectangles of 10 to 45 pixels, rolled by 5 to 40 degrees, before a wall."""
    out = [_rolled(rng, view, k, (10.0, 45.0)) for k in range(max(3, round(12 * view.rows / FULL.rows)))]
    return [*out, wall(4600.0, yaw_deg=float(rng.uniform(-6, 6)), reflectivity=0.6)]


def crossing_boards(rng: np.random.Generator, view: View) -> list[Plate]:
    """Many small rolled boards that cross each other: pixels of three surfaces."""
    count = max(6, round(40 * (view.rows * view.cols) / (FULL.rows * FULL.cols)))
    out = [_rolled(rng, view, k, (14.0, 40.0)) for k in range(count)]
    return [*out, wall(4600.0, yaw_deg=float(rng.uniform(-6, 6)), reflectivity=0.6)]


def _rolled(rng: np.random.Generator, view: View, k: int, sides: tuple[float, float]) -> Plate:
    sign = 1.0 if k % 2 else -1.0
    return facing(
        view,
        float(rng.uniform(0, view.rows)),
        float(rng.uniform(0, view.cols)),
        float(rng.uniform(1200, 3600)),
        size_pixels=(float(rng.uniform(*sides)), float(rng.uniform(*sides))),
        tilt_deg=(float(rng.uniform(-30, 30)), float(rng.uniform(-30, 30))),
        roll_deg=sign * float(rng.uniform(5, 40)),
        reflectivity=float(rng.uniform(0.2, 0.9)),
    )


def lattice(rng: np.random.Generator, view: View) -> list[Plate]:
    """Slats of 6 to 9 pixels across others behind them, all rolled, each at its own range, before a wall."""
    out = []
    for turn, (least, most) in (
        (float(rng.uniform(3, 15)), (1300.0, 1700.0)),
        (90.0 + float(rng.uniform(3, 15)), (2200.0, 2800.0)),
    ):
        across = np.array([math.cos(math.radians(turn)), math.sin(math.radians(turn))])  # col, row
        reach = math.hypot(view.rows, view.cols) / 2
        for place in np.arange(-reach + float(rng.uniform(0, 16)), reach, 18.0):
            col, row = (view.cols - 1) / 2 + place * across[0], (view.rows - 1) / 2 + place * across[1]
            if not (-10 < row < view.rows + 10 and -10 < col < view.cols + 10):
                continue
            out.append(
                facing(
                    view,
                    row,
                    col,
                    float(rng.uniform(least, most)),
                    roll_deg=turn,
                    size_pixels=(float(rng.uniform(6, 9)), 6.0 * reach),
                    reflectivity=float(rng.uniform(0.3, 0.9)),
                )
            )
    return [*out, wall(4600.0, pitch_deg=float(rng.uniform(-6, 6)), reflectivity=0.6)]


def disks(rng: np.random.Generator, view: View) -> list[Plate]:
    """Plates of 4 to 15 pixels radius, side by side, before a wall."""
    out = []
    rows, cols = max(1, view.rows // 34), max(1, view.cols // 34)
    for k in range(rows * cols):
        diameter = 2.0 * float(rng.uniform(4, 15))
        row = (k // cols + 0.5) * view.rows / rows + float(rng.uniform(-2, 2))
        col = (k % cols + 0.5) * view.cols / cols + float(rng.uniform(-2, 2))
        out.append(
            facing(
                view,
                row,
                col,
                float(rng.uniform(1300, 3200)),
                size_pixels=(diameter, diameter),
                outline="disk",
                tilt_deg=(float(rng.uniform(-15, 15)), float(rng.uniform(-15, 15))),
                reflectivity=float(rng.uniform(0.3, 0.9)),
            )
        )
    return [*out, wall(4500.0, yaw_deg=float(rng.uniform(-6, 6)))]


def bars(width_pixels: float) -> Callable[[np.random.Generator, View], list[Plate]]:
    """Bars of a width in pixels, 2 to 20 degrees off the grid, side by side before a wall."""

    def made(rng: np.random.Generator, view: View) -> list[Plate]:
        out = []
        upright = view.cols // 30
        for k in range(upright):
            col = (k + 0.5) * view.cols / upright
            out.append(_bar(rng, view, (view.rows * 0.27, col), (width_pixels, 0.42 * view.rows)))
        level = max(1, view.rows // 48)
        for k in range(level):
            row = view.rows * (0.6 + 0.36 * (k + 0.5) / level)
            out.append(_bar(rng, view, (row, view.cols / 2), (0.8 * view.cols, width_pixels), most_deg=4.0))
        return [*out, wall(4500.0, yaw_deg=float(rng.uniform(-6, 6)))]

    return made


def _bar(
    rng: np.random.Generator, view: View, place: tuple[float, float], size: tuple[float, float], most_deg: float = 20.0
) -> Plate:
    return facing(
        view,
        *place,
        float(rng.uniform(1300, 2500)),
        size_pixels=size,
        reflectivity=float(rng.uniform(0.3, 0.9)),
        roll_deg=float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, most_deg)),
    )


def half_plane(rng: np.random.Generator, view: View) -> list[Plate]:
    """A half-plane at any angle, its edge near the middle of the image, before a wall."""
    row = (view.rows - 1) / 2 + float(rng.uniform(-4, 4))
    col = (view.cols - 1) / 2 + float(rng.uniform(-4, 4))
    near = facing(
        view,
        row,
        col,
        float(rng.uniform(1300, 2500)),
        size_pixels=(1.0, 1.0),
        outline="half-plane",
        tilt_deg=(float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20))),
        roll_deg=float(rng.uniform(0, 360)),
        reflectivity=float(rng.uniform(0.3, 0.9)),
    )
    return [near, wall(4500.0, yaw_deg=float(rng.uniform(-6, 6)))]
