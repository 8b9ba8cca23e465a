"""Recordings of a lock-in camera whose light adds up, from the raw-tap simulator of tests/blind, and how to judge them.

Scenes of flat boards before walls. Each sample of a pixel that sees several surfaces, or open space beside one, is
their phasor sum with the probability q; q = 0 is equation (1) of the paper.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import h5py
import numpy as np
from blind import scenes
from blind.camera import Device, Exposure, Mechanism, record
from blind.effects import OneFrequency, WholeBeam
from blind.geometry import Beams, Surface, cast

from support.cameras import camera_of
from tofmix.arrays import BoolArray, FloatArray
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor

FULL = (144, 176, 47.0, 39.0)
"""Rows, columns and fields of view (horizontal, vertical; degrees) of an SR-3000."""

SMALL = (48, 60, 16.0, 13.0)
"""The middle of it: quick, with pixels of the same size."""

SLATS = (48, 64, 47.0 * 64 / 176, 13.0)
"""The image of `slats`, with pixels of the same size."""

RANGES_MM = (300.0, 600.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0, 7000.0, 9000.0)


def pickets(rng: np.random.Generator) -> list[Surface]:
    """A fence of upright pales, each at its own range, before a wall."""
    count = int(rng.integers(6, 12))
    out = [
        Surface(
            name=f"pale {k}",
            center_mm=(-900 + 1800 * (k + 0.5) / count, 0.0, float(rng.uniform(1500, 2500))),
            size_mm=(float(rng.uniform(60, 140)), 9000.0),
            yaw_deg=float(rng.uniform(-20, 20)),
            pitch_deg=float(rng.uniform(-5, 5)),
            reflectivity=float(rng.uniform(0.3, 0.9)),
        )
        for k in range(count)
    ]
    return [*out, _wall(rng, 4500.0)]


Direction = Literal["vertical", "horizontal", "tilted"]
"""How slats stand: along columns or rows of pixels, or leaning away from the camera, so that they cross columns."""


def slats(
    rng: np.random.Generator, width_pixels: tuple[float, float], direction: Direction, *, ends: bool = False
) -> list[Surface]:
    """Slats a few pixels wide, each at its own range from 2.3 to 3.2 m, before a wall at 4.3 m, for the image `SLATS`.

    There are eleven of them, or eight horizontal ones. They go on beyond the image, or with `ends` end in it.
    """
    rows, cols, wide_deg, high_deg = SLATS
    is_horizontal = direction == "horizontal"
    count, pixels = (8, rows) if is_horizontal else (11, cols)
    pixel = math.radians((high_deg if is_horizontal else wide_deg) / pixels)
    out = []
    for k in range(count):
        depth = float(rng.uniform(2300, 3200))
        middle = ((k + 0.5) * pixels / count - pixels / 2 + float(rng.uniform(-0.5, 0.5))) * pixel
        width = float(rng.uniform(*width_pixels)) * pixel * depth
        length = float(rng.uniform(24, 36)) * pixel * depth if ends else 9000.0
        off, slant = math.tan(middle) * depth, float(rng.uniform(-3, 3))
        lean = float(rng.uniform(20, 40)) if direction == "tilted" else slant
        slat = Surface(
            name=f"slat {k}",
            center_mm=(0.0, off, depth) if is_horizontal else (off, 0.0, depth),
            size_mm=(length, width) if is_horizontal else (width, length),
            yaw_deg=slant if is_horizontal else 0.0,
            pitch_deg=0.0 if is_horizontal else lean,
            reflectivity=float(rng.uniform(0.3, 0.9)),
        )
        out.append(slat)
    return [*out, Surface(name="back wall", center_mm=(0.0, 0.0, 4300.0), size_mm=(40000.0, 40000.0))]


def random_boards(rng: np.random.Generator) -> list[Surface]:
    """Twelve boards of all sizes, tilts and reflectances before a wall."""
    out = []
    for k in range(12):
        depth = float(rng.uniform(1200, 3800))
        out.append(
            Surface(
                name=f"board {k}",
                center_mm=(depth * float(rng.uniform(-0.5, 0.5)), depth * float(rng.uniform(-0.4, 0.4)), depth),
                size_mm=(depth * float(rng.uniform(0.1, 0.4)), depth * float(rng.uniform(0.1, 0.4))),
                yaw_deg=float(rng.uniform(-40, 40)),
                pitch_deg=float(rng.uniform(-30, 30)),
                reflectivity=float(rng.uniform(0.15, 0.95)),
            )
        )
    return [*out, _wall(rng, 4700.0)]


def two_boards(rng: np.random.Generator) -> list[Surface]:
    """Two boards in the middle of the image before a wall: for a small image."""
    return [
        Surface(
            name="near",
            center_mm=(-110.0, -60.0, float(rng.uniform(1600, 1800))),
            size_mm=(170.0, 260.0),
            yaw_deg=12.0,
            pitch_deg=5.0,
            reflectivity=0.5,
        ),
        Surface(
            name="far",
            center_mm=(170.0, 60.0, float(rng.uniform(2200, 2600))),
            size_mm=(330.0, 300.0),
            yaw_deg=-20.0,
            reflectivity=0.8,
        ),
        Surface(name="wall", center_mm=(0.0, 0.0, 3600.0), size_mm=(9000.0, 9000.0), yaw_deg=5.0, reflectivity=0.6),
    ]


def one_wall(rng: np.random.Generator) -> list[Surface]:
    """A slanted wall, and nothing else."""
    return [
        Surface(
            name="wall",
            center_mm=(0.0, 0.0, 2500.0),
            size_mm=(20000.0, 20000.0),
            yaw_deg=float(rng.uniform(30, 50)),
            reflectivity=0.6,
        )
    ]


def crease(rng: np.random.Generator) -> list[Surface]:
    """Two walls that meet in the middle of the image."""
    turn = float(rng.uniform(-5, 5))
    return [
        Surface(
            name="left",
            center_mm=(-1500.0, 0.0, 1000.0),
            size_mm=(4242.64, 9000.0),
            yaw_deg=-45.0 + turn,
            reflectivity=0.5,
        ),
        Surface(
            name="right",
            center_mm=(1500.0, 0.0, 1000.0),
            size_mm=(4242.64, 9000.0),
            yaw_deg=45.0 + turn,
            reflectivity=0.7,
        ),
        Surface(name="behind", center_mm=(0.0, 0.0, 4000.0), size_mm=(90000.0, 90000.0), reflectivity=0.5),
    ]


def _wall(rng: np.random.Generator, range_mm: float) -> Surface:
    return Surface(
        name="back wall",
        center_mm=(0.0, 0.0, range_mm),
        size_mm=(40000.0, 40000.0),
        pitch_deg=round(float(rng.uniform(-6, 6)), 3),
        reflectivity=round(float(rng.uniform(0.4, 0.8)), 3),
    )


FAMILIES = {
    "boards": scenes.boards,
    "pickets": pickets,
    "random boards": random_boards,
    "slanted wall": scenes.slanted_wall,
    "corner": scenes.corner,
    "corridor": scenes.corridor,
    "near and far": scenes.near_far,
    "stairs": scenes.stairs,
    "room": scenes.room,
    "open hall": scenes.open_hall,
}
"""Scenes of the benchmark, drawn from a seed."""


class Texture(Mechanism):
    """Every pixel has a reflectance of its own: a factor of 1 + spread x a standard normal number."""

    moves = False

    def __init__(self, spread: float, seed: int) -> None:
        self._spread, self._seed = spread, seed

    def light(self, x: Exposure) -> None:
        """Scale signal, and with it the light that belongs to it."""
        factor = 1.0 + self._spread * np.asarray(np.random.default_rng(self._seed).standard_normal(x.z.shape[1]))
        x.z *= factor.astype(np.float32)
        x.charge *= (factor**2).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A recording and the truth about it."""

    recording: ArrayRecording
    beams: Beams
    device: Device

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        return self.recording.sensor


