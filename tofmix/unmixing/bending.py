"""Planes, or surfaces that bend? What the pixels around say, where few of them see a surface alone.

Planes explain a pixel of a finger or a pole by chance: two surfaces where there is one, or one where there are two.
There are two models of the surfaces around a pixel: planes, and surfaces that bend like a circle of a few pixels, whose
continuation has an error that grows with distance (`tofmix.unmixing.hypotheses.judge`). The evidence of all pixels
around adds up, and the likelier model labels the pixel.

Use it after the planes' last round. Surfaces of six pixels and more are fitted better by `tofmix.unmixing.curved`.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.masks import near, sum_around
from tofmix.unmixing.distant import DistantPlane
from tofmix.unmixing.hypotheses import Kind, LikeliestHypotheses, OpenSpace, judge
from tofmix.unmixing.image import PhasorImage
from tofmix.unmixing.seeds import Seeds
from tofmix.unmixing.settings import UnmixSettings
from tofmix.unmixing.surface_fit import Members

LOG_ODDS_OF_PLANES = math.log(100.0)
"""Logarithm of the prior odds that the surfaces around a pixel are planes: things are made of walls and boards."""


class Surroundings(NamedTuple):
    """What the models say. Arrays are (pixel,).

    Parameters
    ----------
    gain : float64
        Log evidence of planes over surfaces that bend, of each pixel alone, nat; 0 where planes explain all around.
    bends : float64
        Probability that the surfaces around bend.
    """

    gain: FloatArray
    bends: FloatArray


def weigh_planes(
    image: PhasorImage,
    kind: IntArray,
    probability: FloatArray,
    log_evidence: FloatArray,
    doubtful: IntArray,
    members: Members,
    seeds: Seeds,
    planes: tuple[DistantPlane, ...],
    spaces: tuple[OpenSpace, ...],
    settings: UnmixSettings,
) -> Surroundings:
    """Weigh both models around each pixel.

    Parameters
    ----------
    image : PhasorImage
        The window.
    kind, probability, log_evidence : (pixel,)
        What planes say: the most probable kind, its probability, and the log evidence of all hypotheses.
    doubtful : (n,) int64
        The pixels that they were judged in.
    members, seeds, planes, spaces
        As `tofmix.unmixing.hypotheses.judge` takes them.
    settings : UnmixSettings
        Thresholds.

    Returns
    -------
    Surroundings
        Of all pixels. Planes that explain all pixels around leave no doubt, so nothing is weighed there.
    """
    reach, shape = settings.neighbours.reach, image.shape
    gain, bends = np.zeros(image.count), np.zeros(image.count)
    vague = np.zeros(image.count, bool)
    vague[doubtful] = (kind[doubtful] == Kind.NEW) | (probability[doubtful] < settings.hypotheses.likely)
    pixels = doubtful[near(vague.reshape(shape), 2 * reach).ravel()[doubtful]]
    if not pixels.size:
        return Surroundings(gain, bends)
    found = judge(image, pixels, members, seeds, planes, spaces, settings.hypotheses, settings.neighbours, bends=True)
    gain[pixels] = log_evidence[pixels] - found.log_evidence
    log_odds = LOG_ODDS_OF_PLANES + sum_around(gain.reshape(shape), reach).ravel()
    area = near(vague.reshape(shape), reach).ravel()
    bends[area] = 1.0 / (1.0 + np.exp(np.clip(log_odds[area], -_MOST_LOG, _MOST_LOG)))
    return Surroundings(gain, bends)


_MOST_LOG = 500.0
"""Largest exponent."""


def judge_bending(
    image: PhasorImage,
    pixels: IntArray,
    members: Members,
    seeds: Seeds,
    planes: tuple[DistantPlane, ...],
    spaces: tuple[OpenSpace, ...],
    settings: UnmixSettings,
) -> LikeliestHypotheses:
    """Judge pixels (n,) beside surfaces that bend, from the pixels that were sure before any were judged by planes.

    Here large surfaces are flat. In `weigh_planes` they bend as all others do, so that what they alone explain does not
    speak for things that bend.
    """
    near_sure = settings.neighbours._replace(beside=2)
    return judge(
        image,
        pixels,
        members,
        seeds,
        planes,
        spaces,
        settings.hypotheses,
        near_sure,
        bends=True,
        flat=planes,
        unseen=settings.hypotheses.unseen,
    )


def mixed_probability(bends: FloatArray, planes: FloatArray, bent: FloatArray, same: BoolArray) -> FloatArray:
    """Probability (n,) of the likelier model's label, of both models' where these agree (`same`)."""
    own = np.where(bends > 0.5, bends * bent, (1.0 - bends) * planes)  # noqa: PLR2004  the likelier
    other = np.where(bends > 0.5, (1.0 - bends) * planes, bends * bent)  # noqa: PLR2004
    return np.asarray(own + np.where(same, other, 0.0))
