"""Hypotheses for the mean phasor of a pixel: none, one, two or three surfaces. Bayes' rule over their kinds.

- NEW: a surface that no neighbour shows. Its phasor is uniform in the disc of the image's amplitudes.
- CONTINUED: a neighbouring surface, or a large one elsewhere in the image, fills the pixel. The phasor is Gaussian
  about
  the surface's own. The surface may also have another reflectance here: the phase is Gaussian, the amplitude uniform.
- PAIR: two surfaces share the pixel. The phasor lies on the chord between theirs: Gaussian across, uniform along it.
  One of them may be a large surface that is seen elsewhere alone, as a wall in a gap narrower than a pixel.
- TRIPLE: three of them. It lies in their triangle.
- EMPTY: open space fills the pixel, and noise gave samples. The phasor is Gaussian about that of open space.

Open space is an end like a surface: of phasor 0, as in a sum, or of the camera's return from open space, as under
equation (1). The noise of a single surface equals that of its neighbours. Under equation (1), further scatter is along
the chord, and belongs to the pair.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.unmixing.functions import logsumexp, ndtr
from tofmix.unmixing.image import ComplexArray, PhasorImage, inverse_form, polar_covariance, variance_along
from tofmix.unmixing.neighbours import DistantPlane, Predictions, find_neighbours, phasor_of, predict
from tofmix.unmixing.seeds import Seeds, plane_vector
from tofmix.unmixing.settings import HypothesisSettings, NeighbourSettings
from tofmix.unmixing.surface_fit import MOST_SURFACES, Members, NeighbourSurfaces


class Kind(IntEnum):
    """Kind of a hypothesis."""

    UNKNOWN = 0
    NEW = 1
    CONTINUED = 2
    OTHER_REFLECTANCE = 3
    PAIR = 4
    TRIPLE = 5
    EMPTY = 6


PRIORS = {
    Kind.NEW: 0.02,
    Kind.CONTINUED: 0.5,
    Kind.OTHER_REFLECTANCE: 0.03,
    Kind.PAIR: 0.4,
    Kind.TRIPLE: 0.05,
    Kind.EMPTY: 0.5,
}
"""Prior probabilities at edges, where alone pixels are in doubt; each is shared by the hypotheses of its kind. Beside
open space, that fills a pixel as probably as a surface does.
"""

ENDS = 3
"""Most surfaces of a pixel."""

_OPEN = MOST_SURFACES
"""Number of the first kind of open space among the ends."""

_TINY = 1.0e-30
"""Least variance, and area, in units of the image's median amplitude, squared: divisions stay finite."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenSpace:
    """The return of a pixel without a surface.

    Parameters
    ----------
    nearby : (pixel,) bool
        Whether a pixel may see it.
    phasor : complex
        Mean phasor.
    variance : float
        Variance of its real part, and of its imaginary part, from pixel to pixel, beyond noise.
    scatter : float
        Variance of one sample's, likewise, by noise; 0 where no samples tell.
    """

    nearby: BoolArray
    phasor: complex
    variance: float
    scatter: float

    def log_density(self, image: PhasorImage, pixels: IntArray) -> FloatArray:
        """Log density (n,) of the mean phasors of pixels that open space fills, nat; -inf where it is not nearby."""
        noise = self.scatter / np.maximum(image.samples[pixels], 1.0)
        even = (self.variance + noise)[:, np.newaxis] * np.array([1.0, 1.0, 0.0])
        covariance = even if self.scatter > 0.0 else even + image.mean_covariance[pixels]
        return np.where(self.nearby[pixels], _log_normal(image.phasor[pixels] - self.phasor, covariance), -np.inf)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LikeliestHypotheses:
    """The most probable hypothesis of pixels (n,).

    Parameters
    ----------
    kind : (n,) int64
        `Kind`.
    probability : (n,) float64
        Its posterior.
    plane : (n, 3) float64
        CONTINUED: m of the surface's plane, 1 / mm.
    is_distant : (n,) bool
        CONTINUED: whether the surface is known from elsewhere in the image.
    range_mm, range_variance, share, share_variance : (n, ENDS) float64
        PAIR, TRIPLE and EMPTY: the surfaces; NaN past the last, an infinite range is open space.
    is_known : (n,) bool
        PAIR and TRIPLE: whether all ends are (`tofmix.unmixing.neighbours.Members`).
    is_fresh : (n,) bool
        CONTINUED, PAIR and TRIPLE: whether the surface, or one of the ends, is.
    chord : (n,) complex128
        PAIR: difference of both phasors.
    scatter : (n,) float64
        PAIR: variance along the chord of samples that are of one surface each, or sums, by their noise alone; infinite
        where it is not known.
    log_density : (n,) float64
        Log density of the mean phasor in units of the image's median amplitude, nat.
    log_evidence : (n,) float64
        Likewise, under all hypotheses.
    """

    kind: IntArray
    probability: FloatArray
    plane: FloatArray
    is_distant: BoolArray
    range_mm: FloatArray
    range_variance: FloatArray
    share: FloatArray
    share_variance: FloatArray
    is_known: BoolArray
    is_fresh: BoolArray
    chord: ComplexArray
    scatter: FloatArray
    log_density: FloatArray
    log_evidence: FloatArray


