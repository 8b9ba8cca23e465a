"""A patch and its light together: brightness tells how steeply a surface is seen, and so where its limb is.

    ln A = c + s . x + (1 + gamma) ln cos(theta) - 2 ln r,   gamma ~ N(0, 0.15^2),

with slopes s of a hundredth a pixel. The numbers of patch and light are fitted at once: fitted after the patch,
gamma would absorb the patch's errors.
"""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.patch import PLACES_9, STATE, WEIGHTS_9, Patches, TangentFrame, meet, scaled_inverse
from tofmix.image.segments import View

STATES = STATE + 4
"""Numbers of a patch with its light: those of the patch, c, two slopes (a pixel), gamma."""

_GAMMA = 0.15  # standard deviation: light between cos^0.7 and cos^1.3
_SLOPE = 0.01  # a pixel
_LARGEST_STEP = np.array([10.0, 0.05, 0.05, *np.full(STATE - 3, 1e-3)])
"""In mm, 1 and 1 / mm: rays still meet the patch."""
_LEAST = 3  # pixels
_ROUGH = 0.004  # of ln A: what no law of light is exact to
_GRAZING = 0.002  # the same in units of 1 / cos(theta)^2
_OWN_PART = 0.1  # of the cubic terms' variance, that each pixel has on its own
_HUBER = 4.0  # standard errors, beyond which a pixel counts less


class Lit(NamedTuple):
    """Patches with their light.

    Parameters
    ----------
    patches : Patches
        The patches.
    state, covariance : (n, 13) and (n, 13, 13) float64
        Numbers of patch and light.
    fitted : (n,) bool
        Whether enough of the pixels have light.
    """

    patches: Patches
    state: FloatArray
    covariance: FloatArray
    fitted: BoolArray


def with_light(view: View, at: IntArray, patches: Patches) -> Lit:
    """Fit patches and light to the amplitudes of the patches' members.

    Parameters
    ----------
    view : View
        The image.
    at : (n,) int64
        Pixels in question.
    patches : Patches
        From `fit_patches`: prior of its numbers.
    """
    kept = patches.kept
    pixel = np.where(kept, patches.members, 0)
    n, _ = pixel.shape
    cols = view.shape[1]
    down = pixel // cols - (at // cols)[:, np.newaxis]
    right = pixel % cols - (at % cols)[:, np.newaxis]
    ray = view.direction[pixel]
    state = np.zeros((n, STATES))
    state[:, :STATE] = patches.state
    corrected, usable = _middle_light(view, patches, pixel, ray)
    usable &= kept
    sd = np.sqrt(patches.covariance[:, range(STATE), range(STATE)])
    prior = np.zeros((n, STATES, STATES))
    prior[:, :STATE, :STATE] = scaled_inverse(
        patches.covariance + 1e-9 * sd[:, :, np.newaxis] * sd[:, np.newaxis, :] * np.eye(STATE)
    )
    # the precision of c is small: it is free
    prior[:, range(STATE, STATES), range(STATE, STATES)] = (1e-6, _SLOPE**-2, _SLOPE**-2, _GAMMA**-2)
    first = _light(patches.frame, state[:, np.newaxis, :STATE], ray)[0][:, 0]
    state[:, STATE] = _median(corrected - first, usable & np.isfinite(first))
    start = state.copy()
    inflation, covariance = np.ones(n), scaled_inverse(prior)
    fitted = usable.sum(axis=1) >= _LEAST
    noise = view.amplitude_variance[pixel] + _ROUGH**2
    for number in range(2):  # two rounds of Gauss and Newton
        design, light, log_cosine, good = _linear(patches.frame, state, sd, ray, down, right, usable)
        fitted &= good.sum(axis=1) >= _LEAST
        residual = np.where(good, corrected - light - (design[..., STATE:] @ state[:, STATE:, np.newaxis])[..., 0], 0.0)
        cubic = _cubic(view, patches, pixel, log_cosine)
        variance = noise + (_GRAZING * np.exp(-2.0 * log_cosine)) ** 2 + _OWN_PART * (cubic**2).sum(axis=-1)
        whole = variance + (cubic**2).sum(axis=-1)
        size = np.sqrt(residual**2 / whole / inflation[:, np.newaxis])
        weight = good / np.maximum(1.0, size / _HUBER) / variance / inflation[:, np.newaxis]
        weighed = cubic * weight[..., np.newaxis]
        turned = np.swapaxes(weighed, 1, 2)
        inner = np.linalg.inv(np.eye(cubic.shape[-1]) + turned @ cubic)
        through = design * weight[..., np.newaxis] - weighed @ (inner @ (turned @ design))
        covariance = scaled_inverse(prior + np.swapaxes(through, 1, 2) @ design)
        slope = np.swapaxes(through, 1, 2) @ residual[..., np.newaxis] - prior @ (state - start)[..., np.newaxis]
        state = state + (covariance @ slope)[..., 0]
        if number == 0:
            light, log_cosine = (part[:, 0] for part in _light(patches.frame, state[:, np.newaxis, :STATE], ray))
            design[..., -1] = np.where(np.isfinite(log_cosine), log_cosine, 0.0)
            left = corrected - light - (design[..., STATE:] @ state[:, STATE:, np.newaxis])[..., 0]
            seen = good & np.isfinite(left)
            chi = np.where(seen, left**2 / whole, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1) - 4, 1)
            inflation = np.maximum(1.0, chi)
    fitted &= np.isfinite(state).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    return Lit(patches, state, covariance, fitted)


