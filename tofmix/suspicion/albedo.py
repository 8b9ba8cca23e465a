"""Evidence that several suspicions use: the brightness of surfaces, and which of two shapes their ranges have.

What surfaces return: A r^2, the brightness of a layer, and how it spreads over the surfaces of a scene.

The amplitude of a surface falls with r^2, so that A r^2 is its albedo, times the cosine of incidence. Each surface of a
scene is one draw: its pixels share their albedo. Surfaces are parts of the image whose neighbours agree in range and
amplitude.

Which of two shapes a set of ranges has: evidence for suspicions that amplitudes alone do not settle.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.segments import components
from tofmix.suspicion.frame_kinds import NOISE_SIGMAS
from tofmix.suspicion.scene import WindowScene

PLANE_NUMBERS = 3
"""Free numbers of a plane."""

MOST_EVIDENCE = math.log(1000.0)
"""Most that shapes tell, nat: one surface in a thousand has a shape by chance that another hypothesis predicts."""


def plane_misfit_mm(range_mm: FloatArray, directions: FloatArray) -> float:
    """Root mean square distance, mm along the beams, of ranges (n,) from the plane 1/r = m . d through them.

    `directions` (n, 3) are the unit vectors of the beams.
    """
    weights = (range_mm**2)[:, np.newaxis]
    plane, *_ = np.linalg.lstsq(directions * weights, range_mm, rcond=None)
    return rms((directions @ plane) * range_mm**2 - range_mm)


def evidence_nats(misfit: float, other: float, error: float, free: int) -> float:
    """Evidence, nat, for the first of two shapes, from their misfits.

    Parameters
    ----------
    misfit, other : float
        Root mean square misfit of each shape, as parts of the range.
    error : float
        Root mean square standard error of the ranges, likewise: neither shape fits better.
    free : int
        Ranges less the free numbers of the shape that has more of them.
    """
    squares = [max(value**2, error**2) for value in (misfit, other)]
    if free <= 0 or not 0.0 < squares[0] < math.inf or not 0.0 < squares[1] < math.inf:
        return 0.0
    # free numbers of a smooth shape: more pixels tell no more
    evidence = 0.5 * min(6.0, free) * math.log(squares[1] / squares[0])
    return min(max(evidence, -MOST_EVIDENCE), MOST_EVIDENCE)


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return math.sqrt(float(np.mean(values**2)))


ALBEDO_SPREAD = math.log(0.9 / 0.15) / math.sqrt(12.0)
"""Expected standard deviation of the log of albedos: uniform in the logarithm from 0.15 to 0.9, as of most materials
in the near infrared."""

PRIOR_SURFACES = 20.0
"""How many surfaces' worth of knowledge `ALBEDO_SPREAD` is; a scene of many surfaces has its own spread."""

_RANGE_STEP, _LIGHT_STEP = 0.1, 0.5  # between neighbours of one surface: of the range, and in the log of the amplitude


class AlbedoLaw(NamedTuple):
    """Predictive distribution of the log brightness of one more surface: Student's t.

    References
    ----------
    Gelman et al., Bayesian Data Analysis, 3rd ed., section 3.3: a normal distribution with a conjugate prior of its
    variance and none of its mean.
    """

    mean: float
    scale: float
    freedom: float

    @classmethod
    def of(cls, log_brightness: FloatArray) -> Self:
        """From the log brightness (n,) of the surfaces of a scene, one at least."""
        count, mean = len(log_brightness), float(log_brightness.mean())
        freedom = PRIOR_SURFACES + count - 1.0
        variance = (PRIOR_SURFACES * ALBEDO_SPREAD**2 + ((log_brightness - mean) ** 2).sum()) / freedom
        return cls(mean, math.sqrt(variance * (1.0 + 1.0 / count)), freedom)

    def darker(self, log_brightness: FloatArray) -> FloatArray:
        """Probability of a surface at most as bright as each."""
        from scipy.special import stdtr  # slow to import, and most scenes need none

        return np.asarray(stdtr(self.freedom, (log_brightness - self.mean) / self.scale))


