"""Labels beside surfaces that bend: in rounds, from the pixels that surely see one surface towards the limbs.

Planes label the image first (`tofmix.unmixing.labels`). Here segments of smooth surfaces are found. Where all of them
are planes, nothing changes. Around a segment that bends, pixels are judged anew: those that a surface fills join it,
and the next round sees farther. Mixed pixels are what is left.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.scales import BENDS, THIRDS, Scales, learn_scales, may_bend
from tofmix.image.segments import LEAST_PIXELS, REACH, View, near, rim_of, segments_of
from tofmix.unmixing.curved import Bent, Verdicts, judge_bent
from tofmix.unmixing.functions import ndtr
from tofmix.unmixing.image import ComplexArray, PhasorImage, polar_covariance, variance_along
from tofmix.unmixing.labels import LOG_ODDS_OF_PLANES, Labels, open_spaces
from tofmix.unmixing.likeliest import Kind, OpenSpace
from tofmix.unmixing.seeds import without_creases
from tofmix.unmixing.settings import DEFAULT_SETTINGS, CurvedSettings, UnmixSettings


def label_curved(image: PhasorImage, labels: Labels, settings: UnmixSettings = DEFAULT_SETTINGS) -> Labels:
    """Label the pixels beside surfaces that bend.

    Parameters
    ----------
    image : PhasorImage
        The window.
    labels : Labels
        By planes.
    settings : UnmixSettings
        Thresholds; those of `curved`, `seeds` and `hypotheses` count.

    Returns
    -------
    Labels
        The same object where planes explain all pixels, or nothing bends.
    """
    # Before open space a plane explains any pixel by its share alone: that does not say that nothing bends.
    beside_open = image.valid & np.isinf(labels.range_mm).any(axis=1) & (labels.kind != Kind.EMPTY)
    doubtful_pixels = _undecided(image, labels, settings.curved) | labels.bends | beside_open
    if not settings.curved.rounds or not doubtful_pixels.any():
        return labels
    view = view_of(image, labels)
    segment = segments_of(view)
    count = int(segment.max()) + 1
    beside = segment[near(doubtful_pixels.reshape(image.shape), REACH).ravel()]
    doubtful = np.unique(beside[beside >= 0])
    unexplained = _beside_bent(segment, labels.planes_gain, image.shape, doubtful)
    asked = np.arange(count) if unexplained.any() else doubtful
    bends, tells = may_bend(view, segment, asked, REACH)  # an eighth of the work that the scales take
    if not bends.any() and tells[doubtful[unexplained]].all():
        return labels
    scales = learn_scales(view, segment, np.arange(count), REACH)
    known = scales.is_known() & ~scales.is_flat()
    bent = known.copy()
    bent[doubtful[unexplained]] |= ~scales.is_known()[doubtful[unexplained]]
    if not bent.any():
        return labels
    # Of a thing that bends, a small part has too few pixels to tell; so has a small thing beside open space.
    vague = doubtful_pixels if known.any() else beside_open
    likewise = doubtful[_mostly(segment, vague, image.shape, doubtful)]
    bent[likewise] |= ~scales.is_known()[likewise]
    segment, scales, bent = _parted(image, view, labels, segment, scales, bent, settings)
    if not bent.any():
        return labels
    spaces = open_spaces(image, settings.labels)
    space = spaces[-1] if spaces else None
    segment, pixels, verdicts = _grown(image, view, segment, scales, bent, space, settings)
    return _merged(image, labels, segment, bent, space, pixels, verdicts, settings.curved)


def _parted(
    image: PhasorImage,
    view: View,
    labels: Labels,
    segment: IntArray,
    scales: Scales,
    bent: BoolArray,
    settings: UnmixSettings,
) -> tuple[IntArray, Scales, BoolArray]:
    """Segments, their scales, and which bend, with flat ones parted at creases: no patch goes round a corner.

    Two walls that meet seem to bend. A segment is one of walls if parts that do not bend have nearly all its pixels.
    """
    part, origin = without_creases(image, labels.seeds, segment, settings.seeds.different_sigmas)
    size = np.bincount(part[part >= 0], minlength=origin.size)
    least_wall = 36  # fewest pixels of a part that tell whether it bends: a window of 6 x 6
    large = np.flatnonzero(bent[origin] & (size >= least_wall))
    learnt = learn_scales(view, part, large, REACH)
    flat = large[learnt.is_known() & learnt.is_flat()]
    count = len(bent)
    pixels = np.bincount(segment[segment >= 0], minlength=count)
    # the rest of a segment lies at creases
    of_walls = np.bincount(origin[flat], weights=size[flat], minlength=count) > 0.8 * pixels
    parted = np.bincount(origin[large], minlength=count) > 1
    walls = bent & parted & of_walls
    bent = bent & ~walls
    scales = scales._replace(
        bend=np.where(walls, BENDS[0], scales.bend), third=np.where(walls, THIRDS[0], scales.third)
    )
    curved = np.flatnonzero(bent)
    place = np.full(count, -1)
    place[curved] = origin.size + np.arange(curved.size)
    whole = np.where((segment >= 0) & bent[segment], place[segment], part)
    origin = np.concatenate([origin, curved])
    few = np.bincount(whole[whole >= 0], minlength=origin.size) < LEAST_PIXELS
    whole = np.where((whole >= 0) & few[whole], -1, whole)
    kept = np.flatnonzero(np.bincount(whole[whole >= 0], minlength=origin.size) > 0)
    number = np.full(origin.size, -1)
    number[kept] = np.arange(kept.size)
    origin = origin[kept]
    return np.where(whole >= 0, number[whole], -1), Scales(*(scale[origin] for scale in scales)), bent[origin]


def _undecided(image: PhasorImage, labels: Labels, settings: CurvedSettings) -> BoolArray:
    """Pixels that no planes explain."""
    mixed = np.isin(labels.kind, (Kind.PAIR, Kind.TRIPLE, Kind.EMPTY)) & labels.is_known
    return image.valid & ~labels.is_surface & ~(mixed & (labels.probability > settings.decided))


def _mostly(segment: IntArray, mask: BoolArray, shape: tuple[int, int], numbers: IntArray) -> BoolArray:
    """Segments (m,) beside which a mask has more pixels than the segment."""
    return np.array(
        [
            (mask & near((segment == number).reshape(shape), REACH).ravel()).sum() > (segment == number).sum()
            for number in numbers.tolist()
        ],
        dtype=np.bool_,
    )


def _beside_bent(segment: IntArray, gain: FloatArray, shape: tuple[int, int], numbers: IntArray) -> BoolArray:
    """Segments (m,) beside which surfaces that bend explain the pixels better than planes do."""
    total = np.array(
        [gain[near((segment == number).reshape(shape), REACH).ravel()].sum() for number in numbers.tolist()]
    )
    return np.asarray(LOG_ODDS_OF_PLANES + total < 0.0)


def _beside(segment: IntArray, bent: BoolArray, shape: tuple[int, int], reach: int) -> BoolArray:
    """Which pixels (pixel,) have one of a segment that bends within `reach`."""
    return near(((segment >= 0) & bent[segment]).reshape(shape), reach).ravel()


def view_of(image: PhasorImage, labels: Labels) -> View:
    """The image as smooth surfaces take it."""
    return View(
        shape=image.shape,
        scale_mm=image.scale_mm,
        valid=image.valid,
        range_mm=image.range_mm,
        range_variance=image.range_variance + labels.seeds.pattern_variance,
        log_amplitude=np.log(np.where(image.valid, image.amplitude, 1.0)),
        amplitude_variance=image.light_variance + labels.seeds.texture_variance,
        pattern_variance=labels.seeds.pattern_variance,
        texture_variance=labels.seeds.texture_variance,
        direction=image.directions,
        right=image.across * image.pitch_across[:, np.newaxis],
        below=image.down * image.pitch_down[:, np.newaxis],
        pitch=image.pitch,
    )


class _Judged:
    """Verdicts on pixels, and the surroundings that each was judged in: a pixel is judged again when these change."""

    def __init__(self, image: PhasorImage, view: View, apart: float, space: OpenSpace | None) -> None:
        self._image, self._view, self._apart, self._space = image, view, apart, space
        self._around: dict[int, bytes] = {}
        self.verdict: dict[int, tuple[Any, ...]] = {}

    def judge(self, segment: IntArray, scales: Scales, pixels: IntArray) -> IntArray:
        """Judge what has not been judged in these surroundings; the pixels that were."""
        grid = segment.reshape(self._view.shape)
        fresh = []
        for pixel in pixels.tolist():
            row, col = divmod(pixel, self._view.shape[1])
            window = grid[max(row - REACH, 0) : row + REACH + 1, max(col - REACH, 0) : col + REACH + 1].copy()
            mark = window.tobytes()
            if self._around.get(pixel) != mark:
                self._around[pixel] = mark
                fresh.append(pixel)
        if not fresh:
            return np.zeros(0, np.int64)
        chosen = np.array(fresh, dtype=np.int64)
        chunk = 128  # pixels that are judged at once: the draws of their surfaces take some 100 MB
        for start in range(0, chosen.size, chunk):
            block = chosen[start : start + chunk]
            found = judge_bent(self._image, self._view, segment, block, scales, self._apart, self._space)
            for place, pixel in enumerate(block.tolist()):
                self.verdict[pixel] = tuple(part[place] for part in found)
        return chosen


def _grown(
    image: PhasorImage,
    view: View,
    segment: IntArray,
    scales: Scales,
    bent: BoolArray,
    space: OpenSpace | None,
    settings: UnmixSettings,
) -> tuple[IntArray, IntArray, Verdicts]:
    """Segments with the pixels that joined, and the verdicts on those beside bent ones that are in none."""
    judged = _Judged(image, view, settings.hypotheses.apart, space)
    first, segment = segment, segment.copy()
    relearnt = 2  # round after which scales are learnt again
    leaving = 1  # round in which members at the rim may leave
    for number in range(settings.curved.rounds):
        area = image.valid & _beside(segment, bent, view.shape, REACH)
        candidates = _open_pixels(segment, area, view, settings.curved.beside)
        judged.judge(segment, scales, candidates)
        joined = 0
        changed = segment.copy()
        for pixel in candidates.tolist():
            verdict = judged.verdict[pixel]
            if verdict[0] == Bent.ONE and verdict[1] > settings.curved.sure:
                changed[pixel] = verdict[2]
                joined += 1
        segment = changed
        if not joined and number >= relearnt:
            break
        if number == leaving:
            _leave(judged, segment, scales, np.flatnonzero(rim_of(segment >= 0, view.shape) & area))
        if number == relearnt:
            curved = np.flatnonzero(bent)
            again = learn_scales(view, segment, curved, REACH)
            for old, new in zip(scales, again, strict=True):
                old[curved] = new
    # A pixel that joined when its surface was hardly known may not fit what is known now.
    area = image.valid & _beside(segment, bent, view.shape, REACH)
    grown = (first < 0) & (segment >= 0) & rim_of(segment >= 0, view.shape) & area
    if _leave(judged, segment, scales, np.flatnonzero(grown)):
        area = image.valid & _beside(segment, bent, view.shape, REACH)
        judged.judge(segment, scales, _open_pixels(segment, area, view, settings.curved.beside))
    pixels = np.array([pixel for pixel in np.flatnonzero(area & (segment < 0)).tolist() if pixel in judged.verdict])
    parts = zip(*(judged.verdict[pixel] for pixel in pixels.tolist()), strict=True)
    return (
        segment,
        pixels.astype(np.int64),
        Verdicts(*(np.array(part) for part in parts)) if pixels.size else _nothing(),
    )


def _leave(judged: _Judged, segment: IntArray, scales: Scales, pixels: IntArray) -> bool:
    """Take the pixels that their own segment does not predict out of it; whether there are any."""
    leaving = [p for p in judged.judge(segment, scales, pixels).tolist() if judged.verdict[p][0] != Bent.ONE]
    segment[leaving] = -1
    return bool(leaving)


def _open_pixels(segment: IntArray, area: BoolArray, view: View, reach: int) -> IntArray:
    """Pixels of the area that are of no segment, beside one."""
    return np.flatnonzero(area & (segment < 0) & near((segment >= 0).reshape(view.shape), reach).ravel())


def _nothing() -> Verdicts:
    return Verdicts(
        np.zeros(0, np.int64),
        np.zeros(0),
        np.zeros(0, np.int64),
        np.zeros((0, 2), np.int64),
        np.zeros((0, 5)),
        np.zeros((0, 5, 5)),
        np.zeros(0, np.complex128),
        np.zeros(0),
    )


def _merged(
    image: PhasorImage,
    labels: Labels,
    segment: IntArray,
    bent: BoolArray,
    space: OpenSpace | None,
    pixels: IntArray,
    verdicts: Verdicts,
    settings: CurvedSettings,
) -> Labels:
    """Labels of planes, in the area replaced by those of smooth surfaces where one of these bends."""
    names = (
        "kind",
        "probability",
        "range_mm",
        "range_variance",
        "share",
        "share_variance",
        "is_known",
        "is_fresh",
        "chord",
        "scatter",
        "log_density",
        "is_surface",
    )
    out = {name: getattr(labels, name).copy() for name in names}

    def clear(which: IntArray) -> None:
        for name in ("range_mm", "range_variance", "share", "share_variance"):
            out[name][which] = np.nan
        out["is_known"][which], out["is_fresh"][which] = True, False
        out["chord"][which], out["scatter"][which] = 0.0, 0.0

    inside = np.flatnonzero(image.valid & (segment >= 0) & bent[np.maximum(segment, 0)])
    clear(inside)
    out["kind"][inside], out["probability"][inside], out["is_surface"][inside] = int(Kind.CONTINUED), 1.0, True
    is_pair = np.isin(verdicts.kind, (Bent.LIMB, Bent.CUT))
    with_bent = is_pair & (bent[np.maximum(verdicts.pair, 0)] & (verdicts.pair >= 0)).any(axis=1)
    open_behind = is_pair & (verdicts.pair[:, 1] < 0)
    seen = _seen_probability(verdicts.mean, verdicts.covariance, settings.least_share)
    lesser = with_bent & (seen < 0.5)  # noqa: PLR2004  rather not
    one = (verdicts.kind == Bent.ONE) & bent[np.maximum(verdicts.one, 0)]
    single = pixels[lesser | one]
    clear(single)
    out["kind"][single], out["is_surface"][single] = int(Kind.CONTINUED), True
    out["probability"][single] = verdicts.probability[lesser | one]
    two = np.flatnonzero(with_bent & ~lesser)
    mixed, mean, covariance = pixels[two], verdicts.mean[two], verdicts.covariance[two]
    clear(mixed)
    out["kind"][mixed], out["is_surface"][mixed] = int(Kind.PAIR), False
    out["probability"][mixed] = verdicts.probability[two] * seen[two]
    out["log_density"][mixed] = verdicts.log_density[two]
    out["chord"][mixed] = verdicts.chord[two]
    out["share"][mixed, 0], out["share"][mixed, 1] = mean[:, 0], 1.0 - mean[:, 0]
    out["share_variance"][mixed, :2] = covariance[:, :1, 0]
    out["range_mm"][mixed, 0] = mean[:, 2]
    out["range_mm"][mixed, 1] = np.where(open_behind[two], np.inf, mean[:, 4])
    out["range_variance"][mixed, 0], out["range_variance"][mixed, 1] = covariance[:, 2, 2], covariance[:, 4, 4]
    out["scatter"][mixed] = _scatter(image, segment, mixed, verdicts.pair[two], mean, verdicts.chord[two], space)
    empty = pixels[verdicts.kind == Bent.EMPTY]
    clear(empty)
    out["kind"][empty], out["is_surface"][empty] = int(Kind.EMPTY), False
    out["probability"][empty] = verdicts.probability[verdicts.kind == Bent.EMPTY]
    out["range_mm"][empty, 0], out["share"][empty, 0] = np.inf, 1.0
    out["range_variance"][empty, 0] = out["share_variance"][empty, 0] = 0.0
    vague = pixels[(verdicts.kind == Bent.NEW) & _beside(segment, bent, image.shape, settings.beside)[pixels]]
    doubtful = vague[labels.is_surface[vague] | np.isin(labels.kind[vague], (Kind.PAIR, Kind.TRIPLE))]
    clear(doubtful)
    out["kind"][doubtful], out["is_surface"][doubtful], out["probability"][doubtful] = int(Kind.NEW), False, 0.0
    return replace(labels, **out)


def _lesser_part(mean: FloatArray) -> FloatArray:
    """Part (n,) of the area or of the light, whichever is more, of the surface that has less; NaN without a pair.

    A fiftieth of a pixel that sees a bright surface has a fifth of its light, and moves its range by as much.
    """
    share = mean[:, 0]
    near, far = share * np.exp(mean[:, 1]), (1.0 - share) * np.exp(mean[:, 3]) * (mean[:, 3] != 0.0)
    with np.errstate(invalid="ignore"):
        light = near / (near + far)
        return np.asarray(np.minimum(np.maximum(share, light), np.maximum(1.0 - share, 1.0 - light)))


def _seen_probability(mean: FloatArray, covariance: FloatArray, least: float) -> FloatArray:
    """Probability (n,) that the lesser surface of pairs has the part `least`, by the error of the share.

    A limb at the border of a pixel, which fills it, has a share of 1 within the error.
    """
    part = _lesser_part(mean)
    lesser = np.maximum(np.minimum(mean[:, 0], 1.0 - mean[:, 0]), 1e-9)
    error = np.sqrt(np.maximum(covariance[:, 0, 0], 1e-18)) * part / lesser
    return ndtr((part - least) / error)


def _scatter(
    image: PhasorImage,
    segment: IntArray,
    pixels: IntArray,
    pair: IntArray,
    mean: FloatArray,
    chord: ComplexArray,
    space: OpenSpace | None,
) -> FloatArray:
    """Variance (n,) along the chord of samples of one surface each, by the noise of both segments where seen alone."""
    count = int(segment.max()) + 1
    inside = segment >= 0
    size = np.maximum(np.bincount(segment[inside], minlength=count), 1)
    tangential, radial = (
        np.bincount(segment[inside], weights=part[inside], minlength=count) / size
        for part in (image.scatter_tangential, image.scatter_radial)
    )
    along = chord / np.maximum(np.abs(chord), 1e-30)
    total = np.zeros(len(pixels))
    for end in (0, 1):
        phasor = np.exp(mean[:, 1 + 2 * end] + 1j * mean[:, 2 + 2 * end] / image.scale_mm)
        number = pair[:, end]
        part = mean[:, 0] if end == 0 else 1.0 - mean[:, 0]
        own = variance_along(polar_covariance(phasor, tangential[number], radial[number]), along)
        total += part * (own if space is None else np.where(number < 0, space.scatter, own))
    return total
