"""The surfaces of each pixel of an image, in rounds: from pixels that certainly see one surface, towards the edges.

1. Pixels that are not certain are judged by the certain ones around them.
2. Pixels that no nearby surface explains may see a large surface from elsewhere, or a thin one: pixels that agree with
   their neighbours. Those join, and all is judged again.
3. Once more where pixels joined or left surfaces, as the ends of chords are better known there; and again as long as
   narrow surfaces are found by the mixtures beside them, at most as often.

A pair of equal mixed pixels along a straight edge looks like a thin surface. So a surface one pixel wide may be an end
of a chord, but never continues itself.

Planes, or surfaces that bend? What the pixels around say, where few of them see a surface alone.

Planes explain a pixel of a finger or a pole by chance: two surfaces where there is one, or one where there are two.
There are two models of the surfaces around a pixel: planes, and surfaces that bend like a circle of a few pixels, whose
continuation has an error that grows with distance (`tofmix.unmixing.hypotheses.judge`). The evidence of all pixels
around adds up, and the likelier model labels the pixel.

Use it after the planes' last round. Surfaces of six pixels and more are fitted better by `tofmix.unmixing.curved`.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.segments import near, sum_around
from tofmix.unmixing.hypotheses import judge
from tofmix.unmixing.image import ComplexArray, PhasorImage
from tofmix.unmixing.likeliest import ENDS, Kind, LikeliestHypotheses, OpenSpace
from tofmix.unmixing.lines import Mixtures, agree, find_lines, is_bounded
from tofmix.unmixing.neighbours import DistantPlane, distant_planes
from tofmix.unmixing.seeds import Seeds, find_seeds
from tofmix.unmixing.settings import DEFAULT_SETTINGS, LabelSettings, UnmixSettings
from tofmix.unmixing.surface_fit import Members

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
    most_log = 500.0  # largest exponent
    bends[area] = 1.0 / (1.0 + np.exp(np.clip(log_odds[area], -most_log, most_log)))
    return Surroundings(gain, bends)


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


_BLOCK = 1 << 13
"""Pixels that are judged at once: their surfaces take some 10 MB."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Labels:
    """The hypothesis of each pixel. Arrays are (pixel,) or (pixel, ENDS), as in `Findings`.

    Parameters
    ----------
    kind : int64
        `Kind`; UNKNOWN where the pixel has no mean phasor.
    probability, range_mm, range_variance, share, share_variance, is_known, is_fresh, chord, scatter, log_density
        As in `Findings`.
    is_surface : bool
        Whether the pixel is known to see one surface: certain, continued, or new in a block of 2 x 2 that agree.
    planes_gain : float64
        Log evidence of planes over surfaces that bend (`tofmix.unmixing.labels`), nat.
    bends : bool
        Whether the label is that of surfaces that bend.
    seeds : Seeds
        Fixed pattern and texture.
    """

    kind: IntArray
    probability: FloatArray
    range_mm: FloatArray
    range_variance: FloatArray
    share: FloatArray
    share_variance: FloatArray
    is_known: BoolArray
    is_fresh: BoolArray
    chord: ComplexArray
    scatter: FloatArray
    log_density: FloatArray
    is_surface: BoolArray
    planes_gain: FloatArray
    bends: BoolArray
    seeds: Seeds


_ENDS = ("range_mm", "range_variance", "share", "share_variance")
_FIELDS = (*_ENDS, "kind", "probability", "is_known", "is_fresh", "chord", "scatter", "log_density", "log_evidence")


