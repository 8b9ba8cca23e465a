"""Recordings of a lock-in camera before round things: spheres, cylinders and capsules before walls, and their truth.

Independent of the package: rays through 36 x 36 parts of each pixel, the light of Lambert's law or another power of the
cosine, phasor sums, and noise of each sample's phasor.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import tofmix as tm
from support.counts import counted_layers
from tofmix.layers import Layers
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor

FREQUENCY_HZ = 20e6
CIRCLE_MM = 299_792_458e3 / (2 * FREQUENCY_HZ)
SCALE_MM = CIRCLE_MM / (2 * np.pi)
ROWS, COLS, FOCAL = 48, 64, 75.0
WALL_MM = 3000.0
"""Distance of the wall by which noise is given, where there is none."""
PARTS = 36
"""Parts of a pixel along each side: at a limb the range goes as a square root, so a coarse sum errs by millimetres."""
INNER_PARTS = 12
"""The same of a pixel that sees one thing, as its neighbours do: finer parts change its range by less than 0.01 mm, and
by 0.14 mm at the crease of a thing."""

CAMERA = Sensor(
    name="round things",
    modulation_frequency_hz=FREQUENCY_HZ,
    range_min_mm=300.0,
    range_max_mm=7000.0,
    projection=Pinhole(fx=FOCAL, fy=FOCAL, cx=(COLS - 1) / 2, cy=(ROWS - 1) / 2),
)

Floats = NDArray[np.float64]


class Hits(NamedTuple):
    """Range of each ray, mm, infinite where it misses, and the cosine of incidence."""

    range_mm: Floats
    cosine: Floats


Thing = Callable[[Floats], Hits]
"""A thing gives the hits of rays (..., 3)."""


@lru_cache(maxsize=2)
def rays_of(parts: int) -> Floats:
    """Unit vectors (row x parts, col x parts, 3) through the parts of all pixels; kept, and not to be changed."""
    steps = (np.arange(parts) + 0.5) / parts - 0.5
    x, y = (((np.arange(size)[:, np.newaxis] + steps).ravel() - (size - 1) / 2) / FOCAL for size in (COLS, ROWS))
    ways = np.stack(np.broadcast_arrays(x[np.newaxis], y[:, np.newaxis], 1.0), axis=-1)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    ways.flags.writeable = False
    return np.asarray(ways)


def wall(distance_mm: float, normal: tuple[float, float, float] = (0.0, 0.0, 1.0), left_of_mm: float = np.inf) -> Thing:
    """A plane through (0, 0, distance), as far as x is less than a limit."""
    unit = np.array(normal) / np.linalg.norm(normal)

    def hits(rays: Floats) -> Hits:
        facing = rays @ unit
        t = unit[2] * distance_mm / facing
        seen = (t > 0) & (t * rays[..., 0] < left_of_mm)
        return Hits(np.where(seen, t, np.inf), np.abs(facing))

    return hits


def sphere(centre_mm: tuple[float, float, float], radius_mm: float) -> Thing:
    centre = np.array(centre_mm)

    def hits(rays: Floats) -> Hits:
        along = rays @ centre
        inside = along**2 - (centre @ centre - radius_mm**2)
        t = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), np.inf)
        normal = (rays * np.where(np.isfinite(t), t, 0)[..., np.newaxis] - centre) / radius_mm
        return Hits(t, np.abs((normal * rays).sum(axis=-1)))

    return hits


def cylinder(x_mm: float, z_mm: float, radius_mm: float, top_mm: float = -np.inf, bottom_mm: float = np.inf) -> Thing:
    """An upright cylinder; y points down."""

    def hits(rays: Floats) -> Hits:
        a = rays[..., 0] ** 2 + rays[..., 2] ** 2
        along = rays[..., 0] * x_mm + rays[..., 2] * z_mm
        inside = along**2 - a * (x_mm**2 + z_mm**2 - radius_mm**2)
        t = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        point = rays * np.where(np.isfinite(t), t, 0)[..., np.newaxis]
        t = np.where((point[..., 1] > top_mm) & (point[..., 1] < bottom_mm), t, np.inf)
        normal = np.stack([point[..., 0] - x_mm, 0 * a, point[..., 2] - z_mm], axis=-1) / radius_mm
        return Hits(t, np.abs((normal * rays).sum(axis=-1)))

    return hits


def nothing() -> Thing:
    """Open space: no ray hits it, and no light comes back."""
    return lambda rays: Hits(np.full(rays.shape[:-1], np.inf), np.zeros(rays.shape[:-1]))


def joined(*parts: Thing) -> Thing:
    """One thing of several parts."""

    def hits(rays: Floats) -> Hits:
        found = [part(rays) for part in parts]
        t = np.stack([one.range_mm for one in found])
        first = t.argmin(axis=0)[np.newaxis]
        return Hits(t.min(axis=0), np.take_along_axis(np.stack([one.cosine for one in found]), first, axis=0)[0])

    return hits


def capsule(x_mm: float, z_mm: float, radius_mm: float, top_mm: float, bottom_mm: float) -> Thing:
    """An upright cylinder with round ends."""
    return tilted_capsule((x_mm, top_mm, z_mm), (x_mm, bottom_mm, z_mm), radius_mm)


def tilted_capsule(one_mm: tuple[float, float, float], other_mm: tuple[float, float, float], radius_mm: float) -> Thing:
    """A cylinder with round ends, between the middles of these."""
    start, end = np.array(one_mm), np.array(other_mm)
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length

    def hits(rays: Floats) -> Hits:
        across, foot = rays - (rays @ axis)[..., np.newaxis] * axis, start - (start @ axis) * axis
        a = (across**2).sum(axis=-1)
        along = across @ foot
        inside = along**2 - a * (foot @ foot - radius_mm**2)
        t = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / np.maximum(a, 1e-12), np.inf)
        point = rays * np.where(np.isfinite(t), t, 0)[..., np.newaxis] - start
        place = point @ axis
        t = np.where((place > 0) & (place < length), t, np.inf)
        normal = (point - place[..., np.newaxis] * axis) / radius_mm
        return Hits(t, np.abs((normal * rays).sum(axis=-1)))

    return joined(hits, sphere(one_mm, radius_mm), sphere(other_mm, radius_mm))


def ellipsoid(centre_mm: tuple[float, float, float], axes_mm: tuple[float, float, float], roll: float = 0.0) -> Thing:
    """An ellipsoid; its first two axes are rolled about the third one, z (radians)."""
    turn = np.array([[np.cos(roll), np.sin(roll), 0.0], [-np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]])
    shrink = turn / np.array(axes_mm)[:, np.newaxis]  # to a unit sphere

    def hits(rays: Floats) -> Hits:
        way, middle = rays @ shrink.T, shrink @ np.array(centre_mm)
        a, along = (way**2).sum(axis=-1), way @ middle
        inside = along**2 - a * (middle @ middle - 1.0)
        t = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        normal = (way * np.where(np.isfinite(t), t, 0)[..., np.newaxis] - middle) @ shrink
        return Hits(t, np.abs((normal * rays).sum(axis=-1)) / np.maximum(np.linalg.norm(normal, axis=-1), 1e-12))

    return hits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A recording and its truth."""

    recording: tm.Recording
    """Samples."""
    share: Floats
    range_mm: Floats
    """(thing, row, col) float64. `share`, `range_mm`: share of the parts of a pixel that see each thing, and their mean
    range; NaN without any."""
    noise: NoiseCurve
    """As it was drawn: sigma is inversely proportional to amplitude."""