def sensor_of(device: Device, fov_deg: tuple[float, float]) -> Sensor:
    """The camera, with the noise of `blind.camera.Device`."""
    return camera_of(
        RANGES_MM,
        device.design_sigma(np.array(RANGES_MM)),
        reach_mm=(device.range_min_mm, device.range_max_mm),
        fov_deg=fov_deg,
        name=device.name,
        modulation_frequency_hz=device.frequency_hz,
        outlier_probability=device.outlier_probability,
    )


def made(
    surfaces: list[Surface],
    seed: int,
    *,
    view: tuple[int, int, float, float] = FULL,
    frames: int = 50,
    q: float = 1.0,
    texture: float = 0.0,
    frequency_hz: float = 20.0e6,
    wraps: bool = False,
) -> Scene:
    """Record a scene."""
    device = Device(
        name="lock-in",
        frames=frames,
        rows=view[0],
        cols=view[1],
        fov_horizontal_deg=view[2],
        fov_vertical_deg=view[3],
        frequency_hz=frequency_hz,
    )
    mechanisms: list[Mechanism] = [WholeBeam(probability=q)] if q > 0 else []
    mechanisms += [Texture(texture, seed)] if texture else []
    mechanisms += [OneFrequency()] if wraps else []
    raw = record(device, surfaces, mechanisms, seed=seed)
    recording = ArrayRecording(raw.range_mm, sensor_of(device, view[2:]), amplitude=raw.amplitude)
    return Scene(recording=recording, beams=cast(surfaces, device.view), device=device)