class _Best:
    """Keeps, pixel by pixel, the most probable of the hypotheses that are put to it."""

    def __init__(self, count: int, likely: float) -> None:
        self._likely = likely
        self._log = np.full(count, -np.inf)
        self._logs: list[FloatArray] = []
        ends = (count, ENDS)
        self._kept: dict[str, NDArray[Any]] = {
            "kind": np.zeros(count, np.int64),
            "plane": np.zeros((count, 3)),
            "is_distant": np.zeros(count, bool),
            "range_mm": np.full(ends, np.nan),
            "range_variance": np.full(ends, np.nan),
            "share": np.full(ends, np.nan),
            "share_variance": np.full(ends, np.nan),
            "is_known": np.ones(count, bool),
            "is_fresh": np.zeros(count, bool),
            "chord": np.zeros(count, np.complex128),
            "scatter": np.zeros(count),
            "log_density": np.full(count, np.nan),
        }
        self._blank = {name: values[:1].copy() for name, values in self._kept.items()}

    def put(
        self,
        kind: Kind,
        log_prior: FloatArray,
        log_density: FloatArray,
        *,
        which: IntArray | None = None,
        **values: NDArray[Any],
    ) -> None:
        """Put one hypothesis of each pixel, or of `which`: log prior and density (n,), and its values by field."""
        rows = np.arange(len(self._log)) if which is None else which
        log = log_prior + np.where(np.isfinite(log_density), log_density, -np.inf)
        everywhere = np.full(len(self._log), -np.inf)
        everywhere[rows] = log
        self._logs.append(everywhere)
        better = np.flatnonzero(log > self._log[rows])
        changed = rows[better]
        self._log[changed] = log[better]
        everything = {"kind": np.full(len(log), int(kind)), "log_density": log_density} | values
        for name, kept in self._kept.items():
            kept[changed] = everything[name][better] if name in everything else self._blank[name]

    def unexplained(self) -> IntArray:
        """Pixels (m,) that no neighbouring surfaces explain."""
        total = logsumexp(np.stack(self._logs))
        vague = (self._kept["kind"] == Kind.NEW) | ~self._kept["is_known"]
        return np.flatnonzero(vague | (np.exp(self._log - total) < self._likely))

    def findings(self) -> LikeliestHypotheses:
        """The kept hypothesis, with its probability among all."""
        total = logsumexp(np.stack(self._logs))
        return LikeliestHypotheses(probability=np.exp(self._log - total), log_evidence=total, **self._kept)


