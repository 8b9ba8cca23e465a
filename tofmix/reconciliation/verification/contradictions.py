"""Step 5: evidence against single effects of a set that explains a recording.

A set of effects may bring every statistic down to chance and be wrong: two large effects may cancel, and much noise may
stand for a motion. So each effect is judged by its posterior (`tofmix.simulation.effects.parameter`), by what it does
in the presence of the others, and by the recorded amplitudes. None of these tests knows a kind.

In a `fixed_pattern`, pixels, columns and rows are independent. If a map is smooth over the image, over its columns or
rows, or a plane over a surface, another cause has changed the ranges. Without this test, any static bias that no law
describes would be named a pattern.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.comparison.compare import Compared, disagreements
from tofmix.reconciliation.found import Added, TriedEffect
from tofmix.reconciliation.likelihood.hidden_states import begin, without, without_pattern
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.parameters.pattern_errors import latent_errors
from tofmix.reconciliation.parameters.polish import numbers_of, settle
from tofmix.reconciliation.parameters.standard_errors import standard_errors
from tofmix.reconciliation.settings import Settings, fit_part, held_out
from tofmix.reconciliation.verdict import LAW
from tofmix.simulation.effects.base import Effect

SMOOTH = 0.2
"""Correlation of neighbours in a map, above which it is no pattern."""

TILTED = 0.8
"""Share of a plane in a map on one surface, above which the map is no pattern."""


def tilted(values: FloatArray, known: BoolArray, surface: IntArray) -> bool:
    """Whether a map (row, col) is a plane over a surface, which is then tilted.

    On a surface of so many rows and columns, a pattern looks like a plane once in some thousands of recordings.
    """
    plane_lines = 8  # least rows and columns for the test of a plane
    for number in range(int(surface.max()) + 1):
        row, col = np.nonzero(known & (surface == number))
        if min(np.unique(row).size, np.unique(col).size) < plane_lines:
            continue
        value = values[row, col] - values[row, col].mean()
        slopes = np.stack([row - row.mean(), col - col.mean()], axis=1)
        plane = slopes @ np.linalg.lstsq(slopes, value, rcond=None)[0]
        if float((plane**2).sum()) > TILTED * float((value**2).sum()) > 0:
            return True
    return False


def smooth(values: FloatArray, known: BoolArray) -> bool:
    """Whether a map (row, col), or its means of columns or rows, are smooth over the image.

    Only pixels with a known bias count. In pixels without a return the map is 0, which would distort the mean of a
    column.
    """
    if not known.any():
        return False
    rest = np.where(known, values - values[known].mean(), 0.0)
    whole = float((rest**2).sum())
    lines = [np.zeros(values.shape[1]), np.zeros(values.shape[0])]
    sweeps = 30  # alternations of columns and rows, if some pixels are unknown
    for _ in range(sweeps):
        for axis in (0, 1):
            mean = rest.sum(axis=axis) / np.maximum(known.sum(axis=axis), 1)
            lines[axis] += mean
            rest -= np.where(known, np.expand_dims(mean, axis), 0.0)
    if any(_lines_smooth(line, known.sum(axis=axis), whole) for axis, line in enumerate(lines)):
        return True
    power = float((rest**2).sum()) / known.sum()
    near = 0.5 * (
        _mean_product(rest[1:], rest[:-1], known[1:] & known[:-1])
        + _mean_product(rest[:, 1:], rest[:, :-1], known[:, 1:] & known[:, :-1])
    )
    return bool(near > SMOOTH * power > 0)


def _lines_smooth(line: FloatArray, pixels: IntArray, whole: float) -> bool:
    """Whether values of columns or rows, of `pixels` known pixels each, are smooth.

    In n independent lines, neighbours correlate by 0 +- 1 / sqrt(n).
    """
    seen = pixels > 0
    value = np.where(seen, line - line[seen].mean(), 0.0)
    lines = 0.2  # least share of the columns, or rows, in a map, from which they are tested
    if float((value**2 * pixels).sum()) < lines * whole:
        return False
    power = float((value**2).sum()) / seen.sum()
    near = _mean_product(value[1:], value[:-1], seen[1:] & seen[:-1])
    chance = 4.0  # margin of the correlation of neighbouring lines, in its standard deviations
    return bool(near > (SMOOTH + chance / np.sqrt(seen.sum())) * power)


def _mean_product(a: FloatArray, b: FloatArray, both: BoolArray) -> float:
    return float((a * b).sum() / max(int(both.sum()), 1))


PRICE_NATS = 3.0  # of each number, for effects whose samples are not independent
FAINT_SHARE = 0.01
"""Share of an effect's gain that is too faint to tell: no law is exact."""

