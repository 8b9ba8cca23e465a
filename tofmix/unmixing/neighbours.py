"""The neighbouring surfaces of a pixel, continued to it.

Each one-surface pixel nearby predicts 1 / r at the pixel in question by its own plane. Predictions that agree are of
one surface; a plane is then fitted to all its pixels in a window of 9 x 9, the pixel in question left out. No surface
is followed over the image, so creases, open doors and curved objects need no special rule.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.unmixing.image import ComplexArray, PhasorImage
from tofmix.unmixing.seeds import Seeds
from tofmix.unmixing.settings import DEFAULT_SETTINGS, NeighbourSettings
from tofmix.unmixing.surface_fit import MOST_SURFACES, Members, NeighbourSurfaces, fill_surfaces


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
    range_mm = 1.0 / np.maximum(near, _LEAST_NEAR)
    range_variance = near_variance * range_mm**4 + seeds.pattern_variance
    amplitude = np.exp(np.minimum(light - 3.0 * np.log(range_mm), _MOST_LOG))
    radial = light_variance + seeds.texture_variance + 9.0 * range_variance / range_mm**2
    return Predictions(
        phasor=amplitude * np.exp(1j * range_mm / image.scale_mm),
        tangential=amplitude**2 * range_variance / image.scale_mm**2,
        radial=amplitude**2 * radial,
        range_mm=range_mm,
        range_variance=range_variance,
    )


_LEAST_NEAR = 1.0e-7
"""1 / mm: no surface is farther than 10 km."""

_MOST_LOG = 10.0
"""Logarithm of the largest amplitude, in units of the image's median: an extrapolation must not overflow."""


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