def judge(
    image: PhasorImage,
    pixels: IntArray,
    members: Members,
    seeds: Seeds,
    planes: tuple[DistantPlane, ...],
    spaces: tuple[OpenSpace, ...],
    settings: HypothesisSettings,
    neighbourhood: NeighbourSettings,
    *,
    bends: bool = False,
    flat: tuple[DistantPlane, ...] = (),
    unseen: float = 0.0,
) -> LikeliestHypotheses:
    """Find the most probable hypothesis of each pixel.

    Parameters
    ----------
    image : PhasorImage
        The window.
    pixels : (n,) int64
        The pixels.
    members : Members
        One-surface pixels, as far as they are known.
    seeds : Seeds
        Fixed pattern and texture.
    planes : tuple of DistantPlane
        Large surfaces; none: they are left out.
    spaces : tuple of OpenSpace
        Possible returns of open space.
    settings, neighbourhood
        Thresholds of hypotheses, and of the neighbouring surfaces of a pixel.
    bends : bool
        Whether the surfaces bend as things of a few pixels do; else they are planes.
    flat : tuple of DistantPlane
        Large surfaces whose parts are flat where others bend.
    unseen : float
        Part of the pairs of which one surface is seen alone by no pixel nearby.

    Returns
    -------
    Findings
        One for each pixel.
    """
    neighbours = find_neighbours(image, pixels, members, seeds, neighbourhood)
    if bends:
        neighbours = _bending(image, pixels, neighbours, flat, settings)
    best = _Best(len(pixels), settings.likely)
    largest = 1.5 * float(np.quantile(image.amplitude[image.valid], 0.999))
    best.put(
        Kind.NEW,
        np.full(len(pixels), math.log(PRIORS[Kind.NEW])),
        np.full(len(pixels), -math.log(math.pi * largest**2)),
    )
    here = [
        predict(neighbours, k, np.zeros(len(pixels)), np.zeros(len(pixels)), image=image, seeds=seeds)
        for k in range(MOST_SURFACES)
    ]
    _put_continued(best, image, pixels, neighbours, here, largest, settings.aside)
    _put_distant(best, image, pixels, planes, seeds, settings.distant_prior)
    _put_empty(best, image, pixels, spaces)
    ends = _Ends(image, pixels, neighbours, here, seeds, spaces, settings, bends)
    _put_pairs(best, ends)
    _put_unseen(best, ends, largest, PRIORS[Kind.PAIR] * unseen)
    _put_triples(best, ends)
    _put_distant_pairs(best, ends, planes)
    return best.findings()


def _bending(
    image: PhasorImage,
    pixels: IntArray,
    neighbours: NeighbourSurfaces,
    planes: tuple[DistantPlane, ...],
    settings: HypothesisSettings,
) -> NeighbourSurfaces:
    """The surfaces, if they bend as a thing of a few pixels does.

    A circle of radius R, pixels, recedes by x = d^2 / 2 R^2 of its radius, d pixels from its middle, and the cosine of
    incidence falls by the part x. R is not known, so x has a standard deviation of x, in range and in light. A surface
    on the plane of a large one is a part of that, and flat.
    """
    recedes = (neighbours.row**2 + neighbours.col**2) / (2.0 * settings.bend_radius**2)
    part = settings.bend_radius * image.pitch[pixels, np.newaxis]
    nearer = recedes * part * neighbours.near[:, :, 0]
    on_planes = _on_planes(image, pixels, neighbours, planes, nearer, settings.same_sigmas)
    recedes = np.where(on_planes, 0.0, recedes)
    back = recedes * part  # as a part of the range
    near, light = neighbours.near.copy(), neighbours.light.copy()
    near_covariance, light_covariance = neighbours.near_covariance.copy(), neighbours.light_covariance.copy()
    near_covariance[:, :, 0, 0] += (back * near[:, :, 0]) ** 2
    light_covariance[:, :, 0, 0] += recedes**2
    near[:, :, 0] *= 1.0 - back
    light[:, :, 0] -= recedes
    return neighbours._replace(
        near=near, near_covariance=near_covariance, light=light, light_covariance=light_covariance
    )


def _on_planes(
    image: PhasorImage,
    pixels: IntArray,
    neighbours: NeighbourSurfaces,
    planes: tuple[DistantPlane, ...],
    back: FloatArray,
    sigmas: float,
) -> BoolArray:
    """Which surfaces (n, surface) go on in the pixels as one of the planes does, as far as errors and bending tell."""
    out = np.zeros(neighbours.found.shape, bool)
    ways = image.directions[pixels]
    for plane in planes:
        variance = np.einsum("ni,ik,nk->n", ways, plane.covariance, ways)[:, np.newaxis]
        off = neighbours.near[:, :, 0] - (ways @ plane.plane)[:, np.newaxis]
        error = variance + neighbours.near_covariance[:, :, 0, 0]
        out |= neighbours.found & (off**2 < sigmas**2 * error + back**2)
    return out