def render(
    things: Sequence[Thing],
    reflectivity: Sequence[float],
    *,
    noise_mm: float,
    frames: int = 100,
    seed: int = 1,
    power: float = 1.0,
    texture: float = 0.0,
    threshold: float = 0.0,
) -> Scene:
    """Record things, the wall first.

    `things`: the first one fills the image, or is `nothing`; then noise is that of a wall at `WALL_MM`.
    `reflectivity`: of each.
    `noise_mm`: standard deviation of a sample's range in the wall's middle.
    `frames`, `seed`: number of samples, and seed of the noise.
    `power`: light goes with this power of the cosine of incidence.
    `texture`: standard deviation of the logarithm of light from pixel to pixel.
    `threshold`: amplitude below which a sample is without return, in standard deviations of noise.
    """
    draw = np.random.default_rng(seed)
    phasor, share, truth = _seen(things, reflectivity, power, _of_pixels(INNER_PARTS))
    mixed = (share.max(axis=0) < 1.0).reshape(ROWS, COLS)
    limb = ndimage.binary_dilation(mixed, np.ones((3, 3), np.bool_)).ravel()
    phasor[limb], share[:, limb], truth[:, limb] = _seen(things, reflectivity, power, _of_pixels(PARTS)[limb])
    share, truth = (one.reshape(-1, ROWS, COLS) for one in (share, truth))
    phasor = phasor.reshape(ROWS, COLS) * np.exp(texture * draw.standard_normal((ROWS, COLS)))
    nearest = float(things[0](rays_of(1)).range_mm.min())
    truth[0] = truth[0] if np.isfinite(nearest) else np.nan
    nearest = nearest if np.isfinite(nearest) else WALL_MM
    middle = 1000.0 * reflectivity[0] * (1000.0 / nearest) ** 2
    size = noise_mm / SCALE_MM * middle
    noise = draw.standard_normal((2, frames, ROWS, COLS)) * size
    samples = phasor + noise[0] + 1j * noise[1]
    range_mm = np.where(np.abs(samples) > threshold * size, (SCALE_MM * np.angle(samples)) % CIRCLE_MM, np.nan)
    return Scene(
        recording=tm.from_array(range_mm, units="mm", sensor=CAMERA, amplitude=np.abs(samples)),
        share=share,
        range_mm=truth,
        noise=NoiseCurve(
            np.array([nearest]),
            np.array([noise_mm]),
            law=AmplitudeLaw(np.array([middle]), middle * np.array([0.01, 100.0]), np.array([100.0, 0.01])),
        ),
    )


