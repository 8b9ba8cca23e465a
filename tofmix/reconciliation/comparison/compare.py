"""Step 1: compare a recording with a model by normal scores, and sum them up in a panel of statistics.

The score of a sample is its probability integral transform under the predicted distribution of its pixel, mapped to a
standard normal. If the model is right, scores are standard normal. `tofmix.reconciliation.comparison.panel` computes
the statistics of the scores.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.reconciliation.comparison.information import information_of
from tofmix.reconciliation.comparison.panel import Curve, discreteness, invalid, neighbours, panel_axes, shapes, widths
from tofmix.reconciliation.comparison.panel_between import bridging
from tofmix.reconciliation.comparison.panel_lines import lines
from tofmix.reconciliation.comparison.panel_time import burst_share, in_time
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import memory_of, one_surface, whitened
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.effects.pixel_crosstalk import PixelCrosstalk

FARTHEST_SCORE = np.float32(4.0)
"""Largest score in the statistics: one sample must not determine a fourth power."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """The statistics of a part's scores."""

    curves: tuple[Curve, ...]
    pattern: FloatArray  # (recording, pixel) mean score, NaN outside the part
    part: Part

    @property
    def gap(self) -> float:
        """Root mean square of the panel's distances; noise alone gives 1."""
        return float(np.sqrt(np.mean([c.distance**2 for c in self.curves])))


def compare(
    likelihood: Likelihood, state: ModelState, part: Part, *, seed: int, mixture: Mixture | None = None
) -> Compared:
    """Compare a part of a recording with a state.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    state : State
        The model with the effects added so far.
    part : (frames, pixels)
        Samples to compare. They must be held out of every fit, or the gap is too small. Each recording has separate
        curves.
    seed : int
        For the draws within cells of whole mm.
    mixture : Mixture, optional
        That of the state, if it was computed before.
    """
    m = likelihood.mixture(state) if mixture is None else mixture
    memory = memory_of(state)
    scored = (np.arange(likelihood.evidence.shape[0]), part[1]) if memory else part
    z = likelihood.scores(state, scored, seed, m)
    curves: list[Curve] = []
    pattern = np.full((len(likelihood.evidence.starts), likelihood.evidence.shape[1]), np.nan)
    for view in views(likelihood, m, part):
        own = z[view.frames] if not memory else whitened(z[view.frames], view.mixture, memory)
        own = np.clip(own[view.part[0]][:, view.part[1]], -FARTHEST_SCORE, FARTHEST_SCORE)
        gains = information_of(own, view.evidence, view.mixture, view.part)
        crossed = any(e.kind == PixelCrosstalk.kind for e in (*view.scene.effects, *state.effects))
        apart = _apart(own, view) if crossed else own
        curves += [
            replace(c.varying, recording=view.number, information=gains.get((c.statistic, c.axis)))
            for c in _curves(own, apart, view, state)
        ]
        with np.errstate(invalid="ignore"):
            pattern[view.number, part[1]] = np.nansum(own, axis=0) / np.maximum(np.isfinite(own).sum(axis=0), 1)
    return Compared(curves=tuple(curves), pattern=pattern, part=part)


def _apart(z: Float32Array, view: RecordingView) -> Float32Array:
    """Scores without pixels that see several surfaces, or that have such a neighbour.

    With crosstalk, neighbouring scores are correlated, because they show which surface was drawn.
    """
    alone = one_surface(view.mixture).reshape(view.evidence.image)
    framed = np.pad(alone, 1, mode="edge")
    alone = alone & framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return np.where(alone.ravel()[view.part[1]], z, np.float32(np.nan))


def _curves(z: Float32Array, apart: Float32Array, view: RecordingView, state: ModelState) -> Iterator[Curve]:
    """The panel of one recording's scores (frame, pixel); `apart` are the scores for correlations."""
    evidence, m, part = view.evidence, view.mixture, view.part
    axes = list(panel_axes(evidence, m, part))
    yield from shapes(z, axes, m, state, part, view.number)
    yield from widths(state, view.scene.model.sensor.noise.width_spread, view.number)
    yield from in_time(apart, evidence, part, m)
    if state.bursts is not None:
        yield from burst_share(state.disturbed[view.frames], state.bursts)
    yield from invalid(evidence, m, state, axes, part)
    yield from neighbours(apart, evidence, part)
    yield from lines(apart, evidence, part)
    yield from bridging(evidence, m, state, axes, part)
    yield from discreteness(evidence, part, m, state)
