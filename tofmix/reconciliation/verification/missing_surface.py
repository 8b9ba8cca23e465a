"""A surface that samples show and the model lacks: a box before a wall, a person, a table.

Use `missing_surface` after a search that explains nothing: it takes samples where the model predicts none, and the
rectangle that stands for them. It gives none where the model's own surface appears nowhere where it is predicted: then
this surface is elsewhere, and its pose is the fault.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.evidence import LEAST_PIXELS
from tofmix.reconciliation.found import ALIAS_NATS
from tofmix.reconciliation.likelihood.hidden_states import begin
from tofmix.reconciliation.likelihood.joint import RecordingView
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface, surface_along

_FAR, _MOSTLY = 5.0, 0.8
"""Sigma from every predicted surface of a sample that is of none; least share of the pixels that a plane describes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingSurface:
    """A rectangle where the model has none, and the pixels that show it.

    Parameters
    ----------
    surface : Surface
        The rectangle.
    recording : int
        From 0.
    pixels : int
        Their number.
    rows, cols : (int, int)
        The first and the last of their rows and columns.
    share : float
        Of their samples that lie there.
    range_mm : float
        Median of these.
    gain_nats : float
        Of the log-likelihood by this rectangle.
    """

    surface: Surface
    recording: int
    pixels: int
    rows: tuple[int, int]
    cols: tuple[int, int]
    share: float
    range_mm: float
    gain_nats: float


def missing_surface(view: RecordingView, model: Model, settings: Settings) -> MissingSurface | None:
    """The largest surface that the samples of a recording show and its model lacks, if any.

    Parameters
    ----------
    view : RecordingView
        The recording, with the prediction of the model.
    model : Model
        The model, with the effects that are named.
    settings : Settings
        Of the search.
    """
    m = view.mixture
    if model.scene is not None or len(m.weight) > 1:  # of a measured scene, and where the model moves, another law
        return None
    share, range_mm = unpredicted(view)
    mostly = 0.5  # of a pixel's samples
    pixels = _largest((share > mostly).reshape(view.evidence.image))
    if pixels is None or not (_else_as_predicted(view, pixels, share) and has_edge(view, pixels)):
        return None
    rows, cols = (np.flatnonzero(pixels.any(axis=axis)) for axis in (1, 0))
    own = np.flatnonzero(pixels)
    surface = _rectangle(view, own, share, range_mm)
    if surface is None:
        return None
    gain = likelihood_gain(view, model, replace(model, surfaces=(*model.surfaces, surface)), settings)
    numbers = 7
    if gain < 0.5 * numbers * math.log(view.evidence.samples.size) + ALIAS_NATS:
        return None
    return MissingSurface(
        surface=surface,
        recording=view.number,
        pixels=own.size,
        rows=(int(rows[0]), int(rows[-1])),
        cols=(int(cols[0]), int(cols[-1])),
        share=float(share[own].mean()),
        range_mm=float(np.median(range_mm[own])),
        gain_nats=gain,
    )


def unpredicted(view: RecordingView, reach: float = _FAR) -> tuple[FloatArray, FloatArray]:
    """Share (pixel,) of each pixel's samples in the densest place where none is predicted, and the median there, mm."""
    m, samples = view.mixture, view.evidence.samples
    noise = view.scene.model.sensor.noise_at(view.scene.model.sensor.integration_time_ms)
    share, range_mm = np.zeros(samples.shape[1]), np.full(samples.shape[1], np.nan)
    least = 2  # samples of a place
    for pixel in range(samples.shape[1]):
        seen = np.sort(samples[samples[:, pixel] > 0, pixel].astype(np.float64))
        lit = m.lit[0, :, pixel] & (m.weight[0, :, pixel] > 0)
        off = m.near_turn(seen[:, None] - m.mean[0, lit, pixel])
        away = seen[(np.abs(off) > reach * m.sigma[0, lit, pixel]).all(axis=1)]
        if away.size < least:
            continue
        wide = 2.0 * reach * float(noise.sigma(np.array([np.median(away)]))[0])
        first = np.arange(away.size)
        last = np.searchsorted(away, away + wide, side="right")
        best = int((last - first).argmax())
        share[pixel] = (last[best] - best) / seen.size
        range_mm[pixel] = np.median(away[best : last[best]])
    return share, range_mm


def _largest(image: BoolArray) -> BoolArray | None:
    """The largest connected part of an image; None if it has too few pixels for a size."""
    least = 4
    parts, _ = label(image)
    sizes = np.bincount(parts.ravel())[1:]
    if not sizes.size or sizes.max() < least:
        return None
    return np.asarray(parts == 1 + int(sizes.argmax()))


def _else_as_predicted(view: RecordingView, pixels: BoolArray, share: FloatArray) -> bool:
    """Whether the surfaces that are predicted in these pixels appear in most others where they are predicted."""
    main, inside = view.mixture.of_main(view.mixture.surface), pixels.ravel()
    near = binary_dilation(pixels).ravel()
    for number in np.unique(main[inside & (main >= 0)]):
        others = (main == number) & ~near
        little = 0.5  # of a pixel's samples
        if others.sum() < LEAST_PIXELS or float((share[others] < little).mean()) < _MOSTLY:
            return False
    return True


