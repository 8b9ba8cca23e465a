"""Step 5, rivals of the found effects: smooth laws, maps that are no pattern, motion, the model's own effects.

Step 5, first rivals: smooth laws of place or range that are no known effect, for the named biases.

The nearest effect imitates most of an unknown law: a lens that bends range looks like an amplitude walk, a wrong scale
like a wiggling. So smooth laws compete with the static effects. They are fitted to the same data, have a price for each
number, and are scored on held-out data. If the effects include a fixed pattern, the laws have one too, so that it gives
no advantage.

Whether a map of biases is a pattern: in a `fixed_pattern`, pixels, columns and rows are independent.

If a map is smooth over the image, over its columns or rows, or a plane over a surface, another cause has changed the
ranges. Without this test, any static bias that no law describes would be named a pattern.

Ranges that change in time by more than scores can show: something moves through the scene, or the camera does.

Scores end at four sigma, so a surface that comes 30 mm nearer with each frame looks like a bias of every later frame.
Use `far_trend` to place such a change. It takes medians of ranges, so random values do not matter.

Step 5, last rival: an effect of the given model with other numbers.

If such an effect has wrong numbers, added effects can only imitate the correction.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kruskal

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.comparison.compare import FARTHEST_SCORE, SMALLEST_P, Place
from tofmix.reconciliation.likelihood.joint import Recording, RecordingView, joint_likelihood, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases
from tofmix.reconciliation.parameters.pattern_errors import pattern_of
from tofmix.reconciliation.search.name import PRICE_NATS, TriedEffect, begin_trial, candidates
from tofmix.reconciliation.search.pattern_fits import settled_within, worth
from tofmix.reconciliation.search.refit import begin
from tofmix.reconciliation.search.search_state import Settings, fit_part, name_of
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.base import Effect, Latent, Target
from tofmix.simulation.effects.hidden import PixelBias
from tofmix.simulation.model import Model

CLEARLY_NATS = 6.0  # of gain over the best effect
CLEARLY_SHARE = 0.0001
"""By how much a law must be better than the effects: so many nats, and this share of their gain, because no effect's
law is exact."""

_KNOWN = 0.5
"""Share of the price, for a number that is known to within the tolerance."""

_PASSES = 2  # of a linear fit; the second starts at the end of the first
_SOON = 0.05  # longest time constant, as a part of the recording, of a drift that is taken as static
_ALONE = 0.98  # least share of the beam of a pixel that sees one surface


def better_law(
    likelihood: Likelihood,
    state: ModelState,
    chosen: Sequence[TriedEffect],
    parts: tuple[Part, Part],
    tolerance: float,
    *,
    stood: bool = False,
) -> str | None:
    """The axis of a smooth law that is better than the named static effects; None without one.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : ModelState
        The refined model.
    chosen : sequence of TriedEffect
        Its effects, in its order.
    parts : two of (frames, pixels)
        Fitting data and held-out data, of all pixels: laws of few numbers need no held-out pixels.
    tolerance : float
        Tolerance of the model: a law must also be better than the effects with the model moved within its tolerance.
    stood : bool
        Whether a law was better than the effects of an earlier search. More effects come nearer to the law by their
        number alone, so then a law needs no margin.
    """
    duration = float(likelihood.evidence.time_s.max())
    static = [c for c in chosen if _stays(c.effect, duration)]
    if not static:
        return None
    patterned = pattern_of(state) is not None
    bare = state.unpatterned
    named = replace(bare, effects=tuple(e for e in state.effects if not isinstance(e.hidden, PixelBias)))
    rest = replace(bare, effects=tuple(e for e in state.effects if not _stays(e, duration)))
    # A law without a name may replace the named effects, so the price grows with the number of samples (BIC)
    each = max(PRICE_NATS, 0.5 * math.log(max(len(parts[1][0]) * len(parts[1][1]), 1)))
    price = each * sum(c.parameters for c in static if not c.patterned)
    others = [c for c in chosen if not c.patterned]
    near = settled_within(likelihood, named, others, parts[0], tolerance)
    moved = _KNOWN * PRICE_NATS * (len(near.effects) - len(named.effects))  # their tilts hardly count
    at, about = (worth(likelihood, s, likelihood.mixture(s), parts, patterned=patterned) for s in (named, near))
    explain = max(at, about - moved) - price
    mixture = likelihood.mixture(rest)
    nothing = worth(likelihood, rest, mixture, parts, patterned=False)
    needed = explain if stood else explain + max(CLEARLY_NATS, CLEARLY_SHARE * (explain - nothing))
    found = []
    for axis, law in _LAWS:
        bent = law(likelihood, rest, mixture, parts[0])
        if bent is not None:
            found.append((worth(likelihood, *bent[:2], parts, patterned=patterned) - each * bent[2], axis))
    value, best = max(found)
    return best if value > needed else None


def _stays(effect: Effect, duration_s: float) -> bool:
    """Whether an effect is static, or becomes static soon."""
    of_bias = effect.target in (Target.BIAS, Target.TREND)
    return of_bias and effect.settled_after_s <= _SOON * duration_s


_Bent = tuple[ModelState, Mixture, int]
"""State and prediction with a law, and its number of parameters."""


def _by_plane(likelihood: Likelihood, state: ModelState, mixture: Mixture, part: Part) -> _Bent:
    """A polynomial of first degree in row and column."""
    return _polynomial(likelihood, state, mixture, part, 1)


def _by_bowl(likelihood: Likelihood, state: ModelState, mixture: Mixture, part: Part) -> _Bent:
    """A polynomial of second degree in row and column."""
    return _polynomial(likelihood, state, mixture, part, 2)


def _polynomial(likelihood: Likelihood, state: ModelState, mixture: Mixture, part: Part, degree: int) -> _Bent:
    rows, cols = likelihood.evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    v, u = 2 * row / max(rows - 1, 1) - 1, 2 * col / max(cols - 1, 1) - 1
    columns = np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
    everywhere = np.ones(rows * cols, dtype=bool)
    for _ in range(_PASSES):
        numbers = _fitted(likelihood, state, mixture, part, (columns, everywhere))
        state = replace(state, pixel_bias=state.pixel_bias + columns @ numbers)
    return state, mixture, columns.shape[1]


def _by_range(likelihood: Likelihood, state: ModelState, mixture: Mixture, part: Part) -> _Bent | None:
    """A polynomial of second degree in the range of each surface; for one recording only."""
    lit = mixture.of_main(mixture.lit).astype(bool)
    if len(likelihood.scene.members) > 1 or not lit.any():
        return None
    range_mm = mixture.of_main(mixture.true_range)
    low, high = float(range_mm[lit].min()), float(range_mm[lit].max())

    def columns(true_range_mm: NDArray[Any]) -> FloatArray:
        r = 2 * (true_range_mm - low) / max(high - low, 1.0) - 1
        return np.stack([np.ones_like(r), r, r * r], axis=-1)

    alone = lit & (mixture.of_main(mixture.weight) > _ALONE)
    for _ in range(_PASSES):
        numbers = _fitted(likelihood, state, mixture, part, (columns(range_mm), alone))
        moved = np.where(mixture.lit, columns(mixture.true_range) @ numbers, 0.0)
        mixture = replace(mixture, mean=(mixture.mean + moved).astype(mixture.mean.dtype))
    return state, mixture, 3


_LAWS: Sequence[tuple[str, Callable[[Likelihood, ModelState, Mixture, Part], _Bent | None]]] = (
    ("place in the image", _by_plane),
    ("place in the image", _by_bowl),
    ("range", _by_range),
)


def _fitted(
    likelihood: Likelihood, state: ModelState, mixture: Mixture, part: Part, by: tuple[FloatArray, BoolArray]
) -> FloatArray:
    """The numbers of a law that is linear in columns (pixel, number), from the biases of some pixels."""
    columns, use = by
    found = pixel_biases(likelihood, mixture, state, part)
    weighed = columns * np.where(use, found.information, 0.0)[:, None]
    return np.asarray(np.linalg.lstsq(columns.T @ weighed, weighed.T @ found.bias, rcond=None)[0])


SMOOTH = 0.2
"""Correlation of neighbours in a map, above which it is no pattern."""

TILTED = 0.8
"""Share of a plane in a map on one surface, above which the map is no pattern."""

_LINES = 0.2  # least share of the columns, or rows, in a map, from which they are tested
_CHANCE = 4.0  # margin of the correlation of neighbouring lines, in its standard deviations
_PLANE_LINES = 8  # least rows and columns for the test of a plane
_SWEEPS = 30  # alternations of columns and rows, if some pixels are unknown


def tilted(values: FloatArray, known: BoolArray, surface: IntArray) -> bool:
    """Whether a map (row, col) is a plane over a surface, which is then tilted.

    On a surface of so many rows and columns, a pattern looks like a plane once in some thousands of recordings.
    """
    for number in range(int(surface.max()) + 1):
        row, col = np.nonzero(known & (surface == number))
        if min(np.unique(row).size, np.unique(col).size) < _PLANE_LINES:
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
    for _ in range(_SWEEPS):
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
    if float((value**2 * pixels).sum()) < _LINES * whole:
        return False
    power = float((value**2).sum()) / seen.sum()
    near = _mean_product(value[1:], value[:-1], seen[1:] & seen[:-1])
    return bool(near > (SMOOTH + _CHANCE / np.sqrt(seen.sum())) * power)


def _mean_product(a: FloatArray, b: FloatArray, both: BoolArray) -> float:
    return float((a * b).sum() / max(int(both.sum()), 1))


_PARTS = 10  # of the time
_LEAST_FRAMES = 3  # of a part, for a median with a scatter
_PIXELS = 256  # enough for a median
_POLISHED = 30  # turns of the levels of pixels and frames


def far_trends(likelihood: Likelihood, state: ModelState, alpha: float) -> list[Place]:
    """The change in time of each recording whose ranges leave the reach of scores; none for most recordings.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        A model: the change is that of the differences from it.
    alpha : float
        Level of the test that parts of the time differ, after correction for the recordings.

    References
    ----------
    Kruskal and Wallis, J. American Statistical Association 47 (1952) 583.
    """
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    seen = list(views(likelihood, likelihood.mixture(state), whole))
    found = (_far_trend(view, alpha / len(seen)) for view in seen)
    return [place for place in found if place is not None]


def _far_trend(view: RecordingView, alpha: float) -> Place | None:
    medians, frames, sigma = _medians(view)
    parts = min(_PARTS, medians.size // _LEAST_FRAMES)
    if parts < 2:  # noqa: PLR2004  two parts of the time to compare
        return None
    part = np.arange(medians.size) * parts // medians.size
    level = np.array([np.median(medians[part == k]) for k in range(parts)])
    first, last = sorted((int(level.argmin()), int(level.argmax())))
    change = float(level[last] - level[first])
    if abs(change) < FARTHEST_SCORE * sigma:
        return None
    p = float(kruskal(*(medians[part == k] for k in range(parts))).pvalue)
    if not p < alpha:
        return None
    now = view.evidence.time_s[frames]
    return Place(
        axis="time",
        statistic="trend",
        interval=(float(now[part == first][0]), float(now[part == last][-1])),
        size=change,
        unit="mm",
        p_value=max(p, SMALLEST_P),
        z=abs(change) / sigma,
        recording=view.number,
    )


def _medians(view: RecordingView) -> tuple[FloatArray, IntArray, float]:
    """Median difference from the model of some frames, mm; the frames; and the typical sigma, mm.

    Each pixel has its own level, found together with those of the frames: it does not matter which pixels are valid
    when.

    References
    ----------
    Tukey, Exploratory Data Analysis, 1977, chapter 11: median polish.
    """
    m, samples = view.mixture, view.evidence.samples
    use = np.flatnonzero(m.of_main(m.lit))
    use = use[:: math.ceil(max(use.size, 1) / _PIXELS)]
    off = m.near_turn(samples[:, use] - m.of_main(m.mean)[use])
    away = np.where(samples[:, use] > 0, off, np.nan)
    some = np.isfinite(away).any(axis=1)
    if not some.any():
        return np.zeros(0), np.zeros(0, dtype=np.int64), math.inf
    away = away[some][:, np.isfinite(away).any(axis=0)]
    level = np.zeros(len(away))
    for _ in range(_POLISHED):
        own = np.nanmedian(away - level[:, None], axis=0)
        level = np.nanmedian(away - own, axis=1)
    return level, np.flatnonzero(some), float(np.median(m.of_main(m.sigma)[use]))


def better_model_effect(
    recordings: Sequence[Recording],
    likelihood: Likelihood,
    added: tuple[float, Sequence[TriedEffect]],
    settings: Settings,
) -> Effect | None:
    """The model's own effect with numbers that are better than all added effects; None without one.

    Parameters
    ----------
    recordings : sequence of (Model, Evidence)
        As given.
    likelihood : Likelihood
        Of them.
    added : (float, sequence of TriedEffect)
        Held-out log-likelihood with the added effects, and these effects.
    settings : Settings
        How.
    """
    value, chosen = added
    best, top = None, value - PRICE_NATS * sum(c.parameters for c in chosen) + CLEARLY_NATS
    searched = (e for e in likelihood.scene.effects if e.latent is Latent.NONE and e.kind in EFFECTS)
    for effect in dict.fromkeys(searched):  # recorded amplitudes are among the effects, but are no registered kind
        without = joint_likelihood([(_less(model, effect), evidence) for model, evidence in recordings])
        part = fit_part(without, settings)
        trial = begin_trial(without, begin(without, part[0], settings.tolerance), settings.split, settings.seed)
        for candidate in candidates(trial, (effect.kind,)):
            if name_of(candidate) != (effect.kind, getattr(effect, "surface", "")):
                continue
            score = trial.base + candidate.score
            if score > top:
                best, top = candidate.effect, score
    return best


def _less(model: Model, effect: Effect) -> Model:
    return replace(model, effects=tuple(e for e in model.effects if e != effect))