@dataclass(slots=True, kw_only=True)
class Judged:
    """How many pixels of what kind, and how layers fit the truth.

    `asked` are mixed pixels of two surfaces that are asked for (`judge`), of which `found` have exactly both; `mixed`
    are all of two surfaces, with `false` layers; `sure` are their layers of probability 0.99 and more, `sure_false`
    the false ones of these; `undecided` of them are marked so. Of `single` pixels `split` have more than one layer.
    """

    asked: int = 0
    found: int = 0
    mixed: int = 0
    false: int = 0
    sure: int = 0
    sure_false: int = 0
    undecided: int = 0
    single: int = 0
    split: int = 0
    share_squares: float = 0.0
    share_z_squares: float = 0.0

    def __add__(self, other: "Judged") -> "Judged":
        return Judged(**{name: getattr(self, name) + getattr(other, name) for name in self.__slots__})

    @property
    def share_rms(self) -> float:
        """Root mean square error of the nearer surface's share, where both were found."""
        return float(np.sqrt(self.share_squares / max(self.found, 1)))


def _alone(beams: Beams, shape: tuple[int, int]) -> FloatArray:
    """Number (row, col) of the surface that a pixel sees and nothing else; -1 where there is none."""
    one = ((beams.share > 0).sum(axis=0) == 1) & (beams.nothing == 0)
    return np.asarray(np.where(one, beams.surface[0], -1).reshape(shape))


def judge(
    scene: Scene, layers: Layers, *, least_share: float = 0.15, least_gap: float = 0.12, circle_mm: float = np.inf
) -> Judged:
    """Hold layers (row, col) against the truth.

    Asked for are pixels of two surfaces with shares of `least_share` and more, both seen alone within two pixels, whose
    gap is `least_gap` of the range and 50 standard errors and more. A layer is right within 4 of its standard errors or
    1 % of a surface, on a circle of ranges where there is one. Undecided pixels count as not found, and their layers
    not as false.
    """
    beams, (rows, cols) = scene.beams, layers.shape
    out, alone = Judged(), _alone(beams, (rows, cols))
    count = (beams.share > 0).sum(axis=0)
    frames = scene.recording.shape[0]
    undecided: BoolArray = np.zeros((rows, cols), bool)
    if layers.mixing is not None:
        undecided = layers.mixing == int(Mixing.UNDECIDED)
    for pixel in np.flatnonzero((count == 2) & (beams.nothing == 0)):
        row, col = divmod(int(pixel), cols)
        seen = np.flatnonzero(beams.share[:, pixel] > 0)
        share, truth = beams.share[seen, pixel], beams.range_mm[seen, pixel]
        gap, error = truth[1] - truth[0], float(np.hypot(*scene.device.design_sigma(truth))) / np.sqrt(frames)
        near = alone[max(0, row - 2) : row + 3, max(0, col - 2) : col + 3]
        both = all((near == beams.surface[k, pixel]).any() for k in seen)
        asked = share.min() >= least_share and both and gap >= least_gap * truth[0] and gap >= 50.0 * error
        out.mixed += 1
        out.asked += asked
        if undecided[row, col]:
            out.undecided += 1
            continue
        k = int(layers.n_modes[row, col])
        ranges = layers.range[row, col, :k].astype(float)
        reach = np.maximum(4.0 * layers.range_stderr[row, col, :k], 0.01 * ranges)
        off = np.abs(ranges[:, np.newaxis] - truth)
        right = (
            np.abs(off - circle_mm * np.rint(off / circle_mm) if np.isfinite(circle_mm) else off) < reach[:, np.newaxis]
        )
        sure = layers.probability[row, col, :k] >= 0.99
        out.false += int((~right.any(axis=1)).sum())
        out.sure += int(sure.sum())
        out.sure_false += int((sure & ~right.any(axis=1)).sum())
        if asked and k == 2 and right.any(axis=0).all():
            out.found += 1
            nearer = share[int(right[0].argmax())]
            miss = float(layers.weight[row, col, 0]) / float(layers.weight[row, col, :2].sum()) - nearer
            out.share_squares += miss**2
            out.share_z_squares += (miss / max(float(layers.weight_stderr[row, col, 0]), 1e-6)) ** 2
    single = ((count == 1) & (beams.nothing == 0)).reshape(rows, cols)
    out.single, out.split = int(single.sum()), int((single & (layers.n_modes > 1) & ~undecided).sum())
    return out


def small(seed: int, **choices: float | bool) -> Scene:
    """A small recording of two boards before a wall."""
    return made(two_boards(np.random.default_rng(seed)), seed, view=SMALL, **choices)  # type: ignore[arg-type]


def write_sums(path: Path, source: ArrayRecording, *, amplitude: bool = True, frames: int = 40) -> Path:
    """Write a recording in memory as a foreign program would."""
    with h5py.File(path, "w") as root:
        root["range"] = source.read_range(slice(0, frames), slice(None))
        if amplitude:
            root["amplitude"] = source.read_amplitude(slice(0, frames), slice(None))
        sensor, camera = root.create_group("sensor"), source.sensor
        for name in (
            "modulation_frequency_hz",
            "range_min_mm",
            "range_max_mm",
            "fov_horizontal_deg",
            "fov_vertical_deg",
            "outlier_probability",
        ):
            sensor.attrs[name] = getattr(camera, name)
        assert camera.noise is not None
        sensor["noise_range"], sensor["noise_sigma"] = camera.noise.range_mm, camera.noise.sigma_mm
    return path