def has_edge(view: RecordingView, pixels: BoolArray) -> bool:
    """Whether ranges jump at the edge of these pixels: a bias that is smooth over the image goes on beyond."""
    m, samples = view.mixture, view.evidence.samples
    told = m.of_main(m.lit) & (samples > 0).any(axis=0)
    ring, inside = (binary_dilation(pixels) & ~pixels).ravel() & told, pixels.ravel() & told
    if not (ring.any() and inside.any()):
        return True
    means = m.of_main(m.mean)

    def off(own: BoolArray) -> float:
        seen = np.where(samples[:, own] > 0, samples[:, own], np.nan)
        return float(np.nanmedian(np.abs(m.near_turn(np.nanmedian(seen, axis=0) - means[own]))))

    return off(ring) < 0.5 * off(inside)


def _rectangle(view: RecordingView, own: IntArray, share: FloatArray, range_mm: FloatArray) -> Surface | None:
    """The upright rectangle of the plane of some pixels, by the moments of its shares; None if no plane fits."""
    beams, sensor = view.scene.beams, view.scene.model.sensor
    sigma = sensor.noise_at(sensor.integration_time_ms).sigma(range_mm[own])
    plane = _plane(beams[own], range_mm[own], sigma)
    along = beams @ plane
    if (along <= 0).any():
        return None
    fits = np.abs(range_mm[own] - 1.0 / along[own]) < _FAR * sigma
    if float(fits.mean()) < _MOSTLY:
        return None
    normal = plane / np.linalg.norm(plane)
    upright = 0.1  # of the sine between normal and vertical, below which the x axis is level
    u = np.cross((0.0, 1.0, 0.0), normal)
    u = np.array((1.0, 0.0, 0.0)) - normal[0] * normal if np.linalg.norm(u) < upright else u
    u /= np.linalg.norm(u)
    axes = np.stack([u, np.cross(normal, u), normal], axis=1)
    points = beams / along[:, None]
    near = binary_dilation(_image(own, view), structure=np.ones((3, 3), dtype=np.bool_)).ravel()
    there = near & (np.abs(np.nan_to_num(range_mm) - 1.0 / along) < _FAR * float(np.median(sigma)))
    centre, size = _moments((points @ axes[:, :2]).reshape(*view.evidence.image, 2), np.where(there, share, 0.0))
    at = axes[:, :2] @ centre + normal / np.linalg.norm(plane)
    names = {s.name for s in view.scene.model.surfaces}
    name = next(n for n in ("added", *(f"added {k}" for k in range(2, len(names) + 3))) if n not in names)
    return _written(surface_along(name, center_mm=at, size_mm=size, axes=axes))


def _image(own: IntArray, view: RecordingView) -> BoolArray:
    image = np.zeros(view.evidence.shape[1], dtype=np.bool_)
    image[own] = True
    return image.reshape(view.evidence.image)


def _plane(beams: FloatArray, range_mm: FloatArray, sigma: FloatArray) -> FloatArray:
    """The vector p of the plane p . x = 1, upright before the camera unless its tilts are clear.

    1 / r = p . d for beams d: linear in p. A tilt is clear by the evidence that the logarithm of the number of pixels
    asks for, and `ALIAS_NATS`.
    """
    weight = range_mm**2 / sigma
    inverse = weight / range_mm
    tilted = np.linalg.lstsq(beams * weight[:, None], inverse, rcond=None)[0]
    facing = np.array([0.0, 0.0, float((weight * beams[:, 2]) @ inverse / ((weight * beams[:, 2]) ** 2).sum())])
    left = [float(((weight * (beams @ p) - inverse) ** 2).sum()) for p in (facing, tilted)]
    gain = 0.5 * beams.shape[0] * math.log(max(left[0], 1e-12) / max(left[1], 1e-12))
    clear = len(beams) >= LEAST_PIXELS and gain > math.log(len(beams)) + ALIAS_NATS
    return np.asarray(tilted) if clear else facing


def _moments(place: NDArray[np.float64], share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (2,) and size (2,) of the rectangle with the moments of shares (pixel,) at places (row, col, 2).

    A share is a mean over the pixel: it adds the variance of a pixel's place, a twelfth of its squared size.
    """
    by_row, by_col = (np.gradient(place, axis=axis) for axis in (0, 1))
    area = np.abs(by_row[..., 0] * by_col[..., 1] - by_row[..., 1] * by_col[..., 0]).ravel()
    weight = area * share / (area * share).sum()
    points = place.reshape(-1, 2)
    centre = weight @ points
    pitch = weight @ (by_row**2 + by_col**2).reshape(-1, 2)
    size = np.sqrt(np.maximum(12.0 * (weight @ (points - centre) ** 2) - pitch, pitch))
    return centre, size


def _written(surface: Surface) -> Surface:
    """The surface with the digits that are written."""
    x, y, z = (round(v, 1) for v in surface.center_mm)
    width, height = (round(v, 1) for v in surface.size_mm)
    angles = {name: round(getattr(surface, name), 2) + 0.0 for name in ("yaw_deg", "pitch_deg", "roll_deg")}
    return replace(surface, center_mm=(x, y, z), size_mm=(width, height), **angles)


def likelihood_gain(view: RecordingView, model: Model, other: Model, settings: Settings) -> float:
    """Log-likelihood of the other model minus that of the first, nats, of the samples that fits use."""
    return _log_likelihood(view, other, settings) - _log_likelihood(view, model, settings)


def _log_likelihood(view: RecordingView, model: Model, settings: Settings) -> float:
    likelihood = Likelihood(view.evidence, Scene(model, view.evidence.time_s))
    part = fit_part(likelihood, settings)
    state = begin(likelihood, part[0], settings.accepted(likelihood))
    return float(likelihood.marginal(likelihood.mixture(state), state, part).total)