def _pooled(parts: NDArray[np.number]) -> NDArray[np.complex128]:
    return np.asarray(parts.reshape(ROWS, PARTS, COLS, PARTS).mean(axis=(1, 3)), dtype=np.complex128)


def _of_pixels(parts: int) -> Floats:
    """Unit vectors (pixel, part, 3)."""
    rays = rays_of(parts).reshape(ROWS, parts, COLS, parts, 3).swapaxes(1, 2)
    return rays.reshape(ROWS * COLS, parts * parts, 3)


def _seen(
    things: Sequence[Thing], reflectivity: Sequence[float], power: float, rays: Floats
) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """Mean phasor (pixel), and share and mean range of each thing (thing, pixel) by rays (pixel, part, 3)."""
    t, cosine = (np.stack(part) for part in zip(*(thing(rays) for thing in things), strict=True))
    near = t.argmin(axis=0)
    seen_mm = np.take_along_axis(t, near[np.newaxis], axis=0)[0]
    facing = np.take_along_axis(cosine, near[np.newaxis], axis=0)[0]
    light = 1000.0 * np.array(reflectivity)[near] * facing**power * (1000.0 / seen_mm) ** 2
    seen_mm = np.where(np.isfinite(seen_mm), seen_mm, 0.0)
    sees = near == np.arange(len(things))[:, np.newaxis, np.newaxis]
    share = sees.mean(axis=-1)
    mean_mm = (sees * seen_mm).mean(axis=-1) / np.maximum(share, 1e-9)
    return (light * np.exp(1j * seen_mm / SCALE_MM)).mean(axis=-1), share, np.where(share > 0, mean_mm, np.nan)


class Cast(NamedTuple):
    """What pixels see: share, mean range and that weighed by light (thing, row, col), mm; share of nothing (row, col).

    NaN where a pixel does not see a thing.
    """

    share: Floats
    range_mm: Floats
    lit_mm: Floats
    nothing: Floats


def cast(things: Sequence[Thing]) -> Cast:
    """Cast things without light and noise; the last scenes are kept."""
    return _cast(tuple(things))