def _light(frame: TangentFrame, state: FloatArray, ray: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithm (n, sample, ray) of cos(theta) / r^2, and that of cos(theta)."""
    range_mm, cosine = meet(frame, state, ray)
    with np.errstate(all="ignore"):
        log_cosine = np.log(cosine)
        return log_cosine - 2.0 * np.log(range_mm), log_cosine


def _middle_light(view: View, patches: Patches, pixel: IntArray, ray: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Ln A (n, place) of the pixels' middles, by the patch from those of the pixels; where all of a pixel is hit."""
    n, places = pixel.shape
    inner = view.rays(pixel, PLACES_9).reshape(n, places * len(PLACES_9), 3)
    t, cosine = (part.reshape(n, places, -1) for part in meet(patches.frame, patches.state[:, np.newaxis], inner))
    middle, facing = (part[:, 0] for part in meet(patches.frame, patches.state[:, np.newaxis], ray))
    usable = np.isfinite(t).all(axis=-1) & np.isfinite(middle)
    with np.errstate(all="ignore"):
        turned = np.exp(1j * (t - middle[..., np.newaxis]) / view.scale_mm)
        whole = np.abs((WEIGHTS_9 * cosine / t**2 * turned).sum(axis=-1))
        correction = np.log(whole) - np.log(facing / middle**2)
    return view.log_amplitude[pixel] - np.where(usable, correction, 0.0), usable


def _linear(
    frame: TangentFrame,
    state: FloatArray,
    sd: FloatArray,
    ray: FloatArray,
    down: IntArray,
    right: IntArray,
    usable: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Design (n, place, 13) about states, ln(cos / r^2) and ln cos (n, place), and where all of it is known."""
    step = np.minimum(0.3 * sd, _LARGEST_STEP)  # of a standard deviation, for derivatives
    offsets = np.concatenate([np.eye(STATE), -np.eye(STATE), np.zeros((1, STATE))])
    several = state[:, np.newaxis, :STATE] + offsets * step[:, np.newaxis]
    light, log_cosine = _light(frame, several, ray)
    slope = (light[:, :STATE] - light[:, STATE : 2 * STATE]) / (2.0 * step[..., np.newaxis])
    middle, facing = light[:, -1], log_cosine[:, -1]
    good = usable & np.isfinite(middle) & np.isfinite(slope).all(axis=1)
    even = np.ones_like(middle)
    design = np.concatenate(
        [np.swapaxes(slope, 1, 2), np.stack([even, right * even, down * even, facing], axis=-1)], axis=-1
    )
    design = np.where(good[..., np.newaxis], design, 0.0)
    return design, np.where(good, middle, 0.0), np.where(good, facing, 0.0), good


def _cubic(view: View, patches: Patches, pixel: IntArray, log_cosine: FloatArray) -> FloatArray:
    """What the cubic terms do to ln cos(theta) (n, place, 3): they turn the slope."""
    points = view.range_mm[pixel][..., np.newaxis] * view.direction[pixel] - patches.frame.origin[:, np.newaxis]
    u, v = (np.matmul(points, part[:, :, np.newaxis])[..., 0] for part in (patches.frame.e1, patches.frame.e2))
    tangent = np.sqrt(np.maximum(np.exp(-2.0 * log_cosine) - 1.0, 0.0))
    return np.asarray(
        (patches.third[:, np.newaxis] * tangent)[..., np.newaxis] * np.stack([u * u / 2, u * v, v * v / 2], axis=-1)
    )


def _median(values: FloatArray, mask: BoolArray) -> FloatArray:
    """Lower median (n,) of the values (n, place) of a mask; 0 without one."""
    ordered = np.sort(np.where(mask, values, np.inf), axis=1)
    middle = np.maximum(mask.sum(axis=1) - 1, 0) // 2
    found = np.take_along_axis(ordered, middle[:, np.newaxis], axis=1)[:, 0]
    return np.where(np.isfinite(found), found, 0.0)