_MEANS = (("common_mode", "frame"), ("pattern", "all"))  # curves of means by frame and by pixel


@dataclass(frozen=True, slots=True, kw_only=True)
class Contradiction:
    """Evidence against an effect.

    Parameters
    ----------
    number : int
        Of the effect, in the order of the added ones.
    reason : str
        What speaks against it, as the predicate of a sentence about the effect.
    """

    number: int
    reason: str


def contradictions(likelihood: Likelihood, added: Added, settings: Settings) -> tuple[Contradiction, ...]:
    """Everything that speaks against the added effects; empty for none.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    added : Added
        The outcome of a search.
    """
    if not added.chosen:
        return ()
    found = [*implausible(added.chosen)]
    found = found or [*refuted(likelihood, added.chosen, settings.alpha)]
    found = found or [*_instead_of_means(likelihood, added.state, added.panel, settings.alpha)]
    found = found or [*_by_others(likelihood, added, settings)]
    return tuple(found or _unknown(likelihood, added, settings))


def implausible(chosen: Sequence[TriedEffect]) -> Iterator[Contradiction]:
    """Effects with numbers beyond what their prior has."""
    for number, candidate in enumerate(chosen):
        effect = candidate.effect
        far = [name for name, p in effect.priors().items() if not _possible(effect, name, p.farthest)]
        if far and not effect.plausible():
            values = " and ".join(f"{name} {effect.numbers()[name]:.4g}" for name in far)
            yield Contradiction(number=number, reason=f"would need {values}, beyond that of real cameras and scenes")


def _possible(effect: Effect, name: str, limits: tuple[float, float]) -> bool:
    return bool(limits[0] <= effect.numbers()[name] <= limits[1])


def refuted(likelihood: Likelihood, chosen: Sequence[TriedEffect], alpha: float) -> Iterator[Contradiction]:
    """Effects that are less likely than none by the recorded amplitudes, by odds of more than 1 / alpha."""
    for number, candidate in enumerate(chosen):
        if sum(side.log_odds(candidate.effect) for side in likelihood.side_information) < math.log(alpha):
            yield Contradiction(number=number, reason="would change amplitudes; the recorded ones did not change so")


def _instead_of_means(
    likelihood: Likelihood, state: ModelState, panel: Compared, alpha: float
) -> Iterator[Contradiction]:
    """Effects that widen the samples' distribution, and stand for a mean that changes with the frame or the pixel.

    Noise and random values have no means. If means of frames and pixels make up more than `LAW` of the variance that
    an effect adds, the effect stands for their cause.
    """
    structured = sum(c.size**2 for c in disagreements(panel, alpha) if (c.statistic, c.axis) in _MEANS)
    if not structured:
        return
    wide = _height(likelihood.mixture(state))
    for number in range(len(state.effects)):
        narrow = _height(likelihood.mixture(without(state, number)))
        seen = np.isfinite(wide) & (narrow > 0)
        if not seen.any():
            continue
        added = 1 - float((wide[seen] / narrow[seen]).mean()) ** 2  # of the variance, as for a Gaussian of this height
        if structured > LAW * added > 0:
            yield Contradiction(number=number, reason="stands for means that change with the frame or the pixel")


def _height(m: Mixture) -> FloatArray:
    """Height (pixel,) of the density of a pixel's valid samples at its main surface, but for a factor; NaN for none."""
    lit, valid = m.of_main(m.lit).astype(bool), 1.0 - m.invalid[0]
    seen = lit & (valid > 0)
    share = m.of_main(m.weight) / np.where(seen, valid, 1.0)
    return np.where(seen, share / m.of_main(m.sigma), np.nan)


def _by_others(likelihood: Likelihood, added: Added, settings: Settings) -> Iterator[Contradiction]:
    """Effects that cancel others, and biases whose only trace is noise."""
    part = held_out(likelihood, settings)
    mixture = likelihood.mixture(added.state)
    whole = likelihood.value(added.state, part, mixture)
    scored = likelihood.evidence.part(fit=False, split=settings.split)
    judged = len(part[0]) * len(part[1]) / max(len(scored[0]) * len(scored[1]), 1)
    given = whole - likelihood.value(
        begin(likelihood, fit_part(likelihood, settings)[0], settings.accepted(likelihood)), part
    )
    best = max(given, judged * max((c.gain for c in added.first), default=0.0))
    # Gain of an effect in the presence of the others over that of the best effect alone, and over that of all together:
    # two biases that cancel to less than a quarter gain so much, since gains are squares of biases.
    cancels = 20.0
    for number, candidate in enumerate(added.chosen):
        if candidate.fitted is None:
            continue
        rest = without(added.state, number)
        bare = likelihood.mixture(rest)
        gain = whole - likelihood.value(rest, part, bare)
        if len(added.chosen) > 1 and gain > cancels * best > 0:
            yield Contradiction(number=number, reason="cancels another effect")
        if candidate.static and not moves_by_itself(likelihood, (rest, bare), (added.state, mixture), part):
            yield Contradiction(number=number, reason="moves no range: its only trace is noise")