def label(image: PhasorImage, settings: UnmixSettings = DEFAULT_SETTINGS) -> Labels:
    """Label the pixels of an image."""
    seeds, spaces = find_seeds(image, settings.seeds), open_spaces(image, settings.labels)
    line = find_lines(image, seeds, None, settings.labels, settings.neighbours.reach)
    is_line = line >= 0
    alone = seeds.certain | is_line
    doubtful = np.flatnonzero(image.valid & ~alone)
    member = seeds.has_plane | is_line
    members = Members(
        is_member=member,
        has_plane=seeds.has_plane,
        has_light=alone,
        is_known=member,
        is_trusted=member,
        is_fresh=np.zeros(image.count, bool),
        plane=seeds.plane,
        middle=seeds.middle,
        line=line,
    )
    sure = judged_by = members
    planes: tuple[DistantPlane, ...] = ()
    kind = np.where(alone, int(Kind.CONTINUED), int(Kind.UNKNOWN))
    count = image.count
    arrays: dict[str, NDArray[Any]] = {
        "kind": kind,
        "probability": np.where(alone, 1.0, 0.0),
        "is_known": np.ones(count, bool),
        "is_fresh": np.zeros(count, bool),
        "chord": np.zeros(count, np.complex128),
        "scatter": np.zeros(count),
        "log_density": np.full(count, np.nan),
        "log_evidence": np.zeros(count),
        **{name: np.full((count, ENDS), np.nan) for name in _ENDS},
    }
    plane, is_distant = np.zeros((count, 3)), np.zeros(count, bool)
    square = np.zeros(count, bool)
    pixels = doubtful if alone.any() else doubtful[:0]
    for number in range(2 * settings.labels.rounds):
        for start in range(0, pixels.size, _BLOCK):
            block = pixels[start : start + _BLOCK]
            found = judge(image, block, members, seeds, planes, spaces, settings.hypotheses, settings.neighbours)
            plane[block], is_distant[block] = found.plane, found.is_distant
            for name in _FIELDS:
                arrays[name][block] = getattr(found, name)
        if not pixels.size:
            break
        before = judged_by = members
        is_mixed = np.isin(arrays["kind"], (Kind.PAIR, Kind.TRIPLE))
        mixtures = Mixtures(is_mixed=is_mixed, **{name: arrays[name] for name in _ENDS})
        line = find_lines(image, seeds, mixtures, settings.labels, settings.neighbours.reach)
        is_last = number + 1 >= settings.labels.rounds and bool(np.all(is_line == (line >= 0)))
        is_line = line >= 0
        bounded = is_bounded(image, seeds, mixtures, arrays["kind"] == Kind.NEW, settings.labels)
        members, square = _next_members(image, seeds, line, bounded, arrays["kind"], plane, is_distant, settings.labels)
        if number == 0:  # the large planes are tried from the second round on, in all pixels
            planes = distant_planes(image, seeds, line, settings.planes)
        else:
            pixels = doubtful[_near_changes(before, members, image.shape, settings.neighbours.reach)[doubtful]]
        if is_last:
            break
    kind = arrays["kind"]
    kind[(line >= 0) & (kind == Kind.NEW)] = Kind.CONTINUED
    around = weigh_planes(
        image,
        kind,
        arrays["probability"],
        arrays["log_evidence"],
        doubtful if alone.any() else doubtful[:0],
        judged_by,
        seeds,
        planes,
        spaces,
        settings,
    )
    bent = _put_bent(
        image, arrays, np.flatnonzero(image.valid & ~seeds.certain), around.bends, sure, seeds, planes, spaces, settings
    )
    is_surface = (
        seeds.certain
        | ((line >= 0) & ~bent)
        | np.isin(kind, (Kind.CONTINUED, Kind.OTHER_REFLECTANCE))
        | ((kind == Kind.NEW) & square & ~bent)
    )
    arrays.pop("log_evidence")
    return Labels(**arrays, is_surface=is_surface, planes_gain=around.gain, bends=bent, seeds=seeds)


def _put_bent(
    image: PhasorImage,
    arrays: "dict[str, NDArray[Any]]",
    uncertain: IntArray,
    bends: FloatArray,
    sure: Members,
    seeds: Seeds,
    planes: tuple[DistantPlane, ...],
    spaces: tuple[OpenSpace, ...],
    settings: UnmixSettings,
) -> BoolArray:
    """Put the labels of surfaces that bend over those of planes, where they are likelier: in the mask (pixel,)."""
    bent = np.zeros(image.count, bool)
    pixels = uncertain[bends[uncertain] > 0.0]
    if not pixels.size:
        return bent
    found = judge_bending(image, pixels, sure, seeds, planes, spaces, settings)
    probability = mixed_probability(
        bends[pixels], arrays["probability"][pixels], found.probability, arrays["kind"][pixels] == found.kind
    )
    likelier = bends[pixels] > 0.5  # noqa: PLR2004  than planes
    for name in _FIELDS:
        arrays[name][pixels[likelier]] = getattr(found, name)[likelier]
    arrays["probability"][pixels] = probability
    bent[pixels[likelier]] = True
    return bent