def _log_share(prior: float, chance: FloatArray | BoolArray, total: FloatArray) -> FloatArray:
    """Log (n,) of a prior that hypotheses of chances of `total` share; -inf where the one in question has none."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(prior * chance / np.maximum(total, 1.0)))


def _place_chance(neighbours: NeighbourSurfaces, aside: float) -> FloatArray:
    """Chance (n, surface) of a surface by its place: it fills one of the eight pixels around, or none of them."""
    return np.where(neighbours.touches, 1.0, aside)


def _log_normal(difference: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Log density (n,) of differences of phasors (n,) under a Gaussian of covariances (n, 3)."""
    determinant = np.maximum(covariance[:, 0] * covariance[:, 1] - covariance[:, 2] ** 2, _TINY)
    return np.asarray(-0.5 * inverse_form(covariance, difference, difference) - 0.5 * np.log(determinant) - _LOG_TWO_PI)


_LOG_TWO_PI = math.log(2.0 * math.pi)


def _put_continued(
    best: _Best,
    image: PhasorImage,
    pixels: IntArray,
    neighbours: NeighbourSurfaces,
    here: list[Predictions],
    largest: float,
    aside: float,
) -> None:
    """A trusted neighbouring surface fills the pixel, with its light or with any light."""
    phasor = image.phasor[pixels]
    chances = _place_chance(neighbours, aside) * (neighbours.found & neighbours.is_trusted)
    total = chances.sum(axis=1)
    for k, seen in enumerate(here):
        chance = chances[:, k]
        if not chance.any():
            continue
        tangential = seen.tangential + neighbours.noise_tangential[:, k]
        radial = seen.radial + neighbours.noise_radial[:, k]
        plane = plane_vector(image, pixels, neighbours.near[:, k])
        best.put(
            Kind.CONTINUED,
            _log_share(PRIORS[Kind.CONTINUED], chance, total),
            _log_normal(phasor - seen.phasor, polar_covariance(seen.phasor, tangential, radial)),
            plane=plane,
            is_fresh=neighbours.is_fresh[:, k],
        )
        along = seen.phasor / np.maximum(np.abs(seen.phasor), _TINY)
        turned = phasor * np.conj(along)
        # With other light the noise is other, too: the pixel's own.
        own = variance_along(image.mean_covariance[pixels], 1j * along)
        across = own + seen.tangential * (np.abs(phasor) / np.abs(seen.phasor)) ** 2
        log_density = -0.5 * turned.imag**2 / across - 0.5 * np.log(2.0 * math.pi * across) - math.log(largest)
        best.put(
            Kind.OTHER_REFLECTANCE,
            _log_share(PRIORS[Kind.OTHER_REFLECTANCE], chance * (turned.real > 0), total),
            log_density,
            plane=plane,
            is_fresh=neighbours.is_fresh[:, k],
        )


def _put_distant(
    best: _Best,
    image: PhasorImage,
    pixels: IntArray,
    planes: tuple[DistantPlane, ...],
    seeds: Seeds,
    prior: float,
) -> None:
    """A large surface that is seen elsewhere in the image fills the pixel."""
    ways, phasor = image.directions[pixels], image.phasor[pixels]
    for plane in planes:
        even = np.ones(len(pixels))
        seen = phasor_of(
            ways @ plane.plane,
            np.einsum("ni,ik,nk->n", ways, plane.covariance, ways),
            plane.log_light * even,
            plane.light_variance * even,
            image=image,
            seeds=seeds,
        )
        covariance = polar_covariance(seen.phasor, seen.tangential, seen.radial) + image.mean_covariance[pixels]
        best.put(
            Kind.CONTINUED,
            _log_share(prior, even > 0, even * len(planes)),
            _log_normal(phasor - seen.phasor, covariance),
            plane=np.broadcast_to(plane.plane, (len(pixels), 3)),
            is_distant=even > 0,
        )


def _put_empty(best: _Best, image: PhasorImage, pixels: IntArray, spaces: tuple[OpenSpace, ...]) -> None:
    """Open space fills the pixel."""
    only = np.tile([1.0, np.nan, np.nan], (len(pixels), 1))
    for space in spaces:
        best.put(
            Kind.EMPTY,
            _log_share(PRIORS[Kind.EMPTY], space.nearby[pixels], np.full(len(pixels), float(len(spaces)))),
            space.log_density(image, pixels),
            range_mm=only * np.inf,
            range_variance=only * 0.0,
            share=only,
            share_variance=only * 0.0,
        )