def moves_by_itself(
    likelihood: Likelihood, before: tuple[ModelState, Mixture], after: tuple[ModelState, Mixture], part: Part
) -> bool:
    """Whether the bias of an effect gives more than a faint part of its gain; the rest is by a change of the noise.

    Some effects on light change both. A second path that is longer by one turn only adds noise to a surface. Noise has
    many causes, and a bias that is not seen is an unlikely one.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    before, after : (ModelState, Mixture)
        The model without and with the effect.
    part : (frames, pixels)
        Data of the gains.
    """
    (without_it, bare), (with_it, mixture) = before, after
    if mixture.mean.shape != bare.mean.shape or np.array_equal(mixture.sigma, bare.sigma):
        return True
    whole = likelihood.value(with_it, part, mixture)
    by_bias = whole - likelihood.value(with_it, part, replace(mixture, mean=bare.mean))
    gain = whole - likelihood.value(without_it, part, bare)
    return by_bias > max(2 * PRICE_NATS, FAINT_SHARE * gain)


def _unknown(likelihood: Likelihood, added: Added, settings: Settings) -> Iterator[Contradiction]:
    """Effects whose posterior does not exclude that they are absent, with the others free.

    Numbers of one effect may be tied to each other, as the two of a slow drift; so where their errors are large, the
    others are fitted again without the effect.
    """
    own = numbers_of(likelihood, added.state, added.chosen, fit_part(likelihood, settings))
    errors_of = standard_errors(own)
    for number, candidate in enumerate(added.chosen):
        effect = added.state.effects[number]
        errors = errors_of.get(number, {})
        if candidate.fitted is None and number not in errors_of:
            effect, errors = latent_errors(likelihood, added.state, effect, settings.seed)
        if absent(effect, errors) <= settings.alpha:
            continue
        exact = standard_errors(own, by_blocks=False).get(number, errors)
        share = min(deviate(effect, errors) / deviate(effect, exact), 1.0) ** 2
        if not _needed(likelihood, added, number, share, settings):
            yield Contradiction(number=number, reason="has numbers with errors as large as themselves")


def _needed(likelihood: Likelihood, added: Added, number: int, share: float, settings: Settings) -> bool:
    """Whether the others, fitted again without the effect of this number, lose more than the price of its numbers.

    Where the model of the samples is not exact, as for pixels of different noise, the loss overstates the evidence as
    much as the curvature overstates the information: `share` is the variance by the curvature over that by blocks.

    References
    ----------
    Chandler and Bate, Biometrika 94 (2007) 167: the adjusted likelihood of dependent samples.
    """
    others = [c for k, c in enumerate(added.chosen) if k != number]
    patterned = added.chosen[number].patterned
    rest = without_pattern(added.state, number) if patterned else without(added.state, number)
    rest = settle(numbers_of(likelihood, rest, others, fit_part(likelihood, settings))).state
    part = held_out(likelihood, settings)
    lost = likelihood.value(added.state, part) - likelihood.value(rest, part)
    return share * lost > PRICE_NATS * added.chosen[number].parameters


def absent(effect: Effect, errors: dict[str, float]) -> float:
    """Posterior probability that an effect is absent or acts the other way, by its best known magnitude.

    Parameters
    ----------
    effect : Effect
        With its numbers.
    errors : dict of str to float
        Their posterior standard deviations; a number without one is exact.

    Returns
    -------
    float
        Normal tail probability; 0 for an effect without a magnitude.
    """
    return float(norm.sf(deviate(effect, errors)))


def deviate(effect: Effect, errors: dict[str, float]) -> float:
    """The best known magnitude of an effect over its error; infinity without a magnitude, or with an exact one.

    Parameters
    ----------
    effect : Effect
        With its numbers.
    errors : dict of str to float
        Their posterior standard deviations; a number without one is exact.
    """
    declared = effect.parameters()
    names = effect.magnitudes or tuple(name for name, p in declared.items() if p.zero is not None)
    sizes = [(abs(getattr(effect, n) - (declared[n].zero or 0.0)), errors.get(n, 0.0)) for n in names]
    return max((size / error if error > 0 else math.inf for size, error in sizes if size > 0), default=math.inf)
