"""Step 5, first rivals: smooth laws of place or range that are no known effect, for the named biases.

The nearest effect imitates most of an unknown law: a lens that bends range looks like an amplitude walk, a wrong scale
like a wiggling. So smooth laws compete with the static effects. They are fitted to the same data, have a price for each
number, and are scored on held-out data. If the effects include a fixed pattern, the laws have one too, so that it gives
no advantage.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases
from tofmix.reconciliation.parameters.pattern_errors import pattern_of
from tofmix.reconciliation.search.name import PRICE_NATS, TriedEffect
from tofmix.reconciliation.search.pattern_fits import settled_within, worth
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.base import Target
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.temperature_drift import TemperatureDrift

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
    state : State
        The refined model.
    chosen : sequence of Candidate
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
    bare = replace(state, pixel_bias=np.zeros_like(state.pixel_bias), pixel_variance=np.zeros_like(state.pixel_bias))
    named = replace(bare, effects=tuple(e for e in state.effects if e.kind != FixedPattern.kind))
    rest = replace(bare, effects=tuple(e for e in state.effects if not _stays(e, duration)))
    # A law without a name may replace the named effects, so the price grows with the number of samples (BIC)
    each = max(PRICE_NATS, 0.5 * math.log(max(len(parts[1][0]) * len(parts[1][1]), 1)))
    price = each * sum(c.parameters for c in static if c.kind != FixedPattern.kind)
    others = [c for c in chosen if c.kind != FixedPattern.kind]
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
    return effect.target is Target.BIAS or (
        isinstance(effect, TemperatureDrift) and effect.time_constant_s < _SOON * duration_s
    )


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