class _Ends:
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
        self.count = _OPEN + len(spaces)
        self.found = np.column_stack([neighbours.found, *(space.nearby[pixels] for space in spaces)])
        self.trusted = np.column_stack([neighbours.is_trusted, *(np.ones(count, bool) for _ in spaces)])
        self.fresh = np.column_stack([neighbours.is_fresh, *(np.zeros(count, bool) for _ in spaces)])
        self.chance = np.column_stack([_place_chance(neighbours, settings.aside), *(np.ones(count) for _ in spaces)])
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

    def some(self, which: IntArray) -> "_Ends":
        """The ends of some of the pixels."""
        neighbours = NeighbourSurfaces(**{name: part[which] for name, part in self.neighbours._asdict().items()})
        here = [
            Predictions(**{field.name: getattr(part, field.name)[which] for field in fields(Predictions)})
            for part in self.here
        ]
        return _Ends(
            self.image, self.pixels[which], neighbours, here, self.seeds, self._spaces, self.settings, self.bends
        )

    def at(self, number: int) -> Predictions:
        """The end's phasor where it fills the pixel."""
        return self._open[number - _OPEN] if number >= _OPEN else self.here[number]

    def seen(self, number: int, row: FloatArray, col: FloatArray) -> Predictions:
        """The end's phasor from a place off the middle of the pixel."""
        if number >= _OPEN:
            return self._open[number - _OPEN]
        return predict(self.neighbours, number, row, col, image=self.image, seeds=self.seeds)

    def scatter(self, number: int, phasor: ComplexArray, along: ComplexArray) -> FloatArray:
        """Variance (n,) of the end's samples along unit vectors; `phasor` is the end's own."""
        if number >= _OPEN:
            return np.full(len(self.pixels), self._scatter[number - _OPEN])
        tangential, radial = (
            part[:, number] for part in (self.neighbours.scatter_tangential, self.neighbours.scatter_radial)
        )
        return variance_along(polar_covariance(phasor, tangential, radial), along)

    def apart(self, one: int, other: int) -> BoolArray:
        """Whether two ends are far enough apart to be separated."""
        if other >= _OPEN:
            return np.ones(len(self.pixels), bool)
        return _are_apart(self.at(one), self.at(other), self.settings)

    def may_be_apart(self, one: int, other: int) -> BoolArray:
        """Whether two ends, whose errors leave that open, may be far enough apart: such a pair is not known."""
        if other >= _OPEN or not self.bends:
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
        if other < _OPEN:
            row, col = row - self.neighbours.row[:, other], col - self.neighbours.col[:, other]
        length = np.maximum(np.hypot(row, col), _TINY)
        return row / length, col / length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Chord:
    """A pair in each pixel: share of the first end, its variance, log density, and both ends as seen."""

    share: FloatArray
    variance: FloatArray
    log_density: FloatArray
    one: Predictions
    other: Predictions


def _chord(ends: _Ends, one: int, other: int, plane: DistantPlane | None = None) -> _Chord:
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
        variance = 1.0 / np.maximum(inverse_form(covariance, chord, chord), _TINY)
        share = inverse_form(covariance, chord, offset) * variance
    across = offset - share * chord
    length = np.maximum(np.abs(chord), _TINY)
    determinant = np.maximum(covariance[:, 0] * covariance[:, 1] - covariance[:, 2] ** 2, _TINY)
    broad = variance_along(covariance, chord / length)
    narrow = determinant / np.maximum(broad, _TINY)
    error = np.sqrt(variance)
    inside = ndtr(share / error) - ndtr((share - 1.0) / error)
    log_density = (
        -0.5 * inverse_form(covariance, across, across)
        - 0.5 * np.log(2.0 * math.pi * np.maximum(narrow, _TINY))
        - np.log(length)
        + np.log(np.maximum(inside, _TINY))
    )
    return _Chord(share=share, variance=variance, log_density=log_density, one=a, other=b)


def _elsewhere(ends: _Ends, plane: DistantPlane, row: FloatArray, col: FloatArray) -> Predictions:
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


def _put_distant_pairs(best: _Best, ends: _Ends, planes: tuple[DistantPlane, ...]) -> None:
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


def _near_chord(ends: _Ends, one: Predictions, other: Predictions) -> BoolArray:
    """Whether phasors lie so near the chord between two ends that a pair is worth a fit."""
    chord, offset = one.phasor - other.phasor, ends.phasor - other.phasor
    length = np.maximum(np.abs(chord), _TINY)
    share = (offset * np.conj(chord)).real / length**2
    across = np.abs((offset * np.conj(chord)).imag) / length
    noise = np.max(
        [ends.covariance[:, 0] + ends.covariance[:, 1], one.tangential + one.radial, other.tangential + other.radial],
        axis=0,
    )
    reach = 6.0 * np.sqrt(noise) + ends.settings.near_chord * length
    return np.asarray((across < reach) & (share > -reach / length) & (share < 1.0 + reach / length))