def log_evidence(log_brightness: FloatArray) -> float:
    """Log of the marginal likelihood of surfaces (n,), nat, but for what depends on n alone."""
    squares = ((log_brightness - log_brightness.mean()) ** 2).sum()
    freedom = PRIOR_SURFACES + len(log_brightness) - 1.0
    return float(-0.5 * freedom * np.log(PRIOR_SURFACES * ALBEDO_SPREAD**2 + squares))


class Surfaces(NamedTuple):
    """Layers of a window by surface.

    Parameters
    ----------
    row, col, layer : (n,) int
        The layers with an amplitude.
    part : (n,) int
        Surface of each, in the order of `log_brightness`; -1 where it is too small for one.
    log_brightness : (surface,) float64
        Median of the log of A r^2.
    """

    row: IntArray
    col: IntArray
    layer: IntArray
    part: IntArray
    log_brightness: FloatArray


def log_brightness(scene: WindowScene) -> FloatArray:
    """Log of A r^2 (row, col, layer), r in mm; NaN where the amplitude is not known or not above 0."""
    if scene.amplitude is None:
        return np.full(scene.range_mm.shape, np.nan)
    lit = (scene.amplitude > 0) & (scene.range_mm > 0)
    return np.log(np.where(lit, scene.amplitude * scene.range_mm**2, np.nan))


def find_surfaces(scene: WindowScene, bright: FloatArray) -> Surfaces:
    """Join layers of neighbouring pixels into surfaces.

    Parameters
    ----------
    scene : Scene
        The window; it has amplitudes.
    bright : (row, col, layer) float64
        `log_brightness`.
    """
    known = np.isfinite(bright)
    row, col, layer = np.nonzero(known)
    index = np.full(known.shape, -1)
    index[known] = np.arange(len(row))
    light = bright - 2.0 * np.log(np.where(known, scene.range_mm, 1.0))
    one, other = [], []
    for near, far in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        a, b = scene.range_mm[near][..., :, np.newaxis], scene.range_mm[far][..., np.newaxis, :]
        noise = 3.0 * np.hypot(scene.stderr_mm[near][..., :, np.newaxis], scene.stderr_mm[far][..., np.newaxis, :])
        dark = np.abs(light[near][..., :, np.newaxis] - light[far][..., np.newaxis, :])
        with np.errstate(invalid="ignore"):
            joined = (np.abs(a - b) <= _RANGE_STEP * np.minimum(a, b) + noise) & (dark <= _LIGHT_STEP)
        r, c, i, j = np.nonzero(joined)
        one.append(index[near][r, c, i])
        other.append(index[far][r, c, j])
    part = components(np.concatenate(one), np.concatenate(other), len(row))
    return _surfaces(row, col, layer, part, bright[known])


def _surfaces(row: IntArray, col: IntArray, layer: IntArray, part: IntArray, bright: FloatArray) -> Surfaces:
    size = np.bincount(part)
    least = 4  # pixels of a draw of an albedo: fewer may be mixed, or false
    large = np.flatnonzero(size >= least)
    number = np.full(len(size), -1)
    number[large] = np.arange(len(large))
    part = number[part]
    return Surfaces(row, col, layer, part, medians(bright, part, len(large)))


