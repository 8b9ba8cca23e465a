"""Surfaces that a pixel may see: those of the pixels around, and large ones from elsewhere in the image.

The neighbouring surfaces of a pixel, continued to it.

Each one-surface pixel nearby predicts 1 / r at the pixel in question by its own plane. Predictions that agree are of
one surface; a plane is then fitted to all its pixels in a window of 9 x 9, the pixel in question left out. No surface
is followed over the image, so creases, open doors and curved objects need no special rule.

Planes of the large surfaces in an image: a wall that shows again behind a gap one pixel wide is the same wall.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.image.segments import components
from tofmix.unmixing.image import ComplexArray, PhasorImage
from tofmix.unmixing.seeds import Seeds
from tofmix.unmixing.settings import DEFAULT_SETTINGS, NeighbourSettings, PlaneSettings
from tofmix.unmixing.surface_fit import MOST_SURFACES, Members, NeighbourSurfaces, fill_surfaces


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DistantPlane:
    """A large surface.

    Parameters
    ----------
    plane : (3,) float64
        m of 1 / r = m . d, 1 / mm.
    covariance : (3, 3) float64
        Of m.
    log_light : float
        Median of u = ln A + 3 ln r.
    light_variance : float
        Variance of u over the surface.
    """

    plane: FloatArray
    covariance: FloatArray
    log_light: float
    light_variance: float


def distant_planes(
    image: PhasorImage, seeds: Seeds, line: IntArray, settings: PlaneSettings
) -> tuple[DistantPlane, ...]:
    """Find the planes of large surfaces: random sample consensus within connected regions of one-surface pixels.

    The pixels of narrow surfaces, of numbers `line` (pixel,) from 0 on, are one region: a wall behind slats shows in
    the gaps alone. Any two lines may lie on one plane, so a plane is taken from three and more. Each pixel of a triple
    is of another narrow surface. These are drawn by their lengths: slats are wider than the gaps between them.
    Triples are drawn with a fixed seed: the same image gives the same planes.

    References
    ----------
    Fischler and Bolles, Communications of the ACM 24, 1981, doi:10.1145/358669.358692.
    """
    region = _regions(image, seeds, settings.inlier_sigmas)
    certain = np.flatnonzero(seeds.certain)
    rng = np.random.default_rng(0)
    sizes = np.bincount(region[certain], minlength=int(region.max()) + 1)
    regions = [
        certain[region[certain] == number] for number in np.argsort(-sizes, kind="stable")[: settings.most_regions]
    ]
    found = []
    lines = np.flatnonzero(line >= 0)
    for tries, pixels in (*((settings.tries, one) for one in regions), (settings.line_tries, lines)):
        is_narrow, left = pixels is lines, pixels
        for _ in range(settings.most_planes):
            inliers = _consensus(image, seeds, left, line if is_narrow else None, rng, tries, settings)
            if inliers is None or (
                is_narrow and not _is_tested(line, left[inliers], image.shape, settings.least_width)
            ):
                break
            found.append(_fitted(image, seeds, left[inliers], settings.extrapolated))
            left = left[~inliers]
    return tuple(found)


def _lines_on(
    image: PhasorImage, seeds: Seeds, pixels: IntArray, inliers: BoolArray, line: IntArray, settings: PlaneSettings
) -> tuple[BoolArray, int]:
    """Inliers (n,) whose narrow surfaces lie on a plane for the most part, with one light; and how many those are.

    Slats of several surfaces may lie on a plane, too.
    """
    step = settings.light_slope * image.pitch[pixels] + settings.light_step
    sigma = np.sqrt(image.light_variance[pixels] + seeds.texture_variance + step**2)
    off = image.log_light[pixels] - np.median(image.log_light[pixels[inliers]])
    fits = inliers & (np.abs(off) < settings.inlier_sigmas * sigma)
    most = 2 * np.bincount(line[pixels[fits]], minlength=image.count) > np.bincount(line[pixels], minlength=image.count)
    return fits & most[line[pixels]], int(most.sum())


def _by_length(line: IntArray, pixels: IntArray, shape: tuple[int, int]) -> FloatArray:
    """Chances (n,) of pixels, so that narrow surfaces are drawn by their lengths along rows or columns."""
    row, col = np.divmod(pixels, shape[1])
    numbers, of = np.unique(line, return_inverse=True)
    length = np.zeros(len(numbers))
    for place in (row, col):
        first, last = np.full(len(numbers), np.inf), np.full(len(numbers), -np.inf)
        np.minimum.at(first, of, place)
        np.maximum.at(last, of, place)
        length = np.maximum(length, last - first + 1.0)
    return np.asarray((length / np.bincount(of))[of])


def _of_different_lines(line: IntArray, chances: FloatArray, rng: np.random.Generator) -> IntArray:
    """Three pixels of different narrow surfaces; of the same ones again where there are fewer than three."""
    triple = np.empty(3, np.int64)
    left = chances
    for k in range(3):
        left = left if left.any() else chances
        triple[k] = rng.choice(len(line), p=left / left.sum())
        left = np.where(line == line[triple[k]], 0.0, left)
    return triple


def _is_tested(line: IntArray, pixels: IntArray, shape: tuple[int, int], least_width: float) -> bool:
    """Whether the pixels of a plane are of several narrow surfaces, as wide together as tests a plane."""
    row, col = np.divmod(pixels, shape[1])
    numbers, width = np.unique(line[pixels]), 0.0
    for number in numbers:
        own = line[pixels] == number
        width += np.count_nonzero(own) / max(np.ptp(row[own]) + 1, np.ptp(col[own]) + 1)
    return bool(len(numbers) > 1 and width >= least_width)


def _regions(image: PhasorImage, seeds: Seeds, most_sigmas: float) -> IntArray:
    """Number (pixel,) of the connected region: neighbours belong together where their planes predict each other."""
    index = np.arange(image.count).reshape(image.shape)
    near = 1.0 / image.range_mm
    sigma = 1.5 * np.sqrt(image.range_variance + seeds.pattern_variance) * near**2

    def linked(one: IntArray, other: IntArray) -> BoolArray:
        forth = np.abs((seeds.plane[one] * image.directions[other]).sum(axis=-1) - near[other])
        back = np.abs((seeds.plane[other] * image.directions[one]).sum(axis=-1) - near[one])
        both = seeds.certain[one] & seeds.certain[other]
        return np.asarray(both & (forth < most_sigmas * sigma[other]) & (back < most_sigmas * sigma[one]))

    pairs = [(index[:, :-1].ravel(), index[:, 1:].ravel()), (index[:-1].ravel(), index[1:].ravel())]
    kept = [(one[mask], other[mask]) for one, other in pairs for mask in (linked(one, other),)]
    one, other = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return components(one, other, image.count)


def _sigmas(image: PhasorImage, seeds: Seeds, pixels: IntArray) -> FloatArray:
    """Standard deviation (n,) of 1 / r, 1 / mm."""
    variance = image.range_variance[pixels] + seeds.pattern_variance
    return np.sqrt(np.maximum(variance, np.finfo(float).tiny)) / image.range_mm[pixels] ** 2


def _consensus(
    image: PhasorImage,
    seeds: Seeds,
    pixels: IntArray,
    line: IntArray | None,
    rng: np.random.Generator,
    tries: int,
    settings: PlaneSettings,
) -> BoolArray | None:
    """Pixels of the plane that most of them lie on, or with `line` most narrow surfaces; None if they are too few."""
    if len(pixels) < settings.least_pixels:
        return None
    beams, near = image.directions[pixels], 1.0 / image.range_mm[pixels]
    reach = settings.inlier_sigmas * _sigmas(image, seeds, pixels)
    best, most = np.zeros(len(pixels), bool), 0
    chances = None if line is None else _by_length(line[pixels], pixels, image.shape)
    for _ in range(tries):
        triple = (
            rng.choice(len(pixels), 3, replace=False)
            if line is None or chances is None
            else _of_different_lines(line[pixels], chances, rng)
        )
        # Three beams that lie in a plane with each other tell no plane.
        if abs(np.linalg.det(beams[triple])) < np.finfo(float).eps:
            continue
        inliers = np.abs(beams @ np.linalg.solve(beams[triple], near[triple]) - near) < reach
        lines = 0
        if line is not None and inliers.any():
            inliers, lines = _lines_on(image, seeds, pixels, inliers, line, settings)
        if (lines, inliers.sum()) > (most, best.sum()):
            best, most = inliers, lines
    for _ in range(3):
        if best.sum() < settings.least_pixels:
            return None
        plane, _ = _least_squares(image, seeds, pixels[best])
        best = np.abs(beams @ plane - near) < reach
        if line is not None:
            best, _ = _lines_on(image, seeds, pixels, best, line, settings)
    return best if best.sum() >= settings.least_pixels else None


def _least_squares(image: PhasorImage, seeds: Seeds, pixels: IntArray) -> tuple[FloatArray, FloatArray]:
    """Vector m (3,) of the pixels' plane, and its covariance (3, 3)."""
    beams, near = image.directions[pixels], 1.0 / image.range_mm[pixels]
    sigma = _sigmas(image, seeds, pixels)
    weighted = beams / sigma[:, np.newaxis] ** 2
    normal = np.einsum("ni,nk->ik", weighted, beams)
    covariance = np.linalg.pinv(normal, hermitian=True)
    plane = covariance @ np.einsum("ni,n->i", weighted, near)
    excess = float((((beams * plane).sum(axis=-1) - near) ** 2 / sigma**2).mean())
    return plane, covariance * max(1.0, excess)


