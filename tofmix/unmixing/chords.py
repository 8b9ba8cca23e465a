"""Hypotheses of several surfaces in a pixel: pairs, whose phasor lies on a chord, and triples, in a triangle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.unmixing.functions import logsumexp, ndtr
from tofmix.unmixing.image import TINY, ComplexArray, PhasorImage, inverse_form, polar_covariance, variance_along
from tofmix.unmixing.likeliest import (
    OPEN,
    PRIORS,
    Best,
    Kind,
    OpenSpace,
    log_share,
    place_chance,
)
from tofmix.unmixing.neighbours import DistantPlane, Predictions, phasor_of, predict
from tofmix.unmixing.seeds import Seeds
from tofmix.unmixing.settings import HypothesisSettings
from tofmix.unmixing.surface_fit import MOST_SURFACES, NeighbourSurfaces


class Ends:
    """Neighbouring surfaces and open space, as ends of chords and corners of triangles."""

    def __init__(
        self,
        image: PhasorImage,
        pixels: IntArray,
        neighbours: NeighbourSurfaces,
        here: list[Predictions],
        seeds: Seeds,
        spaces: tuple[OpenSpace, ...],
        settings: HypothesisSettings,
        bends: bool,
    ) -> None:
        self.image, self.pixels, self.neighbours, self.here, self.seeds = image, pixels, neighbours, here, seeds
        self.settings, self.bends = settings, bends
        self.phasor, self.covariance = image.phasor[pixels], image.mean_covariance[pixels]
        count = len(pixels)
        self.count = OPEN + len(spaces)
        self.found = np.column_stack([neighbours.found, *(space.nearby[pixels] for space in spaces)])
        self.trusted = np.column_stack([neighbours.is_trusted, *(np.ones(count, bool) for _ in spaces)])
        self.fresh = np.column_stack([neighbours.is_fresh, *(np.zeros(count, bool) for _ in spaces)])
        self.chance = np.column_stack([place_chance(neighbours, settings.aside), *(np.ones(count) for _ in spaces)])
        self.known = np.column_stack([neighbours.is_known, *(np.ones(count, bool) for _ in spaces)])
        even = np.ones(count)
        self._spaces, self._scatter = spaces, [space.scatter for space in spaces]
        self._open = [
            Predictions(
                phasor=np.full(count, space.phasor),
                tangential=space.variance * even,
                radial=space.variance * even,
                range_mm=np.full(count, np.inf),
                range_variance=np.zeros(count),
            )
            for space in spaces
        ]

    def some(self, which: IntArray) -> "Ends":
        """The ends of some of the pixels."""
        neighbours = NeighbourSurfaces(**{name: part[which] for name, part in self.neighbours._asdict().items()})
        here = [
            Predictions(**{field.name: getattr(part, field.name)[which] for field in fields(Predictions)})
            for part in self.here
        ]
        return Ends(
            self.image, self.pixels[which], neighbours, here, self.seeds, self._spaces, self.settings, self.bends
        )

    def at(self, number: int) -> Predictions:
        """The end's phasor where it fills the pixel."""
        return self._open[number - OPEN] if number >= OPEN else self.here[number]

    def seen(self, number: int, row: FloatArray, col: FloatArray) -> Predictions:
        """The end's phasor from a place off the middle of the pixel."""
        if number >= OPEN:
            return self._open[number - OPEN]
        return predict(self.neighbours, number, row, col, image=self.image, seeds=self.seeds)

    def scatter(self, number: int, phasor: ComplexArray, along: ComplexArray) -> FloatArray:
        """Variance (n,) of the end's samples along unit vectors; `phasor` is the end's own."""
        if number >= OPEN:
            return np.full(len(self.pixels), self._scatter[number - OPEN])
        tangential, radial = (
            part[:, number] for part in (self.neighbours.scatter_tangential, self.neighbours.scatter_radial)
        )
        return variance_along(polar_covariance(phasor, tangential, radial), along)

    def apart(self, one: int, other: int) -> BoolArray:
        """Whether two ends are far enough apart to be separated."""
        if other >= OPEN:
            return np.ones(len(self.pixels), bool)
        return _are_apart(self.at(one), self.at(other), self.settings)

    def may_be_apart(self, one: int, other: int) -> BoolArray:
        """Whether two ends, whose errors leave that open, may be far enough apart: such a pair is not known."""
        if other >= OPEN or not self.bends:
            return np.zeros(len(self.pixels), bool)
        first, second = self.at(one).range_mm, self.at(other).range_mm
        return np.asarray(np.abs(first - second) > self.settings.apart * np.minimum(first, second))

    def is_told(self, chord: "_Chord") -> BoolArray:
        """Whether the pixel sees both ends of a chord for certain: beside surfaces that bend, no share may be 0."""
        if not self.bends:
            return np.ones(len(self.pixels), bool)
        lesser = np.minimum(chord.share, 1.0 - chord.share)
        return np.asarray(lesser**2 > chord.variance)

    def towards(self, one: int, other: int) -> tuple[FloatArray, FloatArray]:
        """Unit vector (row, col) from the second end's pixels to the first one's."""
        row, col = self.neighbours.row[:, one], self.neighbours.col[:, one]
        if other < OPEN:
            row, col = row - self.neighbours.row[:, other], col - self.neighbours.col[:, other]
        length = np.maximum(np.hypot(row, col), TINY)
        return row / length, col / length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Chord:
    """A pair in each pixel: share of the first end, its variance, log density, and both ends as seen."""

    share: FloatArray
    variance: FloatArray
    log_density: FloatArray
    one: Predictions
    other: Predictions


