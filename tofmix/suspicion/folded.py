"""Folded: a surface beyond the unambiguous range, whose range is one turn too short.

A surface at r + d_u that a phase shows at r returns (r / (r + d_u))^2 of what it would at r. The sets of surfaces that
may be folded are compared by the evidence of their albedos: one set explains the brightness of the others better. Where
the camera's view is known, so do shapes: unfolded, a wall is a plane; a dark thing that is near is one as it is. What
continues a surface is as far as it: dark paint on a wall is no fold.
"""

import math

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.image.segments import around, count_around
from tofmix.suspicion.albedo import (
    PLANE_NUMBERS,
    AlbedoLaw,
    Surfaces,
    chosen,
    evidence_nats,
    find_surfaces,
    join_painted,
    log_brightness,
    log_evidence,
    plane_misfit_mm,
    rms,
)
from tofmix.suspicion.scene import FALSE_MARKS, Suspicion, WindowScene

_BESIDE = 0.2  # a layer beside a folded surface within this share of its range is of it


def mark_folded(scene: WindowScene) -> BoolArray:
    """Layers (row, col, layer) whose amplitude says that they are one turn farther.

    The prior odds of a fold are `FALSE_MARKS`, of each further folded surface even ones: by Markov's inequality, a
    scene without a fold has a mark with no more than this probability.
    """
    nothing = np.zeros(scene.range_mm.shape, bool)
    if scene.amplitude is None or scene.turn_mm is None or not (scene.range_mm < scene.turn_mm).any():
        return nothing
    bright = log_brightness(scene)
    known = bright[np.isfinite(bright)]
    beyond = scene.present & (scene.range_mm > scene.turn_mm + 3.0 * scene.sigma_mm)
    # A camera that shows ranges past the turn knows the turn.
    if beyond.sum() > FALSE_MARKS * scene.present.sum() or not len(known):
        return nothing
    low, high = np.quantile(known, (0.01, 0.99))
    least_contrast = 1.0  # log of the ratio of brightnesses below which no set of surfaces can have enough evidence
    if high - low < least_contrast:
        return nothing
    surfaces = join_painted(scene, find_surfaces(scene, bright))
    folded = _folded_surfaces(scene, surfaces, scene.turn_mm)
    if not folded.any():
        return nothing
    marked = chosen(surfaces, folded, nothing.shape)
    return marked | _beside(scene, marked, bright, AlbedoLaw.of(surfaces.log_brightness[~folded]))


def _folded_surfaces(scene: WindowScene, surfaces: Surfaces, turn_mm: float) -> BoolArray:
    """Which surfaces (surface,) are folded: the set with the most evidence, grown one by one."""
    count = len(surfaces.log_brightness)
    folded = np.zeros(count, bool)
    sizes = np.bincount(surfaces.part[surfaces.part >= 0], minlength=count)
    largest = np.argsort(-sizes, kind="stable")[:24]  # further ones cost time, and are small
    if len(largest) < 2:  # noqa: PLR2004  nothing to compare it with
        return folded
    bright = surfaces.log_brightness[largest]
    gains, shapes = (np.zeros(len(largest)) for _ in range(2))
    for index, number in enumerate(largest.tolist()):
        gains[index], shapes[index] = _gain_and_shape(scene, surfaces, number, turn_mm)
    best, best_evidence, current = np.zeros(len(largest), bool), 0.0, np.zeros(len(largest), bool)
    as_it_is = log_evidence(bright)
    for step in range(len(largest) - 1):
        trials = []
        for place in np.flatnonzero(~current):
            trial = current.copy()
            trial[place] = True
            trials.append((log_evidence(bright + trial * gains) + shapes[trial].sum(), trial))
        evidence, current = max(trials, key=lambda pair: pair[0])
        evidence += math.log(FALSE_MARKS) - step * math.log(2.0) - as_it_is
        if evidence > best_evidence and _fits(bright + current * gains, current):
            best, best_evidence = current, evidence
    folded[largest] = best
    return folded


def _fits(bright: FloatArray, folded: BoolArray) -> bool:
    """Whether the folded surfaces, one turn farther, are as bright as the others."""
    chance = AlbedoLaw.of(bright[~folded]).darker(bright[folded])
    return bool((np.minimum(chance, 1.0 - chance) > 0.01).all())  # noqa: PLR2004  a hundredth on each side


def _gain_and_shape(scene: WindowScene, surfaces: Surfaces, number: int, turn_mm: float) -> tuple[float, float]:
    """How much brighter a surface is one turn farther, in the log, and the evidence of its shape for that, nat."""
    part = surfaces.part == number
    place = surfaces.row[part], surfaces.col[part], surfaces.layer[part]
    range_mm = scene.range_mm[place]
    gain = 2.0 * float(np.median(np.log((range_mm + turn_mm) / range_mm)))
    if scene.directions is None:
        return gain, 0.0
    beams = scene.directions[place[:2]]
    middle = float(np.median(range_mm))
    near, far = (plane_misfit_mm(range_mm + turn, beams) / (middle + turn) for turn in (0.0, turn_mm))
    error = rms(scene.stderr_mm[place]) / middle
    return gain, evidence_nats(far, near, error, len(range_mm) - PLANE_NUMBERS)


def _beside(scene: WindowScene, marked: BoolArray, bright: FloatArray, law: AlbedoLaw) -> BoolArray:
    """Layers at the rim of folded surfaces: beside one, at its range, and as improbable as it is."""
    pixels = np.asarray(marked.any(-1))
    low = np.where(marked, scene.range_mm, np.inf).min(-1)
    high = np.where(marked, scene.range_mm, -np.inf).max(-1)
    found = marked.copy()
    for _ in range(2):  # rims are mixed pixels, two wide at most
        beside = count_around(pixels, 1) > 0
        least, most = around(low, np.minimum), around(high, np.maximum)
        at_range = (scene.range_mm >= (least * (1.0 - _BESIDE))[..., np.newaxis]) & (
            scene.range_mm <= (most * (1.0 + _BESIDE))[..., np.newaxis]
        )
        dark = ~(law.darker(bright) > 0.05)  # noqa: PLR2004  of layers at the range of a folded surface beside them
        found |= beside[..., np.newaxis] & at_range & dark
        pixels = np.asarray(found.any(-1))
        low, high = np.minimum(low, np.where(pixels, least, low)), np.maximum(high, np.where(pixels, most, high))
    return found


FOLDED = Suspicion(
    name="folded",
    flag=2,
    short="folded by a turn",
    meaning="the amplitude says that the surface is one turn of the wrapped range farther away",
    mark=mark_folded,
)