def _fitted(image: PhasorImage, seeds: Seeds, pixels: IntArray, extrapolated: float) -> DistantPlane:
    plane, covariance = _least_squares(image, seeds, pixels)
    light = image.log_light[pixels]
    middle = float(np.median(light))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(light - middle)))
    return DistantPlane(plane=plane, covariance=extrapolated * covariance, log_light=middle, light_variance=spread**2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predictions:
    """Returns of surfaces that fill a pixel, or a part of it. Arrays are (n,), one for each pixel.

    Parameters
    ----------
    phasor : complex128
        z.
    tangential, radial : float64
        Its variances across and along its direction, of the fit, the fixed pattern and the texture.
    range_mm, range_variance : float64
        Range, mm, and its variance, mm^2.
    """

    phasor: ComplexArray
    tangential: FloatArray
    radial: FloatArray
    range_mm: FloatArray
    range_variance: FloatArray


def phasor_of(
    near: FloatArray,
    near_variance: FloatArray,
    light: FloatArray,
    light_variance: FloatArray,
    *,
    image: PhasorImage,
    seeds: Seeds,
) -> Predictions:
    """Phasors (n,) of surfaces, from 1 / r (1 / mm), u, and their variances."""
    least_near = 1.0e-7  # 1 / mm: no surface is farther than 10 km
    range_mm = 1.0 / np.maximum(near, least_near)
    range_variance = near_variance * range_mm**4 + seeds.pattern_variance
    # Logarithm of the largest amplitude, in units of the image's median: an extrapolation must not overflow.
    most_log = 10.0
    amplitude = np.exp(np.minimum(light - 3.0 * np.log(range_mm), most_log))
    radial = light_variance + seeds.texture_variance + 9.0 * range_variance / range_mm**2
    return Predictions(
        phasor=amplitude * np.exp(1j * range_mm / image.scale_mm),
        tangential=amplitude**2 * range_variance / image.scale_mm**2,
        radial=amplitude**2 * radial,
        range_mm=range_mm,
        range_variance=range_variance,
    )


def predict(
    surfaces: NeighbourSurfaces, number: int, rows: FloatArray, cols: FloatArray, *, image: PhasorImage, seeds: Seeds
) -> Predictions:
    """Returns of the surfaces of a number from places (n,), `rows` and `cols` off the pixels."""
    at = np.stack([np.ones_like(rows), cols, rows], axis=-1)

    def value(coefficients: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = (coefficients[:, number] * at).sum(axis=-1)
        return mean, np.einsum("ni,nik,nk->n", at, covariance[:, number], at)

    near, near_variance = value(surfaces.near, surfaces.near_covariance)
    light, light_variance = value(surfaces.light, surfaces.light_covariance)
    return phasor_of(near, near_variance, light, light_variance, image=image, seeds=seeds)


def find_neighbours(
    image: PhasorImage,
    pixels: IntArray,
    members: Members,
    seeds: Seeds,
    settings: NeighbourSettings = DEFAULT_SETTINGS.neighbours,
) -> NeighbourSurfaces:
    """Find the neighbouring surfaces of pixels (n,)."""
    shape = (len(pixels), MOST_SURFACES)
    vectors, matrices = (*shape, 3), (*shape, 3, 3)
    out = NeighbourSurfaces(
        found=np.zeros(shape, bool),
        near=np.zeros(vectors),
        near_covariance=np.zeros(matrices),
        light=np.zeros(vectors),
        light_covariance=np.zeros(matrices),
        is_known=np.zeros(shape, bool),
        is_trusted=np.zeros(shape, bool),
        is_fresh=np.zeros(shape, bool),
        row=np.zeros(shape),
        col=np.zeros(shape),
        touches=np.zeros(shape, bool),
        noise_radial=np.zeros(shape),
        noise_tangential=np.zeros(shape),
        scatter_radial=np.zeros(shape),
        scatter_tangential=np.zeros(shape),
    )
    fill_surfaces(
        pixels,
        *image.shape,
        image.beams,
        image.measured,
        members,
        seeds.pattern_variance,
        seeds.texture_variance,
        out,
        settings,
    )
    return out