def join_painted(scene: WindowScene, surfaces: Surfaces) -> Surfaces:
    """Join surfaces that continue each other in range along most of their border: one thing in several paints.

    Its brightness is the median of all its layers.
    """
    count = len(surfaces.log_brightness)
    shape = scene.range_mm.shape
    part = np.full(shape, -1)
    part[surfaces.row, surfaces.col, surfaces.layer] = surfaces.part
    pairs = []
    for axis in (0, 1):
        numbers, ranges, errors = (np.swapaxes(each, 0, axis) for each in (part, scene.range_mm, scene.stderr_mm))
        pairs.append(_border(numbers, ranges, errors, _pitch(scene)))
    one, other, continued = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    border, of_pair = np.unique(np.minimum(one, other) * count + np.maximum(one, other), return_inverse=True)
    all_pairs, agreeing = (
        np.bincount(of_pair, minlength=len(border)),
        np.bincount(of_pair[continued], minlength=len(border)),
    )
    least = 4  # pairs of pixels of a border: fewer may agree by chance
    joined = border[(agreeing >= least) & (2 * agreeing > all_pairs)]
    thing = components(joined // count, joined % count, count) if count else np.zeros(0, np.int64)
    numbers, thing = np.unique(thing, return_inverse=True)
    of_layer = np.where(surfaces.part >= 0, np.append(thing, -1)[surfaces.part], -1)
    bright = log_brightness(scene)[surfaces.row, surfaces.col, surfaces.layer]
    return Surfaces(surfaces.row, surfaces.col, surfaces.layer, of_layer, medians(bright, of_layer, len(numbers)))


def _pitch(scene: WindowScene) -> float:
    """Angle between the beams of neighbouring pixels, radians."""
    unknown = 0.005  # 0.3 degrees, of a camera whose view is not known
    if scene.directions is None or min(scene.directions.shape[:2]) < 2:  # noqa: PLR2004  no neighbour
        return unknown
    return float(np.median(np.linalg.norm(np.diff(scene.directions, axis=1), axis=-1)))


def _border(
    part: IntArray, range_mm: FloatArray, stderr_mm: FloatArray, pitch: float
) -> tuple[IntArray, IntArray, BoolArray]:
    """Parts (n,) and (n,) of layers whose pixels follow each other along the first axis, and whether ranges go on.

    All arrays are (place, place across, layer). Ranges go on if the step between the pixels is that of one of the two
    surfaces beside it, within noise and a quarter of a pixel's width: the slope of what bends changes by 14 degrees.
    """
    steps = np.full((2, *part.shape), np.nan)  # within the same part, to each layer from the pixel before and after
    for near in range(part.shape[2]):
        for far in range(part.shape[2]):
            same = (part[:-1, :, near] == part[1:, :, far]) & (part[1:, :, far] >= 0)
            step = range_mm[1:, :, far] - range_mm[:-1, :, near]
            steps[0, 1:, :, far] = np.where(same, step, steps[0, 1:, :, far])
            steps[1, :-1, :, near] = np.where(same, step, steps[1, :-1, :, near])
    steps = np.nan_to_num(steps)  # a part that is one pixel wide tells no slope
    place, across, i, j = np.nonzero(
        (part[:-1, :, :, np.newaxis] >= 0)
        & (part[1:, :, np.newaxis] >= 0)
        & (part[:-1, :, :, np.newaxis] != part[1:, :, np.newaxis])
    )
    one, other = (place, across, i), (place + 1, across, j)
    gap = range_mm[other] - range_mm[one]
    off = np.minimum(np.abs(gap - steps[0][one]), np.abs(gap - steps[1][other]))
    # a gap and a step are of four ranges
    noise = NOISE_SIGMAS * math.sqrt(2.0) * np.hypot(stderr_mm[one], stderr_mm[other])
    return part[one], part[other], off <= noise + 0.25 * pitch * range_mm[one]


def medians(values: FloatArray, part: IntArray, count: int) -> FloatArray:
    """Median (count,) of the values (n,) of each part (n,); parts below 0 are left out."""
    order = np.lexsort((values, part))
    values, part = values[order], part[order]
    first = np.searchsorted(part, np.arange(count))
    last = np.searchsorted(part, np.arange(count), side="right")
    return values[(first + last - 1) // 2] if count else np.zeros(0)


def chosen(surfaces: Surfaces, of_surface: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """Layers (row, col, layer) of the surfaces (surface,) that are chosen."""
    out = np.zeros(shape, bool)
    picked = (surfaces.part >= 0) & np.append(of_surface, False)[surfaces.part]
    out[surfaces.row[picked], surfaces.col[picked], surfaces.layer[picked]] = True
    return out