def _chord(ends: Ends, one: int, other: int, plane: DistantPlane | None = None) -> _Chord:
    """Find the share of a pair by generalised least squares: z - z_b = w (z_a - z_b).

    The surface of share w fills a part of the pixel whose middle lies (1 - w) / 2 pixels towards its side. The other
    one may be a large surface that is seen elsewhere.
    """
    row, col = ends.towards(one, other)
    share = np.full(len(ends.pixels), 0.5)
    for _ in range(ends.settings.rounds):
        part = np.clip(share, 0.0, 1.0)
        a = ends.seen(one, row * (1.0 - part) / 2.0, col * (1.0 - part) / 2.0)
        back_row, back_col = -row * part / 2.0, -col * part / 2.0
        b = ends.seen(other, back_row, back_col) if plane is None else _elsewhere(ends, plane, back_row, back_col)
        covariance = (
            ends.covariance
            + part[:, np.newaxis] ** 2 * polar_covariance(a.phasor, a.tangential, a.radial)
            + (1.0 - part)[:, np.newaxis] ** 2 * polar_covariance(b.phasor, b.tangential, b.radial)
        )
        chord, offset = a.phasor - b.phasor, ends.phasor - b.phasor
        variance = 1.0 / np.maximum(inverse_form(covariance, chord, chord), TINY)
        share = inverse_form(covariance, chord, offset) * variance
    across = offset - share * chord
    length = np.maximum(np.abs(chord), TINY)
    determinant = np.maximum(covariance[:, 0] * covariance[:, 1] - covariance[:, 2] ** 2, TINY)
    broad = variance_along(covariance, chord / length)
    narrow = determinant / np.maximum(broad, TINY)
    error = np.sqrt(variance)
    inside = ndtr(share / error) - ndtr((share - 1.0) / error)
    log_density = (
        -0.5 * inverse_form(covariance, across, across)
        - 0.5 * np.log(2.0 * math.pi * np.maximum(narrow, TINY))
        - np.log(length)
        + np.log(np.maximum(inside, TINY))
    )
    return _Chord(share=share, variance=variance, log_density=log_density, one=a, other=b)


def _elsewhere(ends: Ends, plane: DistantPlane, row: FloatArray, col: FloatArray) -> Predictions:
    """The return of a large surface from places (n,), `row` and `col` off the pixels."""
    image, pixels = ends.image, ends.pixels
    ways = (
        image.directions[pixels]
        + (row * image.pitch_down[pixels])[:, np.newaxis] * image.down[pixels]
        + (col * image.pitch_across[pixels])[:, np.newaxis] * image.across[pixels]
    )
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    even = np.ones(len(pixels))
    return phasor_of(
        ways @ plane.plane,
        np.einsum("ni,ik,nk->n", ways, plane.covariance, ways),
        plane.log_light * even,
        plane.light_variance * even,
        image=image,
        seeds=ends.seeds,
    )


