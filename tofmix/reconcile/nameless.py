"""Step 5's nameless rivals: smooth laws of place or range, which no effect is, against the biases that were named.

The nearest effect takes up most of a law that it is not: a lens that bends range outwards looks like a walk with
amplitude, a scale that is off like a wiggling. So smooth laws compete with the effects that move each pixel by itself,
as those did among themselves: fitted to the same data, paying for their numbers, and scored on what no fit has seen.
A fixed pattern among the effects is put under the law too, so that it tips no scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconcile import links
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.mixture import Mixture
from tofmix.reconcile.name import PRICE_NATS, Candidate
from tofmix.reconcile.pixel_pattern import marginal_pattern, pixel_biases
from tofmix.simulation.effects.fixed_pattern import FixedPattern

STATIC = (
    "range_offset", "surface_pose", "wiggling", "amplitude_walk", "scattering", "multipath", FixedPattern.kind,
)  # fmt: skip
"""Kinds that give each pixel a bias that stays."""

CLEARLY_NATS = 6.0
CLEARLY_SHARE = 0.0003
"""By how much a law must beat the effects: at least so many nats, and this share of what they gained, as no effect's
law is exact."""


def better_law(
    likelihood: Likelihood, state: State, chosen: Sequence[Candidate], parts: tuple[Part, Part]
) -> str | None:
    """The axis of a smooth law that beats the static effects that were named; None if none does.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recording.
    state : State
        The refined model.
    chosen : sequence of Candidate
        Its effects, in its order.
    parts : two of (frames, pixels)
        What fits may see, and what they may not, of all pixels: laws of few numbers need none held out.
    """
    static = [c for c in chosen if c.kind in STATIC]
    if not static:
        return None
    patterned = any(c.kind == FixedPattern.kind for c in static)
    bare = replace(state, pixel_bias=np.zeros_like(state.pixel_bias), pixel_variance=np.zeros_like(state.pixel_bias))
    named = replace(bare, effects=tuple(e for e in state.effects if e.kind != FixedPattern.kind))
    rest = replace(bare, effects=tuple(e for e in state.effects if e.kind not in STATIC))
    price = PRICE_NATS * sum(c.parameters for c in static if c.kind != FixedPattern.kind)
    nothing = _worth(likelihood, rest, parts, patterned=False)
    worth = _worth(likelihood, named, parts, patterned=patterned) - price
    needed = worth + max(CLEARLY_NATS, CLEARLY_SHARE * (worth - nothing))
    found = {
        axis: _worth(likelihood, _bent(likelihood, rest, columns, parts[0]), parts, patterned=patterned)
        - PRICE_NATS * columns.shape[1]
        for axis, columns in _laws(likelihood, likelihood.scene.mixture(rest.effects)).items()
    }
    best = max(found, key=lambda axis: found[axis])
    return best if found[best] > needed else None


def _laws(likelihood: Likelihood, mixture: Mixture) -> Mapping[str, FloatArray]:
    """The numbers (pixel, n) by which each law is linear: polynomials of second degree."""
    rows, cols = likelihood.evidence.image
    row, col = np.divmod(np.arange(rows * cols), cols)
    v, u = 2 * row / max(rows - 1, 1) - 1, 2 * col / max(cols - 1, 1) - 1
    laws = {"place in the image": np.stack([np.ones(rows * cols), u, v, u * u, u * v, v * v], axis=1)}
    if len(likelihood.scene.members) == 1:
        range_mm = mixture.of_main(mixture.true_range)
        lit = mixture.of_main(mixture.lit).astype(bool)
        if lit.any():
            low, high = float(range_mm[lit].min()), float(range_mm[lit].max())
            r = 2 * (range_mm - low) / max(high - low, 1.0) - 1
            laws["range"] = np.where(lit[:, None], np.stack([np.ones(r.size), r, r * r], axis=1), 0.0)
    return laws


def _bent(likelihood: Likelihood, state: State, columns: FloatArray, part: Part) -> State:
    """The state with the law that fits best as its pixels' bias."""
    mixture = likelihood.scene.mixture(state.effects)
    for _ in range(2):
        found = pixel_biases(likelihood, mixture, state, part)
        weighed = columns * found.information[:, None]
        numbers = np.linalg.lstsq(columns.T @ weighed, weighed.T @ found.bias, rcond=None)[0]
        state = replace(state, pixel_bias=state.pixel_bias + columns @ numbers)
    return state


def _worth(likelihood: Likelihood, state: State, parts: tuple[Part, Part], *, patterned: bool) -> float:
    """Log-likelihood of what no fit has seen, a pattern integrated out."""
    fit, test = parts
    mixture = likelihood.scene.mixture(state.effects)
    worth = likelihood.value(state, test, mixture)
    pattern = links.fit_pattern(likelihood, mixture, state, fit) if patterned else None
    if pattern is not None:
        effect = pattern[0]
        spreads = (effect.pixel_sigma_mm, effect.column_sigma_mm, effect.row_sigma_mm)
        biases = pixel_biases(likelihood, mixture, state, test)
        worth += marginal_pattern(biases, likelihood.evidence.image, spreads)[0]
    return worth