@lru_cache(maxsize=4)
def _cast(things: tuple[Thing, ...]) -> Cast:
    t, cosine = (np.stack(part) for part in zip(*(thing(rays_of(PARTS)) for thing in things), strict=True))
    near, open_space = t.argmin(axis=0), ~np.isfinite(t.min(axis=0))
    share, ranges, lit = [], [], []
    for number in range(len(things)):
        seen = (near == number) & ~open_space
        range_mm = np.where(seen, t[number], 1.0)
        light = np.where(seen, cosine[number] / range_mm**2, 0.0)
        share.append(_pooled(seen * 1.0).real)
        with np.errstate(invalid="ignore", divide="ignore"):
            ranges.append(_pooled(seen * range_mm).real / share[-1])
            lit.append(_pooled(light * range_mm).real / _pooled(light).real)
    return Cast(np.stack(share), np.stack(ranges), np.stack(lit), np.asarray(_pooled(open_space * 1.0).real))


def counted(things: Sequence[Thing], *, stderr_mm: float, seed: int = 1, samples: int = 2000) -> Layers:
    """Layers as an estimator finds them that knows the thing of each sample: counts, and mean ranges with errors."""
    draw = np.random.default_rng(seed)
    seen = cast(things)
    sigma = stderr_mm * np.sqrt(samples)
    return counted_layers(seen.share, seen.lit_mm, seen.nothing, lambda _: sigma, samples=samples, rng=draw)


def thing_at(things: Sequence[Thing], row: Floats, col: Floats) -> NDArray[np.int64]:
    """Thing that is nearest at places (n,) of the image, pixels."""
    ways = np.stack([(col - (COLS - 1) / 2) / FOCAL, (row - (ROWS - 1) / 2) / FOCAL, np.ones_like(row)], axis=-1)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    return np.asarray(np.stack([thing(ways).range_mm for thing in things]).argmin(axis=0))