def put_distant_pairs(best: Best, ends: Ends, planes: tuple[DistantPlane, ...]) -> None:
    """A neighbouring surface shares the pixel with a large one that is seen elsewhere only.

    If neighbouring surfaces explain a pixel, this is not tried: it is much less likely.
    """
    doubtful = best.unexplained()
    if not planes or not doubtful.size:
        return
    here = ends.some(doubtful)
    usable = here.found[:, :MOST_SURFACES] & here.trusted[:, :MOST_SURFACES]
    pairs, total = [], np.zeros(len(doubtful))
    seen: list[tuple[BoolArray, Predictions]] = [(usable[:, k], here.at(k)) for k in range(MOST_SURFACES)]
    for plane in planes:
        none = np.zeros(len(doubtful))
        far = _elsewhere(here, plane, none, none)
        beyond = [_are_apart(other, far, ends.settings) for _, other in seen]
        # A surface that is seen beside the pixel, or is a part of a larger one, is an end already.
        new = np.all([apart | ~known for apart, (known, _) in zip(beyond, seen, strict=True)], axis=0)
        new &= ends.image.directions[here.pixels] @ plane.plane > 0
        seen.append((new, far))
        for one in range(MOST_SURFACES):
            possible = new & usable[:, one] & beyond[one]
            total += possible * here.chance[:, one]
            tried = np.flatnonzero(possible & _near_chord(here, here.at(one), far))
            if tried.size:
                pairs.append((one, plane, tried))
    for one, plane, tried in pairs:
        _put_distant_pair(best, here.some(tried), one, plane, doubtful[tried], total[tried])


def _are_apart(one: Predictions, other: Predictions, settings: HypothesisSettings) -> BoolArray:
    """Whether two ends are far enough apart to be separated."""
    gap, error = np.abs(one.range_mm - other.range_mm), np.sqrt(one.range_variance + other.range_variance)
    least = np.minimum(one.range_mm, other.range_mm)
    return np.asarray((gap > settings.apart_sigmas * error) & (gap > settings.apart * least))


def _near_chord(ends: Ends, one: Predictions, other: Predictions) -> BoolArray:
    """Whether phasors lie so near the chord between two ends that a pair is worth a fit."""
    chord, offset = one.phasor - other.phasor, ends.phasor - other.phasor
    length = np.maximum(np.abs(chord), TINY)
    share = (offset * np.conj(chord)).real / length**2
    across = np.abs((offset * np.conj(chord)).imag) / length
    noise = np.max(
        [ends.covariance[:, 0] + ends.covariance[:, 1], one.tangential + one.radial, other.tangential + other.radial],
        axis=0,
    )
    reach = 6.0 * np.sqrt(noise) + ends.settings.near_chord * length
    return np.asarray((across < reach) & (share > -reach / length) & (share < 1.0 + reach / length))


def _put_distant_pair(
    best: Best, ends: Ends, one: int, plane: DistantPlane, which: IntArray, total: FloatArray
) -> None:
    """Put the pair of one end and a large surface, of `which` of the pixels that are judged."""
    chord = _chord(ends, one, OPEN, plane)
    possible = chord.share <= 1.0 - ends.settings.same_sigmas * np.sqrt(chord.variance)
    share, none = np.clip(chord.share, 0.0, 1.0), np.full(len(which), np.nan)
    best.put(
        Kind.PAIR,
        log_share(ends.settings.distant_prior, possible * ends.chance[:, one], total),
        chord.log_density,
        which=which,
        range_mm=np.column_stack([chord.one.range_mm, chord.other.range_mm, none]),
        range_variance=np.column_stack([chord.one.range_variance, chord.other.range_variance, none]),
        share=np.column_stack([share, 1.0 - share, none]),
        share_variance=np.column_stack([chord.variance, chord.variance, none]),
        is_known=ends.known[:, one],
        is_fresh=ends.fresh[:, one],
        chord=chord.one.phasor - chord.other.phasor,
        scatter=np.full(len(which), np.inf),
    )