def _put_distant_pair(
    best: _Best, ends: _Ends, one: int, plane: DistantPlane, which: IntArray, total: FloatArray
) -> None:
    """Put the pair of one end and a large surface, of `which` of the pixels that are judged."""
    chord = _chord(ends, one, _OPEN, plane)
    possible = chord.share <= 1.0 - ends.settings.same_sigmas * np.sqrt(chord.variance)
    share, none = np.clip(chord.share, 0.0, 1.0), np.full(len(which), np.nan)
    best.put(
        Kind.PAIR,
        _log_share(ends.settings.distant_prior, possible * ends.chance[:, one], total),
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


def _put_pairs(best: _Best, ends: _Ends) -> None:
    """Two ends share the pixel; one of them at least is trusted. All kinds of open space are one end."""
    pairs, total = [], np.zeros(len(ends.pixels))
    spaces = tuple(range(_OPEN, ends.count))
    for one in range(MOST_SURFACES):
        for others in (*((other,) for other in range(one + 1, MOST_SURFACES)), spaces):
            if not others:
                continue
            other = others[0]
            possible = ends.found[:, one] & ends.found[:, other]
            possible &= ends.trusted[:, one] | (ends.trusted[:, other] & (other < _OPEN))
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
            _log_share(PRIORS[Kind.PAIR], chance, total[which]),
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


def _put_unseen(best: _Best, ends: _Ends, largest: float, prior: float) -> None:
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
        best.put(Kind.NEW, _log_share(prior, chances[:, one], total), log_density)


def unseen_log_density(phasor: ComplexArray, seen: ComplexArray, error: FloatArray, largest: float) -> FloatArray:
    """Log density (n,) of phasors z of pixels that a known surface, of phasors a, shares with an unseen one, nat.

    z = (1 - v) a + v b, with the share v of the unseen surface uniform, and its phasor b uniform in the disc of radius
    L = `largest`: the density is the integral of 1 / (pi L^2 v^2) over all v that leave b in the disc, from v_0 to 1.
    `error` is the mean square of z - a by errors of both.
    """
    offset = phasor - seen
    free = np.maximum(largest**2 - np.abs(seen) ** 2, _TINY)
    along = (np.conj(seen) * offset).real
    square = np.abs(offset) ** 2 + error
    least = np.clip((along + np.sqrt(along**2 + free * square)) / free, _TINY, 1.0)
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


def _noise_along(ends: _Ends, one: int, other: int, chord: _Chord, share: FloatArray) -> FloatArray:
    """Variance (n,) along the chord of a pair's samples, by noise alone."""
    difference = chord.one.phasor - chord.other.phasor
    along = difference / np.maximum(np.abs(difference), _TINY)
    first = ends.scatter(one, chord.one.phasor, along)
    return np.asarray(share * first + (1.0 - share) * ends.scatter(other, chord.other.phasor, along))


def _put_triples(best: _Best, ends: _Ends) -> None:
    """Three trusted ends share the pixel: barycentric coordinates of its phasor in their triangle are the shares."""
    triples, total = [], np.zeros(len(ends.pixels))
    spread = np.sqrt(0.5 * (ends.covariance[:, 0] + ends.covariance[:, 1]))
    for a in range(MOST_SURFACES):
        for b in range(a + 1, MOST_SURFACES):
            for c in range(b + 1, min(ends.count, _OPEN + 1)):
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
            _log_share(PRIORS[Kind.TRIPLE], chance, total),
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
    area = np.where(np.abs(area) > _TINY, area, _TINY)
    first = ((b - phasor) * np.conj(c - phasor)).imag / area
    second = ((c - phasor) * np.conj(a - phasor)).imag / area
    shares = np.column_stack([first, second, 1.0 - first - second])
    sides = np.column_stack([np.abs(b - c), np.abs(c - a), np.abs(a - b)])
    errors = np.maximum(spread[:, np.newaxis] * sides / np.abs(area)[:, np.newaxis], _TINY)
    inside = ndtr(shares / errors).prod(axis=1)
    return shares, errors, np.log(np.maximum(inside, _TINY)) - np.log(0.5 * np.abs(area))