def open_spaces(image: PhasorImage, settings: LabelSettings) -> tuple[OpenSpace, ...]:
    """Pixels that may see open space, and its possible returns: nothing, or the return of pixels of open space.

    Where samples are lost below some amplitude, pixels of open space have a few samples, each of noise alone: their
    means scatter by that noise. What is beyond it is the scatter of the return from pixel to pixel.
    """
    nearby = near(image.open_space.reshape(image.shape), settings.open_reach).ravel()
    if not nearby.any():
        return ()
    own = image.open_space & (image.samples > 0)
    seen = image.phasor[own]
    if len(seen) < settings.least_open:
        return (OpenSpace(nearby=nearby, phasor=0.0, variance=0.0, scatter=0.0),)
    middle = complex(np.median(seen.real), np.median(seen.imag))
    total = float(np.median(np.abs(seen - middle))) ** 2 / (2.0 * math.log(2.0))  # the median of a Gaussian's radius
    samples = image.samples[own]
    several = samples > 1
    free = 2.0 * (samples[several] - 1.0)
    median = (1.0 - 2.0 / (9.0 * free)) ** 3  # of chi-squared over its degrees of freedom (Wilson and Hilferty)
    within = 0.5 * (image.covariance[own, 0] + image.covariance[own, 1])[several] / median
    scatter = float(np.median(within)) if within.size >= settings.least_open else total * float(np.median(samples))
    between = max(total - scatter * float(np.median(1.0 / samples)), 0.0)
    return (
        OpenSpace(nearby=nearby, phasor=0.0, variance=0.0, scatter=scatter),
        OpenSpace(nearby=nearby, phasor=middle, variance=between, scatter=scatter),
    )


def _next_members(
    image: PhasorImage,
    seeds: Seeds,
    line: IntArray,
    bounded: BoolArray,
    kind: IntArray,
    plane: FloatArray,
    is_distant: BoolArray,
    settings: LabelSettings,
) -> tuple[Members, BoolArray]:
    """Settle who is a member in the next round, and which new pixels agree in blocks of 2 x 2 and are bounded."""
    continued = np.isin(kind, (Kind.CONTINUED, Kind.OTHER_REFLECTANCE))
    kept = seeds.has_plane & continued
    joined = (kind == Kind.CONTINUED) & ~kept & (line < 0)
    fresh = kind == Kind.NEW
    agrees, square = _agreeing(image, seeds, fresh, settings)
    square &= bounded
    is_line = line >= 0
    is_known = kept | joined | (fresh & square) | is_line
    next_members = Members(
        is_member=kept | joined | (fresh & agrees) | is_line,
        has_plane=kept | joined,
        has_light=seeds.certain | (kind == Kind.CONTINUED) | (fresh & agrees),
        is_known=is_known,
        is_trusted=kept | (joined & is_distant) | (fresh & square) | is_line,
        is_fresh=fresh & square,
        plane=np.where(joined[:, np.newaxis], plane, seeds.plane),
        middle=np.where(joined, np.arange(image.count), seeds.middle),
        line=line,
    )
    return next_members, square


def _near_changes(before: Members, after: Members, shape: tuple[int, int], reach: int) -> BoolArray:
    """Pixels (pixel,) whose neighbourhood has changed: the others keep their hypothesis."""
    changed = np.zeros(len(before.middle), bool)
    for old, new in zip(before, after, strict=True):
        differs = old != new
        changed |= differs if differs.ndim == 1 else differs.any(axis=1)
    changed &= before.is_member | after.is_member
    return near(changed.reshape(shape), reach).ravel()


def _agreeing(
    image: PhasorImage, seeds: Seeds, mask: BoolArray, settings: LabelSettings
) -> tuple[BoolArray, BoolArray]:
    """Which pixels of a mask agree with a neighbour in it, and which do so in blocks of 2 x 2."""
    index = np.arange(image.count).reshape(image.shape)

    def agreeing(one: IntArray, other: IntArray) -> BoolArray:
        return mask[one] & mask[other] & agree(image, seeds, one, other, settings)

    across, below = agreeing(index[:, :-1], index[:, 1:]), agreeing(index[:-1], index[1:])
    any_, square = np.zeros(image.shape, bool), np.zeros(image.shape, bool)
    any_[:, :-1] |= across
    any_[:, 1:] |= across
    any_[:-1] |= below
    any_[1:] |= below
    block = across[:-1] & across[1:] & below[:, :-1] & below[:, 1:]
    rows, cols = block.shape
    for i in (0, 1):
        for j in (0, 1):
            square[i : i + rows, j : j + cols] |= block
    return any_.ravel(), square.ravel()