def put_pairs(best: Best, ends: Ends) -> None:
    """Two ends share the pixel; one of them at least is trusted. All kinds of open space are one end."""
    pairs, total = [], np.zeros(len(ends.pixels))
    spaces = tuple(range(OPEN, ends.count))
    for one in range(MOST_SURFACES):
        for others in (*((other,) for other in range(one + 1, MOST_SURFACES)), spaces):
            if not others:
                continue
            other = others[0]
            possible = ends.found[:, one] & ends.found[:, other]
            possible &= ends.trusted[:, one] | (ends.trusted[:, other] & (other < OPEN))
            if not possible.any():
                continue
            which = np.flatnonzero(possible & (ends.apart(one, other) | ends.may_be_apart(one, other)))
            here = ends.some(which)
            chord = _likeliest([_chord(here, one, number) for number in others])
            error = ends.settings.same_sigmas * np.sqrt(chord.variance)
            is_distinct = here.trusted[:, one] | (1.0 - chord.share >= error)
            is_distinct &= here.trusted[:, other] | (chord.share >= error)
            chance = is_distinct * here.chance[:, one] * here.chance[:, other]
            total[which] += chance
            pairs.append((one, other, which, here, chance, chord))
    for one, other, which, here, chance, chord in pairs:
        share, none = np.clip(chord.share, 0.0, 1.0), np.full(len(which), np.nan)
        best.put(
            Kind.PAIR,
            log_share(PRIORS[Kind.PAIR], chance, total[which]),
            chord.log_density,
            which=which,
            range_mm=np.column_stack([chord.one.range_mm, chord.other.range_mm, none]),
            range_variance=np.column_stack([chord.one.range_variance, chord.other.range_variance, none]),
            share=np.column_stack([share, 1.0 - share, none]),
            share_variance=np.column_stack([chord.variance, chord.variance, none]),
            is_known=here.known[:, one] & here.known[:, other] & here.apart(one, other) & here.is_told(chord),
            is_fresh=here.fresh[:, one] | here.fresh[:, other],
            chord=chord.one.phasor - chord.other.phasor,
            scatter=_noise_along(here, one, other, chord, share),
        )


def put_unseen(best: Best, ends: Ends, largest: float, prior: float) -> None:
    """A neighbouring surface shares the pixel with one that no pixel nearby sees alone: more than that is not known."""
    if prior <= 0.0:
        return
    possible = ends.found[:, :MOST_SURFACES] & ends.trusted[:, :MOST_SURFACES]
    chances = possible * ends.chance[:, :MOST_SURFACES]
    total = chances.sum(axis=1)
    for one in range(MOST_SURFACES):
        here = ends.at(one)
        error = ends.covariance[:, 0] + ends.covariance[:, 1] + here.tangential + here.radial
        log_density = unseen_log_density(ends.phasor, here.phasor, error, largest)
        best.put(Kind.NEW, log_share(prior, chances[:, one], total), log_density)


def unseen_log_density(phasor: ComplexArray, seen: ComplexArray, error: FloatArray, largest: float) -> FloatArray:
    """Log density (n,) of phasors z of pixels that a known surface, of phasors a, shares with an unseen one, nat.

    z = (1 - v) a + v b, with the share v of the unseen surface uniform, and its phasor b uniform in the disc of radius
    L = `largest`: the density is the integral of 1 / (pi L^2 v^2) over all v that leave b in the disc, from v_0 to 1.
    `error` is the mean square of z - a by errors of both.
    """
    offset = phasor - seen
    free = np.maximum(largest**2 - np.abs(seen) ** 2, TINY)
    along = (np.conj(seen) * offset).real
    square = np.abs(offset) ** 2 + error
    least = np.clip((along + np.sqrt(along**2 + free * square)) / free, TINY, 1.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(1.0 / least - 1.0) - math.log(math.pi * largest**2))


