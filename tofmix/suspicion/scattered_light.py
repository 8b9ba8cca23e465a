"""Scattered light: a layer at the range of a bright surface elsewhere in the image, and far too dark for a surface.

Light of a bright thing that scatters within the lens takes the same time, so that other pixels see a layer at its
range. A real surface of that brightness is possible, but improbable by the albedos of the scene; and over many pixels
it would be flat, where scattered light has one range.
"""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.image.segments import count_around
from tofmix.suspicion.albedo import (
    PLANE_NUMBERS,
    AlbedoLaw,
    evidence_nats,
    find_surfaces,
    log_brightness,
    plane_misfit_mm,
    rms,
)
from tofmix.suspicion.frame_kinds import NOISE_SIGMAS
from tofmix.suspicion.scene import FALSE_MARKS, Suspicion, WindowScene


def mark_scattered(scene: WindowScene) -> BoolArray:
    """Layers (row, col, layer) that are scattered light.

    A surface is marked with the probability `FALSE_MARKS` at most, that of its albedo by the law of the scene's others.
    """
    marked = np.zeros(scene.range_mm.shape, bool)
    bright = log_brightness(scene)
    known = np.isfinite(bright)
    if scene.amplitude is None or not known.any():
        return marked
    light = np.where(known, scene.amplitude, 0.0)
    dimmest = light[known].min()
    surfaces = None
    most_sources = 4  # bright things that are looked at, from the brightest on
    slope = 0.1  # how much ranges of one surface differ between neighbouring pixels, of the range
    most_scattered = 0.05  # most of a bright thing's light that a pixel elsewhere gets of it
    for _ in range(most_sources):
        source = np.unravel_index(int(light.argmax()), light.shape)
        if light[source] * most_scattered < dimmest:
            break
        surfaces = surfaces or find_surfaces(scene, bright)
        at_range = known & _agrees(scene, source)
        own = at_range[surfaces.row, surfaces.col, surfaces.layer]
        others = np.setdiff1d(surfaces.part[~own], surfaces.part[own])
        others = others[others >= 0]
        if len(others):
            law = AlbedoLaw.of(surfaces.log_brightness[others])
            candidates = at_range & (scene.amplitude <= most_scattered * scene.amplitude[source])
            improbable = _improbable(scene, candidates, bright, law, source)
            with np.errstate(invalid="ignore"):
                close = np.abs(scene.range_mm / scene.range_mm[source] - 1.0) <= slope
            marked |= _without_rims(scene.amplitude, known & close, improbable)
        light = np.where(at_range, 0.0, light)
    return marked


def _agrees(scene: WindowScene, source: tuple[np.intp, ...]) -> BoolArray:
    """Layers (row, col, layer) at the range of a source, or that one of their samples may be of.

    Layers that noise joins to one of them count too: a split layer has parts beside the range of the source.
    """
    error = NOISE_SIGMAS * np.maximum(np.hypot(scene.stderr_mm, scene.stderr_mm[source]), scene.sigma_mm)
    with np.errstate(invalid="ignore"):
        agrees = np.asarray(np.abs(scene.range_mm - scene.range_mm[source]) <= error)
    joined = scene.joined
    for layer in range(1, agrees.shape[-1]):
        agrees[..., layer] |= joined[..., layer - 1] & agrees[..., layer - 1]
    for layer in range(agrees.shape[-1] - 2, -1, -1):
        agrees[..., layer] |= joined[..., layer] & agrees[..., layer + 1]
    return agrees


def _improbable(
    scene: WindowScene, candidates: BoolArray, bright: FloatArray, law: AlbedoLaw, source: tuple[np.intp, ...]
) -> BoolArray:
    """The candidates that are improbable as a surface."""
    if not candidates.any():
        return candidates
    shape = 0.0
    if scene.directions is not None:
        row, col, layer = np.nonzero(candidates)
        range_mm, stderr = scene.range_mm[row, col, layer], scene.stderr_mm[row, col, layer]
        flat = plane_misfit_mm(range_mm, scene.directions[row, col])
        common = scene.range_mm[source]
        even = rms(range_mm - common)
        shape = evidence_nats(even / common, flat / common, rms(stderr) / common, len(row) - PLANE_NUMBERS)
    return np.asarray(candidates & (law.darker(bright) * np.exp(-shape) <= FALSE_MARKS))


def _without_rims(amplitude: FloatArray, close: BoolArray, improbable: BoolArray) -> BoolArray:
    """The improbable layers without those that may be the rim of a surface, which fills a part of their pixel.

    Beside a surface at about that range (`close`), a layer is scattered light only if it is no brighter than elsewhere.
    """
    beside = count_around(np.asarray((close & ~improbable).any(-1)), 1) > 0
    apart = improbable & ~beside[..., np.newaxis]
    brighter_beside = 2.0  # times, that scattered light may be brighter beside the bright thing than elsewhere
    most = brighter_beside * np.where(apart, amplitude, -np.inf).max(initial=-np.inf)
    return np.asarray(improbable & (apart | (amplitude <= most)))


SCATTERED_LIGHT = Suspicion(
    name="scattered_light",
    flag=1,
    short="scattered light",
    meaning="far too dark for a surface, at the range of a bright one elsewhere in the image",
    mark=mark_scattered,
)
