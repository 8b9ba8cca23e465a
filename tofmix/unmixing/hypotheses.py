"""Hypotheses for the mean phasor of a pixel: none, one, two or three surfaces. Bayes' rule over their kinds.

- NEW: a surface that no neighbour shows. Its phasor is uniform in the disc of the image's amplitudes.
- CONTINUED: a neighbouring surface, or a large one elsewhere in the image, fills the pixel. The phasor is Gaussian
  about the surface's own. The surface may also have another reflectance here: the phase is Gaussian, the amplitude
  uniform.
- PAIR: two surfaces share the pixel. The phasor lies on the chord between theirs: Gaussian across, uniform along it.
  One of them may be a large surface that is seen elsewhere alone, as a wall in a gap narrower than a pixel.
- TRIPLE: three of them. It lies in their triangle.
- EMPTY: open space fills the pixel, and noise gave samples. The phasor is Gaussian about that of open space.

Open space is an end like a surface: of phasor 0, as in a sum, or of the camera's return from open space, as under
equation (1). The noise of a single surface equals that of its neighbours. Under equation (1), further scatter is along
the chord, and belongs to the pair.
"""

import math

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.unmixing.chords import Ends, put_distant_pairs, put_pairs, put_triples, put_unseen
from tofmix.unmixing.image import TINY, PhasorImage, polar_covariance, variance_along
from tofmix.unmixing.likeliest import (
    PRIORS,
    Best,
    Kind,
    LikeliestHypotheses,
    OpenSpace,
    log_normal,
    log_share,
    place_chance,
)
from tofmix.unmixing.neighbours import DistantPlane, Predictions, find_neighbours, phasor_of, predict
from tofmix.unmixing.seeds import Seeds, plane_vector
from tofmix.unmixing.settings import HypothesisSettings, NeighbourSettings
from tofmix.unmixing.surface_fit import MOST_SURFACES, Members, NeighbourSurfaces


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
    best = Best(len(pixels), settings.likely)
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
    ends = Ends(image, pixels, neighbours, here, seeds, spaces, settings, bends)
    put_pairs(best, ends)
    put_unseen(best, ends, largest, PRIORS[Kind.PAIR] * unseen)
    put_triples(best, ends)
    put_distant_pairs(best, ends, planes)
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


def _put_continued(
    best: Best,
    image: PhasorImage,
    pixels: IntArray,
    neighbours: NeighbourSurfaces,
    here: list[Predictions],
    largest: float,
    aside: float,
) -> None:
    """A trusted neighbouring surface fills the pixel, with its light or with any light."""
    phasor = image.phasor[pixels]
    chances = place_chance(neighbours, aside) * (neighbours.found & neighbours.is_trusted)
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
            log_share(PRIORS[Kind.CONTINUED], chance, total),
            log_normal(phasor - seen.phasor, polar_covariance(seen.phasor, tangential, radial)),
            plane=plane,
            is_fresh=neighbours.is_fresh[:, k],
        )
        along = seen.phasor / np.maximum(np.abs(seen.phasor), TINY)
        turned = phasor * np.conj(along)
        # With other light the noise is other, too: the pixel's own.
        own = variance_along(image.mean_covariance[pixels], 1j * along)
        across = own + seen.tangential * (np.abs(phasor) / np.abs(seen.phasor)) ** 2
        log_density = -0.5 * turned.imag**2 / across - 0.5 * np.log(2.0 * math.pi * across) - math.log(largest)
        best.put(
            Kind.OTHER_REFLECTANCE,
            log_share(PRIORS[Kind.OTHER_REFLECTANCE], chance * (turned.real > 0), total),
            log_density,
            plane=plane,
            is_fresh=neighbours.is_fresh[:, k],
        )


def _put_distant(
    best: Best,
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
            log_share(prior, even > 0, even * len(planes)),
            log_normal(phasor - seen.phasor, covariance),
            plane=np.broadcast_to(plane.plane, (len(pixels), 3)),
            is_distant=even > 0,
        )


def _put_empty(best: Best, image: PhasorImage, pixels: IntArray, spaces: tuple[OpenSpace, ...]) -> None:
    """Open space fills the pixel."""
    only = np.tile([1.0, np.nan, np.nan], (len(pixels), 1))
    for space in spaces:
        best.put(
            Kind.EMPTY,
            log_share(PRIORS[Kind.EMPTY], space.nearby[pixels], np.full(len(pixels), float(len(spaces)))),
            space.log_density(image, pixels),
            range_mm=only * np.inf,
            range_variance=only * 0.0,
            share=only,
            share_variance=only * 0.0,
        )