def _likeliest(chords: list[_Chord]) -> _Chord:
    """The likeliest chord of each pixel, of several between the same ends; its density is the mean of theirs."""
    if len(chords) == 1:
        return chords[0]
    densities = np.stack([chord.log_density for chord in chords])
    which = densities.argmax(axis=0)

    def chosen(values: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return np.asarray(np.choose(which, values))

    def end(name: str) -> Predictions:
        parts = [getattr(chord, name) for chord in chords]
        return Predictions(
            **{field.name: chosen([getattr(part, field.name) for part in parts]) for field in fields(Predictions)}
        )

    return _Chord(
        share=chosen([chord.share for chord in chords]),
        variance=chosen([chord.variance for chord in chords]),
        log_density=logsumexp(np.asarray(densities)) - math.log(len(chords)),
        one=end("one"),
        other=end("other"),
    )


def _noise_along(ends: Ends, one: int, other: int, chord: _Chord, share: FloatArray) -> FloatArray:
    """Variance (n,) along the chord of a pair's samples, by noise alone."""
    difference = chord.one.phasor - chord.other.phasor
    along = difference / np.maximum(np.abs(difference), TINY)
    first = ends.scatter(one, chord.one.phasor, along)
    return np.asarray(share * first + (1.0 - share) * ends.scatter(other, chord.other.phasor, along))


def put_triples(best: Best, ends: Ends) -> None:
    """Three trusted ends share the pixel: barycentric coordinates of its phasor in their triangle are the shares."""
    triples, total = [], np.zeros(len(ends.pixels))
    spread = np.sqrt(0.5 * (ends.covariance[:, 0] + ends.covariance[:, 1]))
    for a in range(MOST_SURFACES):
        for b in range(a + 1, MOST_SURFACES):
            for c in range(b + 1, min(ends.count, OPEN + 1)):
                possible = np.ones(len(ends.pixels), bool)
                for number in (a, b, c):
                    possible &= ends.found[:, number] & ends.trusted[:, number]
                if not possible.any():
                    continue
                possible &= ends.apart(a, b) & ends.apart(b, c) & ends.apart(a, c)
                corners = [ends.at(number) for number in (a, b, c)]
                shares, errors, log_density = _barycentric(ends.phasor, spread, corners)
                chance = possible * ends.chance[:, a] * ends.chance[:, b] * ends.chance[:, c]
                total += chance
                fresh = ends.fresh[:, a] | ends.fresh[:, b] | ends.fresh[:, c]
                triples.append((chance, corners, shares, errors, log_density, fresh))
    for chance, corners, shares, errors, log_density, fresh in triples:
        best.put(
            Kind.TRIPLE,
            log_share(PRIORS[Kind.TRIPLE], chance, total),
            log_density,
            range_mm=np.column_stack([corner.range_mm for corner in corners]),
            range_variance=np.column_stack([corner.range_variance for corner in corners]),
            share=np.clip(shares, 0.0, 1.0),
            share_variance=errors**2,
            is_fresh=fresh,
        )


def _barycentric(
    phasor: ComplexArray, spread: FloatArray, corners: list[Predictions]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shares (n, 3) of three corners, their errors, and the log density (n,) of being uniform in the triangle."""
    a, b, c = (corner.phasor for corner in corners)
    area = ((b - a) * np.conj(c - a)).imag
    area = np.where(np.abs(area) > TINY, area, TINY)
    first = ((b - phasor) * np.conj(c - phasor)).imag / area
    second = ((c - phasor) * np.conj(a - phasor)).imag / area
    shares = np.column_stack([first, second, 1.0 - first - second])
    sides = np.column_stack([np.abs(b - c), np.abs(c - a), np.abs(a - b)])
    errors = np.maximum(spread[:, np.newaxis] * sides / np.abs(area)[:, np.newaxis], TINY)
    inside = ndtr(shares / errors).prod(axis=1)
    return shares, errors, np.log(np.maximum(inside, TINY)) - np.log(0.5 * np.abs(area))
