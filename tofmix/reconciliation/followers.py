"""Which pixels follow a surface that moves far.

A surface that comes nearer or recedes leaves the sight of some pixels, and hides what others see: a zone of a drone's
sensor that sees the wall at first sees the floor later. No motion of the surface explains the samples of such a pixel.
So each pixel either follows its surface to the end, or from some frame on it sees something else, at any range. Pixels
that see something else are left out and counted, and what moves is named by those that follow.
"""

from dataclasses import replace

import numpy as np
from scipy.stats import norm

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import RecordingView, joint_likelihood, views
from tofmix.reconciliation.likelihood.mixture import plane_distance
from tofmix.reconciliation.likelihood.unsteady_way import PARTS
from tofmix.reconciliation.parameters.searches import search_facts
from tofmix.simulation.effects.search import SearchFacts
from tofmix.simulation.model import Model


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
    likelihood = joint_likelihood([(model, evidence)])
    mixture = likelihood.scene.mixture()
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    (view,) = views(likelihood, mixture, whole)
    speed = _speeds(view, search_facts(likelihood, mixture))
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
    samples = np.where(others, 0, evidence.samples).astype(evidence.samples.dtype)
    scene = replace(model.scene, lost=np.where(others.reshape(model.scene.shape), 1.0, model.scene.lost))
    return replace(model, scene=scene), replace(evidence, samples=samples, others=others)


def _speeds(view: RecordingView, facts: SearchFacts) -> FloatArray:
    """Speeds (pixel,) along the beams of surfaces that move far, mm/s; 0 of others."""
    m = view.mixture
    lit, number = m.of_main(m.lit).astype(bool), m.of_main(m.surface)
    speed = np.zeros(lit.size)
    for seen in facts.surfaces:
        if facts.goes_far(seen):
            own = lit & (number == view.scene.names.index(seen.name))
            speed[own] = seen.speed_mm_s * m.of_main(m.mean)[own] / plane_distance(seen.surface)
    return speed


def _leave(view: RecordingView, speed: FloatArray, lit: BoolArray) -> BoolArray:
    """Whether each of the lit pixels sees something else from some frame on, by its likelihood."""
    m, rare = view.mixture, 0.01  # share of random values, and of pixels that leave
    samples, time_s = view.evidence.samples[:, lit].astype(np.float64), view.evidence.time_s
    mean, sigma = m.of_main(m.mean)[lit], m.of_main(m.sigma)[lit]
    way = time_s[:, None] * speed[lit]
    uneven = np.hypot(PARTS[-1], PARTS[-1]) * np.abs(way)
    scale = np.hypot(sigma * np.maximum((mean + way) / mean, 1.0), uneven)
    off = m.near_turn(samples - mean - way)
    longest = max(m.high - m.low, float(samples.max()))
    follows = np.log((1.0 - rare) * norm.pdf(off, scale=scale) + rare / longest)
    gain = np.where(samples > 0, -np.log(longest) - follows, 0.0)
    from_frame = np.cumsum(gain[::-1], axis=0).max(axis=0)
    return np.asarray(from_frame > np.log(len(time_s)) - np.log(rare))
