"""How noise depends on amplitude: a power law, or one bent at one or two amplitudes, if the recording shows it.

Use `choose_law` on single-surface series in bins of range. Range and amplitude act by a product: log sigma is a value
for each bin, plus a function g of amplitude that is the same for all. So only pixels at about one range that differ in
amplitude determine g. Laws are compared by the likelihood of series of pixels that no fit has seen.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.estimation.noise.curve import GRID, STEP, AmplitudeSettings, ScaleMixtures, place
from tofmix.estimation.noise.series import SEED
from tofmix.sensor import AmplitudeLaw

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
    settings : AmplitudeSettings
        Thresholds.

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