def edge_distances(things: Sequence[Thing], row: Floats, col: Floats, *, reach: float = 1.5) -> Floats:
    """Distance (n,), pixels, of places from the nearest place of another thing; infinite beyond `reach`.

    The nearest place on circles around each, then halved towards it.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    out = np.full(len(row), np.inf)
    own = thing_at(things, row, col)
    for radius in np.linspace(0.02, reach, 75):
        down, right = radius * np.sin(turn), radius * np.cos(turn)
        other = thing_at(things, row[:, np.newaxis] + down, col[:, np.newaxis] + right) != own[:, np.newaxis]
        for k in np.flatnonzero(np.isinf(out) & other.any(axis=1)):
            way = float(np.angle(np.exp(1j * turn[other[k]]).sum()))
            low, high = 0.0, radius
            for _ in range(20):
                middle = 0.5 * (low + high)
                place = row[k : k + 1] + middle * np.sin(way), col[k : k + 1] + middle * np.cos(way)
                low, high = (middle, high) if thing_at(things, *place)[0] == own[k] else (low, middle)
            out[k] = high
    return out


@dataclass(slots=True, kw_only=True)
class Score:
    """Counts of pixels, and the squares of errors over stated ones."""

    mixed: int = 0
    both: int = 0
    undecided: int = 0
    ranges: int = 0
    ranges_within: int = 0
    shares_within: int = 0
    share_square: float = 0.0
    single: int = 0
    split: int = 0
    flying: int = 0

    def __iadd__(self, other: "Score") -> Self:
        for name in self.__dataclass_fields__:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self


def score(scene: Scene, layers: Layers, *, least_share: float = 0.1, least_mm: float = 30.0) -> Score:
    """Compare layers (row, col) with the truth.

    A mixed pixel has two things of `least_share` and more; open space is one. Both are found if two layers of
    probability above 0.5, or the one before open space, lie within 5 stated errors, or `least_mm`. A layer flies if its
    probability is above 0.5, and nothing is within twice that of it.
    """
    result = Score()
    order = np.argsort(-scene.share, axis=0)
    mixing = np.zeros(layers.shape) if layers.mixing is None else layers.mixing
    for row, col in np.ndindex(*layers.shape):
        share, truth = scene.share[:, row, col], scene.range_mm[:, row, col]
        count = int(layers.n_modes[row, col])
        sure = layers.probability[row, col, :count] > 0.5
        place, error = layers.range[row, col, :count], layers.range_stderr[row, col, :count]
        there = truth[(share > 0) & np.isfinite(truth)]
        away = np.abs(place[:, np.newaxis] - there).min(axis=1, initial=np.inf)
        result.flying += int((sure & (away > np.maximum(5.0 * error, 2.0 * least_mm))).sum())
        if share.max() > 0.999:
            result.single += 1
            result.split += int(sure.sum() > 1)
        first, second = order[:2, row, col]
        if share[second] <= least_share or share[first] + share[second] < 0.999:
            continue
        result.mixed += 1
        result.undecided += int(mixing[row, col] == 3)
        pair = sorted((number for number in (first, second) if np.isfinite(truth[number])), key=truth.__getitem__)
        if count != len(pair) or not sure.all():
            continue
        off = place - truth[pair]
        if (np.abs(off) > np.maximum(5.0 * error, least_mm)).any():
            continue
        result.both += 1
        result.ranges += len(pair)
        result.ranges_within += int((np.abs(off) < 2.0 * error).sum())
        share_off = layers.weight[row, col, 0] - share[pair[0]]
        result.shares_within += int(abs(share_off) < 2.0 * layers.weight_stderr[row, col, 0])
        result.share_square += float(share_off**2)
    return result


SCENES: dict[str, tuple[list[Thing], list[float]]] = {
    "sphere and cylinder": (
        [wall(3000), sphere((-350, 0, 1800), 220), cylinder(420, 1900, 130)],
        [0.5, 0.8, 0.7],
    ),
    "sphere of 60 mm at 1 m": ([wall(2500), sphere((-60, 30, 1000), 60)], [0.5, 0.8]),
    "sphere of 150 mm at 1 m": ([wall(2500), sphere((-100, 0, 1000), 150)], [0.5, 0.8]),
    "sphere and cylinder at 2.5 m": (
        [wall(4500), sphere((-300, 0, 2500), 300), cylinder(400, 2300, 200)],
        [0.5, 0.8, 0.7],
    ),
    "sphere of 500 mm at 4 m": ([wall(6000), sphere((-400, 0, 4000), 500)], [0.5, 0.8]),
    "person": (
        [wall(4000), joined(capsule(100, 2200, 180, -250, 900), sphere((100, -560, 2200), 120))],
        [0.5, 0.7],
    ),
    "two columns": ([wall(3500), cylinder(-420, 2000, 160), cylinder(380, 2300, 120)], [0.5, 0.7, 0.6]),
    "sphere before sphere": (
        [wall(4500), sphere((250, 0, 2700), 500), sphere((-150, 0, 1700), 220)],
        [0.5, 0.6, 0.8],
    ),
    "slanted wall": ([wall(4000), wall(1800, (0.6, 0.0, 0.8), 206)], [0.5, 0.8]),
    "creased wall and sphere": (
        [joined(wall(3600, (0.5, 0.0, 0.87)), wall(3600, (-0.5, 0.0, 0.87))), sphere((100, 0, 1700), 200)],
        [0.5, 0.8],
    ),
    "capsules": (
        [
            wall(3500),
            tilted_capsule((-500, -250, 2000), (-250, 300, 1900), 120),
            tilted_capsule((150, -100, 2200), (550, 200, 1900), 150),
        ],
        [0.5, 0.7, 0.8],
    ),
    "capsule on its side": ([wall(4000), tilted_capsule((-350, 60, 2300), (300, -60, 2000), 200)], [0.5, 0.7]),
    "ellipsoid": ([wall(3400), ellipsoid((50, 0, 1800), (360, 150, 220), 0.6)], [0.5, 0.7]),
}
"""Things and their reflectivities, the wall first."""

OPEN_SCENES: dict[str, tuple[list[Thing], list[float]]] = {
    "sphere and cylinder": ([nothing(), sphere((-350, 0, 1800), 220), cylinder(420, 1900, 130)], [0.5, 0.8, 0.7]),
    "person": ([nothing(), joined(capsule(100, 2200, 180, -250, 900), sphere((100, -560, 2200), 120))], [0.5, 0.7]),
    "sphere at a wall's end": ([nothing(), wall(3000, left_of_mm=100), sphere((60, 0, 1700), 250)], [0.5, 0.5, 0.8]),
}
"""Things before open space, which is first."""
