"""From labels to layers: unmixed layers replace those of mixed pixels."""

from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.circle import fold
from tofmix.flags import MOST_UNDECIDED, Mixing, Status
from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.unmixing.hypotheses import Kind
from tofmix.unmixing.image import PhasorImage
from tofmix.unmixing.labels import Labels
from tofmix.unmixing.law import MixingLaw
from tofmix.unmixing.settings import DEFAULT_SETTINGS, UnmixSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rewritten:
    """Layers of one window after unmixing.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), with `mixing`.
    phasor_share : float
        q, share of the samples at edges that are phasor sums; NaN if no pixel determines it.
    informative_pixels : int
        Pixels that determine it.
    """

    layers: Layers
    phasor_share: float
    informative_pixels: int


def rewrite(
    layers: Layers,
    image: PhasorImage,
    labels: Labels,
    law: MixingLaw,
    sensor: Sensor,
    *,
    insist: bool,
    circle_mm: float | None = None,
    settings: UnmixSettings = DEFAULT_SETTINGS,
) -> Rewritten:
    """Write the surfaces of mixed pixels over layers.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), as samples of one surface each give them. They are not changed.
    image, labels, law
        Of the same window.
    sensor : Sensor
        Its noise curve gives sigma.
    insist : bool
        Whether all samples at edges are taken as phasor sums, for any measured q.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    settings : UnmixSettings
        Thresholds.

    Returns
    -------
    Rewritten
        Pixels whose samples are of one surface each are as they were.
    """
    shape = layers.shape
    sums = np.ones(image.count, bool) if insist else law.is_sum
    count = layers.n_modes.ravel()
    several = (count > 1) | ((count > 0) & (layers.weight_no_return.ravel() > 0))
    mixing = np.where(several, int(Mixing.EVENTS), int(Mixing.ONE_SURFACE)).astype(np.uint8)
    out = Layers(
        **{spec.name: getattr(layers, spec.name).copy() for spec in layers.fields}, mixing=mixing.reshape(shape)
    )
    if sums.any():
        mixed = np.isin(labels.kind, (Kind.PAIR, Kind.TRIPLE, Kind.EMPTY)) & image.valid
        ends = np.isfinite(labels.range_mm).sum(axis=1)
        decided = (
            mixed & labels.is_known & (labels.probability > settings.least_probability) & (ends <= layers.max_layers)
        )
        flat = out.reshaped((image.count,))
        _write(flat, decided & sums, image, labels, sensor, circle_mm, settings.most_fresh_probability)
        # One surface, says the mean; several, say the samples: as surfaces that move do, which scatter, or by chance.
        contradicted = labels.is_surface & several & (count > 1)
        known = (labels.kind == Kind.CONTINUED) & ~labels.is_fresh & (labels.probability > settings.curved.sure)
        by_chance = contradicted & known & image.valid & sums & ~image.is_noisier(settings.law.different_sigmas)
        contradicted &= ~by_chance
        _write(flat, by_chance, image, _alone(labels, image), sensor, circle_mm, settings.most_fresh_probability)
        flat.mixing[by_chance] = int(Mixing.ONE_SURFACE)  # type: ignore[index]  # it was just made
        _doubt(flat, image.valid & ~decided & sums & (count > 0) & (~labels.is_surface | contradicted))
        fresh = labels.is_surface & ((labels.kind == Kind.NEW) | labels.is_fresh) & sums
        flat.probability[fresh] = np.minimum(flat.probability[fresh], settings.most_fresh_probability)
    return Rewritten(layers=out, phasor_share=law.phasor_share, informative_pixels=law.pixels)


def _alone(labels: Labels, image: PhasorImage) -> Labels:
    """Labels with the return of a whole pixel as its only surface."""
    names = ("range_mm", "range_variance", "share", "share_variance")
    out = {name: np.full_like(getattr(labels, name), np.nan) for name in names}
    for name, values in zip(names, (image.range_mm, image.range_variance, 1.0, 0.0), strict=True):
        out[name][:, 0] = values
    return replace(labels, **out)


def _write(
    flat: Layers,
    pixels: BoolArray,
    image: PhasorImage,
    labels: Labels,
    sensor: Sensor,
    circle_mm: float | None,
    most_fresh: float,
) -> None:
    """Write the surfaces of decided pixels."""
    chosen = np.flatnonzero(pixels)
    if not chosen.size:
        return
    places = labels.range_mm[chosen]
    if circle_mm is not None:
        places = np.where(np.isfinite(places), fold(places, circle_mm), places)
    order = np.argsort(places, axis=1)  # near to far, open space and NaN behind

    def sorted_(values: FloatArray) -> FloatArray:
        return np.take_along_axis(values[chosen], order, axis=1)

    range_mm = np.take_along_axis(places, order, axis=1)
    variance, share, share_variance = (
        sorted_(part) for part in (labels.range_variance, labels.share, labels.share_variance)
    )
    is_surface = np.isfinite(range_mm)
    share = np.where(np.isnan(share), 0.0, share)
    share = share / share.sum(axis=1, keepdims=True)
    returned = 1.0 - sensor.outlier_probability
    sure = np.where(labels.is_fresh, np.minimum(labels.probability, most_fresh), labels.probability)[chosen]
    width = 1.0 if flat.noise_width is None else np.nan_to_num(flat.noise_width[chosen], nan=1.0)[:, np.newaxis]
    curve = sensor.noise
    sigma = (
        np.full(range_mm.shape, np.nan) if curve is None else curve.sigma(np.where(is_surface, range_mm, 0.0)) * width
    )
    columns = min(flat.max_layers, range_mm.shape[1])
    written = {
        "range": range_mm,
        "sigma": sigma,
        "weight": share * returned,
        "range_stderr": np.sqrt(variance),
        "weight_stderr": np.sqrt(share_variance) * returned,
        "probability": np.repeat(sure[:, np.newaxis], range_mm.shape[1], axis=1),
    }
    for name, values in written.items():
        target = getattr(flat, name)
        target[chosen] = np.nan
        target[chosen, :columns] = np.where(is_surface, values, np.nan)[:, :columns]
    if flat.amplitude is not None:
        flat.amplitude[chosen] = np.nan  # a sample is of all surfaces
    flat.n_modes[chosen] = is_surface.sum(axis=1)
    flat.weight_no_return[chosen] = np.where(is_surface, 0.0, share).sum(axis=1) * returned
    flat.weight_outlier[chosen] = sensor.outlier_probability
    log_likelihood = labels.log_density[chosen] - 2.0 * np.log(image.unit)
    flat.log_likelihood[chosen] = np.where(np.isnan(log_likelihood), flat.log_likelihood[chosen], log_likelihood)
    empty = labels.kind[chosen] == Kind.EMPTY
    flat.status[chosen] = np.where(empty, int(Status.NO_SURFACE), int(Status.OK))
    flat.mixing[chosen] = np.where(empty, int(Mixing.ONE_SURFACE), int(Mixing.PHASOR))  # type: ignore[index]  # as above


def _doubt(flat: Layers, pixels: BoolArray) -> None:
    """Mark undecided pixels."""
    flat.probability[pixels] = np.minimum(flat.probability[pixels], MOST_UNDECIDED)
    flat.mixing[pixels] = int(Mixing.UNDECIDED)  # type: ignore[index]  # it was just made
