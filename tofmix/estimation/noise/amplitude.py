"""How noise depends on amplitude: the law of a recording, and the curves of single pixels that follow from it.

Use `choose_law` on single-surface series in bins of range. Range and amplitude act by a product: log sigma is a value
for each bin, plus a function g of amplitude that is the same for all: a power law, or one bent at one or two
amplitudes. So only pixels at about one range that differ in amplitude determine g. Laws are compared by the likelihood
of series of pixels that no fit has seen.

Use `pixel_curves` on a block of samples whose noise curve has such a law, and `beam_of_pixel` wherever a kernel takes
the beam of one pixel. Samples of one surface lie together in range and have about one amplitude. So sigma near a range
follows from the amplitudes of the samples near it: a dark and a bright surface of one pixel each get their own. Where
two of them overlap, it is between the two.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam, PixelCurves, Steps, sigma_at
from tofmix.estimation.noise.curve import GRID, STEP, AmplitudeSettings, ScaleMixtures, place
from tofmix.estimation.noise.series import SEED
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.sensor import AmplitudeLaw, NoiseCurve

_SEED = SEED + 1
"""Seed of the split into folds: the same recording gives the same law."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpreadSeries:
    """Single-surface series, all (series,): bin `group` from 0, half the log variance, log amplitude, pixel.

    `degrees` of freedom of the variances. A log amplitude that is not known is NaN.
    """

    group: IntArray
    log_sigma: FloatArray
    log_amplitude: FloatArray
    pixel: IntArray
    degrees: int

    def only(self, chosen: BoolArray | IntArray) -> "SpreadSeries":
        """Some of the series."""
        return SpreadSeries(
            group=self.group[chosen],
            log_sigma=self.log_sigma[chosen],
            log_amplitude=self.log_amplitude[chosen],
            pixel=self.pixel[chosen],
            degrees=self.degrees,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChosenLaw:
    """A law with a reference for each bin, and its gain of held-out likelihood over range alone, nat."""

    law: AmplitudeLaw
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    level: FloatArray  # (group,) log sigma at amplitude ends[0]
    exponents: FloatArray  # (piece,)
    mixture: int


def choose_law(series: SpreadSeries, settings: AmplitudeSettings) -> ChosenLaw | None:
    """Choose the law with the fewest pieces that series of other pixels ask for, or none.

    Parameters
    ----------
    series : SpreadSeries
        Of all bins.

    Returns
    -------
    ChosenLaw or None
        None where range alone does as well. The reference of a bin is the median amplitude of its series; of a bin
        without a known amplitude, such as one of samples without a return, that of its neighbours.
    """
    groups = int(series.group.max()) + 1
    known = np.flatnonzero(np.isfinite(series.log_amplitude))
    if known.size < settings.least_series:
        return None
    thinned = series.only(known[:: -(-known.size // settings.most_series)])
    mixtures = ScaleMixtures.of(series.degrees)
    drawn = np.random.default_rng(_SEED).integers(0, settings.folds, int(series.pixel.max()) + 1)
    fold = drawn[thinned.pixel]
    best: FloatArray | None = None
    gain, total = _heldout(thinned, fold, groups, mixtures, None, settings), 0.0
    for pieces in settings.pieces:
        knots = _knots(thinned.log_amplitude, pieces, settings.ends)
        if knots is None:
            break
        other = _heldout(thinned, fold, groups, mixtures, knots, settings)
        more = other - gain
        if more.sum() < max(settings.least_gain, settings.least_errors * more.std() * np.sqrt(more.size)):
            continue
        best, gain, total = knots, other, total + float(more.sum())
    if best is None:
        return None
    law = _law(thinned, _fit(thinned, groups, mixtures, best, settings.exponents), best, groups)
    effect = law.log_factor(np.exp(thinned.log_amplitude)) - law.log_factor(law.reference)[thinned.group]
    return ChosenLaw(law=law, gain=total) if effect.std() >= settings.least_effect else None


def _knots(log_amplitude: FloatArray, pieces: int, ends: tuple[float, float]) -> FloatArray | None:
    """Ends of the pieces (piece + 1,): as many series in each; None where amplitudes do not differ enough."""
    knots = np.quantile(log_amplitude, np.linspace(*ends, pieces + 1))
    return knots if (np.diff(knots) > STEP).all() else None


def _basis(log_amplitude: FloatArray, knots: FloatArray | None) -> FloatArray:
    """Length of each piece below each amplitude, (series, piece)."""
    if knots is None:
        return np.zeros((len(log_amplitude), 0))
    return np.asarray(np.clip(log_amplitude[:, None], knots[:-1], knots[1:]) - knots[:-1])


def _heldout(
    series: SpreadSeries,
    fold: IntArray,
    groups: int,
    mixtures: ScaleMixtures,
    knots: FloatArray | None,
    settings: AmplitudeSettings,
) -> FloatArray:
    """Log likelihood of each series under the fit to the other folds."""
    out = np.zeros(len(fold))
    for k in range(settings.folds):
        held = fold == k
        fit = _fit(series.only(~held), groups, mixtures, knots, settings.exponents)
        rest = series.only(held)
        away = rest.log_sigma - fit.level[rest.group] + _basis(rest.log_amplitude, knots) @ fit.exponents
        out[held] = np.log(mixtures.density[fit.mixture])[place(away)]
    return out


def _fit(
    series: SpreadSeries,
    groups: int,
    mixtures: ScaleMixtures,
    knots: FloatArray | None,
    limits: tuple[float, float],
    *,
    most_rounds: int = 30,  # of scoring
    tolerance: float = 1e-4,  # step of log sigma that ends the scoring: 0.01 % of sigma
) -> _Fit:
    """Fit levels and exponents by Fisher scoring, with the mixture that does best at each third step."""
    basis, group = _basis(series.log_amplitude, knots), series.group
    # Least squares to start from: far from the answer the mixtures take every series for wider.
    _, exponents = _scoring_step(group, groups, basis, series.log_sigma, np.ones(len(group)))
    exponents = np.clip(exponents, *limits)
    flat = series.log_sigma + basis @ exponents
    level = np.array([_median_or(flat[group == g], float(np.median(flat))) for g in range(groups)])
    best = 0
    log_density = np.log(mixtures.density)
    for step in range(most_rounds):
        away = series.log_sigma - level[group] + basis @ exponents
        if step % 3 == 0:
            counts = np.bincount(place(away), minlength=len(GRID))
            best = int(np.argmax(log_density @ counts))
            score = -np.gradient(log_density[best], STEP)
            weight = 2.0 * mixtures.degrees[best] * mixtures.single[best] / mixtures.density[best]
        at = place(away)
        shift, fall = _scoring_step(group, groups, basis, score[at], weight[at])
        level = level + shift
        new = np.clip(exponents + fall, *limits)
        moved = max(float(np.abs(shift).max()), float(np.abs(new - exponents).max(initial=0.0)))
        exponents = new
        if step % 3 and moved < tolerance:
            break
    return _Fit(level, exponents, best)


def _scoring_step(
    group: IntArray, groups: int, basis: FloatArray, score: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """One step of levels and exponents: weighted least squares of score / weight, the levels eliminated."""
    mass = np.bincount(group, weight, groups) + 1e-6
    pull = np.bincount(group, score, groups) / mass
    if basis.shape[1] == 0:
        return pull, np.zeros(0)
    means = np.stack([np.bincount(group, weight * column, groups) / mass for column in basis.T], axis=1)
    centred = basis - means[group]
    # Log sigma falls by the basis: its derivative is minus the basis.
    normal = (centred * weight[:, None]).T @ centred + 1e-6 * np.eye(basis.shape[1])
    fall = -np.linalg.solve(normal, centred.T @ (score - weight * pull[group]))
    return pull + means @ fall, fall


def _median_or(values: FloatArray, otherwise: float) -> float:
    return float(np.median(values)) if values.size else otherwise


def _law(series: SpreadSeries, fit: _Fit, knots: FloatArray, groups: int) -> AmplitudeLaw:
    """The fitted law, with factor 1 at the median amplitude."""
    log_factor = -np.concatenate([[0.0], np.cumsum(fit.exponents * np.diff(knots))])
    log_factor -= np.interp(np.median(series.log_amplitude), knots, log_factor)
    seen = np.unique(series.group)
    reference = np.array([np.median(series.log_amplitude[series.group == g]) for g in seen])
    return AmplitudeLaw(np.exp(np.interp(np.arange(groups), seen, reference)), np.exp(knots), np.exp(log_factor))


CLUSTER_SAMPLES = 3.0
"""Weight of the cluster's median amplitude in this mean, in samples, for ranges with few samples."""


class _Law(NamedTuple):
    """A curve with a law as the kernel reads it: logarithms of the amplitudes and factors."""

    curve_range: FloatArray
    curve_sigma: FloatArray
    log_reference_factor: FloatArray
    log_amplitude: FloatArray
    log_factor: FloatArray


@jit
def _log_scale(range_mm: float, amplitude: float, law: _Law) -> float:
    """Log factor on the curve at a range and amplitude; NaN where the amplitude is not a number above 0."""
    if not 0.0 < amplitude < math.inf:
        return math.nan
    reference = sigma_at(range_mm, law.curve_range, law.log_reference_factor)
    return float(sigma_at(math.log(amplitude), law.log_amplitude, law.log_factor) - reference)


@jit
def _middle(values: FloatArray) -> float:
    """Median of the values that are numbers, 0 without any."""
    count = 0
    for value in values:
        count += not math.isnan(value)
    if count == 0:
        return 0.0
    ordered = np.sort(values)  # NaN last
    return float(0.5 * (ordered[(count - 1) // 2] + ordered[count // 2]))


@jit
def _fill_cluster(
    values: FloatArray, scale: FloatArray, law: _Law, curve_range: FloatArray, curve_sigma: FloatArray, size: int
) -> int:
    """Append the points of one cluster to a pixel's curve; return their number so far."""
    middle = _middle(scale)
    first, stop, total, known = 0, 0, 0.0, 0
    for j in range(len(values)):
        base = sigma_at(values[j], law.curve_range, law.curve_sigma)
        reach = base * math.exp(middle)  # one sigma, within which samples give the amplitude at a range
        while stop < len(values) and values[stop] <= values[j] + reach:
            if not math.isnan(scale[stop]):
                total, known = total + scale[stop], known + 1
            stop += 1
        while values[first] < values[j] - reach:
            if not math.isnan(scale[first]):
                total, known = total - scale[first], known - 1
            first += 1
        if size == 0 or values[j] > curve_range[size - 1]:
            curve_range[size] = values[j]
            curve_sigma[size] = base * math.exp((total + CLUSTER_SAMPLES * middle) / (known + CLUSTER_SAMPLES))
            size += 1
    return size


@jit
def _fill(block: Float32Array, amplitude: Float32Array, law: _Law, out: PixelCurves) -> None:
    frames, pixels = block.shape
    values, scale = np.empty(frames), np.empty(frames)
    for pixel in range(pixels):
        n = 0
        for frame in range(frames):
            if abs(block[frame, pixel]) <= FARTHEST_MM:  # false for NaN
                values[n] = block[frame, pixel]
                scale[n] = _log_scale(values[n], amplitude[frame, pixel], law)
                n += 1
        # Samples of one range go by their scales: the order of the frames must not change the rounding of a sum.
        order = np.argsort(scale[:n], kind="mergesort")
        order = order[np.argsort(values[:n][order], kind="mergesort")]
        ordered, scales = values[:n][order], scale[:n][order]
        size, first = 0, 0
        widest = 0.0
        for j in range(n):
            factor = 1.0 if math.isnan(scales[j]) else math.exp(scales[j])
            sigma = factor * sigma_at(ordered[j], law.curve_range, law.curve_sigma)
            # sigmas: a wider gap separates two clusters, each with its own amplitude
            if j > first and ordered[j] - ordered[j - 1] > 3.0 * max(sigma, widest):
                size = _fill_cluster(
                    ordered[first:j], scales[first:j], law, out.range_mm[pixel], out.sigma_mm[pixel], size
                )
                first = j
            widest = sigma
        if n > 0:
            size = _fill_cluster(ordered[first:n], scales[first:n], law, out.range_mm[pixel], out.sigma_mm[pixel], size)
        out.size[pixel] = size


def pixel_curves(block: Float32Array, amplitude: Float32Array, curve: NoiseCurve) -> PixelCurves:
    """Each pixel's curve from the amplitudes of its samples.

    Parameters
    ----------
    block : (frame, pixel) float32
        Samples, mm; values that are not finite, or beyond 10^9 mm, are skipped.
    amplitude : (frame, pixel) float32
        Their amplitudes. An amplitude that is not a number above 0 is replaced by those of its neighbours, or by the
        curve.
    curve : NoiseCurve
        With a law.

    Returns
    -------
    PixelCurves
        Points at the samples' ranges. Samples less than three sigmas from their neighbour are a cluster. At a range
        in it, log sigma has the mean scale of the samples within one sigma, and of `CLUSTER_SAMPLES` more with
        the cluster's median scale.

    Raises
    ------
    ValueError
        If the two differ in shape, or the curve has no law.
    """
    if block.shape != amplitude.shape:
        raise ValueError(f"amplitude: shape {amplitude.shape} differs from range {block.shape}")
    if curve.law is None:
        raise ValueError("the noise curve has no law of amplitude")
    frames, pixels = block.shape
    out = PixelCurves(np.zeros((pixels, frames)), np.zeros((pixels, frames)), np.zeros(pixels, dtype=np.int64))
    law = _Law(
        np.array(curve.range_mm),
        np.array(curve.sigma_mm),
        curve.law.log_factor(curve.law.reference),
        np.log(curve.law.amplitude),
        np.log(curve.law.factor),
    )
    _fill(np.ascontiguousarray(block), np.ascontiguousarray(amplitude), law, out)
    return out


@jit
def beam_of_pixel(beam: Beam, pixel: int) -> Beam:
    """The beam with the pixel's own curve, and its own step, where there are."""
    size = beam.pixel_curves.size[pixel] if pixel < len(beam.pixel_curves.size) else 0
    steps = beam.steps
    if pixel < len(steps.of_pixel):
        steps = Steps(steps.range_mm[:1], steps.of_pixel[pixel : pixel + 1], steps.of_pixel)
    elif size == 0:
        return beam
    return Beam(
        beam.pixel_curves.range_mm[pixel, :size] if size > 0 else beam.curve_range,
        beam.pixel_curves.sigma_mm[pixel, :size] if size > 0 else beam.curve_sigma,
        beam.range_max,
        beam.sigma_max,
        beam.no_return_from,
        beam.no_return_to,
        beam.surface_end,
        beam.p_outlier,
        beam.outlier_density,
        beam.range_min,
        beam.range_top,
        beam.pixel_curves,
        steps,
        beam.background,
    )
