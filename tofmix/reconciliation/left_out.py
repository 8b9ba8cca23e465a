"""Which pixels of a measured scene are left out, because they see something that the scene does not have.

A surface that comes nearer or recedes leaves the sight of some pixels, and hides what others see: a zone of a drone's
sensor that sees the wall at first sees the floor later. No motion of the surface explains the samples of such a pixel.
So each pixel either follows its surface to the end, or from some frame on it sees something else, at any range. Pixels
that see something else are left out and counted, and what moves is named by those that follow.

Where something new stands, or something has gone, pixels see it in all frames. No effect of a camera moves the samples
of a part of the image far away, with an edge, and leaves the same surface elsewhere as it was. The pixels of such a
part and of its edge are left out, and the part is told.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation, label
from scipy.stats import norm

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.comparison.compare import SMALLEST_P, Place
from tofmix.reconciliation.evidence import LEAST_PIXELS, ChangedPart, Evidence
from tofmix.reconciliation.likelihood.joint import RecordingView, joint_likelihood, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import plane_distance
from tofmix.reconciliation.likelihood.unsteady_way import PARTS
from tofmix.reconciliation.parameters.searches import ranges_to, search_facts
from tofmix.reconciliation.verification.missing_surface import has_edge, unpredicted
from tofmix.simulation.effects.search import SearchFacts
from tofmix.simulation.model import Model


def without_changes(model: Model, evidence: Evidence) -> tuple[Model, Evidence]:
    """A measured scene and a recording without the pixels that see something new, or see what was hidden.

    Nothing changes where such pixels are more than half of those with light.

    Parameters
    ----------
    model : Model
        With a measured scene, or as given.
    evidence : Evidence
        One recording.
    """
    if model.scene is None:
        return model, evidence
    view, _ = _view(model, evidence)
    if len(view.mixture.weight) > 1:  # where the scene moves, what is new is told by no mean
        return model, evidence
    parts, out = _changed(view)
    lit = view.mixture.lit[0].any(axis=0)
    if not parts or 2 * (out & lit).sum() > lit.sum():
        return model, evidence
    return _without(model, replace(evidence, changed=parts), out)


def _view(model: Model, evidence: Evidence) -> tuple[RecordingView, Likelihood]:
    """A whole recording beside the prediction of its model."""
    likelihood = joint_likelihood([(model, evidence)])
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    (view,) = views(likelihood, likelihood.scene.mixture(), whole)
    return view, likelihood


def places(changed: Sequence[ChangedPart]) -> list[Place]:
    """Rows and columns of the parts that have changed; where no surface was before, samples are valid now."""
    out = []
    for part in changed:
        moved = part.moved_mm
        statistic, size, unit = ("invalid", -1.0, "1") if moved is None else ("bias", moved, "mm")
        for axis, interval in (("row", part.rows), ("col", part.cols)):
            first, last = (float(edge) for edge in interval)
            place = Place(
                axis=axis,
                statistic=statistic,
                interval=(first, last),
                size=size,
                unit=unit,
                p_value=SMALLEST_P,
                z=math.sqrt(-2.0 * math.log(SMALLEST_P)),
            )
            out.append(place)
    return out


def _without(model: Model, evidence: Evidence, out: BoolArray) -> tuple[Model, Evidence]:
    if model.scene is None:
        raise TypeError("pixels are left out of a measured scene")
    samples = np.where(out, 0, evidence.samples).astype(evidence.samples.dtype)
    scene = replace(model.scene, lost=np.where(out.reshape(model.scene.shape), 1.0, model.scene.lost))
    return replace(model, scene=scene), replace(evidence, samples=samples)


def _changed(view: RecordingView) -> tuple[tuple[ChangedPart, ...], BoolArray]:
    """The parts of the image that have changed, and their pixels (pixel,) with those of their edges."""
    m, image, surfaces = view.mixture, view.evidence.image, view.scene.model.surfaces
    reach, mostly, least = 10.0, 0.5, 4  # sigma; of a pixel's samples, and of all frames; pixels of a part
    nearly_all = 0.8  # of the pixels of a surface that stands where it stood
    share, range_mm = unpredicted(view, reach)
    seen = (view.evidence.samples > 0).mean(axis=0) > mostly
    other, out = seen & (share > mostly), np.zeros(seen.size, dtype=np.bool_)
    main = np.where(m.of_main(m.lit), m.of_main(m.surface), -1)
    as_before = np.where(main >= 0, _as_before(view, reach), ~seen)
    near = binary_dilation(other.reshape(image)).ravel()
    of_each = ((number, as_before[(main == number) & ~near]) for number in range(-1, len(surfaces) + 1))
    stands = [number for number, own in of_each if own.size >= LEAST_PIXELS and own.mean() >= nearly_all]
    new = other & np.isin(main, stands)
    before = np.where(main >= 0, m.of_main(m.mean), np.nan)
    gone = np.zeros(seen.size, dtype=np.bool_)
    hidden = seen & ~as_before & ~np.isin(main, stands)
    for number in (k for k in stands if 0 <= k < len(surfaces)):  # what stands behind a surface that does not
        behind = ranges_to(surfaces[number], view.scene.beams)
        far = 0.5 * reach * m.of_main(m.sigma) * np.maximum(behind / before, 1.0)
        on = (np.abs(range_mm - behind) < far) | (share < 1 - mostly)  # or it was seen in the same pixel
        gone |= hidden & on & (behind > before)
    found = []
    medians = _medians(view.evidence)
    square = np.ones((3, 3), dtype=np.bool_)
    unseen = ~(view.evidence.samples > 0).any(axis=0).reshape(image)
    for appears, own in ((True, new.reshape(image)), (False, gone.reshape(image))):
        joined = own | (unseen & binary_dilation(own, structure=square))  # pixels of an edge may not be known
        numbered, parts = label(joined, structure=square)
        for number in range(1, parts + 1):
            pixels = own & (numbered == number)
            if pixels.sum() < least or not (has_edge(view, pixels) or not appears):
                continue
            inside = pixels.ravel()
            of = np.unique(main[inside])
            names = [surfaces[k].name for k in of if 0 <= k < len(surfaces)]
            rows, cols = (np.flatnonzero(pixels.any(axis=axis)) for axis in (1, 0))
            found.append(
                ChangedPart(
                    is_new=appears,
                    surfaces=tuple(names),
                    rows=(int(rows[0]), int(rows[-1])),
                    cols=(int(cols[0]), int(cols[-1])),
                    pixels=int(inside.sum()),
                    range_mm=float(np.nanmedian(medians[inside])),
                    before_mm=float(np.nanmedian(before[inside])) if np.isfinite(before[inside]).any() else None,
                )
            )
            out |= binary_dilation(numbered == number, structure=square).ravel()
    return tuple(found), out


def _medians(evidence: Evidence) -> FloatArray:
    """Median (pixel,) of the valid samples, mm; NaN without any."""
    out = np.full(evidence.shape[1], np.nan)
    for own in _blocks(evidence):
        samples = np.where(evidence.samples[:, own] > 0, evidence.samples[:, own], np.nan)
        told = np.isfinite(samples).any(axis=0)
        out[own[told]] = np.nanmedian(samples[:, told], axis=0)
    return out


def _blocks(evidence: Evidence) -> list[IntArray]:
    """Pixels in blocks of few samples: copies of all samples of a long recording would take gigabytes."""
    frames, pixels = evidence.shape
    most = 4_000_000  # samples
    return np.array_split(np.arange(pixels), max(1, frames * pixels // most))


def _as_before(view: RecordingView, reach: float) -> BoolArray:
    """Whether each pixel (pixel,) still sees its main surface, within `reach` sigma, in half as many samples."""
    m, mean = view.mixture, view.mixture.of_main(view.mixture.mean)
    limit, share = reach * m.of_main(m.sigma), np.zeros(mean.size)
    for own in _blocks(view.evidence):
        samples = view.evidence.samples[:, own]
        near = (samples > 0) & (np.abs(m.near_turn(samples - mean[own])) < limit[own])
        share[own] = near.sum(axis=0) / np.maximum((samples > 0).sum(axis=0), 1)
    weight = m.of_main(m.weight) / np.maximum(m.weight[0].sum(axis=0), 1e-9)
    return np.asarray(share > 0.5 * weight)


def without_others(model: Model, evidence: Evidence) -> tuple[Model, Evidence]:
    """A measured scene and a recording without the pixels that do not follow what moves far.

    Nothing changes where nothing moves far, or where fewer than half of the pixels of what moves follow it, or fewer
    than a plane needs.

    Parameters
    ----------
    model : Model
        With a measured scene, or as given.
    evidence : Evidence
        One recording.
    """
    if model.scene is None:
        return model, evidence
    view, likelihood = _view(model, evidence)
    mixture = view.mixture
    speed = _speeds(view, search_facts(likelihood, likelihood.scene.mixture()))
    moving = speed != 0
    if not moving.any():
        return model, evidence
    others = np.zeros(speed.size, dtype=np.bool_)
    lit = mixture.of_main(mixture.lit).astype(bool)
    others[lit] = _leave(view, speed, lit)  # what stands still may be hidden by what moves
    plane_points = 3  # which a plane needs
    follow = int((moving & ~others).sum())
    if not others.any() or 2 * follow < moving.sum() or follow < plane_points:
        return model, evidence
    return _without(model, replace(evidence, others=others), others)


def _speeds(view: RecordingView, facts: SearchFacts) -> FloatArray:
    """Speeds (pixel,) along the beams of surfaces that move far, mm/s; 0 of others, and of those that moved at once."""
    m, time_s = view.mixture, view.evidence.time_s
    lit, number = m.of_main(m.lit).astype(bool), m.of_main(m.surface)
    speed = np.zeros(lit.size)
    for seen in facts.surfaces:
        if not facts.goes_far(seen):
            continue
        own = lit & (number == view.scene.names.index(seen.name))
        along = m.of_main(m.mean)[own] / plane_distance(seen.surface)
        at_once = np.full((time_s.size, int(own.sum())), seen.residual_mm)
        moving = _log_density(view, own, time_s[:, None] * seen.speed_mm_s * along)
        if moving.sum() > _log_density(view, own, at_once).sum():
            speed[own] = seen.speed_mm_s * along
    return speed


def _log_density(view: RecordingView, pixels: BoolArray, way_mm: FloatArray) -> FloatArray:
    """Log density (frame, pixel) of samples of pixels whose surface goes a way, uneven or not; 0 if invalid."""
    m, rare = view.mixture, 0.01  # share of random values
    samples = view.evidence.samples[:, pixels].astype(np.float64)
    mean, sigma = m.of_main(m.mean)[pixels], m.of_main(m.sigma)[pixels]
    uneven = np.hypot(PARTS[-1], PARTS[-1]) * np.abs(way_mm)
    scale = np.hypot(sigma * np.maximum((mean + way_mm) / mean, 1.0), uneven)
    off = m.near_turn(samples - mean - way_mm)
    density = np.log((1.0 - rare) * norm.pdf(off, scale=scale) + rare / _longest(view))
    return np.where(samples > 0, density, 0.0)


def _longest(view: RecordingView) -> float:
    return max(view.mixture.high - view.mixture.low, float(view.evidence.samples.max()))


def _leave(view: RecordingView, speed: FloatArray, lit: BoolArray) -> BoolArray:
    """Whether each of the lit pixels sees something else from some frame on, by its likelihood."""
    rare = 0.01  # share of pixels that leave
    samples, time_s = view.evidence.samples[:, lit], view.evidence.time_s
    follows = _log_density(view, lit, time_s[:, None] * speed[lit])
    gain = np.where(samples > 0, -np.log(_longest(view)) - follows, 0.0)
    from_frame = np.cumsum(gain[::-1], axis=0).max(axis=0)
    return np.asarray(from_frame > np.log(len(time_s)) - np.log(rare))
